"""Roll, pitch and gyroscope bias from inertial samples alone, at rest where possible and on the move where not."""

from math import atan2, dist, hypot, sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shared.maths.earth import STANDARD_GRAVITY
from shared.maths.rotation import (
    Quaternion,
    Vector,
    ned_from_body,
    quaternion_from_matrix,
    quaternion_from_rotation_vector,
    quaternion_product,
)

from ..filter.strapdown import normalised, rotate
from ..settings import Settings

FloatArray = npt.NDArray[np.float64]

BLOCK_S = 0.5
SPREAD_LIMIT = 2.0  # [m/s²] standard deviation within a block, of which an idling engine makes 0.7
FORCE_CHANGE_LIMIT = 0.06  # [m/s²] of a block's mean against the mean so far, and
RATE_CHANGE_LIMIT = 0.004  # [rad/s] for the rate, each with
SPREAD_SHARE = 0.2  # of the standard deviation of the samples, but no more than
LARGEST_FORCE_CHANGE, LARGEST_RATE_CHANGE = 0.2, 0.008  # [m/s²], [rad/s]
RATE_LIMIT = 0.095  # [rad/s] of a block's mean: the bias at switch-on
REST_S = 2.0  # blocks that agree for so long are a rest
BIAS_CHANGE_LIMIT = 0.0015  # [rad/s] from rest to rest; a shorter one that differs by more was a creep
LEVEL_FORCE_LIMIT = 0.15  # [m/s²] by which it may differ from the attitude kept since; beyond it was even acceleration
LEVEL_DRIFT = 0.002  # [m/s³] by which that attitude tilts
WEIGHT_LIMIT = 0.3  # [m/s²] of the mean force at rest against gravity
MOTION_S = 3.0  # of motion without a rest, after which levelling goes on while navigating
MOTION_TILT_SD = 0.05  # [rad] a car's acceleration against gravity
REST_TILT_SD = 0.001  # [rad] apart from the accelerometer's bias
SLOW_S = 30.0  # time constant of levelling on the move
LEAN_PSD = 0.025  # [rad² s] of the vehicle's own accelerations over gravity, when it is levelled by its mean force
FAST_M_S = 0.5  # [m/s] a vehicle that GNSS sees as fast as this does not rest
FAST_S = 1.5  # how long that observation holds


def level(force: Vector) -> tuple[float, float]:
    """Roll and pitch of a body at rest.

    Parameters
    ----------
    force : tuple of float
        [m/s², body] Mean specific force.

    Returns
    -------
    tuple of float
        [rad] Roll and pitch; a bias of 2 mg tilts them by 0.115 degrees.

    Notes
    -----
    ::

        roll = atan2(-f_y, -f_z),   pitch = atan(f_x / sqrt(f_y² + f_z²))

    References
    ----------
    P. Groves, 2nd ed., eq. 5.101.
    """
    x, y, z = force
    return atan2(-y, -z), atan2(x, hypot(y, z))


def rest_gyroscope_bias(mean_rate: Vector, ned_from_body_at_rest: FloatArray, earth_rate: Vector) -> Vector:
    """Bias of a gyroscope at rest [rad/s, body]: mean(w) - C^T w_ie."""
    x, y, z = (np.array(mean_rate) - ned_from_body_at_rest.T @ np.array(earth_rate)).tolist()
    return x, y, z


class _Rest(NamedTuple):
    """Mean of successive blocks that agree with each other."""

    force: Vector = (0.0, 0.0, 0.0)
    rate: Vector = (0.0, 0.0, 0.0)
    length_s: float = 0.0

    def agrees(self, block: "_Block") -> bool:
        if self.length_s == 0.0:
            return True
        force_limit = min(FORCE_CHANGE_LIMIT + SPREAD_SHARE * block.force_spread(), LARGEST_FORCE_CHANGE)
        rate_limit = min(RATE_CHANGE_LIMIT + SPREAD_SHARE * block.rate_spread(), LARGEST_RATE_CHANGE)
        mean = block.mean()
        return dist(self.force, mean.force) < force_limit and dist(self.rate, mean.rate) < rate_limit

    def with_block(self, block: "_Rest", longest_s: float) -> "_Rest":
        """Mean with one more block; beyond the longest time the oldest is forgotten."""
        share = block.length_s / min(self.length_s + block.length_s, longest_s)
        length_s = self.length_s + block.length_s
        return _Rest(_blend(self.force, block.force, share), _blend(self.rate, block.rate, share), length_s)


class Levelling:
    """Attitude against a level frame whose north is arbitrary, from the first sample on.

    At rest (half seconds that agree with each other) it averages force and rate. While the vehicle drives, it
    turns with the gyroscope, levels slowly, and sums up the velocity gained since the rest.
    """

    def __init__(
        self, settings: Settings, quaternion: Quaternion | None = None, bias: Vector = (0.0, 0.0, 0.0)
    ) -> None:
        self.quaternion = quaternion or (1.0, 0.0, 0.0, 0.0)  # level frame from body
        self.ready = quaternion is not None
        self.rate_bias = bias  # [rad/s, body] mean rate of the last rest: gyroscope bias and the Earth's rate
        self.quaternion_at_rest: Quaternion | None = None  # of the rest that `rate_bias` is from
        self.velocity = (0.0, 0.0)  # [m/s, level frame] gained since the last rest
        self.before = (0.0, 0.0)  # [m/s, level frame] gained up to then, and what levelling has kept from it
        self._leant = (0.0, 0.0)  # [m/s²] that levelling has taken for tilt so far
        self.way = 0j  # [m, level frame, north + i east] by that velocity, since the last rest
        self.ahead = 0j  # [s, likewise] integral of the direction of the nose
        self.moving_s = 0.0  # since the last rest
        self.yaw_at_start: float | None = None  # in the level frame, of a vehicle that stood when all this began
        self.rate: Vector = (0.0, 0.0, 0.0)  # [rad/s, body] last sample, mean rate of the rest removed
        self._started, self._bias_before = self.ready, bias
        self.turn_rate_sd = 0.0 if quaternion else settings.imu.gyroscope_bias_sd_rad_s  # [rad/s] of an unmeasured bias
        self.drift = Drift(bias=self.turn_rate_sd**2)  # of levelling on the move
        self._longest_s = 0.0  # of all rests
        self._elapsed_s = SLOW_S if self.ready else 0.0
        self._unrest_s = 0.0
        self._fast_s = 0.0
        self._rest = _Rest()
        self._block = _Block()
        self._levelling_s = settings.alignment.levelling_s

    @property
    def at_rest(self) -> bool:
        """Whether the vehicle has not moved for a while."""
        rest = self._rest
        if rest.length_s < REST_S or abs(hypot(*rest.force) - STANDARD_GRAVITY) > WEIGHT_LIMIT:
            return False
        if self.quaternion_at_rest is None or rest.length_s > self._longest_s:
            return True
        north, east, _ = rotate(self.quaternion, rest.force)
        level = hypot(north, east) < LEVEL_FORCE_LIMIT + LEVEL_DRIFT * self.moving_s
        return level and dist(rest.rate, self.rate_bias) < BIAS_CHANGE_LIMIT

    @property
    def rest_s(self) -> float:
        """How long the samples have looked like a rest."""
        return self._rest.length_s

    @property
    def tilt_sd(self) -> float:
        """Standard deviation of roll and pitch [rad], apart from the biases."""
        if self.quaternion_at_rest is None:
            return max(MOTION_TILT_SD, sqrt(self.drift.tilt))
        return REST_TILT_SD + 2e-4 * self.moving_s

    def turn_sd(self, span_s: float) -> float:
        """By how much the level frame may have turned in a time [rad] for a bias that no rest has measured."""
        return self.turn_rate_sd * min(span_s, self.moving_s) if self.quaternion_at_rest is None else 0.0

    @property
    def yaw(self) -> float:
        """Yaw in the level frame [rad]."""
        w, x, y, z = self.quaternion
        return atan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))

    def see_speed(self, speed: float) -> None:
        """Take note of a speed [m/s] that GNSS measured."""
        self._fast_s = FAST_S if speed > FAST_M_S else 0.0

    def forget_rest(self) -> None:
        """Discard a standstill that was none: by GNSS the vehicle moved at constant velocity."""
        self._unrest_s += self._rest.length_s
        self._rest, self._longest_s, self._fast_s = _Rest(), 0.0, FAST_S
        self.quaternion_at_rest, self.rate_bias, self.yaw_at_start = None, self._bias_before, None

    def advance(self, force: Vector, rate: Vector, step_s: float) -> None:
        """Take one sample in [m/s², rad/s; body]."""
        if not self._started:
            self.quaternion = quaternion_from_matrix(ned_from_body(*level(force), 0.0))
            self._started = True
        x, y, z = self.rate_bias
        self.rate = (rate[0] - x, rate[1] - y, rate[2] - z)
        turn = (self.rate[0] * step_s, self.rate[1] * step_s, self.rate[2] * step_s)
        self.quaternion = normalised(quaternion_product(self.quaternion, quaternion_from_rotation_vector(turn)))
        north, east, _ = rotate(self.quaternion, force)
        self._elapsed_s += step_s
        self.moving_s += step_s
        self.velocity = (self.velocity[0] + north * step_s, self.velocity[1] + east * step_s)
        self.way += step_s * complex(*self.velocity)
        w, x, y, z = self.quaternion
        self.ahead += step_s * complex(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z))
        if self.quaternion_at_rest is None:
            self._level_slowly(north, east, step_s)
        self._block = self._block.with_sample(force, rate, step_s)
        if self._block.length_s >= BLOCK_S - 1e-9:
            self._close(self._block)
            self._block = _Block()

    def _level_slowly(self, north: float, east: float, step_s: float) -> None:
        """Align the vertical of the level frame with the mean specific force, and learn the horizontal biases."""
        self.drift, gain, bias_gain = self.drift.after(step_s)
        share = gain / STANDARD_GRAVITY
        correction = quaternion_from_rotation_vector((-east * share, north * share, 0.0))
        self.quaternion = normalised(quaternion_product(correction, self.quaternion))
        w, i, j, k = self.quaternion
        seen = -bias_gain / STANDARD_GRAVITY
        x, y, z = rotate((w, -i, -j, -k), (east * seen, -north * seen, 0.0))
        bx, by, bz = self.rate_bias
        self.rate_bias = (bx + x, by + y, bz + z)
        (a, b), (x, y) = self._leant, self.before
        self._leant = a + STANDARD_GRAVITY * share * north, b + STANDARD_GRAVITY * share * east
        self.before = x + a * step_s, y + b * step_s

    def _close(self, block: "_Block") -> None:
        """Decide whether the last half second was rest."""
        mean = block.mean()
        self._fast_s = max(0.0, self._fast_s - mean.length_s)
        calm = block.force_spread() < SPREAD_LIMIT and max(map(abs, mean.rate)) < RATE_LIMIT and self._fast_s == 0.0
        if calm and self._rest.agrees(block):
            self._rest = self._rest.with_block(mean, self._levelling_s)
        else:
            self._rest = _Rest().with_block(mean, self._levelling_s) if calm else _Rest()
            self._unrest_s += mean.length_s
        if self.at_rest:
            self._settle()
        drove_off = self.quaternion_at_rest is not None and not self.at_rest
        self.ready = self.ready or drove_off or self._rest.length_s >= self._levelling_s or self._unrest_s >= MOTION_S

    def _settle(self) -> None:
        """Adopt what the rest has taught."""
        self.rate_bias = self._rest.rate
        self._longest_s = max(self._longest_s, self._rest.length_s)
        self.quaternion = quaternion_from_matrix(ned_from_body(*level(self._rest.force), self.yaw))
        self.quaternion_at_rest = self.quaternion
        if self.yaw_at_start is None and self._unrest_s < MOTION_S:  # doors and starters shake, too
            self.yaw_at_start = self.yaw
        (north, east), (x, y) = self.velocity, self.before
        self.before = (x + north, y + east)
        self.velocity, self.way, self.moving_s = (0.0, 0.0), 0j, 0.0


class Drift(NamedTuple):
    """Covariance of tilt and horizontal gyroscope bias, alike about both level axes, of levelling on the move.

    A Kalman filter of psi, the error of the tilt, and beta, that of the bias, which takes the vehicle's own
    accelerations for white noise of PSD r on the tilt. Without a bias its gain is 1/t at first, and then 1/(30 s)::

        psi' = -beta + noise of PSD r / (30 s)²,    z = psi + noise of PSD r
    """

    tilt: float = 1.0  # [rad²]
    both: float = 0.0  # [rad²/s]
    bias: float = 0.0  # [rad²/s²]

    def after(self, step_s: float) -> "tuple[Drift, float, float]":
        """Predict and correct over a step: the covariance, and the gains of tilt [-] and bias [1/s]."""
        tilt = self.tilt - 2.0 * self.both * step_s + self.bias * step_s**2 + LEAN_PSD * step_s / SLOW_S**2
        both = self.both - self.bias * step_s
        total = tilt + LEAN_PSD / step_s
        gain, bias_gain = tilt / total, both / total
        return Drift((1.0 - gain) * tilt, (1.0 - gain) * both, self.bias - bias_gain * both), gain, bias_gain


class _Block(NamedTuple):
    """Sums over half a second of samples."""

    samples: int = 0
    length_s: float = 0.0
    force: Vector = (0.0, 0.0, 0.0)
    rate: Vector = (0.0, 0.0, 0.0)
    force_square: float = 0.0
    rate_square: float = 0.0

    def with_sample(self, force: Vector, rate: Vector, step_s: float) -> "_Block":
        (a, b, c), (x, y, z) = self.force, self.rate
        return _Block(
            self.samples + 1,
            self.length_s + step_s,
            (a + force[0], b + force[1], c + force[2]),
            (x + rate[0], y + rate[1], z + rate[2]),
            self.force_square + force[0] ** 2 + force[1] ** 2 + force[2] ** 2,
            self.rate_square + rate[0] ** 2 + rate[1] ** 2 + rate[2] ** 2,
        )

    def mean(self) -> _Rest:
        (a, b, c), (x, y, z), n = self.force, self.rate, self.samples
        return _Rest((a / n, b / n, c / n), (x / n, y / n, z / n), self.length_s)

    def force_spread(self) -> float:
        """Root of the summed variances of the three axes [m/s²]."""
        return _spread(self.force_square / self.samples, self.mean().force)

    def rate_spread(self) -> float:
        """The same of the rate [rad/s]."""
        return _spread(self.rate_square / self.samples, self.mean().rate)


def _spread(mean_square: float, mean: Vector) -> float:
    x, y, z = mean
    return sqrt(max(0.0, mean_square - (x * x + y * y + z * z)))


def _blend(old: Vector, new: Vector, share: float) -> Vector:
    (a, b, c), (x, y, z) = old, new
    return a + share * (x - a), b + share * (y - b), c + share * (z - c)

"""Levelling: roll, pitch and gyroscope bias from inertial samples alone, at standstill or on the move."""

from math import atan2, dist, hypot, sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shared.inertial.strapdown import normalised, rotate
from shared.maths.earth import STANDARD_GRAVITY
from shared.maths.rotation import (
    Quaternion,
    Vector,
    ned_from_body,
    quaternion_from_matrix,
    quaternion_from_rotation_vector,
    quaternion_product,
)

from ..settings import Settings

FloatArray = npt.NDArray[np.float64]

BLOCK_S = 0.5  # length of a block of samples
SPREAD_LIMIT = 2.0  # [m/s²] largest standard deviation within a block at standstill; an idling engine makes 0.7
FORCE_CHANGE_LIMIT = 0.06  # [m/s²] largest difference of a block's mean force from that of the standstill so far
RATE_CHANGE_LIMIT = 0.004  # [rad/s] largest difference of its mean rate
SPREAD_SHARE = 0.2  # of the standard deviation within the block, by which both limits grow
LARGEST_FORCE_CHANGE, LARGEST_RATE_CHANGE = 0.2, 0.008  # [m/s²], [rad/s] upper limits of both
RATE_LIMIT = 0.095  # [rad/s] largest mean rate of a block at standstill: the bias at switch-on
STANDSTILL_S = 2.0  # shortest standstill
BIAS_CHANGE_LIMIT = 0.0015  # [rad/s] largest change of the mean rate between standstills, unless the later is longer
LEVEL_FORCE_LIMIT = 0.15  # [m/s²] largest horizontal mean force at standstill, by the propagated attitude
LEVEL_DRIFT = 0.002  # [m/s³] growth of that limit with time, by the tilt error of this attitude
WEIGHT_LIMIT = 0.3  # [m/s²] largest difference of the mean force at standstill from gravity
MOTION_S = 3.0  # time of motion without a standstill after which levelling is left to the filter
MOTION_TILT_SD = 0.05  # [rad] tilt error by the accelerations of a car
STANDSTILL_TILT_SD = 0.001  # [rad] without the part of the accelerometer bias
MOTION_LEVELLING_S = 30.0  # time constant of levelling on the move
ACCELERATION_TILT_PSD = 0.025  # [rad² s] PSD of the vehicle's accelerations over gravity
MOVING_M_S = 0.5  # [m/s] GNSS speed above which the vehicle is not at standstill
MOVING_S = 1.5  # time for which such a speed excludes a standstill


def level(force: Vector) -> tuple[float, float]:
    """Roll and pitch of a body at standstill.

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


def standstill_gyroscope_bias(mean_rate: Vector, C: FloatArray, earth_rate: Vector) -> Vector:
    """Gyroscope bias at standstill [rad/s, body]: mean(w) - C^T w_ie, with the attitude C (NED from body)."""
    x, y, z = (np.array(mean_rate) - C.T @ np.array(earth_rate)).tolist()
    return x, y, z


class _Mean(NamedTuple):
    """Mean of force and rate over a standstill or over one block."""

    force: Vector = (0.0, 0.0, 0.0)
    rate: Vector = (0.0, 0.0, 0.0)
    length_s: float = 0.0

    def agrees(self, block: "_Block") -> bool:
        """Whether a block continues this standstill."""
        if self.length_s == 0.0:
            return True
        force_limit = min(FORCE_CHANGE_LIMIT + SPREAD_SHARE * block.force_spread(), LARGEST_FORCE_CHANGE)
        rate_limit = min(RATE_CHANGE_LIMIT + SPREAD_SHARE * block.rate_spread(), LARGEST_RATE_CHANGE)
        mean = block.mean()
        return dist(self.force, mean.force) < force_limit and dist(self.rate, mean.rate) < rate_limit

    def with_block(self, block: "_Mean", longest_s: float) -> "_Mean":
        """Mean with one more block; beyond the longest time older blocks are weighted less."""
        share = block.length_s / min(self.length_s + block.length_s, longest_s)
        length_s = self.length_s + block.length_s
        return _Mean(_blend(self.force, block.force, share), _blend(self.rate, block.rate, share), length_s)


class Levelling:
    """Attitude against a level frame of arbitrary azimuth, from the first sample on.

    At standstill (successive blocks of half a second that agree) it averages force and rate. On the move it integrates
    the rate, aligns the vertical slowly with the mean force, and integrates the velocity gained since the standstill.

    Parameters
    ----------
    settings : Settings
        For the longest standstill and the standard deviation of the gyroscope bias.
    quaternion : tuple of float, optional
        Level frame from body, if the attitude is known.
    bias : tuple of float
        [rad/s, body] Gyroscope bias, if the attitude is known.
    tilt_variance : float
        [rad²] Of roll and pitch.
    """

    def __init__(
        self,
        settings: Settings,
        quaternion: Quaternion | None = None,
        bias: Vector = (0.0, 0.0, 0.0),
        tilt_variance: float = 1.0,
    ) -> None:
        self.quaternion = quaternion or (1.0, 0.0, 0.0, 0.0)  # level frame from body
        self.ready = quaternion is not None
        self.rate_bias = bias  # [rad/s, body] mean rate of the last standstill: gyroscope bias and Earth rate
        self.standstill_quaternion: Quaternion | None = None  # attitude of that standstill
        self.velocity = (0.0, 0.0)  # [m/s, level frame] gained since the last standstill
        self.velocity_before = (0.0, 0.0)  # [m/s, level frame] gained before, and removed by levelling on the move
        self._levelled_force = (0.0, 0.0)  # [m/s²] horizontal force that levelling on the move has taken for tilt
        self.displacement = 0j  # [m, level frame, north + i east] integral of `velocity` since the last standstill
        self.heading_integral = 0j  # [s, level frame, north + i east] integral of the direction of the x axis
        self.moving_s = 0.0  # time since the last standstill
        self.yaw_at_start: float | None = None  # [rad, level frame] at a standstill at the start
        self.rate: Vector = (0.0, 0.0, 0.0)  # [rad/s, body] last sample, minus `rate_bias`
        self._started, self._bias_before = self.ready, bias
        self.yaw_rate_sd = 0.0 if quaternion else settings.imu.gyroscope_bias_sd_rad_s  # [rad/s] of an unmeasured bias
        self.covariance = LevellingCovariance(tilt=tilt_variance, bias=self.yaw_rate_sd**2)
        self._longest_standstill_s = 0.0
        self._motion_s = 0.0  # time of all blocks without standstill
        self._gnss_moving_s = 0.0  # remaining time for which a GNSS speed excludes a standstill
        self._standstill = _Mean()
        self._block = _Block()
        self._levelling_s = settings.alignment.levelling_s

    @property
    def is_stationary(self) -> bool:
        """Whether the vehicle has been at standstill for `STANDSTILL_S`."""
        mean = self._standstill
        if mean.length_s < STANDSTILL_S or abs(hypot(*mean.force) - STANDARD_GRAVITY) > WEIGHT_LIMIT:
            return False
        if self.standstill_quaternion is None or mean.length_s > self._longest_standstill_s:
            return True
        north, east, _ = rotate(self.quaternion, mean.force)
        level = hypot(north, east) < LEVEL_FORCE_LIMIT + LEVEL_DRIFT * self.moving_s
        return level and dist(mean.rate, self.rate_bias) < BIAS_CHANGE_LIMIT

    @property
    def has_stood(self) -> bool:
        """Whether the vehicle stands, and has not moved since the first sample."""
        return self.is_stationary and self.yaw_at_start is not None and self._motion_s < MOTION_S

    @property
    def standstill_s(self) -> float:
        """Time for which successive blocks have agreed."""
        return self._standstill.length_s

    @property
    def tilt_sd(self) -> float:
        """Standard deviation of roll and pitch [rad], without the part of the accelerometer bias."""
        if self.standstill_quaternion is None:
            return max(MOTION_TILT_SD, sqrt(self.covariance.tilt))
        return STANDSTILL_TILT_SD + 2e-4 * self.moving_s

    def yaw_drift_sd(self, span_s: float) -> float:
        """Standard deviation [rad] of the level frame's rotation over a time, by an unmeasured gyroscope bias."""
        return self.yaw_rate_sd * min(span_s, self.moving_s) if self.standstill_quaternion is None else 0.0

    @property
    def yaw(self) -> float:
        """Yaw in the level frame [rad]."""
        w, x, y, z = self.quaternion
        return atan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))

    def use_speed(self, speed: float) -> None:
        """Use a GNSS speed [m/s]: a moving vehicle is not at standstill."""
        self._gnss_moving_s = MOVING_S if speed > MOVING_M_S else 0.0

    def discard_standstill(self) -> None:
        """Discard the standstill: by GNSS positions the vehicle moved at constant velocity."""
        self._motion_s += self._standstill.length_s
        self._standstill, self._longest_standstill_s, self._gnss_moving_s = _Mean(), 0.0, MOVING_S
        self.standstill_quaternion, self.rate_bias, self.yaw_at_start = None, self._bias_before, None

    def advance(self, force: Vector, rate: Vector, step_s: float) -> None:
        """Use one sample [m/s², rad/s; body]."""
        if not self._started:
            self.quaternion = quaternion_from_matrix(ned_from_body(*level(force), 0.0))
            self._started = True
        x, y, z = self.rate_bias
        self.rate = (rate[0] - x, rate[1] - y, rate[2] - z)
        rotation = (self.rate[0] * step_s, self.rate[1] * step_s, self.rate[2] * step_s)
        self.quaternion = normalised(quaternion_product(self.quaternion, quaternion_from_rotation_vector(rotation)))
        north, east, _ = rotate(self.quaternion, force)
        self.moving_s += step_s
        self.velocity = (self.velocity[0] + north * step_s, self.velocity[1] + east * step_s)
        self.displacement += step_s * complex(*self.velocity)
        w, x, y, z = self.quaternion
        self.heading_integral += step_s * complex(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z))
        if self.standstill_quaternion is None:
            self._level_on_the_move(north, east, step_s)
        self._block = self._block.with_sample(force, rate, step_s)
        if self._block.length_s >= BLOCK_S - 1e-9:
            self._end_block(self._block)
            self._block = _Block()

    def _level_on_the_move(self, north: float, east: float, step_s: float) -> None:
        """Correct tilt and horizontal gyroscope bias by the horizontal specific force [m/s²]."""
        self.covariance, gain, bias_gain = self.covariance.after(step_s)
        share = gain / STANDARD_GRAVITY
        correction = quaternion_from_rotation_vector((-east * share, north * share, 0.0))
        self.quaternion = normalised(quaternion_product(correction, self.quaternion))
        w, i, j, k = self.quaternion
        bias_share = -bias_gain / STANDARD_GRAVITY
        x, y, z = rotate((w, -i, -j, -k), (east * bias_share, -north * bias_share, 0.0))
        bx, by, bz = self.rate_bias
        self.rate_bias = (bx + x, by + y, bz + z)
        (a, b), (x, y) = self._levelled_force, self.velocity_before
        self._levelled_force = a + STANDARD_GRAVITY * share * north, b + STANDARD_GRAVITY * share * east
        self.velocity_before = x + a * step_s, y + b * step_s

    def _end_block(self, block: "_Block") -> None:
        """Decide whether the last half second belongs to a standstill."""
        mean = block.mean()
        self._gnss_moving_s = max(0.0, self._gnss_moving_s - mean.length_s)
        slow = max(map(abs, mean.rate)) < RATE_LIMIT and self._gnss_moving_s == 0.0
        calm = slow and block.force_spread() < SPREAD_LIMIT
        if calm and self._standstill.agrees(block):
            self._standstill = self._standstill.with_block(mean, self._levelling_s)
        else:
            self._standstill = _Mean().with_block(mean, self._levelling_s) if calm else _Mean()
            self._motion_s += mean.length_s
        if self.is_stationary:
            self._use_standstill()
        moved_off = self.standstill_quaternion is not None and not self.is_stationary
        long_enough = self._standstill.length_s >= self._levelling_s
        self.ready = self.ready or moved_off or long_enough or self._motion_s >= MOTION_S

    def _use_standstill(self) -> None:
        """Set roll, pitch and gyroscope bias to the means of the standstill."""
        self.rate_bias = self._standstill.rate
        self._longest_standstill_s = max(self._longest_standstill_s, self._standstill.length_s)
        self.quaternion = quaternion_from_matrix(ned_from_body(*level(self._standstill.force), self.yaw))
        self.standstill_quaternion = self.quaternion
        if self.yaw_at_start is None and self._motion_s < MOTION_S:  # doors and the starter disturb a few blocks
            self.yaw_at_start = self.yaw
        (north, east), (x, y) = self.velocity, self.velocity_before
        self.velocity_before = (x + north, y + east)
        self.velocity, self.displacement, self.moving_s = (0.0, 0.0), 0j, 0.0


class LevellingCovariance(NamedTuple):
    """Covariance of tilt and horizontal gyroscope bias, equal about both level axes, of levelling on the move.

    A Kalman filter of psi, the tilt error, and beta, the bias error; the vehicle's accelerations are white noise of PSD
    r on the measured tilt. Without a bias its gain is 1/t at first, and then 1/(30 s)::

        psi' = -beta + noise of PSD r / (30 s)²,    z = psi + noise of PSD r
    """

    tilt: float = 1.0  # [rad²]
    cross: float = 0.0  # [rad²/s]
    bias: float = 0.0  # [rad²/s²]

    def after(self, step_s: float) -> "tuple[LevellingCovariance, float, float]":
        """Covariance after prediction and correction over a step, and the gains of tilt [-] and bias [1/s]."""
        noise = ACCELERATION_TILT_PSD * step_s / MOTION_LEVELLING_S**2
        tilt = self.tilt - 2.0 * self.cross * step_s + self.bias * step_s**2 + noise
        cross = self.cross - self.bias * step_s
        total = tilt + ACCELERATION_TILT_PSD / step_s
        gain, bias_gain = tilt / total, cross / total
        covariance = LevellingCovariance((1.0 - gain) * tilt, (1.0 - gain) * cross, self.bias - bias_gain * cross)
        return covariance, gain, bias_gain


class _Block(NamedTuple):
    """Sums over the samples of half a second."""

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

    def mean(self) -> _Mean:
        (a, b, c), (x, y, z), n = self.force, self.rate, self.samples
        return _Mean((a / n, b / n, c / n), (x / n, y / n, z / n), self.length_s)

    def force_spread(self) -> float:
        """Root of the summed variances of the three axes [m/s²]."""
        return _spread(self.force_square / self.samples, self.mean().force)

    def rate_spread(self) -> float:
        """Root of the summed variances of the three axes [rad/s]."""
        return _spread(self.rate_square / self.samples, self.mean().rate)


def _spread(mean_square: float, mean: Vector) -> float:
    x, y, z = mean
    return sqrt(max(0.0, mean_square - (x * x + y * y + z * z)))


def _blend(old: Vector, new: Vector, share: float) -> Vector:
    (a, b, c), (x, y, z) = old, new
    return a + share * (x - a), b + share * (y - b), c + share * (z - c)

"""Inertial samples as increments of 100 ms, and the mechanisation that propagates attitude and velocity by them."""

from collections import Counter
from dataclasses import dataclass
from math import isfinite

import numpy as np
import numpy.typing as npt

from shared.maths.earth import earth_rate_n, gravity, transport_rate_n
from shared.maths.rotation import Vector, matrix_from_quaternion, quaternion_from_rotation_vector, skew

FloatArray = npt.NDArray[np.float64]

SECOND_NS = 1_000_000_000
PERIOD_NS = 100_000_000  # of the increments
GAP_NS = 100_000_000  # between two samples, beyond which the motion between them is not known


@dataclass(frozen=True)
class Increment:
    """Integrals of specific force and angular rate over 100 ms; the first of a contiguous run follows a gap."""

    start_ns: int
    end_ns: int
    force_b: FloatArray  # shape (3,) [m/s, body at the start] integral of the specific force, rotation compensated
    rotation: FloatArray  # shape (3, 3) body at the start from body at the end
    rate_b: FloatArray  # shape (3,) [rad/s, body] mean
    excess_force: float  # [m/s²] magnitude of the mean specific force minus standard gravity
    after_gap: bool

    @property
    def duration(self) -> float:
        """Length [s]."""
        return (self.end_ns - self.start_ns) / SECOND_NS


class Decimator:
    """Integrates samples into increments, which end with the first sample at or after each multiple of 100 ms.

    A sample is the mean over the interval since the one before. Samples that are not newer are rejected and counted.
    """

    def __init__(self) -> None:
        self.rejected: Counter[str] = Counter()
        self._start_ns: int | None = None
        self._last_ns = 0
        self._after_gap = True
        self._force, self._angle = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]

    def add(self, time_ns: int, force_b: Vector, rate_b: Vector) -> Increment | None:
        """Use a sample [m/s², rad/s; body]; give the increment that it completes."""
        if self._start_ns is not None and time_ns <= self._last_ns:
            self.rejected["imu: stamp is not after the one before"] += 1
            return None
        if not all(isfinite(value) for value in (*force_b, *rate_b)):
            self.rejected["imu: value is not a number"] += 1
            return None
        if self._start_ns is None or time_ns - self._last_ns > GAP_NS:
            self._after_gap = True
            self._begin(time_ns)
            self._last_ns = time_ns
            return None
        step = (time_ns - self._last_ns) / SECOND_NS
        for axis in range(3):
            self._force[axis] += force_b[axis] * step
            self._angle[axis] += rate_b[axis] * step
        complete = time_ns // PERIOD_NS != self._last_ns // PERIOD_NS
        self._last_ns = time_ns
        return self._complete(self._start_ns) if complete else None

    def _begin(self, time_ns: int) -> None:
        self._start_ns = time_ns
        self._force, self._angle = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]

    def _complete(self, start_ns: int) -> Increment:
        duration = (self._last_ns - start_ns) / SECOND_NS
        force, angle = np.array(self._force), np.array(self._angle)
        S = skew(angle)
        mean_rotation = np.eye(3) + S / 2.0 + S @ S / 6.0  # of an even turn; to 4e-5 of the force at 1 rad/s
        turn = (self._angle[0], self._angle[1], self._angle[2])
        increment = Increment(
            start_ns, self._last_ns, mean_rotation @ force,
            matrix_from_quaternion(quaternion_from_rotation_vector(turn)), angle / duration,
            float(np.linalg.norm(force)) / duration - 9.80665, self._after_gap,
        )  # fmt: skip
        self._after_gap = False
        self._begin(self._last_ns)
        return increment


@dataclass(frozen=True)
class Anchor:
    """Solution of fusion from which a propagation starts."""

    time_ns: int
    ned_from_body: FloatArray  # shape (3, 3)
    velocity_n: FloatArray  # shape (3,) [m/s, NED]
    accelerometer_bias: FloatArray  # shape (3,) [m/s²]
    gyroscope_bias: FloatArray  # shape (3,) [rad/s]
    latitude: float  # [rad]
    height: float  # [m]
    stationary: bool
    gnss_age_s: float | None
    attitude_cov: FloatArray  # shape (3, 3) [rad², NED]
    gyroscope_bias_sd: FloatArray  # shape (3,) [rad/s, body]


@dataclass(frozen=True)
class FilterAnchor(Anchor):
    """State of fusion's filter, with what it knows of odometer and mounting, and the covariance of all of it."""

    scale: float  # [-] speed of the vehicle over that of the odometer
    yaw: float  # [rad] lateral over forward velocity of the body
    pitch: float  # [rad] minus the downward over the forward velocity of the body
    covariance: FloatArray  # shape (15, 15) of the errors in the order of `free_propagation`


class Strapdown:
    """Attitude and velocity from an anchor on, by inertial increments alone.

    Notes
    -----
    With C from body to NED, f dt and R the increment's force and rotation, b the biases, that of the gyroscopes with
    their scale error times the rate::

        v+ = v + C (f dt - b_a dt) + (g - (2 w_ie + w_en) x v) dt
        C+ = (I - sk(w_ie + w_en) dt) C R (I - sk(b_g) dt)

    The gyroscope's bias enters to first order, which over 100 ms is exact to 1e-6 of it.

    References
    ----------
    P. Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, 2nd ed., section 5.4.
    """

    def __init__(self, anchor: Anchor) -> None:
        self.time_ns = anchor.time_ns
        self.ned_from_body, self.velocity = anchor.ned_from_body.copy(), anchor.velocity_n.copy()
        self.accelerometer_bias, self.gyroscope_bias = anchor.accelerometer_bias.copy(), anchor.gyroscope_bias.copy()
        self.gyroscope_scale = np.zeros(3)  # [-] measured over true rate, minus one
        self._latitude, self._height = anchor.latitude, anchor.height
        self._gravity = np.array([0.0, 0.0, gravity(anchor.latitude, anchor.height)])
        self._earth_rate = np.array(earth_rate_n(anchor.latitude))

    def advance(self, increment: Increment) -> FloatArray:
        """Propagate by one increment; give the specific force's integral [m/s, NED], shape (3,)."""
        step, C, v = increment.duration, self.ned_from_body, self.velocity
        north, east, down = v.tolist()
        transport = np.array(transport_rate_n(self._latitude, self._height, (north, east, down)))
        force_n: FloatArray = C @ (increment.force_b - self.accelerometer_bias * step)
        coriolis = skew(2.0 * self._earth_rate + transport) @ v
        self.velocity = v + force_n + (self._gravity - coriolis) * step
        turned = C @ increment.rotation
        error_b = self.gyroscope_bias + self.gyroscope_scale * increment.rate_b
        turned = turned - turned @ skew(error_b * step)
        self.ned_from_body = turned - skew((self._earth_rate + transport) * step) @ turned
        self.time_ns = increment.end_ns
        return force_n

"""Position without inertial sensors: GNSS positions, velocities and the odometer under constant turn rate and speed.

It answers one question: where is the vehicle, if the inertial measurement unit is wrong? Its error is that of GNSS; in
an outage it soon knows nothing.
"""

from math import atan2, cos, hypot, sin, sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shared.copies import shallow
from shared.errors import FilterDiverged
from shared.maths.earth import Geodetic, geodetic_from_ned_difference, ned_from_geodetic_difference, wrap_angle
from shared.maths.kalman import correct, predict
from shared.maths.quantiles import chi_square_limit
from shared.maths.rotation import Vector

from ..aids.base import Measurement
from ..aids.gnss.fix import GnssPosition, GnssVelocity
from ..aids.odometer.aid import WheelSpeed
from ..settings import Settings

FloatArray = npt.NDArray[np.float64]

NORTH, EAST, DOWN, SPEED, HEADING, TURN, CLIMB, SCALE = range(8)
SIZE = 8
MIN_SPEED_M_S = 3.0  # from which the direction of a velocity is the heading at the start
# Noise of what the model takes as constant, per root second: changes of speed of 2 m/s², of turn rate of 0.3 rad/s² and
# of the climb of 0.5 m/s², each for a second, as a car drives.
NOISE_SD = np.array([0.05, 0.05, 0.05, 2.0, 0.005, 0.3, 0.5, 1e-5])
SCALE_SD = 0.05  # of an odometer that is not calibrated
SIDE_SLIP_SD_M_S = 0.1  # of the antenna against the direction of the vehicle
STANDING_M_S = 0.3  # below it the model does not turn
MAX_STEP_S = 0.5
MAX_GAP_S = 10.0  # without a position, after which it starts again
GATE = chi_square_limit(3, 1e-6)
REJECTIONS = 10  # in a row, after which it starts again
MEAN_OF = 30  # innovations whose mean is published


class State(NamedTuple):
    """Estimate of the vehicle at an instant; of the IMU's place."""

    time_ns: int
    position: Geodetic
    velocity: Vector  # [m/s, NED]
    heading: float  # [rad]
    position_cov: FloatArray  # shape (3, 3) [m², NED], with the errors of GNSS that no average removes
    velocity_cov: FloatArray  # shape (3, 3) [m²/s², NED]
    heading_variance: float  # [rad²]


class MotionModel:
    """Extended Kalman filter: north, east, down, speed, heading, turn rate, climb, scale of the odometer."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._arm = settings.vehicle.gnss.lever_arm_body_m
        self.time_ns = 0
        self.started_ns: int | None = None
        self._origin: Geodetic | None = None
        self._x = np.zeros(SIZE)
        self._P = np.eye(SIZE)
        self._position: GnssPosition | None = None  # before the start: the newest one
        self._gnss_cov = np.eye(3)  # [m²] of the newest position
        self._fix_ns = 0
        self._rejections = 0
        self.innovations = 3.0  # [-] mean normalised innovation squared of positions; 3 without a fault

    def use(self, measurement: Measurement) -> None:
        """Use a measurement, not older than those before, if it is none of inertial sensors."""
        if measurement.time_ns >= self.time_ns:
            measurement.tell(self)

    def use_position(self, fix: GnssPosition) -> None:
        """Use a position of the antenna."""
        self._position, self._gnss_cov, self._arm = fix, fix.cov, fix.lever_arm
        if not self._advance(fix.time_ns):
            return
        assert self._origin is not None
        arm, arm_by_heading = self._arm_n()
        measured = np.array(ned_from_geodetic_difference(fix.position, self._origin))
        H = np.zeros((3, SIZE))
        H[:, :3] = np.eye(3)
        H[:, HEADING] = arm_by_heading
        z = measured - self._x[:3] - arm
        late = self._settings.gnss.time_sd_s * self._velocity()
        R = fix.cov + np.outer(late, late)
        n = fix.axes
        found = self._correct(z[:n], H[:n], R[:n, :n])
        if found is not None:
            self.innovations += (found - self.innovations) / MEAN_OF
            self._fix_ns, self._rejections = fix.time_ns, 0
            return
        self._rejections += 1
        if self._rejections >= REJECTIONS:
            self.started_ns = None

    def use_velocity(self, fix: GnssVelocity) -> None:
        """Use a velocity of the antenna; one in motion starts the model at the position before."""
        if not self._advance(fix.time_ns):
            self._start(fix)
            return
        x, heading = self._x, float(self._x[HEADING])
        c, s = cos(heading), sin(heading)
        ahead, right, _ = self._arm
        turn = float(x[TURN])
        # Velocity of the antenna in the axes of the vehicle: speed less turn times right, turn times ahead.
        along, across = float(x[SPEED]) - turn * right, turn * ahead
        predicted = np.array([along * c - across * s, along * s + across * c, float(x[CLIMB])])
        H = np.zeros((3, SIZE))
        H[0, [SPEED, HEADING, TURN]] = c, -along * s - across * c, -right * c - ahead * s
        H[1, [SPEED, HEADING, TURN]] = s, along * c - across * s, -right * s + ahead * c
        H[2, CLIMB] = 1.0
        n = fix.axes
        R = fix.cov + SIDE_SLIP_SD_M_S**2 * np.eye(3)
        self._correct((np.array(fix.velocity) - predicted)[:n], H[:n], R[:n, :n])

    def use_speed(self, wheels: WheelSpeed) -> None:
        """Use a speed of the vehicle, which has no sign."""
        if not self._advance(wheels.time_ns):
            return
        speed, scale = float(self._x[SPEED]), 1.0 + float(self._x[SCALE])
        H = np.zeros((1, SIZE))
        H[0, SPEED], H[0, SCALE] = scale, speed
        z = np.array([(wheels.speed if speed >= 0.0 else -wheels.speed) - scale * speed])
        noise = hypot(self._settings.odometer.speed_sd_m_s, wheels.resolution / sqrt(12.0), SIDE_SLIP_SD_M_S)
        self._correct(z, H, np.array([[noise**2]]))

    def state(self, time_ns: int) -> State | None:
        """Estimate at a time, not before the last measurement; None without one, or long after the last position."""
        return shallow(self)._carried(time_ns)

    def _carried(self, time_ns: int) -> State | None:
        if not self._advance(time_ns) or self._origin is None:
            return None
        velocity = self._velocity()
        heading, speed = float(self._x[HEADING]), float(self._x[SPEED])
        J = np.zeros((3, SIZE))
        J[0, [SPEED, HEADING]] = cos(heading), -speed * sin(heading)
        J[1, [SPEED, HEADING]] = sin(heading), speed * cos(heading)
        J[2, CLIMB] = 1.0
        return State(
            self.time_ns,
            geodetic_from_ned_difference(self._ned(), self._origin),
            (float(velocity[0]), float(velocity[1]), float(velocity[2])),
            heading,
            self._P[:3, :3] + self._gnss_cov,
            J @ self._P @ J.T,
            float(self._P[HEADING, HEADING]),
        )

    def _ned(self) -> Vector:
        return float(self._x[NORTH]), float(self._x[EAST]), float(self._x[DOWN])

    def _velocity(self) -> FloatArray:
        """Velocity of the vehicle [m/s, NED]."""
        speed, heading = self._x[SPEED], self._x[HEADING]
        return np.array([speed * np.cos(heading), speed * np.sin(heading), self._x[CLIMB]])

    def _arm_n(self) -> tuple[FloatArray, FloatArray]:
        """Lever arm of the antenna [m, NED], the vehicle being level, and its derivative by the heading."""
        ahead, right, down = self._arm
        c, s = float(np.cos(self._x[HEADING])), float(np.sin(self._x[HEADING]))
        north, east = ahead * c - right * s, ahead * s + right * c
        return np.array([north, east, down]), np.array([-east, north, 0.0])

    def _start(self, fix: GnssVelocity) -> None:
        """Start at the newest position, if the vehicle moves."""
        north, east, _ = fix.velocity
        speed, place = hypot(north, east), self._position
        if place is None or speed < MIN_SPEED_M_S or abs(fix.time_ns - place.time_ns) * 1e-9 > 1.0:
            return
        self.time_ns = self._fix_ns = fix.time_ns
        self.started_ns, self._origin, self._rejections, self.innovations = fix.time_ns, place.position, 0, 3.0
        self._x = np.zeros(SIZE)
        self._x[SPEED], self._x[HEADING] = speed, atan2(east, north)
        self._x[:3] = -self._arm_n()[0]
        moved = np.diag(np.r_[np.full(2, speed), 1.0]) * abs(fix.time_ns - place.time_ns) * 1e-9
        self._P = np.zeros((SIZE, SIZE))
        self._P[:3, :3] = place.cov + moved**2
        variance = float(np.max(fix.cov.diagonal()[:2])) + SIDE_SLIP_SD_M_S**2
        rest = [variance, variance / speed**2, 0.3**2, variance, SCALE_SD**2]
        self._P[range(SPEED, SIZE), range(SPEED, SIZE)] = rest

    def _advance(self, time_ns: int) -> bool:
        """Propagate to a time; returns whether the model runs."""
        if self.started_ns is None:
            return False
        if (time_ns - self._fix_ns) * 1e-9 > MAX_GAP_S:
            self.started_ns = None
            return False
        left_s = (time_ns - self.time_ns) * 1e-9
        while left_s > 0.0:
            step_s = min(left_s, MAX_STEP_S)
            self._propagate(step_s)
            left_s -= step_s
        self.time_ns = max(self.time_ns, time_ns)
        return True

    def _propagate(self, step_s: float) -> None:
        """Advance by constant turn rate and speed, along the chord of the arc."""
        x = self._x
        turns = abs(float(x[SPEED])) > STANDING_M_S
        turn = float(x[TURN]) if turns else 0.0
        middle = float(x[HEADING]) + 0.5 * turn * step_s
        c, s, way = cos(middle), sin(middle), float(x[SPEED]) * step_s
        Phi = np.eye(SIZE)
        Phi[NORTH, [SPEED, HEADING]] = c * step_s, -way * s
        Phi[EAST, [SPEED, HEADING]] = s * step_s, way * c
        Phi[DOWN, CLIMB] = step_s
        if turns:
            Phi[NORTH, TURN], Phi[EAST, TURN] = -0.5 * way * s * step_s, 0.5 * way * c * step_s
            Phi[HEADING, TURN] = step_s
        x = x.copy()
        x[:3] += way * c, way * s, float(x[CLIMB]) * step_s
        x[HEADING] = wrap_angle(float(x[HEADING]) + turn * step_s)
        noise = NOISE_SD**2 * step_s
        if not turns:
            noise[HEADING] = 0.0
        self._x, self._P = x, predict(self._P, Phi, np.diag(noise))

    def _correct(self, z: FloatArray, H: FloatArray, R: FloatArray) -> float | None:
        """Use a measurement within its gate; returns its normalised innovation squared, None if it is not used."""
        try:
            found = correct(self._P, z, H, R)
        except FilterDiverged:
            self.started_ns = None
            return None
        distance2 = float(found.distance2)
        if not distance2 < GATE:
            return None
        self._x = self._x + found.x
        self._x[HEADING] = wrap_angle(float(self._x[HEADING]))
        self._P = found.P
        return distance2

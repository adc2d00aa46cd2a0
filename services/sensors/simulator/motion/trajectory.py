"""The true motion of the vehicle, block by block: position, velocity, attitude and ideal inertial readings.

The reference point is the IMU, above the middle of the rear axle, so that the velocity points along the body.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.maths.earth import Geodetic

from ..imu.ideal_imu import attitude_matrices, ideal_forces, ideal_rates, integrate_position
from .roads import Course, Road
from .speed import Timetable

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

ROLL_STIFFNESS = 0.007  # [rad per m/s²] 4 degrees of body roll per g of lateral acceleration: a passenger car


@dataclass(frozen=True)
class Motion:
    """n steps of the true motion, between n + 1 nodes."""

    first: int  # number of the first node since the start; node k is at k times the step
    position: FloatArray  # shape (n + 1, 3) [rad, rad, m] latitude, longitude, ellipsoidal height
    velocity_n: FloatArray  # shape (n + 1, 3) [m/s, NED]
    attitude: FloatArray  # shape (n + 1, 3) [rad] roll, pitch, yaw
    ned_from_body: FloatArray  # shape (n + 1, 3, 3)
    earth_rate_n: FloatArray  # shape (n + 1, 3) [rad/s]
    speed: FloatArray  # shape (n + 1,) [m/s]
    covered: BoolArray  # shape (n + 1,) no sky above
    force_b: FloatArray  # shape (n, 3) [m/s², body] ideal, mean of each step
    rate_b: FloatArray  # shape (n, 3) [rad/s, body] ideal, mean of each step


class Trajectory:
    """Drives a course for ever, from a given place, in steps of equal length."""

    def __init__(
        self,
        course: Course,
        start: Geodetic,
        *,
        stand: float,
        acceleration: float,
        step: float,
        rng: np.random.Generator,
    ) -> None:
        self._road = Road(course)
        self._timetable = Timetable(course, stand, acceleration, rng)
        self._step = step
        self._node = 0
        self._place = start

    def advance(self, steps: int) -> Motion:
        """Drive on; the first node is the last of the block before."""
        first, self._node = self._node, self._node + steps
        times: FloatArray = np.arange(first, self._node + 1, dtype=np.float64) * self._step
        distance, speed = self._timetable.at(times)
        heading, slope, curvature = self._road.at(distance)
        level = speed * np.cos(slope)
        velocity_n = np.column_stack([level * np.cos(heading), level * np.sin(heading), -speed * np.sin(slope)])
        roll = -ROLL_STIFFNESS * curvature * speed**2
        attitude = np.column_stack([roll, slope, np.remainder(heading + np.pi, 2.0 * np.pi) - np.pi])
        matrices = attitude_matrices(attitude)
        place = integrate_position(self._place, velocity_n, self._step)
        self._place = Geodetic(*place.position[-1].tolist())
        rate_b = ideal_rates(place, matrices, self._step)
        return Motion(
            first,
            place.position,
            velocity_n,
            attitude,
            matrices,
            place.earth_rate_n,
            speed,
            self._road.covered(distance),
            ideal_forces(place, velocity_n, matrices, rate_b, self._step),
            rate_b,
        )

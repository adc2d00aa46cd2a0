"""The true motion of the vehicle, block by block: position, velocity, attitude and ideal inertial measurements.

The reference point is the IMU, above the centre of the rear axle, so that the velocity is along the body x axis.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.maths.earth import Geodetic

from ..imu.ideal_imu import attitude_matrices, ideal_forces, ideal_rates, integrate_position
from .roads import Course, Road
from .speed import SpeedProfile

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

ROLL_GRADIENT = 0.007  # [rad per m/s²] 4 degrees of body roll per g of lateral acceleration: a passenger car


@dataclass(frozen=True)
class Motion:
    """n steps of the true motion, between n + 1 nodes."""

    first: int  # index of the first node; node k is at time k times the step
    position: FloatArray  # shape (n + 1, 3) [rad, rad, m] latitude, longitude, ellipsoidal height
    velocity_n: FloatArray  # shape (n + 1, 3) [m/s, NED]
    attitude: FloatArray  # shape (n + 1, 3) [rad] roll, pitch, yaw
    ned_from_body: FloatArray  # shape (n + 1, 3, 3)
    earth_rate_n: FloatArray  # shape (n + 1, 3) [rad/s]
    speed: FloatArray  # shape (n + 1,) [m/s]
    covered: BoolArray  # shape (n + 1,) GNSS signals blocked
    force_b: FloatArray  # shape (n, 3) [m/s², body] ideal, mean of each step
    rate_b: FloatArray  # shape (n, 3) [rad/s, body] ideal, mean of each step


class Trajectory:
    """Motion along a course, from a given position, in equal time steps without end."""

    def __init__(
        self,
        course: Course,
        start: Geodetic,
        *,
        standstill: float,
        acceleration: float,
        step: float,
        rng: np.random.Generator,
    ) -> None:
        self._road = Road(course)
        self._speed_profile = SpeedProfile(course, standstill, acceleration, rng)
        self._step = step
        self._node = 0
        self._place = start

    def advance(self, steps: int) -> Motion:
        """Compute the next steps; the first node is the last node of the previous block."""
        first, self._node = self._node, self._node + steps
        times: FloatArray = np.arange(first, self._node + 1, dtype=np.float64) * self._step
        distance, speed = self._speed_profile.at(times)
        heading, slope, curvature = self._road.at(distance)
        level = speed * np.cos(slope)
        velocity_n = np.column_stack([level * np.cos(heading), level * np.sin(heading), -speed * np.sin(slope)])
        roll = -ROLL_GRADIENT * curvature * speed**2
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

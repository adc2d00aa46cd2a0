"""The vehicle with its inertial sensors and its GNSS antenna, determined by scenario and seed."""

from dataclasses import dataclass
from enum import IntEnum
from math import atan2

import numpy as np
import numpy.typing as npt

from shared.maths.earth import Geodetic, geodetic_from_ned_difference

from .imu.imu_errors import MTI_630_ACCELEROMETER, MTI_630_GYROSCOPE, SensorErrors
from .motion.trajectory import Motion, Trajectory
from .scenarios import Scenario

FloatArray = npt.NDArray[np.float64]
Vector = tuple[float, float, float]

LEVER_ARM_B: Vector = (0.3, 0.0, -1.2)  # [m, body] from the IMU to the antenna


class Stream(IntEnum):
    """Independent streams of random numbers of one seed."""

    ROUTE = 1
    GYROSCOPE = 2
    ACCELEROMETER = 3
    GNSS = 4
    SATELLITES = 5
    WHEELS = 6
    CLOCKS = 7
    ENVIRONMENT = 8
    ATTACKS = 9
    NEIGHBOURS = 10


@dataclass(frozen=True)
class Readings:
    """n steps of the motion, and the measurements of the inertial sensors."""

    motion: Motion
    force_b: FloatArray  # shape (n, 3) [m/s², body]
    rate_b: FloatArray  # shape (n, 3) [rad/s, body]


class Vehicle:
    """Simulates a scenario block by block; the result is independent of the block lengths, to rounding."""

    def __init__(self, scenario: Scenario, seed: int, step: float) -> None:
        rng = np.random.default_rng((seed, Stream.ROUTE))
        self._trajectory = Trajectory(
            scenario.course,
            scenario.start,
            standstill=rng.uniform(*scenario.standstill_s),
            acceleration=scenario.acceleration_m_s2,
            step=step,
            rng=rng,
        )
        self.gyroscope = SensorErrors(MTI_630_GYROSCOPE, step, (seed, Stream.GYROSCOPE))
        self.accelerometer = SensorErrors(MTI_630_ACCELEROMETER, step, (seed, Stream.ACCELEROMETER))

    def advance(self, steps: int) -> Readings:
        """Simulate the next steps."""
        motion = self._trajectory.advance(steps)
        moving = motion.speed[1:] > 0.0
        return Readings(
            motion,
            motion.force_b + self.accelerometer.advance(moving),
            motion.rate_b + self.gyroscope.advance(moving),
        )


@dataclass(frozen=True)
class AntennaState:
    """Position and velocity of the GNSS antenna, and the vehicle's heading."""

    position: Geodetic
    velocity_n: Vector
    covered: bool
    heading: float  # [rad] of the vehicle's forward axis, clockwise from north


def antenna_at(motion: Motion, node: float, lever_b: Vector = LEVER_ARM_B) -> AntennaState:
    """Compute the state of the antenna from the motion of the IMU and the lever arm.

    Parameters
    ----------
    motion : Motion
        A block of the true motion.
    node : float
        [-] Node number since the start; between two nodes of the block the motion is interpolated linearly,
        which at 100 Hz is within 0.05 mm.
    lever_b : tuple of float
        [m, body] Lever arm from the IMU to the antenna.

    Returns
    -------
    AntennaState
        With l = C lever: position r + l, and velocity v + C (w x lever) - w_ie x l.
    """
    index = min(int(node - motion.first), len(motion.rate_b) - 1)
    share = node - motion.first - index
    weights = np.array([1.0 - share, share])
    pair = slice(index, index + 2)
    C = np.tensordot(weights, motion.ned_from_body[pair], 1)
    lever_n = C @ lever_b
    moved = C @ np.cross(motion.rate_b[max(0, index - 1) if share == 0.0 else index], lever_b)
    velocity = weights @ motion.velocity_n[pair] + moved - np.cross(motion.earth_rate_n[index], lever_n)
    latitude, longitude, height = (weights @ motion.position[pair]).tolist()
    north, east, down = lever_n.tolist()
    position = geodetic_from_ned_difference((north, east, down), Geodetic(latitude, longitude, height))
    v_north, v_east, v_down = velocity.tolist()
    covered = bool(motion.covered[index + (share > 0.5)])
    return AntennaState(position, (v_north, v_east, v_down), covered, atan2(C[1, 0], C[0, 0]))

"""Manoeuvres that the simulator's roads do not have, for tests of the alignment."""

from dataclasses import replace

import numpy as np

from benchmarks.starts.start import STEP_S, drive
from services.sensors.simulator.drive import Drive
from services.sensors.simulator.imu.ideal_imu import attitude_matrices, ideal_forces, ideal_rates, integrate_position
from services.sensors.simulator.imu.imu_errors import MTI_630_ACCELEROMETER, MTI_630_GYROSCOPE, SensorErrors
from services.sensors.simulator.motion.trajectory import ROLL_GRADIENT
from shared.maths.earth import Geodetic

Leg = tuple[float, float, float]  # [s], [m/s²], [1/m]


def manoeuvre(legs: tuple[Leg, ...], seed: int = 0, yaw: float = 0.0) -> Drive:
    """Drive legs of (duration [s], acceleration [m/s²], curvature [1/m]) from standstill, also backwards."""
    durations, accelerations, curvatures = np.array(legs).T
    counts = np.round(durations / STEP_S).astype(int)
    speed = np.concatenate([[0.0], np.cumsum(np.repeat(accelerations, counts)) * STEP_S])
    curve = np.concatenate([[0.0], np.repeat(curvatures, counts)])
    smooth = np.ones(30) / 30.0  # limits the jerk
    speed = np.convolve(np.pad(speed, 30, mode="edge"), smooth, mode="same")[30:-30]
    curve = np.convolve(np.pad(curve, 30, mode="edge"), smooth, mode="same")[30:-30]
    heading = yaw + np.cumsum(speed * curve) * STEP_S
    zero = np.zeros_like(speed)
    velocity = np.column_stack([speed * np.cos(heading), speed * np.sin(heading), zero])
    attitude = np.column_stack(
        [-ROLL_GRADIENT * curve * speed**2, zero, np.remainder(heading + np.pi, 2 * np.pi) - np.pi]
    )
    matrices = attitude_matrices(attitude)
    model = drive("parking_lot", 1, 20.0)
    place = integrate_position(Geodetic(*model.position[0].tolist()), velocity, STEP_S)
    rate = ideal_rates(place, matrices, STEP_S)
    force = ideal_forces(place, velocity, matrices, rate, STEP_S)
    moving = np.abs(speed[1:]) > 0.01
    accelerometer = SensorErrors(MTI_630_ACCELEROMETER, STEP_S, (seed, 1))
    gyroscope = SensorErrors(MTI_630_GYROSCOPE, STEP_S, (seed, 2))
    return replace(
        model,
        t_ns=np.arange(1, len(speed)) * 10_000_000,
        position=place.position[1:],
        velocity_n=velocity[1:],
        attitude=attitude[1:],
        ideal_force_b=force,
        ideal_rate_b=rate,
        force_b=force + accelerometer.advance(moving),
        rate_b=rate + gyroscope.advance(moving),
    )

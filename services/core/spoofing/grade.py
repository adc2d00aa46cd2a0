"""Grades of inertial sensors: the thresholds to start from, until a vehicle's own have been learned."""

from collections.abc import Mapping
from enum import StrEnum

from .profile import UNIT_IMU, Profile


class Grade(StrEnum):
    """Class of the inertial sensors as it is bought."""

    CONSUMER = "consumer"
    AUTOMOTIVE = "automotive"
    INDUSTRIAL = "industrial"
    TACTICAL = "tactical"


DEFAULT_GRADE = Grade.CONSUMER
# Factor on the standard deviations of the 5 s metrics of `UNIT_IMU`, which are those of an industrial sensor.
PROFILE_FACTORS: Mapping[Grade, float] = {
    Grade.CONSUMER: 6.0, Grade.AUTOMOTIVE: 3.0, Grade.INDUSTRIAL: 1.0, Grade.TACTICAL: 1.0,
}  # fmt: skip
# What free propagations assume, where the vehicle's file has nothing; the defaults are those of an industrial sensor.
# A tactical one is no better in a car: vibration, slip and the receiver limit it.
LONG: Mapping[Grade, Mapping[str, float]] = {
    Grade.CONSUMER: {
        "velocity_random_walk_m_s_sqrt_s": 0.03, "angle_random_walk_rad_sqrt_s": 6e-4,
        "accelerometer_bias_sd_m_s2": 0.03, "gyroscope_bias_sd_rad_s": 5e-4, "scale_sd": 0.01,
        "gyroscope_scale_sd": 0.02, "position_time_sd_s": 0.2, "attitude_sd_rad": 2e-3, "velocity_sd_m_s": 0.1,
    },
    Grade.AUTOMOTIVE: {
        "velocity_random_walk_m_s_sqrt_s": 0.015, "angle_random_walk_rad_sqrt_s": 4e-4,
        "accelerometer_bias_sd_m_s2": 0.01, "gyroscope_bias_sd_rad_s": 2e-4, "scale_sd": 0.005,
        "gyroscope_scale_sd": 0.01, "position_time_sd_s": 0.1, "attitude_sd_rad": 1e-3, "velocity_sd_m_s": 0.05,
    },
    Grade.INDUSTRIAL: {},
    Grade.TACTICAL: {},
}  # fmt: skip
# What the observer assumes of the gyroscope biases since the last standstill. A consumer sensor walks by 0.014 deg/s in
# ten minutes, which a change of its temperature by a kelvin or two explains; moving, it differs by more than that from
# standing, as a recorded drive shows (navmatlab: 0.09 deg/s in six standstills).
OBSERVER: Mapping[Grade, Mapping[str, float]] = {
    Grade.CONSUMER: {
        "gyroscope_instability_rad_s": 7e-5,
        "gyroscope_bias_walk_rad_s_sqrt_s": 1e-5,
        "gyroscope_moving_sd_rad_s": 1.6e-3,
    },
    Grade.AUTOMOTIVE: {
        "gyroscope_instability_rad_s": 5e-5,
        "gyroscope_bias_walk_rad_s_sqrt_s": 3e-6,
        "gyroscope_moving_sd_rad_s": 5e-4,
    },
    Grade.INDUSTRIAL: {},
    Grade.TACTICAL: {
        "gyroscope_instability_rad_s": 5e-6,
        "gyroscope_bias_walk_rad_s_sqrt_s": 2e-7,
        "gyroscope_moving_sd_rad_s": 2e-5,
    },
}


def profile_of(grade: Grade) -> Profile:
    """Profile of the 5 s metrics of a grade."""
    factor = PROFILE_FACTORS[grade]
    if factor == 1.0:
        return UNIT_IMU
    return UNIT_IMU.times(factor, f"{factor:g} times the built-in profile of an industrial sensor, for grade {grade}")

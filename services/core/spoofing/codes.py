"""Codes of the inertial monitors; `words.toml` beside this file has their words."""

from enum import StrEnum


class Code(StrEnum):
    """Why a test has the result that it has, or none."""

    PAUSED = "spoofing.paused"
    NO_INPUT = "spoofing.no_input"  # has never come
    INPUT_SILENT = "spoofing.input_silent"
    WARMING_UP = "spoofing.warming_up"
    # windows of 5 s
    FEW_VELOCITIES = "spoofing.few_velocities"
    VELOCITY_GAP = "spoofing.velocity_gap"
    NO_START = "spoofing.no_start"
    NO_POSITIONS = "spoofing.no_positions"
    POSITION_STEP = "spoofing.position_step"
    TOO_SLOW = "spoofing.too_slow"
    NO_BAROMETER = "spoofing.no_barometer"
    NOT_IN_PROFILE = "spoofing.not_in_profile"
    ACCELERATION = "spoofing.acceleration"
    HEADING_RATE = "spoofing.heading_rate"
    ALTITUDE_RATE = "spoofing.altitude_rate"
    # free propagations
    PROPAGATION_YOUNG = "spoofing.propagation_young"
    VELOCITY = "spoofing.velocity"
    VELOCITY_WITHOUT_ODOMETER = "spoofing.velocity_without_odometer"
    WAY = "spoofing.way"
    # what the unit teaches itself
    LEARNING = "spoofing.learning"
    LEARNING_UNVOUCHED = "spoofing.learning_unvouched"
    LEARNED = "spoofing.learned"
    PROFILE_OF_ANOTHER_UNIT = "spoofing.profile_of_another_unit"
    LEARNED_OF_ANOTHER_UNIT = "spoofing.learned_of_another_unit"
    # yaw rates
    NO_GYROSCOPE = "spoofing.no_gyroscope"
    NO_YAW_RATE = "spoofing.no_yaw_rate"
    NO_YAW_RATE_YET = "spoofing.no_yaw_rate_yet"  # that of the wheels is being learned
    YAW_RATES = "spoofing.yaw_rates"
    YAW_RATES_WITHOUT_WHEELS = "spoofing.yaw_rates_without_wheels"
    YAW_RATES_LEARNING = "spoofing.yaw_rates_learning"
    # yaw of standstills, which GNSS never touches
    NO_STANDSTILL_YET = "spoofing.no_standstill_yet"
    NO_COURSES = "spoofing.no_courses"
    OBSERVED_TURN = "spoofing.observed_turn"
    OBSERVED_BIAS = "spoofing.observed_bias"
    NO_GRAVITY = "spoofing.no_gravity"
    GRAVITY = "spoofing.gravity"
    # sums of innovations
    FEW_INNOVATIONS = "spoofing.few_innovations"
    LEARNING_SPREAD = "spoofing.learning_spread"
    INNOVATIONS = "spoofing.innovations"
    INNOVATIONS_DOWN = "spoofing.innovations_down"

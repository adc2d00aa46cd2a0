"""Codes of the motion monitors; `words.toml` beside this file has their words."""

from enum import StrEnum


class Code(StrEnum):
    """Why a test has the result that it has, or none."""

    NO_INPUT = "motion.no_input"  # has never come
    INPUT_SILENT = "motion.input_silent"
    SPEED_REPEATED = "motion.speed_repeated"  # after the loss of signals: there is no measured speed
    # tests of the tachograph
    WARMING_UP = "motion.warming_up"
    WARMING_UP_MOVING = "motion.warming_up_moving"
    TRIMMED_MEAN = "motion.trimmed_mean"
    MEDIAN = "motion.median"
    EVENT = "motion.event"
    CROSSING = "motion.crossing"  # the driver has entered a ferry or train
    NOT_CARRIED = "motion.not_carried"
    CARRIED_OR_SPOOFED = "motion.carried_or_spoofed"
    CARRIED = "motion.carried"  # a crossing is entered, and nothing contradicts it
    CROSSING_WITHOUT_WHEELS = "motion.crossing_without_wheels"  # nothing would close it
    CROSSING_TURNS = "motion.crossing_turns"
    CROSSING_LONG = "motion.crossing_long"
    NO_DISTANCE = "motion.no_distance"
    DISTANCE = "motion.distance"
    ODOMETER_STANDS = "motion.odometer_stands"
    # with the learned scale and delay
    SCALE_UNKNOWN = "motion.scale_unknown"
    CALIBRATED = "motion.calibrated"
    SCALE_NOT_LEARNED = "motion.scale_not_learned"
    SCALE_STEP = "motion.scale_step"
    SCALE_RANGE = "motion.scale_range"
    NO_EPOCH = "motion.no_epoch"
    HELD_SPEED = "motion.held_speed"
    DELAY_UNKNOWN = "motion.delay_unknown"
    FEW_PAIRS = "motion.few_pairs"
    FAST = "motion.fast"
    # against the centripetal speed in bends
    NO_STANDSTILL = "motion.no_standstill"
    NO_BEND = "motion.no_bend"
    FEW_BENDS = "motion.few_bends"
    SCALE_OF_GNSS = "motion.scale_of_gnss"
    SCALE_OF_BOTH = "motion.scale_of_both"
    GNSS_OR_IMU_SCALED = "motion.gnss_or_imu_scaled"
    GNSS_SCALED = "motion.gnss_scaled"
    BOTH_SCALED = "motion.both_scaled"
    SCALED_BEFORE = "motion.scaled_before"

"""Codes of the monitor `evidence`; `words.toml` beside this file has their words."""

from enum import StrEnum


class Code(StrEnum):
    """Why a test has the result that it has, or none."""

    # of the monitor
    NOTHING_STATED = "evidence.nothing_stated"
    NOTHING_EVALUATED = "evidence.nothing_evaluated"
    PASSES = "evidence.passes"
    PASSES_PARTLY = "evidence.passes_partly"
    # a test without a result
    NO_SPOOFING_STATE = "evidence.no_spoofing_state"
    NO_JAMMING_STATE = "evidence.no_jamming_state"
    NO_GAIN = "evidence.no_gain"
    NO_LEVEL = "evidence.no_level"
    NO_SPREAD = "evidence.no_spread"
    NO_CLOCK = "evidence.no_clock"
    NO_GNSS_TIME = "evidence.no_gnss_time"
    NO_HOST_TIME = "evidence.no_host_time"
    NO_VELOCITIES = "evidence.no_velocities"
    SILENT = "evidence.silent"
    # a test with one
    SPOOFING = "evidence.spoofing"
    JAMMING = "evidence.jamming"
    JAMMING_OF_PATH = "evidence.jamming_of_path"
    GAIN = "evidence.gain"
    LEVEL = "evidence.level"
    LEVEL_AND_MEAN = "evidence.level_and_mean"
    SPREAD = "evidence.spread"
    CLOCK = "evidence.clock"
    CLOCK_AFTER_LOSS = "evidence.clock_after_loss"
    GNSS_TIME = "evidence.gnss_time"
    HOST_TIME = "evidence.host_time"
    VELOCITIES = "evidence.velocities"
    VELOCITIES_AGREE = "evidence.velocities_agree"

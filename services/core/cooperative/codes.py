"""Codes of the monitor `satellites`; `words.toml` beside this file has their words."""

from enum import StrEnum

from shared.trust.result import SATELLITE_LEFT_OUT


class Code(StrEnum):
    """Why an epoch, a satellite or a neighbour has the result that it has, or none."""

    # no epoch
    NO_RECEIVER = "cooperative.no_receiver"  # with raw measurements
    SILENT = "cooperative.silent"
    SILENT_AFTER_EXCLUSION = "cooperative.silent_after_exclusion"
    # an epoch without a result
    NO_MEASUREMENTS = "cooperative.no_measurements"
    EPHEMERIDES_MISSING = "cooperative.ephemerides_missing"
    NO_SOLUTION = "cooperative.no_solution"
    NO_REDUNDANCY = "cooperative.no_redundancy"
    NOT_DETERMINED = "cooperative.not_determined"  # without one of the satellites
    # an epoch with one
    AGREE = "cooperative.agree"
    AGREE_WITHOUT_LEVEL = "cooperative.agree_without_level"
    UNRESOLVED = "cooperative.unresolved"
    EXCLUDED = "cooperative.excluded"
    EXCLUDED_OR = "cooperative.excluded_or"
    NEIGHBOURS_CONTRADICTED = "cooperative.neighbours_contradicted"
    MOST_NEIGHBOURS_CONTRADICT = "cooperative.most_neighbours_contradict"
    # the test with neighbours
    NO_START = "cooperative.no_start"
    NO_SATELLITE = "cooperative.no_satellite"
    NO_NEIGHBOUR = "cooperative.no_neighbour"
    FEW_VIRTUAL = "cooperative.few_virtual"
    FILTERS_RESTART = "cooperative.filters_restart"
    AGREE_WITH_NEIGHBOURS = "cooperative.agree_with_neighbours"
    EXCLUDED_WITH_NEIGHBOURS = "cooperative.excluded_with_neighbours"
    # one satellite, one neighbour, and the level
    USED = "cooperative.used"
    USED_WITHOUT_BIAS = "cooperative.used_without_bias"
    LEFT_OUT = SATELLITE_LEFT_OUT
    NEIGHBOUR_USED = "cooperative.neighbour_used"
    NEIGHBOUR_LEFT_OUT = "cooperative.neighbour_left_out"
    LEVEL = "cooperative.level"
    LEVEL_TOO_LARGE = "cooperative.level_too_large"

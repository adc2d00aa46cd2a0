"""Codes of the verdict; `words.toml` beside this file has their words."""

from enum import StrEnum


class Code(StrEnum):
    """Why the verdict is what it is. Those with a sentence may decide it, the others explain further."""

    NO_SOLUTION_YET = "trust.no_solution_yet"
    SOLUTION_OLD = "trust.solution_old"
    SOLUTION_LOST = "trust.solution_lost"
    LEVEL_ABOVE_LIMIT = "trust.level_above_limit"
    LEVEL_MISSING = "trust.level_missing"
    LEVEL_NEAR_LIMIT = "trust.level_near_limit"
    LEVEL_HELD = "trust.level_held"  # covers a difference of positions
    UNSAFE_SUSPECTED = "trust.unsafe_suspected"
    UNSAFE_MANY_SUSPECTED = "trust.unsafe_many_suspected"
    UNSAFE_CONFLICT = "trust.unsafe_conflict"
    UNSAFE_HELD = "trust.unsafe_held"  # a conflict that has ended has left an offset
    UNSAFE_HELD_NEAR_PLACE = "trust.unsafe_held_near_place"  # the same, with a known place
    UNSAFE_HELD_AFTER_LOSS = "trust.unsafe_held_after_loss"  # an ordinary one, until displacement agrees
    UNSAFE_HELD_AT_START = "trust.unsafe_held_at_start"  # the first fix was aside of the saved position
    UNSAFE_DEAD_RECKONING = "trust.unsafe_dead_reckoning"
    NO_SOLUTION_WITHOUT_GNSS = "trust.no_solution_without_gnss"
    NO_OTHER_SOLUTION = "trust.no_other_solution"  # under a hypothesis that survives
    SATELLITE_IN_USE = "trust.satellite_in_use"
    GNSS_EXCLUDED = "trust.gnss_excluded"
    GNSS_NOT_AGREED = "trust.gnss_not_agreed"
    GNSS_MISSING = "trust.gnss_missing"
    NO_GNSS_YET = "trust.no_gnss_yet"
    SUSPECTED = "trust.suspected"
    MANY_SUSPECTED = "trust.many_suspected"
    SOURCE_LEFT_OUT = "trust.source_left_out"
    CONFLICT = "trust.conflict"
    GNSS_BACK = "trust.gnss_back"  # after interference
    IMU_NOT_AGREED = "trust.imu_not_agreed"
    GNSS_DISTURBED = "trust.gnss_disturbed"
    MONITOR_DOUBTFUL = "trust.monitor_doubtful"
    HYPOTHESIS = "trust.hypothesis"
    DECIDED_BY = "trust.decided_by"
    SOLUTIONS_APART = "trust.solutions_apart"
    EXCLUSION_DECLINED = "trust.exclusion_declined"
    MONITOR_SUSPECTS = "trust.monitor_suspects"
    MONITOR_SUSPECTS_BY_RULE = "trust.monitor_suspects_by_rule"  # without a statistic
    NO_INERTIAL_UNIT = "trust.no_inertial_unit"
    CHECKS_PAUSED = "trust.checks_paused"
    NO_INDEPENDENT_CHECK = "trust.no_independent_check"
    START_UNKNOWN = "trust.start_unknown"  # nothing is known of the time before
    START_IN_MOTION = "trust.start_in_motion"
    START_AFTER_CUT = "trust.start_after_cut"  # in motion
    NOT_EVALUATED = "trust.not_evaluated"
    MONITORS_MISSING = "trust.monitors_missing"  # have not published yet
    MONITOR_SILENT = "trust.monitor_silent"
    MONITOR_AHEAD = "trust.monitor_ahead"  # by its stamp
    WINDOW_REACHES_BACK = "trust.window_reaches_back"
    LEVEL_HAS_TO_FALL = "trust.level_has_to_fall"  # below a share of the limit, before it counts as below
    HAS_TO_LAST = "trust.has_to_last"  # a better verdict, before it is given
    SAFE = "trust.safe"
    SAFE_WITHOUT_SATELLITES = "trust.safe_without_satellites"
    ACCUSED = "trust.accused"  # a satellite or a neighbour
    ACCUSED_IN_USE = "trust.accused_in_use"
    ACCUSED_LEFT_OUT = "trust.accused_left_out"
    ODOMETER_LEFT_OUT = "trust.odometer_left_out"
    # of the comparison of hypotheses
    NOT_COMPARABLE = "trust.not_comparable"
    HARDLY_MOVES = "trust.hardly_moves"
    SOLUTIONS_COMPARED = "trust.solutions_compared"
    NO_TWO_AGREE = "trust.no_two_agree"
    # of a belief
    NO_ACCUSATION = "trust.no_accusation"
    FALSE_ALARMS = "trust.false_alarms"
    NO_EVIDENCE = "trust.no_evidence"
    SUPPORTED = "trust.supported"
    CONTRADICTED = "trust.contradicted"
    DISPUTED = "trust.disputed"
    FIXES_LATE = "trust.fixes_late"  # and taken as older
    SATELLITE_EXCLUDED = "trust.satellite_excluded"

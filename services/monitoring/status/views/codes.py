"""Codes of the banner; `words.toml` beside this file has their words."""

from enum import StrEnum


class Code(StrEnum):
    """What the banner itself says: of each state of the verdict, and where there is no verdict or no position."""

    SAFE = "banner.safe"
    CAUTION = "banner.caution"
    UNSAFE = "banner.unsafe"
    DEAD_RECKONING = "banner.dead_reckoning"
    NO_FIX = "banner.no_fix"
    NO_FIX_CAUSE = "banner.no_fix_cause"
    NO_FIX_SLOW = "banner.no_fix_slow"
    NO_FIX_WAITING = "banner.no_fix_waiting"
    INITIALISING = "banner.initialising"
    INITIALISING_CAUSE = "banner.initialising_cause"
    INITIALISING_WAITING = "banner.initialising_waiting"
    BROKER_LOST = "banner.broker_lost"
    STARTING = "banner.starting"
    NO_VERDICT = "banner.no_verdict"
    NO_VERDICT_CAUSE = "banner.no_verdict_cause"
    OLD_VERDICT = "banner.old_verdict"
    OLD_VERDICT_CAUSE = "banner.old_verdict_cause"
    # causes that this process finds itself
    NOT_REPORTED = "banner.not_reported"
    NOT_REPORTED_YET = "banner.not_reported_yet"
    FIRST_VERDICT = "banner.first_verdict"
    FIRST_SOLUTION = "banner.first_solution"

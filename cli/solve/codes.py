"""Codes of the verdict on a solved drive; `words.toml` beside this file has their words."""

from enum import StrEnum


class Code(StrEnum):
    """How good the solution of a drive is, as far as it can be known."""

    UNSOUND = "solve.unsound"  # few fixes were used, or the filter was reset often: no other number counts
    UNSOUND_EXCLUDED = "solve.unsound_excluded"  # core.trust excluded GNSS
    UNSOUND_UNEXPLAINED = "solve.unsound_unexplained"
    BETTER = "solve.better"  # than the receiver
    AS_GOOD = "solve.as_good"
    WORSE = "solve.worse"
    VERTICAL = "solve.vertical"
    TRUTH = "solve.truth"
    INNOVATION = "solve.innovation"
    NOTHING = "solve.nothing"
    MISSING = "solve.missing"

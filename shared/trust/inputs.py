"""Inputs of the integrity monitors, and why one of them is missing."""

from collections.abc import Mapping
from enum import StrEnum

from ..messages.explanation import Explanation, explain

SECOND_NS = 1_000_000_000


class Input(StrEnum):
    """What a monitor compares."""

    INERTIAL_SAMPLES = "inertial_samples"
    ATTITUDE = "attitude"  # a solution with attitude and heading
    GNSS_VELOCITY = "gnss_velocity"
    GNSS_SPEED = "gnss_speed"
    ODOMETER_SPEED = "odometer_speed"


def absent(
    newest_ns: Mapping[Input, int | None], time_ns: int, limit_s: float, *, never: str, silent: str
) -> Explanation | None:
    """Name the first input that is missing, by one of two codes of the monitor.

    Parameters
    ----------
    newest_ns : mapping
        [ns, OBU time line] Newest stamp of each input, None of one that has never come.
    time_ns : int
        [ns, OBU time line] Now.
    limit_s : float
        [s] Age above which an input is missing.
    never, silent : str
        Codes; the second one has the value `age_s`.
    """
    for name, stamp_ns in newest_ns.items():
        if stamp_ns is None:
            return explain(never, input=name)
        if time_ns - stamp_ns > limit_s * SECOND_NS:
            return explain(silent, input=name, age_s=round((time_ns - stamp_ns) / SECOND_NS))
    return None

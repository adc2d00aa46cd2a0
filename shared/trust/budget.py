"""One budget of false alarms for all tests of a vehicle: from it follow the rates that tests have by design.

A share of the budget belongs to each monitor, in equal parts to its tests. Evaluations a second apart share samples: a
mean over W seconds begins to exceed u standard deviations some u²/W times as often in a second as it is above them at
one time (Rice), and at the thresholds of these tests u² is some 20. Windows of more than 20 s are thus evaluated
3600 · 20 / W times an hour, shorter ones once a second.
"""

from collections.abc import Mapping
from typing import NamedTuple

PER_HOUR = 0.1  # false alarms of a vehicle: one in ten hours
CORRELATION = 20.0  # u²
HOUR_S = 3600.0


class Share(NamedTuple):
    """Part of the budget of one monitor."""

    share: float  # [-]
    tests: int
    shortest_s: float  # window


# The 5 s metrics have thresholds that are learned, with a rate that was counted, and are outside of it; so are the
# rules of the regulation and the flags of a receiver, which have no rate.
SHARES: Mapping[str, Share] = {
    "long": Share(0.12, 4, 30.0),  # velocities of 30 and 60 s, ways of 60 and 120 s
    "gyroscope": Share(0.12, 8, 5.0),  # 5, 10 and 30 s; observer over 60, 120 and 300 s, its bias, gravity
    "drift": Share(0.04, 12, 30.0),  # three windows of velocity and position, two axes and down
    "motion_fast": Share(0.36, 1, 5.0),
    "satellites": Share(0.36, 1, 1.0),  # one epoch a second
}


def evaluations(window_s: float) -> float:
    """Independent evaluations an hour of a test of a window, once a second."""
    return HOUR_S * min(1.0, CORRELATION / window_s)


def rate_of(monitor: str) -> float:
    """False-alarm rate of one evaluation of a test of a monitor [-]."""
    one = SHARES[monitor]
    return PER_HOUR * one.share / one.tests / evaluations(one.shortest_s)

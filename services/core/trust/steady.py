"""Keeps the verdict from flapping: a worse one acts at once, a better one has to last.

The limits of rows 3 and 8 are left at a smaller share of the alert limit than they are entered. This never keeps a
verdict that is too good: what is worse is taken at the old limits, at once.
"""

from dataclasses import replace

from shared.messages.explanation import explain
from shared.messages.trust import TrustLevel

from .codes import Code
from .facts import SECOND_NS, Facts
from .verdict import REASONS_MAXIMUM, Verdict, axes, verdict

DURATION_S = 3.0  # of a better verdict, before it is given
LEAVES_UNSAFE = 0.95  # share of the alert limit
NARROWER = 0.75 / 0.8  # of the share above which a level is near its limit
ROW_LEVEL, ROW_NEAR = 3, 8
# Between these a better one has to last. A first position, and one after a loss, is shown at once.
ORDER = (TrustLevel.UNSAFE, TrustLevel.DEAD_RECKONING, TrustLevel.CAUTION, TrustLevel.SAFE)


class VerdictHysteresis:
    """The verdict that is given, of those that the facts make."""

    def __init__(self) -> None:
        self._given: Verdict | None = None
        self._better_since_ns: int | None = None
        self._worst: Verdict | None = None  # newest of the worst ones since then

    def after(self, facts: Facts) -> Verdict:
        """Give the verdict of these facts, or the last one while a better one has not lasted."""
        found, given = verdict(facts), self._given
        if given is not None and _is_better(found, given):
            found = _at_narrower_limits(facts, given.row, found)
        if given is None or not _is_better(found, given):
            self._given, self._worst, self._better_since_ns = found, None, None
            return found
        if self._better_since_ns is None or self._better_since_ns > facts.time_ns:
            self._better_since_ns = facts.time_ns
        if self._worst is None or not _is_better(found, self._worst):
            self._worst = found
        if (facts.time_ns - self._better_since_ns) / SECOND_NS >= DURATION_S:
            self._given, self._better_since_ns, self._worst = self._worst, None, None
            return self._given
        why = explain(Code.HAS_TO_LAST, state=self._worst.state.value, lasts_s=DURATION_S)
        return replace(given, reasons=(*given.reasons[: REASONS_MAXIMUM - 1], why), findings=found.findings)


def _is_better(found: Verdict, given: Verdict) -> bool:
    if found.state not in ORDER or given.state not in ORDER or found.state is TrustLevel.DEAD_RECKONING:
        return False  # what is excluded is decided, and no threshold
    return ORDER.index(found.state) > ORDER.index(given.state)


def _at_narrower_limits(facts: Facts, row: int, found: Verdict) -> Verdict:
    """Verdict at the limits at which a row is left."""
    if row == ROW_NEAR:
        limits = replace(facts.limits, near_share=NARROWER * facts.limits.near_share)
        return verdict(facts.with_decided(limits=limits))
    above = [
        explain(Code.LEVEL_HAS_TO_FALL, axis=axis, level_m=level_m, limit_m=limit_m, share=LEAVES_UNSAFE)
        for axis, level_m, limit_m in axes(facts)
        if row == ROW_LEVEL and level_m is not None and level_m > LEAVES_UNSAFE * limit_m
    ]
    return replace(found, state=TrustLevel.UNSAFE, row=ROW_LEVEL, reasons=tuple(above)) if above else found

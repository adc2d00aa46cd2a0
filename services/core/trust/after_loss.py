"""A loss of GNSS with interference: its return may be that of a transmitter, until displacement has agreed.

The receiver's own evidence (gain, C/N0, flags, clock) tells it from a tunnel. A conflict of GNSS is opened at the last
position before it, so that the level covers the solution without GNSS since then; it ends when the windows pass and
positions have agreed with that solution for 60 to 120 s.
"""

from dataclasses import replace

from shared.messages.trust import Outcome

from .facts import SECOND_NS, Facts, Monitor
from .readmission import Judgement

LOSS_TIMEOUT_S = 3.0  # [s] without a used position
RETURN_S = 10.0  # [s] after the return, in which evidence is still of the loss
AGREEMENT_S = (60.0, 120.0)  # bounds of the time of agreement
TIME_TESTS = frozenset({"gnss_time", "host_time"})  # say nothing of interference


class InterferenceLoss:
    """Whether GNSS was lost with interference, since when, and whether its return has been confirmed."""

    def __init__(self) -> None:
        self._used_ns: int | None = None  # last position before the present loss
        self._returned_ns: int | None = None
        self.since_ns: int | None = None  # last position before a loss with interference, until its return is confirmed
        self._begins = False  # the conflict is still to be opened

    def update(self, facts: Facts) -> None:
        """Use the facts of one time."""
        solution = facts.solution
        if solution is None or solution.gnss_age_s is None or facts.gnss_excluded or solution.gnss_only:
            return
        if solution.gnss_age_s > LOSS_TIMEOUT_S:
            self._used_ns = self._used_ns or facts.time_ns - round(solution.gnss_age_s * SECOND_NS)
            self._returned_ns = None
        elif self._used_ns is not None:
            self._returned_ns = self._returned_ns or facts.time_ns
            if facts.time_ns - self._returned_ns > RETURN_S * SECOND_NS:
                self._used_ns = self._returned_ns = None
        if self._used_ns is not None and self.since_ns is None and _is_disturbed(facts):
            self.since_ns, self._begins = self._used_ns, True

    def judged(self, judged: Judgement) -> Judgement:
        """Judgement of GNSS while a return is not confirmed."""
        if self.since_ns is None:
            return judged
        begins, self._begins = self._begins, False
        since_ns = self.since_ns if judged.suspect_since_ns is None else min(self.since_ns, judged.suspect_since_ns)
        return replace(
            judged, accused=judged.accused or begins, contradicted=False, suspect_since_ns=since_ns,
            within_s=AGREEMENT_S,
        )  # fmt: skip

    def end(self) -> None:
        """Take the return for confirmed."""
        self.since_ns = self._used_ns = self._returned_ns = None
        self._begins = False


def _is_disturbed(facts: Facts) -> bool:
    statement = facts.statement(Monitor.EVIDENCE)
    return statement.outcome is Outcome.ACCUSES and bool(set(statement.accusing_tests) - TIME_TESTS)

"""A start of the unit: what is known of the time before it, and until when satellites alone do not make SAFE."""

from shared.messages.explanation import Explanation, explain
from shared.messages.navigation import NavigationState
from shared.messages.trust import Outcome, TrustRecord

from .codes import Code
from .facts import Facts, Monitor


class Start:
    """Whether the present start of fusion needs a long inertial window before the position can be SAFE.

    It does where nothing is known of the time before, and after a power cut in motion: an attack that began before such
    a start is in the first position, and in all that begins there. After an orderly stop and a start in motion
    satellites alone are not enough: a window of either length has to pass.
    """

    def __init__(self) -> None:
        self._known: TrustRecord | None = None  # of the process before
        self._short_ns: int | None = None  # when a short one has
        self.confirmed_ns: int | None = None  # when a long inertial window has last passed

    def recall(self, record: TrustRecord) -> None:
        """Use the record of the process before; stamps of another boot are not compared with those of this one."""
        self._known = record
        self.confirmed_ns = None if record.earlier_life else record.confirmed_ns

    def unconfirmed(self, facts: Facts, state: NavigationState | None) -> Explanation | None:
        """Why the position needs a long window first; None once one has passed since fusion started."""
        started_ns = 0 if state is None or state.started_ns is None else state.started_ns
        self.confirmed_ns = _passed_ns(facts, Monitor.INERTIAL_LONG, started_ns) or self.confirmed_ns
        self._short_ns = _passed_ns(facts, Monitor.INERTIAL_SHORT, started_ns) or self._short_ns
        if self.confirmed_ns is not None and self.confirmed_ns >= started_ns:
            return None
        known = self._known
        if known is None:
            return explain(Code.START_UNKNOWN)
        if known.moving and not known.ended_in_order:
            return explain(Code.START_AFTER_CUT)
        in_motion = state is not None and state.started_in_motion
        alone = self._short_ns is None or self._short_ns < started_ns  # satellites
        return explain(Code.START_IN_MOTION) if in_motion and alone else None


def _passed_ns(facts: Facts, monitor: Monitor, started_ns: int) -> int | None:
    """Stamp of a statement that passes, if it is of the present start."""
    statement = facts.statement(monitor)
    passes = statement.outcome is Outcome.PASS and statement.stated_ns >= started_ns
    return statement.stated_ns if passes else None

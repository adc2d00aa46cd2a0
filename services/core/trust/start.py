"""A start of the unit: what is known of the time before it, and until when satellites alone do not make SAFE."""

from shared.messages.explanation import Explanation, explain
from shared.messages.navigation import NavigationState
from shared.messages.trust import Outcome, TrustRecord

from .codes import Code
from .facts import Facts, Monitor


class Start:
    """Whether the present start of fusion needs a long inertial window before the position can be SAFE.

    It does where nothing is known of the time before, where the vehicle was in motion, and after a power cut in motion.
    An attack that began before such a start is in the first position, and in all that begins there.
    """

    def __init__(self) -> None:
        self._known: TrustRecord | None = None  # of the process before
        self.confirmed_ns: int | None = None  # when a long inertial window has last passed

    def recall(self, record: TrustRecord) -> None:
        """Use the record of the process before; stamps of another boot are not compared with those of this one."""
        self._known = record
        self.confirmed_ns = None if record.earlier_life else record.confirmed_ns

    def unconfirmed(self, facts: Facts, state: NavigationState | None) -> Explanation | None:
        """Why the position needs a long window first; None once one has passed since fusion started."""
        started_ns = 0 if state is None or state.started_ns is None else state.started_ns
        statement = facts.statement(Monitor.INERTIAL_LONG)
        if statement.outcome is Outcome.PASS and statement.stated_ns >= started_ns:
            self.confirmed_ns = statement.stated_ns
        if self.confirmed_ns is not None and self.confirmed_ns >= started_ns:
            return None
        known = self._known
        if known is None:
            return explain(Code.START_UNKNOWN)
        if state is not None and state.started_in_motion:
            return explain(Code.START_IN_MOTION)
        return explain(Code.START_AFTER_CUT) if known.moving and not known.ended_in_order else None

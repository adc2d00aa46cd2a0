"""Publishes the events of the tachograph, and the records that are kept."""

from collections.abc import Iterator

from shared.messages.operation import HostClock
from shared.messages.tachograph import TachographEvent, TachographKind, TachographRecords
from shared.messages.trust import TrustState

from ..verdicts import MotionVerdicts
from .conditions import Conditions
from .log import TachographLog


class TachographRecorder:
    """Conditions on the OBU time line, and the log in UTC; without a time of GNSS nothing is recorded."""

    def __init__(self) -> None:
        self.conditions = Conditions()
        self._log = TachographLog()
        self._begun = False  # whether an event or a record of this run was published

    def trust(self, state: TrustState) -> None:
        """Use the verdict."""
        self.conditions.trust(state)

    def follow(self, message: HostClock | TachographRecords) -> None:
        """Use the clock of the unit, or the records of an earlier run; its own come back too."""
        if isinstance(message, HostClock):
            self.conditions.clock(message)
        elif not self._begun:
            self._begun = True
            self._log.adopt(message.records)

    def events(
        self, verdicts: MotionVerdicts, exceeded_s: float, time_ns: int
    ) -> Iterator[TachographEvent | TachographRecords]:
        """Yield events that begin or end now, and then all records."""
        offset_ns = self.conditions.utc_offset_ns
        if offset_ns is None:
            return
        now_utc_ns, changed = time_ns + offset_ns, False
        for kind, begin_ns in self.conditions.begins(verdicts, exceeded_s, time_ns).items():
            difference_s = self.conditions.clock_difference_s if kind is TachographKind.TIME_CONFLICT else None
            begin_utc_ns = None if begin_ns is None else begin_ns + offset_ns
            for event in self._log.update(kind, begin_utc_ns, now_utc_ns, difference_s):
                changed = self._begun = True
                yield event
        if changed:
            yield TachographRecords(sampled_ns=time_ns, records=tuple(self._log.records(now_utc_ns)))

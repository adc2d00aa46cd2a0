"""Publishes the events of the tachograph, and the records that are kept."""

from collections.abc import Iterator

from shared.messages.operation import HostClock
from shared.messages.tachograph import TachographEvent, TachographKind, TachographRecords
from shared.messages.trust import TrustState

from ..verdicts import MotionVerdicts
from .conditions import ABSENCE_S, NS, Conditions
from .log import TachographLog

EACH_S = 60.0  # [s] between two messages while an event lasts, or the vehicle drives without a position


class TachographRecorder:
    """Conditions on the OBU time line, and the log in UTC; without a time of GNSS nothing is recorded."""

    def __init__(self) -> None:
        self.conditions = Conditions()
        self._log = TachographLog()
        self._published_ns, self._driven_s = 0, 0.0
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
            self.conditions.adopt(message.driven_s, message.absent_since_utc_ns)

    def events(
        self, verdicts: MotionVerdicts, exceeded_s: float, time_ns: int
    ) -> Iterator[TachographEvent | TachographRecords]:
        """Yield events that begin or end now, and then all records."""
        offset_ns = self.conditions.utc_offset_ns
        if offset_ns is None:
            return
        now_utc_ns, changed = time_ns + offset_ns, False
        absent = self.conditions.driven_s > ABSENCE_S
        for kind, begin_ns in self.conditions.begins(verdicts, exceeded_s, time_ns).items():
            difference_s = self.conditions.clock_difference_s if kind is TachographKind.TIME_CONFLICT else None
            begin_utc_ns = None if begin_ns is None else begin_ns + offset_ns
            if kind is TachographKind.POSITION_ABSENT and absent:
                begin_utc_ns = self.conditions.absent_since(offset_ns)
            for event in self._log.update(kind, begin_utc_ns, now_utc_ns, difference_s):
                changed = self._begun = True
                yield event
        driven_s = self.conditions.driven_s if self.conditions.driven_s >= EACH_S else 0.0
        goes_on = self._log.lasts or driven_s != self._driven_s  # a restart goes on with what is published
        if changed or (goes_on and time_ns - self._published_ns >= EACH_S * NS):
            self._published_ns, self._driven_s, self._begun = time_ns, driven_s, True
            since_ns = self.conditions.absent_since(offset_ns) if driven_s else None
            yield TachographRecords(
                sampled_ns=time_ns, records=tuple(self._log.records(now_utc_ns)), driven_s=driven_s,
                absent_since_utc_ns=since_ns,
            )  # fmt: skip

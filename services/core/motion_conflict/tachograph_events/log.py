"""Which events of the smart tachograph are kept, and why.

References
----------
Regulation (EU) 2016/799, Annex IC, 3.12.8 (records of events: cards, begin and end, number of similar events of the
day), and Appendix 1, EventFaultRecordPurpose. Time conflicts are ranked by their seriousness, the others by length.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence

from shared.messages.tachograph import RecordPurpose, TachographEvent, TachographKind

NS = 1_000_000_000
DAY_NS = 86_400 * NS
DAYS_KEPT = 10  # days of occurrence of which the longest event is kept
LONGEST_KEPT = 5  # longest events of the year
YEAR_DAYS = 365
MAX_PER_DAY = 65_535  # of one kind, as the annex counts them


class TachographLog:
    """The events that last, and those that are kept."""

    def __init__(self) -> None:
        self._kept: list[TachographEvent] = []
        self._active: dict[TachographKind, TachographEvent] = {}
        self._count: Counter[tuple[TachographKind, int]] = Counter()  # by kind and day

    def adopt(self, records: Iterable[TachographEvent]) -> None:
        """Take over records of an earlier run; one that was active ends when it was last published as lasting."""
        for record in records:
            lasted_ns = max(record.begin_utc_ns, record.seen_utc_ns or record.begin_utc_ns)
            ended = (
                record
                if record.end_utc_ns is not None
                else record.model_copy(update={"end_utc_ns": lasted_ns, "seen_utc_ns": None, "purposes": ()})
            )
            self._kept.append(ended)
            key = record.kind, record.begin_utc_ns // DAY_NS
            self._count[key] = max(self._count[key], record.similar_that_day)

    def update(
        self, kind: TachographKind, begin_utc_ns: int | None, now_utc_ns: int, difference_s: float | None = None
    ) -> Iterator[TachographEvent]:
        """Say whether an event lasts (its begin), or not (None); yield it at its begin and at its end.

        Parameters
        ----------
        kind : TachographKind
            Kind of the event.
        begin_utc_ns : int or None
            [ns, UTC] Begin of the condition that lasts now.
        now_utc_ns : int
            [ns, UTC] Now: the end of an event that lasts no more.
        difference_s : float, optional
            [s] Seriousness of a time conflict.
        """
        active = self._active.get(kind)
        if begin_utc_ns is None:
            if active is not None:
                del self._active[kind]
                end = max(now_utc_ns, active.begin_utc_ns)
                yield self._keep(active.model_copy(update={"end_utc_ns": end, "purposes": ()}), end)
        elif active is None:
            begin = min(begin_utc_ns, now_utc_ns)
            key = kind, begin // DAY_NS
            self._count[key] = min(self._count[key] + 1, MAX_PER_DAY)
            self._active[kind] = begun = TachographEvent(
                kind=kind, begin_utc_ns=begin, similar_that_day=self._count[key], purposes=(RecordPurpose.ACTIVE,),
                difference_s=difference_s,
            )  # fmt: skip
            yield begun
        elif difference_s is not None and difference_s > (active.difference_s or 0.0):
            self._active[kind] = active.model_copy(update={"difference_s": difference_s})

    @property
    def lasts(self) -> bool:
        """Whether an event lasts."""
        return bool(self._active)

    def _keep(self, event: TachographEvent, now_utc_ns: int) -> TachographEvent:
        """Store an event that has ended, and drop what has no purpose any more; return it with its purposes."""
        self._kept.append(event)
        self._kept = [record for record in self.records(now_utc_ns) if record.end_utc_ns is not None]
        kept = {(record.kind, record.begin_utc_ns, record.end_utc_ns): record for record in self._kept}
        days = {(record.kind, record.begin_utc_ns // DAY_NS) for record in self._kept}
        today = now_utc_ns // DAY_NS
        self._count = Counter({key: n for key, n in self._count.items() if key in days or key[1] >= today - 1})
        return kept.get((event.kind, event.begin_utc_ns, event.end_utc_ns), event)

    def records(self, now_utc_ns: int) -> list[TachographEvent]:
        """Records with a purpose, oldest first; the count of similar events is that of the whole day."""
        found = [
            event.model_copy(update={"seen_utc_ns": max(now_utc_ns, event.begin_utc_ns)})
            for event in self._active.values()
        ]
        for kind in TachographKind:
            found += self._with_purposes([event for event in self._kept if event.kind is kind], now_utc_ns)
        return sorted((self._counted(event) for event in found), key=lambda event: event.begin_utc_ns)

    def _counted(self, event: TachographEvent) -> TachographEvent:
        of_day = self._count[event.kind, event.begin_utc_ns // DAY_NS]
        return event.model_copy(update={"similar_that_day": max(of_day, event.similar_that_day)})

    def _with_purposes(self, events: Sequence[TachographEvent], now_utc_ns: int) -> Iterator[TachographEvent]:
        ranked = sorted(events, key=_rank, reverse=True)
        days: dict[int, int] = {}  # day, and the index of its first in rank
        for index, event in enumerate(ranked):
            days.setdefault(event.begin_utc_ns // DAY_NS, index)
        of_days = {days[day] for day in sorted(days, reverse=True)[:DAYS_KEPT]}
        recent = [n for n, event in enumerate(ranked) if now_utc_ns - event.begin_utc_ns <= YEAR_DAYS * DAY_NS]
        of_year = set(recent[:LONGEST_KEPT])
        for index, event in enumerate(ranked):
            serious = event.kind is TachographKind.TIME_CONFLICT
            day = RecordPurpose.MOST_SERIOUS_OF_DAY if serious else RecordPurpose.LONGEST_OF_DAY
            year = RecordPurpose.MOST_SERIOUS_OF_YEAR if serious else RecordPurpose.LONGEST_OF_YEAR
            purposes = [*([day] if index in of_days else []), *([year] if index in of_year else [])]
            if purposes:
                yield event.model_copy(update={"purposes": tuple(purposes)})


def _rank(event: TachographEvent) -> tuple[float, int]:
    """Seriousness of a time conflict, length [s] of another event; the earlier one first where they are equal."""
    length_s = ((event.end_utc_ns or event.begin_utc_ns) - event.begin_utc_ns) / NS
    rank = event.difference_s or 0.0 if event.kind is TachographKind.TIME_CONFLICT else length_s
    return rank, -event.begin_utc_ns

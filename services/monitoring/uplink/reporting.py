"""Puts reports and events into the outbox, and begins another where its file is damaged."""

import logging
from collections import Counter, deque
from pathlib import Path

from shared.evidence.signer import Signer
from shared.fleet.batch import DIGEST_BYTES, BadBatch, Batch, Event, Kind, Report, encode

from .outbox import LostReports, Outbox, OutboxDamaged, OutboxFault, in_range, set_aside
from .sending import BatchCounters, BatchSelection

log = logging.getLogger(__name__)

NS = 1_000_000_000
RETRY_NS = 5 * NS  # after the outbox could not be used
MAX_HELD = 600  # reports and events in memory, while the disk takes none
GAP, CLOCK = "uplink/gap", "uplink/clock"  # events of the uplink itself


class ReportWriter:
    """Never raises for a disk that is full, nor for a file that is damaged: it counts, tells, and goes on."""

    def __init__(self, path: Path, most_bytes: int, rejects: Counter[str]) -> None:
        self.sending: BatchSelection | None = None
        self.fault: str | None = None  # why nothing is stored now
        self.tally = BatchCounters()
        self.lost = 0  # reports that were not stored since the start of this process
        self._path, self._most_bytes, self._rejects = path, most_bytes, rejects
        self._held: deque[Report | Event] = deque()
        self._missing: LostReports | None = None
        self._retry_ns = self._utc_ms = 0
        self._said_full = False

    def open(self, vehicle: str, now_ns: int, utc_ms: int) -> bool:
        """Open the outbox of this unit, if it is not open; whether it can be used now."""
        if self.sending is not None and self.sending.outbox.vehicle != vehicle:
            self.close()
        self._utc_ms = utc_ms
        if now_ns < self._retry_ns:
            return False
        if self.sending is None:
            try:
                outbox = Outbox(self._path, vehicle, utc_ms, self._most_bytes)
            except OutboxFault as error:
                self.failed(error, now_ns)
                return False
            self.sending = BatchSelection(outbox, self.tally, self._rejects)
        return True

    def add(self, item: Report | Event) -> None:
        """Take a report or event, for `store`; a time that is out of range is rejected."""
        if not in_range(item.utc_ms):
            self._rejects["stamp"] += 1
            return
        if isinstance(item, Event):
            item = self._fitting(item)
        self._held.append(item)
        if len(self._held) > MAX_HELD:
            self._lose_oldest()

    def store(self, now_ns: int) -> None:
        """Put into the outbox what was taken."""
        if self.sending is None or now_ns < self._retry_ns or not (self._held or self._missing):
            return
        outbox = self.sending.outbox
        try:
            outbox.add(*(() if self._missing is None else (self._missing,)), *self._held)
            self._missing = None
            self._held.clear()
            self._worked()
        except OutboxFault as error:
            self.failed(error, now_ns)

    def flush(self, signer: Signer, now_ns: int, utc_ms: int, *, events_only: bool = False) -> None:
        """Make signed batches of everything that is stored."""
        if self.sending is None or now_ns < self._retry_ns:
            return
        outbox = self.sending.outbox
        dropped, unusable = outbox.dropped, outbox.unusable
        try:
            outbox.flush(signer, (Kind.EVENTS,) if events_only else (Kind.EVENTS, Kind.GAP, Kind.POSITIONS))
            self._worked()
        except OutboxFault as error:
            self.failed(error, now_ns)
        self._rejects["unusable report"] += outbox.unusable - unusable
        if outbox.dropped > dropped and not self._said_full:
            self._said_full = True
            log.warning("the outbox has %d MB: its oldest positions are dropped", self._most_bytes // 1_000_000)
            self.add(Event(utc_ms, GAP, {"why": "full", "bytes": self._most_bytes}))

    def failed(self, error: OutboxFault, now_ns: int) -> None:
        """Note that the outbox cannot be used now; a damaged one is set aside, and another one begun."""
        if str(error) != self.fault:
            log.error("%s", error)
        self._rejects["outbox"] += 1
        self.fault = str(error)
        self._retry_ns = now_ns + RETRY_NS
        if isinstance(error, OutboxDamaged):
            self.close()
            try:
                place = set_aside(self._path)
            except OutboxFault as other:
                self.fault = str(other)
                return
            log.error("the outbox is now %s, and another one is begun", place)
            self._retry_ns = now_ns
            self.add(Event(self._utc_ms, GAP, {"why": "damaged", "reason": str(error)[:400]}))

    def close(self) -> None:
        """Close the outbox."""
        if self.sending is not None:
            self.sending.outbox.close()
        self.sending = None

    @property
    def dropped(self) -> int:
        """Reports that were lost since the start of this process."""
        return self.lost + (self.sending.outbox.dropped if self.sending is not None else 0)

    def _worked(self) -> None:
        if self.fault is not None:
            log.info("the outbox is usable again")
        self.fault = None

    def _lose_oldest(self) -> None:
        """Leave out the oldest report, for which a gap will stand; of events the oldest if there are no reports."""
        for place, item in enumerate(self._held):
            if isinstance(item, Report):
                missing = self._missing or LostReports(0, item.utc_ms, item.utc_ms)
                self._missing = missing.more(item.utc_ms)
                self.lost += 1
                del self._held[place]
                return
        self._held.popleft()
        self._rejects["lost event"] += 1

    @staticmethod
    def _fitting(event: Event) -> Event:
        """Leave the content of an event out that is too much for a batch."""
        try:
            encode(Batch(Kind.EVENTS, event.utc_ms, 0, 1, bytes(DIGEST_BYTES), events=(event,)))
        except BadBatch as error:
            return Event(event.utc_ms, event.name, {"left_out": str(error)})
        return event

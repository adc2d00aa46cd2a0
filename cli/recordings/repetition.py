"""Repeats one incarnation of a process: feeds its inputs in the journal's order, and compares its messages."""

import heapq
from collections import Counter, deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial

from shared.bus import codec
from shared.bus.bus import Envelope
from shared.errors import BadPayload, TooManyFaults
from shared.faults import Faults
from shared.messages.base import Message, Sender, Tick
from shared.messages.operation import ConsumptionOrder
from shared.runtime.live import Reactor, handled
from shared.topics import topic_of

from .release import Release

PATIENCE_NS = 5_000_000_000  # QoS 1 may overtake QoS 0 on the way to the recorder by less than this
LATEST_JOURNAL_NS = 55_000_000_000  # after a message, while inputs that a journal may name are still kept

Key = tuple[str, str, int, int]  # topic, producer, incarnation, sequence
Output = tuple[str, bytes]  # topic, and payload without sender


class Verdict(StrEnum):
    """How a repeated incarnation compares with the recorded one."""

    IDENTICAL = "identical"
    DIFFERENT = "different"
    OTHER_RELEASE = "other release"  # made by another one, whose messages this one does not repeat
    INCOMPLETE = "incomplete"  # the recording lacks what it consumed, or a part of its journal
    NO_JOURNAL = "no journal"


@dataclass(frozen=True)
class Finding:
    """What the repetition of one incarnation has given."""

    process: str
    incarnation: int
    consumed: int
    compared: int
    unrecorded: int
    verdict: Verdict
    reason: str | None


@dataclass(frozen=True)
class Run:
    """Consecutive messages of one producer, in the order consumed."""

    topic: str
    producer: str
    incarnation: int
    first: int
    count: int
    journal_ns: int  # arrival of the journal that holds the run


class Repetition:
    """Feeds a new process the messages named by the journal, and compares its messages with the recorded ones.

    A gap in the sequence of the recorded messages shows that some are missing; as many of the repeated messages are
    skipped at most.
    """

    def __init__(self, name: str, incarnation: int, process: Reactor, find: Callable[[Key], Envelope | None]) -> None:
        self.name, self.incarnation = name, incarnation
        self.consumed = self.compared = self.unrecorded = 0
        self.reason: str | None = None
        self._process, self._find = process, find
        self._faults = Faults(Counter())
        self._runs: deque[Run] = deque()
        self._rebuilt: deque[Output] = deque()
        self._recorded: list[tuple[int, int, Envelope | None]] = []
        self.running = False  # has published a message that is not retained
        self._known: set[int] = set()
        self._restored: set[int] = set()  # own messages that it consumed: saved by an earlier incarnation
        self._last_sequence = self._journal_ns = 0
        self._gap = self._spare = 0  # sequence numbers that are not recorded: since the last message, and before
        self._failed = False

    @property
    def verdict(self) -> Verdict:
        """Result of the comparison so far."""
        if self._failed:
            return Verdict.DIFFERENT
        if self.reason:
            return Verdict.INCOMPLETE
        return Verdict.IDENTICAL if self._journal_ns else Verdict.NO_JOURNAL

    def finding(self, release: Release) -> Finding:
        """The result, of a recording of a release: messages of another one differ for that reason."""
        is_other = self.verdict is Verdict.DIFFERENT and not release.is_this
        verdict = Verdict.OTHER_RELEASE if is_other else self.verdict
        return Finding(self.name, self.incarnation, self.consumed, self.compared, self.unrecorded, verdict, self.reason)

    def add_journal(self, consumed: ConsumptionOrder, received_ns: int) -> None:
        """Append the next part of the order of consumption."""
        self._runs.extend(Run(*run, journal_ns=received_ns) for run in consumed.runs)
        self._journal_ns = received_ns

    def add_message(self, envelope: Envelope, *, compare: bool) -> bool:
        """Add a recorded message of the incarnation; those of its runtime are counted, not compared.

        Returns whether it is new: after a reconnection the recorder receives retained messages twice.
        """
        if envelope.sequence <= self._last_sequence or envelope.sequence in self._known:
            return False
        self._known.add(envelope.sequence)
        heapq.heappush(self._recorded, (envelope.sequence, envelope.received_ns, envelope if compare else None))
        row = topic_of(envelope.topic)
        self.running = self.running or (row is not None and not row.retain)
        return True

    def advance(self, now_ns: int, *, last: bool = False) -> None:
        """Feed the inputs that are available and compare the messages that are due."""
        if self.reason:
            return
        self._feed(now_ns, last=last)
        while self._recorded and not self.reason and (last or self._is_due(now_ns)):
            self._compare()
        if last and not self.reason and len(self._rebuilt) > self._gap:
            self._differs(f"{len(self._rebuilt)} additional messages, first {self._rebuilt[0][0]}")

    def _is_due(self, now_ns: int) -> bool:
        """Whether the inputs of the oldest message are known: a process that is behind publishes its journal late."""
        published_ns = self._recorded[0][1]
        if published_ns > now_ns - 2 * PATIENCE_NS:
            return False
        return published_ns + PATIENCE_NS <= self._journal_ns or published_ns <= now_ns - LATEST_JOURNAL_NS

    def _feed(self, now_ns: int, *, last: bool) -> None:
        while self._runs:
            run = self._runs[0]
            if run.topic == "close":
                self._runs.popleft()
                self._keep(getattr(self._process, "close", tuple))
                continue
            message = self._input(run)
            if message is None:
                if last or now_ns - run.journal_ns > PATIENCE_NS:
                    self.reason = f"it consumed {run.topic} {run.first} of {run.producer}, which is not recorded"
                return
            self._runs.popleft()
            if (run.producer, run.incarnation) == (self.name, self.incarnation):
                self._restored.add(run.first)
            if run.count > 1:
                self._runs.appendleft(replace(run, first=run.first + 1, count=run.count - 1))
            self.consumed += 1
            self._keep(partial(handled, self._process, message, self._faults, run.journal_ns))

    def _input(self, run: Run) -> Message | None:
        if run.topic == "tick":
            return Tick(now_ns=run.incarnation)
        envelope = self._find((run.topic, run.producer, run.incarnation, run.first))
        try:
            return None if envelope is None else envelope.decode()
        except BadPayload:
            return None

    def _keep(self, work: Callable[[], Iterable[Message]]) -> None:
        """Run the process, and keep its messages."""
        try:
            for message in work():
                self._rebuilt.append((codec.topic_name(message), codec.encode(message)))
        except Exception as error:  # noqa: BLE001  # the error that ends a process is a result
            cause = error.__cause__ if isinstance(error, TooManyFaults) else error
            self._failed, self.reason = True, f"it now ends by {type(cause).__name__}: {cause}"
            self._runs.clear()

    def _compare(self) -> None:
        """Compare the next recorded message with the next repeated one, except those missing in the recording."""
        sequence, received_ns, envelope = heapq.heappop(self._recorded)
        self._known.discard(sequence)
        self._gap += sequence - self._last_sequence - 1
        self._last_sequence = sequence
        if envelope is None or sequence in self._restored:
            return
        recorded = (envelope.topic, envelope.payload)
        sender = Sender(process=self.name, incarnation=self.incarnation, sequence=sequence)
        while self._rebuilt and _sent(self._rebuilt[0], sender) != recorded and self._gap:
            self._gap -= 1
            self.unrecorded += 1
            self._rebuilt.popleft()
        repeated = _sent(self._rebuilt.popleft(), sender) if self._rebuilt else None
        if repeated == recorded:
            self.compared += 1
        elif repeated is not None or received_ns <= self._journal_ns:
            self._differs(f"message {sequence}: {_difference(recorded, repeated)}")
        self._spare, self._gap = self._spare + self._gap, 0

    def _differs(self, reason: str) -> None:
        ahead = max((entry[0] for entry in self._recorded), default=self._last_sequence) - self._last_sequence
        lost = self._gap + self._spare + self.unrecorded + ahead - len(self._recorded)
        self._failed = not lost  # a part of its journal may be missing as well
        self.reason = f"{lost} of its messages are not recorded, then {reason}" if lost else reason


def _sent(output: Output, sender: Sender) -> Output:
    return output[0], codec.signed(output[1], sender)


def _difference(recorded: Output, repeated: Output | None) -> str:
    """Describe the first difference of two messages."""
    if repeated is None:
        return f"was {recorded[0]}, now nothing"
    if recorded[0] != repeated[0]:
        return f"was {recorded[0]}, now {repeated[0]}"
    old, new = recorded[1], repeated[1]
    at = next((k for k, pair in enumerate(zip(old, new, strict=False)) if pair[0] != pair[1]), min(len(old), len(new)))
    start = max(at - 30, 0)
    return f"{recorded[0]} byte {at}: was {old[start : at + 30]!r}, now {new[start : at + 30]!r}"

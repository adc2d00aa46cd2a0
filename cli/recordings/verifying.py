"""Repeats one run of a process: feeds it the messages in the order consumed, and compares what it publishes."""

import heapq
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial

from shared.bus import codec
from shared.bus.bus import Envelope
from shared.errors import BadPayload
from shared.messages.base import Message, Sender, Tick
from shared.messages.operation import Consumed
from shared.runtime.live import Reactor
from shared.topics import topic_of

PATIENCE_NS = 5_000_000_000  # QoS 1 may overtake QoS 0 on the way to the recorder by less than this

Key = tuple[str, str, int, int]  # topic, producer, life, running number
Output = tuple[str, bytes]  # topic, and payload without sender


class Verdict(StrEnum):
    """How a repeated life compares with the recorded one."""

    IDENTICAL = "identical"
    DIFFERENT = "different"
    INCOMPLETE = "incomplete"  # the recording lacks what it consumed, or a part of its journal
    NO_JOURNAL = "no journal"


@dataclass(frozen=True)
class Run:
    """Successive messages of one producer, in the order consumed."""

    topic: str
    producer: str
    life: int
    first: int
    count: int
    stated_ns: int  # arrival of the part of the journal that states it


class Repetition:
    """Feeds a fresh process the messages that the journal lists, and compares what it publishes with the recording.

    A published message that is missing in the recording leaves a gap in the sequence numbers, and is skipped in the
    repetition as well: at most as many as the gap has numbers.
    """

    def __init__(self, name: str, life: int, process: Reactor, find: Callable[[Key], Envelope | None]) -> None:
        self.name, self.life = name, life
        self.consumed = self.compared = self.unrecorded = 0
        self.reason: str | None = None
        self._process, self._find = process, find
        self._runs: deque[Run] = deque()
        self._rebuilt: deque[Output] = deque()
        self._recorded: list[tuple[int, int, Envelope | None]] = []
        self.lively = False  # published something that a broker does not retain
        self._known: set[int] = set()
        self._restored: set[int] = set()  # its own messages that it consumed: what it had saved before a restart
        self._last_sequence = self._journal_ns = 0
        self._gap = self._spare = 0  # numbers that are not recorded: since the last message, and before
        self._failed = False

    @property
    def verdict(self) -> Verdict:
        """Judge what was compared so far."""
        if self._failed:
            return Verdict.DIFFERENT
        if self.reason:
            return Verdict.INCOMPLETE
        return Verdict.IDENTICAL if self._journal_ns else Verdict.NO_JOURNAL

    def add_journal(self, consumed: Consumed, received_ns: int) -> None:
        """Take the next part of the order of consumption."""
        self._runs.extend(Run(*run, stated_ns=received_ns) for run in consumed.runs)
        self._journal_ns = received_ns

    def add_published(self, envelope: Envelope, *, compare: bool) -> bool:
        """Take a message that the recorded process published; those of its runtime only fill the sequence numbers.

        Returns whether it is new: after a reconnection the recorder gets retained messages twice.
        """
        if envelope.sequence <= self._last_sequence or envelope.sequence in self._known:
            return False
        self._known.add(envelope.sequence)
        heapq.heappush(self._recorded, (envelope.sequence, envelope.received_ns, envelope if compare else None))
        row = topic_of(envelope.topic)
        self.lively = self.lively or (row is not None and not row.retain)
        return True

    def advance(self, now_ns: int, *, last: bool = False) -> None:
        """Feed what is there and compare what is due."""
        if self.reason:
            return
        self._feed(now_ns, last=last)
        while self._recorded and not self.reason and (last or self._recorded[0][1] <= now_ns - 2 * PATIENCE_NS):
            self._compare()
        if last and not self.reason and len(self._rebuilt) > self._gap:
            self._differs(f"publishes {len(self._rebuilt)} messages more now, the first on {self._rebuilt[0][0]}")

    def _feed(self, now_ns: int, *, last: bool) -> None:
        while self._runs:
            run = self._runs[0]
            if run.topic == "close":
                self._runs.popleft()
                self._keep(getattr(self._process, "close", tuple))
                continue
            message = self._input(run)
            if message is None:
                if last or now_ns - run.stated_ns > PATIENCE_NS:
                    self.reason = f"it consumed {run.topic} {run.first} of {run.producer}, which is not recorded"
                return
            self._runs.popleft()
            if (run.producer, run.life) == (self.name, self.life):
                self._restored.add(run.first)
            if run.count > 1:
                self._runs.appendleft(replace(run, first=run.first + 1, count=run.count - 1))
            self.consumed += 1
            self._keep(partial(self._process.handle, message))

    def _input(self, run: Run) -> Message | None:
        if run.topic == "tick":
            return Tick(now_ns=run.life)
        envelope = self._find((run.topic, run.producer, run.life, run.first))
        try:
            return None if envelope is None else envelope.decode()
        except BadPayload:
            return None

    def _keep(self, work: Callable[[], Iterable[Message]]) -> None:
        """Let the process work, and keep what it publishes."""
        try:
            for message in work():
                self._rebuilt.append((codec.topic_name(message), codec.encode(message)))
        except Exception as error:  # noqa: BLE001  # how a process ends is part of the result
            self._failed, self.reason = True, f"now it ends by {type(error).__name__}: {error}"
            self._runs.clear()

    def _compare(self) -> None:
        """Compare the next recorded message with the next repeated one that was not lost on the way."""
        sequence, received_ns, envelope = heapq.heappop(self._recorded)
        self._known.discard(sequence)
        self._gap += sequence - self._last_sequence - 1
        self._last_sequence = sequence
        if envelope is None or sequence in self._restored:
            return
        recorded = (envelope.topic, envelope.payload)
        sender = Sender(process=self.name, incarnation=self.life, sequence=sequence)
        while self._rebuilt and _sent(self._rebuilt[0], sender) != recorded and self._gap:
            self._gap -= 1
            self.unrecorded += 1
            self._rebuilt.popleft()
        now = _sent(self._rebuilt.popleft(), sender) if self._rebuilt else None
        if now == recorded:
            self.compared += 1
        elif now is not None or received_ns <= self._journal_ns:
            self._differs(f"message {sequence}: {_difference(recorded, now)}")
        self._spare, self._gap = self._spare + self._gap, 0

    def _differs(self, reason: str) -> None:
        ahead = max((row[0] for row in self._recorded), default=self._last_sequence) - self._last_sequence
        lost = self._gap + self._spare + self.unrecorded + ahead - len(self._recorded)
        self._failed = not lost  # a part of its journal may be among what is lost
        self.reason = f"{lost} of its messages are not recorded, then {reason}" if lost else reason


def _sent(output: Output, sender: Sender) -> Output:
    return output[0], codec.signed(output[1], sender)


def _difference(recorded: Output, repeated: Output | None) -> str:
    """State the first difference between two messages."""
    if repeated is None:
        return f"published {recorded[0]}, now nothing"
    if recorded[0] != repeated[0]:
        return f"published {recorded[0]}, now {repeated[0]}"
    old, new = recorded[1], repeated[1]
    at = next((k for k, pair in enumerate(zip(old, new, strict=False)) if pair[0] != pair[1]), min(len(old), len(new)))
    start = max(at - 30, 0)
    return f"{recorded[0]} byte {at}: recorded {old[start : at + 30]!r}, now {new[start : at + 30]!r}"

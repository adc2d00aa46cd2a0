"""One life of a process done again: fed in the order in which it was, and compared with what it said then."""

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
    """Neighbouring messages of one producer, in the order consumed."""

    topic: str
    producer: str
    life: int
    first: int
    count: int
    told_ns: int  # when the journal said so


class Repetition:
    """Feeds a fresh process what the journal says, and holds its words against the recorded ones.

    A word that is missing in the recording is seen by the gap in the running numbers, and is skipped
    in the repetition as well: at most as many as the gap is wide.
    """

    def __init__(self, name: str, life: int, process: Reactor, find: Callable[[Key], Envelope | None]) -> None:
        self.name, self.life = name, life
        self.consumed = self.compared = self.unrecorded = 0
        self.reason: str | None = None
        self._process, self._find = process, find
        self._runs: deque[Run] = deque()
        self._rebuilt: deque[Output] = deque()
        self._recorded: list[tuple[int, int, Envelope | None]] = []
        self.lively = False  # said something that a broker does not keep
        self._known: set[int] = set()
        self._restored: set[int] = set()  # words of its own that it consumed: what it had saved in another life
        self._last_sequence = self._journal_ns = 0
        self._gap = self._spare = 0  # numbers that are not recorded: since the last word, and before
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
        self._runs.extend(Run(*run, told_ns=received_ns) for run in consumed.runs)
        self._journal_ns = received_ns

    def add_word(self, envelope: Envelope, *, compare: bool) -> bool:
        """Take a message of the recorded life; what its runtime says only fills the running numbers.

        Tells whether it is new: after a reconnection the recorder gets retained messages twice.
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
            self._differs(f"now says {len(self._rebuilt)} words more, first {self._rebuilt[0][0]}")

    def _feed(self, now_ns: int, *, last: bool) -> None:
        while self._runs:
            run = self._runs[0]
            if run.topic == "close":
                self._runs.popleft()
                self._keep(getattr(self._process, "close", tuple))
                continue
            message = self._input(run)
            if message is None:
                if last or now_ns - run.told_ns > PATIENCE_NS:
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
        """Let the process work, and keep what it says."""
        try:
            for message in work():
                self._rebuilt.append((codec.topic_name(message), codec.encode(message)))
        except Exception as error:  # noqa: BLE001  # what a process dies of is what we are here to tell
            self._failed, self.reason = True, f"now it ends by {type(error).__name__}: {error}"
            self._runs.clear()

    def _compare(self) -> None:
        """Compare the next recorded word with the next repeated one that was not lost on the way."""
        sequence, received_ns, envelope = heapq.heappop(self._recorded)
        self._known.discard(sequence)
        self._gap += sequence - self._last_sequence - 1
        self._last_sequence = sequence
        if envelope is None or sequence in self._restored:
            return
        word = (envelope.topic, envelope.payload)
        sender = Sender(process=self.name, incarnation=self.life, sequence=sequence)
        while self._rebuilt and _sent(self._rebuilt[0], sender) != word and self._gap:
            self._gap -= 1
            self.unrecorded += 1
            self._rebuilt.popleft()
        now = _sent(self._rebuilt.popleft(), sender) if self._rebuilt else None
        if now == word:
            self.compared += 1
        elif now is not None or received_ns <= self._journal_ns:
            self._differs(f"word {sequence}: {_difference(word, now)}")
        self._spare, self._gap = self._spare + self._gap, 0

    def _differs(self, reason: str) -> None:
        ahead = max((word[0] for word in self._recorded), default=self._last_sequence) - self._last_sequence
        lost = self._gap + self._spare + self.unrecorded + ahead - len(self._recorded)
        self._failed = not lost  # a part of its journal may be among what is lost
        self.reason = f"{lost} of its words are not recorded, then {reason}" if lost else reason


def _sent(word: Output, sender: Sender) -> Output:
    return word[0], codec.signed(word[1], sender)


def _difference(recorded: Output, repeated: Output | None) -> str:
    """Say where two words part."""
    if repeated is None:
        return f"said {recorded[0]}, now nothing"
    if recorded[0] != repeated[0]:
        return f"said {recorded[0]}, now {repeated[0]}"
    old, new = recorded[1], repeated[1]
    at = next((k for k, pair in enumerate(zip(old, new, strict=False)) if pair[0] != pair[1]), min(len(old), len(new)))
    start = max(at - 30, 0)
    return f"{recorded[0]} byte {at}: said {old[start : at + 30]!r}, now {new[start : at + 30]!r}"

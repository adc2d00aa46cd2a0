"""A bus without a broker, for the loops of processes that own theirs: time advances in `receive` only."""

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import cast

from shared.bus.bus import Bus, Envelope
from shared.messages.base import Message
from shared.topics import Topic


class FakeBus:
    """Delivers the messages of a script and stores what was published; ends with the script.

    The script is called once a `receive` with the number of the call and returns the envelopes to
    deliver, or None to stop the process.
    """

    def __init__(
        self, state_dir: Path, script: Callable[[int], list[Envelope] | None], *, start_ns: int, step_ns: int = 10**8
    ) -> None:
        self.state_dir = state_dir
        self.process, self.vehicle, self.vehicle_toml = "test", "car", '[vehicle]\nname = "car"\n'
        self.stopping = False
        self.connected = True
        self.dropped = 0
        self.sequence = 1
        self.rejects: Counter[str] = Counter()
        self.last_error: str | None = None
        self.published: list[Message] = []
        self.hears_broker = False
        self.refusals = self.crowded = 0
        self.refused: list[str] = []
        self.followed: frozenset[str] | None = None
        self.asked: frozenset[str] = frozenset()  # topics besides those of the process
        self._script, self._step_ns = script, step_ns
        self._now_ns = start_ns
        self._calls = 0

    def now_ns(self) -> int:
        return self._now_ns

    def publish(self, message: Message) -> None:
        self.published.append(message)

    def hear_broker(self) -> None:
        self.hears_broker = True

    def follow(self, fast: frozenset[str]) -> None:
        self.followed = fast

    def also(self, topics: Sequence[Topic]) -> None:
        self.asked = frozenset(topic.name for topic in topics)

    def receive(self, timeout_s: float) -> list[Envelope]:
        if self.stopping:
            return []
        delivered = self._script(self._calls)
        self._calls += 1
        self._now_ns += self._step_ns
        if delivered is None:
            self.stopping = True
            return []
        return delivered

    def as_bus(self) -> Bus:
        """Return the bus for a process that opens one."""
        return cast(Bus, self)

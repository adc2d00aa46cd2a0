"""A bus without a broker in real time, for device drivers that run in a thread beside the test."""

import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar, cast

from shared.bus.bus import Bus, Envelope
from shared.messages.base import Message
from shared.topics import Topic
from tests.support.bus.envelopes import sent
from tests.support.patience import HANGS_S

M = TypeVar("M", bound=Message)


class LiveBus:
    """Stores what a driver publishes, and delivers the messages passed to `deliver`."""

    def __init__(self) -> None:
        self.vehicle, self.process = "car", "test"
        self.state_dir = Path()
        self.asked: frozenset[str] = frozenset()  # topics besides those of the process
        self.stopping = False
        self.connected = True
        self.last_error: str | None = None
        self.rejects: Counter[str] = Counter()
        self.published: list[Message] = []
        self.longest_gap_s = 0.0  # between two calls of `receive`
        self._inbox: deque[Envelope] = deque()
        self._last_call = time.monotonic()

    def now_ns(self) -> int:
        return time.monotonic_ns()

    def publish(self, message: Message) -> None:
        self.published.append(message)

    def also(self, topics: Sequence[Topic]) -> None:
        self.asked = frozenset(topic.name for topic in topics)

    def receive(self, timeout_s: float) -> list[Envelope]:
        now = time.monotonic()
        self.longest_gap_s = max(self.longest_gap_s, now - self._last_call)
        if not self._inbox:
            time.sleep(timeout_s)
        self._last_call = time.monotonic()
        return [self._inbox.popleft() for _ in range(len(self._inbox))]

    def deliver(self, message: Message) -> None:
        self._inbox.append(sent(message, self.now_ns()))

    def all_received(self) -> bool:
        """Whether the driver has received every delivered message."""
        return not self._inbox

    def of(self, kind: type[M]) -> list[M]:
        return [message for message in list(self.published) if isinstance(message, kind)]

    def as_bus(self) -> Bus:
        return cast(Bus, self)


@contextmanager
def running(run: Callable[[Bus], None], state_dir: Path | None = None) -> Iterator[LiveBus]:
    """Run a driver's loop in a thread; an exception in it fails the test."""
    bus = LiveBus()
    bus.state_dir = state_dir or bus.state_dir
    faults: list[BaseException] = []

    def work() -> None:
        try:
            run(bus.as_bus())
        except BaseException as error:  # noqa: BLE001  # handed to the test below
            faults.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield bus
    finally:
        bus.stopping = True
        thread.join(HANGS_S)
    assert not thread.is_alive(), "the driver did not stop"
    if faults:
        raise faults[0]


def eventually(condition: Callable[[], bool], within_s: float = HANGS_S) -> None:
    """Wait until a condition holds."""
    deadline = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.005)

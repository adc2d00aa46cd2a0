"""Somebody who may not speak: connections that the broker refuses, and a second program under the name of a process."""

from collections import deque
from collections.abc import Iterator, Sequence

from shared.messages.operation import Problem

SHOWN_NS = 60_000_000_000  # after the last sign of it
WINDOW = 8  # names that a sentence holds
BROKER = "broker"


class Intruders:
    """Keeps what was seen for a minute."""

    def __init__(self) -> None:
        self._count = 0  # refusals at the last call
        self._recent: deque[tuple[int, int]] = deque(maxlen=1_000)  # time and number of refusals
        self._names: tuple[str, ...] = ()
        self._crowd = 0
        self._crowded: deque[tuple[int, int]] = deque(maxlen=1_000)
        self._twice: dict[str, tuple[int, int]] = {}  # by process: first and last time of a message of an older life

    def refused(self, count: int, names: Sequence[str], now_ns: int) -> None:
        """Take how many connections the broker has refused so far, and what the newest clients call themselves."""
        if count > self._count:
            self._recent.append((now_ns, count - self._count))
            self._names = tuple(dict.fromkeys(names))[-WINDOW:]
        self._count = count

    def crowded(self, count: int, now_ns: int) -> None:
        """Take how many connections the broker has refused so far since there were too many."""
        if count > self._crowd:
            self._crowded.append((now_ns, count - self._crowd))
        self._crowd = count

    def second_life(self, process: str, now_ns: int) -> None:
        """Note a heartbeat of a life of a process that another one has followed already."""
        since_ns, _ = self._twice.get(process, (now_ns, 0))
        self._twice[process] = since_ns, now_ns

    def problems(self, now_ns: int) -> Iterator[Problem]:
        """What was seen in the last minute."""
        for events in (self._recent, self._crowded):
            while events and now_ns - events[0][0] > SHOWN_NS:
                events.popleft()
        if self._recent:
            number = sum(count for _, count in self._recent)
            text = (
                f"the broker has refused {number} connection{'s' if number > 1 else ''} without the right secret in "
                f"the last minute: {', '.join(self._names)}"
            )
            yield Problem(what=BROKER, text=text[:400], since_ns=self._recent[0][0])
        if self._crowded:
            number = sum(count for _, count in self._crowded)
            text = (
                f"the broker has refused {number} connection{'s' if number > 1 else ''} in the last minute, since it "
                "has as many as it may: `ss -tnp` names the programs that hold them"
            )
            yield Problem(what=BROKER, text=text, since_ns=self._crowded[0][0])
        for process, (since_ns, last_ns) in list(self._twice.items()):
            if now_ns - last_ns > SHOWN_NS:
                del self._twice[process]
                continue
            text = f"{process} runs twice: two programs send under its name and its secret; stop one of them"
            yield Problem(what=process, text=text, since_ns=since_ns)

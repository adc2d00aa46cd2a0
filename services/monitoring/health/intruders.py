"""Somebody who may not speak: connections that the broker refuses, and a second program under the name of a process."""

from collections import deque
from collections.abc import Iterator, Sequence

from shared.messages.explanation import QUOTED_LENGTH, Explanation, QuotedText, explain, process
from shared.messages.operation import Problem
from shared.words.words import reason

from .codes import Code

DISPLAY_TIME_NS = 60_000_000_000  # after the last sign of it
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

    def second_life(self, name: str, now_ns: int) -> None:
        """Note a heartbeat of a life of a process that another one has followed already."""
        since_ns, _ = self._twice.get(name, (now_ns, 0))
        self._twice[name] = since_ns, now_ns

    def problems(self, now_ns: int) -> Iterator[Problem]:
        """What was seen in the last minute."""
        for events in (self._recent, self._crowded):
            while events and now_ns - events[0][0] > DISPLAY_TIME_NS:
                events.popleft()
        if self._recent:
            number = sum(count for _, count in self._recent)
            clients = QuotedText(quoted=", ".join(self._names)[:QUOTED_LENGTH])
            yield _problem(BROKER, explain(Code.REFUSED, refused_count=number, clients=clients), self._recent[0][0])
        if self._crowded:
            number = sum(count for _, count in self._crowded)
            yield _problem(BROKER, explain(Code.CROWDED, refused_count=number), self._crowded[0][0])
        for name, (since_ns, last_ns) in list(self._twice.items()):
            if now_ns - last_ns > DISPLAY_TIME_NS:
                del self._twice[name]
                continue
            yield _problem(name, explain(Code.RUNS_TWICE, process(name)), since_ns)


def _problem(what: str, why: Explanation, since_ns: int) -> Problem:
    return Problem(what=what, text=reason(why), text_code=why, since_ns=since_ns)

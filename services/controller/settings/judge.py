"""Whether the unit is worse with a change: lives, inputs and rejects, against what they were."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from shared.messages.explanation import Explanation, explain, process, topic
from shared.messages.operation import DeadlineReport, Freshness, ProcessHealth
from shared.messages.settings import SettingsChange
from shared.processes import BY_NAME
from shared.topics import needs, publications, subscriptions

from .codes import Code

CAME = (Freshness.FRESH, Freshness.LATE)
SILENT = (Freshness.STALE, Freshness.NEVER)
ENDS = 3  # restarts of a touched process; one is what the change itself needs
REJECTS_HZ, REJECTS_RATIO = 0.5, 2.0  # more than so many a second, and than so many times those of before
NS = 1_000_000_000


def downstream(touched: Iterable[str]) -> frozenset[str]:
    """Topics that processes publish, and those that need them further on."""
    found: set[str] = set()
    waiting = [name for name in touched if name in BY_NAME]
    seen = set(waiting)
    while waiting:
        topics = {row.name for row in publications(waiting.pop()) if not row.per_process}
        found |= topics
        for name in BY_NAME:
            if name not in seen and topics & {row.name for row in needs(name)}:
                seen.add(name)
                waiting.append(name)
    return frozenset(found)


@dataclass(frozen=True)
class Before:
    """What was there before a change."""

    fresh: tuple[str, ...] = ()  # topics that came
    restarts: Mapping[str, int] = field(default_factory=dict)

    @classmethod
    def of(cls, report: DeadlineReport | None) -> "Before":
        """State that a report of monitoring.health gives."""
        if report is None:
            return cls()
        fresh = tuple(one.topic for one in report.topics if one.freshness in CAME)
        return cls(fresh, {one.process: one.restarts for one in report.processes})


def switched(change: SettingsChange, *, on: bool) -> tuple[str, ...]:
    """Processes that a change lets begin, or end."""
    wanted = "true" if on else "false"
    return tuple(one.name for one in change.differences if one.name in BY_NAME and one.after == wanted)


def outstanding(lives: Mapping[str, int], change: SettingsChange) -> tuple[str, ...]:
    """Touched processes that have not started since a change was written, by the begin of their lives [ns].

    One without a heartbeat does not run in this unit, unless the change lets it begin.
    """
    written_ns, begin, end = change.begun_ns, switched(change, on=True), switched(change, on=False)
    return tuple(
        name for name in change.touched
        if name not in end and lives.get(name, written_ns + (name not in begin)) <= written_ns
    )  # fmt: skip


class Rejects:
    """Rates of rejected inputs of each process, before and since a change."""

    def __init__(self) -> None:
        self._newest: dict[str, ProcessHealth] = {}
        self._begun: dict[str, tuple[int, int, int, float]] = {}  # life, time, rejects, rate before
        self._compares = False

    @property
    def lives(self) -> dict[str, int]:
        """Begin of the present life of each process [ns]."""
        return {name: one.incarnation for name, one in self._newest.items()}

    def note(self, health: ProcessHealth) -> None:
        """Take the heartbeat of a process."""
        if not health.state.is_over:
            self._newest[health.process] = health
            if self._compares and health.process not in self._begun:
                self._begun[health.process] = health.incarnation, health.sent_ns, _count(health), 0.0

    def begin(self) -> None:
        """Begin to compare: what came until now was before the change."""
        self._compares = True
        self._begun = {
            name: (one.incarnation, one.sent_ns, _count(one), _count(one) / _span_s(one.incarnation, one.sent_ns))
            for name, one in self._newest.items()
        }

    def worse(self) -> dict[str, float]:
        """Processes that reject more than before, with the rate [1/s]."""
        found = {}
        for name, one in self._newest.items():
            life, since_ns, count, before_hz = self._begun.get(name, (0, one.incarnation, 0, 0.0))
            if life == one.incarnation:
                now_hz = (_count(one) - count) / _span_s(since_ns, one.sent_ns)
            else:
                now_hz = _count(one) / _span_s(one.incarnation, one.sent_ns)
            if now_hz > REJECTS_HZ + REJECTS_RATIO * before_hz:
                found[name] = now_hz
        return found


def worse(
    before: Before, change: SettingsChange, report: DeadlineReport, rejects: Rejects, watched_s: float
) -> tuple[Explanation, ...]:
    """Why the unit is worse than before; () if it is not."""
    ended = switched(change, on=False)
    touched = tuple(name for name in change.touched if name not in ended)
    found: list[Explanation] = []
    for one in report.processes:
        if one.process not in touched:
            continue
        ends = one.restarts - before.restarts.get(one.process, 0)
        if one.status.down:
            found.append(explain(Code.PROCESS_DOWN, process(one.process)))
        elif ends >= ENDS:
            found.append(explain(Code.KEEPS_ENDING, process(one.process), ends_number=ends, watched_s=watched_s))
    # What came from a process that is switched off is missed only where one that is switched on takes its place.
    follows = downstream(touched) - (downstream(ended) - downstream(switched(change, on=True)))
    found += [
        explain(Code.TOPIC_SILENT, topic(one.topic))
        for one in report.topics
        if one.topic in follows and one.topic in before.fresh and one.freshness in SILENT
    ]
    readers = set(touched) | {
        name for name in BY_NAME
        if any(row.is_raw and set(row.producers) & set(touched) for row in subscriptions(name))
        and not BY_NAME[name].observes_all
    }  # fmt: skip
    found += [
        explain(Code.MORE_REJECTS, process(name), rejects_number=rate)
        for name, rate in rejects.worse().items() if name in readers
    ]  # fmt: skip
    return tuple(found[:16])


def _count(health: ProcessHealth) -> int:
    return sum(health.rejects.values())


def _span_s(begin_ns: int, end_ns: int) -> float:
    return max((end_ns - begin_ns) / NS, 1.0)

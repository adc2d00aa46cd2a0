"""Who talks to whom: the flows between processes that a picture needs, from the table of processes."""

from collections import defaultdict
from collections.abc import Iterable
from typing import NamedTuple

from shared.processes import PROCESSES, Kind, ProcessRow, Role
from shared.topics import TOPICS

MONITOR_TOPIC, VERDICT_TOPIC = "trust/monitor", "trust/state"
# States for all who need them; their arrows would lead from and to everything.
COMMON = ("device/state", "origin/state", "host/clock", "mode/state", "health/load", "corrections/state")


class Flow(NamedTuple):
    """Messages from one box of the picture to another one."""

    source: str
    target: str
    topics: tuple[str, ...]
    mutual: bool  # the target answers the source, and the picture has one arrow with two heads


class Boxes(NamedTuple):
    """Processes by the place that they have in the picture; those of a group share their arrows."""

    columns: tuple[tuple[ProcessRow, ...], ...]  # sensors, parsers, core and controller, what follows it, monitoring
    monitors: tuple[ProcessRow, ...]  # test a source of measurements; part of the core
    simulated: tuple[ProcessRow, ...]  # stand in for devices
    observers: tuple[ProcessRow, ...]  # read every topic

    def group(self, name: str) -> str | None:
        """Box of a process: its own name, that of its group, None of one that is drawn without arrows."""
        if any(name == row.name for row in (*self.simulated, *self.observers)):
            return None
        return "monitors" if any(name == row.name for row in self.monitors) else name

    def column(self, box: str) -> int:
        """Number of the column of a box, from the devices on."""
        if box == "monitors":
            return 2
        return next(n for n, rows in enumerate(self.columns) if any(row.name == box for row in rows))


def boxes() -> Boxes:
    """Arrange the processes."""
    simulated = tuple(row for row in PROCESSES if row.kind in (Kind.SIMULATOR, Kind.REPLAY))
    observers = tuple(row for row in PROCESSES if row.observes_all)
    monitors = tuple(row for row in PROCESSES if MONITOR_TOPIC in row.produces)
    rest = [row for row in PROCESSES if row not in (*simulated, *observers, *monitors)]
    columns: dict[int, list[ProcessRow]] = defaultdict(list)
    for row in rest:
        columns[_column(row)].append(row)
    return Boxes(tuple(tuple(columns[n]) for n in range(5)), monitors, simulated, observers)


def _column(row: ProcessRow) -> int:
    if row.layer == 4 and (VERDICT_TOPIC in row.produces or row.roles == (Role.RSU,)):
        return 3
    return {1: 0, 2: 1, 3: 2, 4: 2, 5: 4}[row.layer]


def flows(arranged: Boxes) -> list[Flow]:
    """Find the arrows of the picture.

    An arrow towards monitoring, or from the core to the controller, is left out where others lead from its source to
    its target; one towards the devices where it passes a column. Topics of `COMMON` are left out.
    """
    topics: dict[tuple[str, str], list[str]] = defaultdict(list)
    for topic in TOPICS:
        if not topic.per_process and topic.name not in COMMON:
            for pair in _pairs(topic.producers, topic.consumers, arranged):
                topics[pair].append(topic.name)
    step = {pair: arranged.column(pair[1]) - arranged.column(pair[0]) for pair in topics}
    forward = {pair for pair in topics if step[pair] > 0 or (step[pair] == 0 and pair[1].startswith("controller."))}
    drawn = {pair for pair in forward if not _reaches(pair, forward - {pair}) or pair[::-1] in topics}
    drawn |= {pair for pair in topics if step[pair] in (0, -1) and pair not in forward and pair[::-1] not in drawn}
    once = {pair for pair in drawn if pair[::-1] not in drawn or pair < pair[::-1]}
    return [Flow(*pair, tuple(topics[pair]), pair[::-1] in topics) for pair in sorted(once)]


def _pairs(producers: Iterable[str], consumers: Iterable[str], arranged: Boxes) -> set[tuple[str, str]]:
    sources, targets = ({arranged.group(name) for name in names} for names in (producers, consumers))
    return {(a, b) for a in sources for b in targets if a is not None and b is not None and a != b}


def _reaches(pair: tuple[str, str], edges: set[tuple[str, str]]) -> bool:
    """Whether edges lead from the first to the second of a pair."""
    known, waiting = {pair[0]}, [pair[0]]
    while waiting:
        here = waiting.pop()
        following = {target for source, target in edges if source == here} - known
        known |= following
        waiting += following
    return pair[1] in known

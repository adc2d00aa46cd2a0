"""Positions under the hypotheses: the newest message of each process, and tracks of the last two minutes."""

from collections import deque
from dataclasses import dataclass
from itertools import pairwise

from shared.messages.trust import Hypothesis, HypothesisSolution, TrustHypotheses
from shared.processes import BY_NAME as PROCESS_ROWS

from .track import Place

SPAN_NS = 120_000_000_000  # of a track
STEP_NS = 900_000_000  # between points: the messages come once a second
BREAK_NS = 3_000_000_000  # a longer pause ends a line, as in the history
POINTS_MAXIMUM = SPAN_NS // STEP_NS + 1


@dataclass(frozen=True)
class Point:
    """A position under a hypothesis, and the sources that it is without."""

    time_ns: int
    place: Place
    left_out: tuple[str, ...]


@dataclass(frozen=True)
class Line:
    """An unbroken part of the positions under one hypothesis by one process."""

    producer: str
    hypothesis: Hypothesis
    points: tuple[Point, ...]


class Alternatives:
    """Keeps one message of each process, and one track for each of its hypotheses."""

    def __init__(self) -> None:
        self.newest: dict[str, tuple[TrustHypotheses, int]] = {}  # by process, with the time of its arrival
        self._tracks: dict[tuple[str, Hypothesis], deque[Point]] = {}

    def note(self, message: TrustHypotheses, producer: str, received_ns: int) -> None:
        """Take a message; one of a process that is not in the table is ignored, so that memory is bounded."""
        if producer not in PROCESS_ROWS:
            return
        self.newest[producer] = (message, received_ns)
        for hypothesis in Hypothesis:
            solution = worst([solution for solution in message.solutions if solution.hypothesis is hypothesis])
            if solution is not None:
                track = self._tracks.setdefault((producer, hypothesis), deque(maxlen=POINTS_MAXIMUM))
                _append(track, _point(solution, message.sampled_ns))

    def lines(self, now_ns: int) -> list[Line]:
        """Give the tracks of the last two minutes, broken at pauses and where other sources are left out."""
        found = []
        for (producer, hypothesis), track in self._tracks.items():
            recent = [point for point in track if 0 <= now_ns - point.time_ns <= SPAN_NS]
            found += [Line(producer, hypothesis, part) for part in _parts(recent)]
        return found


def worst(solutions: list[HypothesisSolution]) -> HypothesisSolution | None:
    """Choose the solution with the largest separation over its limit; None of none."""
    return max(solutions, key=lambda hypothesis_solution: separation_ratio(hypothesis_solution) or 0.0, default=None)


def separation_ratio(solution: HypothesisSolution) -> float | None:
    """Separation over its limit [-]: above 1 noise does not explain it; None where it is not tested."""
    if solution.separation is None or not solution.separation_limit:
        return None
    return solution.separation / solution.separation_limit


def _point(solution: HypothesisSolution, time_ns: int) -> Point:
    return Point(time_ns, Place(solution.latitude_deg, solution.longitude_deg), solution.left_out)


def _append(track: deque[Point], point: Point) -> None:
    """Add a point; a stamp that goes back begins the track anew, and one that follows too soon is left out."""
    if track and point.time_ns < track[-1].time_ns:
        track.clear()
    if not track or point.time_ns - track[-1].time_ns >= STEP_NS:
        track.append(point)


def _parts(points: list[Point]) -> list[tuple[Point, ...]]:
    if not points:
        return []
    parts = [[points[0]]]
    for before, point in pairwise(points):
        if point.time_ns - before.time_ns > BREAK_NS or point.left_out != before.left_out:
            parts.append([])
        parts[-1].append(point)
    return [tuple(part) for part in parts]

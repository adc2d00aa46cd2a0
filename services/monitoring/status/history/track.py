"""The track of this drive: the positions of every source, thinned so that the whole drive fits."""

from collections import deque
from collections.abc import Iterable, Iterator
from itertools import pairwise
from math import cos, hypot, inf, radians
from typing import Literal, NamedTuple

from pydantic import TypeAdapter, ValidationError
from typing_extensions import TypedDict

from shared.page.answers import Stamp, answer
from shared.track_files import Extra, TrackPoint

POINTS_MAXIMUM = 6000
SPACING_M = 0.5  # between points at first; doubled whenever the points become too many
METRES_PER_DEGREE = 111_320.0  # good enough for a spacing
RESTORED_NS = 3_600_000_000_000  # a longer pause ends a drive
UNSAVED = 1000  # rows
SOURCES = ("fused", "gnss", "truth")


class Place(NamedTuple):
    """A position on the ground."""

    latitude_deg: float
    longitude_deg: float


@answer()
class TrackColumns(TypedDict):
    """Columns of one length, one row a position; null where a source was silent."""

    time_ns: list[Stamp]
    state: list[str]
    """the verdict shown: `state` of /api/solution"""
    aided: list[Literal[0, 1]]
    """1: GNSS was part of the solution within the last 3 s"""
    height_ellipsoid_m: list[float | None]
    radius_95_m: list[float | None]
    """semi-major axis of the 95 % error ellipse"""
    level_m: list[float | None]
    """horizontal protection level"""
    fused_latitude_deg: list[float | None]
    fused_longitude_deg: list[float | None]
    gnss_latitude_deg: list[float | None]
    """of the receiver only"""
    gnss_longitude_deg: list[float | None]
    truth_latitude_deg: list[float | None]
    """of the simulator"""
    truth_longitude_deg: list[float | None]


class TrackRow(NamedTuple):
    """What was known at one time; None where a source was silent."""

    time_ns: int
    state: str  # the verdict shown
    aided: bool  # GNSS was part of the solution within the last seconds
    fused: Place | None = None
    gnss: Place | None = None
    truth: Place | None = None
    height_ellipsoid_m: float | None = None
    radius_95_m: float | None = None  # semi-major axis of the 95 % ellipse
    level_m: float | None = None  # horizontal protection level


ROW = TypeAdapter(TrackRow)


class Track:
    """Rows in the order of time, at most `maximum`; a row is kept where it differs from the one before."""

    def __init__(self, maximum: int = POINTS_MAXIMUM) -> None:
        self.rows: list[TrackRow] = []
        self.spacing_m = SPACING_M
        self._unsaved: deque[TrackRow] = deque(maxlen=UNSAVED)
        self.generation = 0  # changes when rows were removed, so that a reader starts afresh
        self._maximum = maximum

    def add(self, row: TrackRow) -> None:
        """Keep a row that says something new; what is earlier than the last one is known already."""
        if self.rows and row.time_ns <= self.rows[-1].time_ns:
            return
        if self.rows and not differs(self.rows[-1], row, self.spacing_m):
            return
        if not self.rows and not any((row.fused, row.gnss, row.truth)):
            return
        self._append(row)
        self._unsaved.append(row)

    def interrupt(self) -> None:
        """End a part of the track: the next position does not continue it."""
        if self.rows and self.rows[-1].fused:
            self._append(TrackRow(self.rows[-1].time_ns, self.rows[-1].state, aided=False))

    def unsaved(self) -> list[TrackRow]:
        """Rows to be kept for the next incarnation of this process, since the last call."""
        rows, self._unsaved = list(self._unsaved), deque(maxlen=UNSAVED)
        return rows

    def restore(self, lines: Iterable[bytes], now_ns: int) -> int:
        """Add rows of earlier incarnations that belong to this drive; returns the number of invalid lines.

        A pause of more than `RESTORED_NS` separates drives. Lines are the JSON of rows, oldest first.
        """
        bad, rows = 0, list[TrackRow]()
        for line in lines:
            try:
                row = ROW.validate_json(line)
            except ValidationError:
                bad += 1
                continue
            if rows and not 0 < row.time_ns - rows[-1].time_ns <= RESTORED_NS:
                rows.clear()
            rows.append(row)
        if rows and 0 <= now_ns - rows[-1].time_ns <= RESTORED_NS:
            for row in rows:
                self._append(row)
            self.interrupt()
        return bad

    def _append(self, row: TrackRow) -> None:
        self.rows.append(row)
        if len(self.rows) > self._maximum:
            self._thin()

    def after(self, time_ns: int) -> list[TrackRow]:
        """Rows later than a time."""
        first = next((i + 1 for i in range(len(self.rows) - 1, -1, -1) if self.rows[i].time_ns <= time_ns), 0)
        return self.rows[first:]

    def _thin(self) -> None:
        """Double the spacing until a quarter of the rows is gone; drop every second row where few depend on it."""
        self.generation += 1
        if len(thinned(self.rows, inf)) > self._maximum // 2:
            self.rows = self.rows[::2]
            return
        while len(self.rows) > 0.75 * self._maximum:
            self.spacing_m *= 2.0
            self.rows = thinned(self.rows, self.spacing_m)


def thinned(rows: list[TrackRow], spacing_m: float) -> list[TrackRow]:
    """Keep the rows that differ from the last one that was kept."""
    kept = rows[:1]
    for row in rows[1:]:
        if differs(kept[-1], row, spacing_m):
            kept.append(row)
    return kept


def differs(before: TrackRow, row: TrackRow, spacing_m: float) -> bool:
    """Whether the verdict or the aiding changed, a source began or ended, or one moved by the spacing."""
    if (before.state, before.aided) != (row.state, row.aided):
        return True
    pairs = ((before.fused, row.fused), (before.gnss, row.gnss), (before.truth, row.truth))
    return any((a is None) != (b is None) or (a and b and distance_m(a, b) >= spacing_m) for a, b in pairs)


def distance_m(a: Place, b: Place) -> float:
    """Distance of two near positions, on a sphere [m]."""
    east = (b.longitude_deg - a.longitude_deg) * cos(radians(a.latitude_deg))
    return METRES_PER_DEGREE * hypot(b.latitude_deg - a.latitude_deg, east)


def segments(rows: list[TrackRow], source: str) -> Iterator[list[TrackPoint]]:
    """Split one source's positions where it was silent: the segments of a GPX or KML file."""
    points: list[TrackPoint] = []
    for row in rows:
        place: Place | None = getattr(row, source)
        if place is not None:
            points.append(_point(row, place, source))
        elif points:
            yield points
            points = []
    if points:
        yield points


def _point(row: TrackRow, place: Place, source: str) -> TrackPoint:
    """What the solution says of itself goes with its own positions only."""
    if source != "fused":
        return TrackPoint(row.time_ns, *place)
    extras: dict[str, Extra] = {
        "trust": row.state,
        "gnss_used": int(row.aided),
        "radius_95_m": row.radius_95_m,
        "protection_level_horizontal_m": row.level_m,
    }
    return TrackPoint(row.time_ns, *place, row.height_ellipsoid_m, extras)


def columns(rows: list[TrackRow]) -> TrackColumns:
    """Turn rows into columns for JSON: degrees to 8 decimals, metres to centimetres."""
    fused, gnss, truth = ([getattr(row, source) for row in rows] for source in SOURCES)
    return {
        "time_ns": [row.time_ns for row in rows],
        "state": [row.state for row in rows],
        "aided": [1 if row.aided else 0 for row in rows],
        "height_ellipsoid_m": [_rounded(row.height_ellipsoid_m) for row in rows],
        "radius_95_m": [_rounded(row.radius_95_m) for row in rows],
        "level_m": [_rounded(row.level_m) for row in rows],
        "fused_latitude_deg": _degrees(fused, 0),
        "fused_longitude_deg": _degrees(fused, 1),
        "gnss_latitude_deg": _degrees(gnss, 0),
        "gnss_longitude_deg": _degrees(gnss, 1),
        "truth_latitude_deg": _degrees(truth, 0),
        "truth_longitude_deg": _degrees(truth, 1),
    }


def _degrees(places: list[Place | None], number: int) -> list[float | None]:
    return [None if place is None else round(place[number], 8) for place in places]


def length_m(rows: list[TrackRow]) -> float:
    """Distance driven by the solution, without the spans in which there was none [m]."""
    return sum(distance_m(a.fused, b.fused) for a, b in pairwise(rows) if a.fused and b.fused)


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 2)

"""What a list of recordings shows of one: times, distance, outline of the track, verdicts and outages.

`python -m shared.recording.summary RECORDING OUTPUT [NICE]` computes it in a process of its own, which
`shared.library.summary.SummaryWorker` starts.
"""

import json
import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import suppress
from math import cos, hypot, radians
from pathlib import Path

from ..bus.envelope import Envelope
from ..errors import BadPayload, BadRecording
from ..library.summary import MAX_LENGTH, NICE, Point, RecordingSummary
from ..maths.ellipsoid import curvature_radii
from ..messages.base import Name
from ..messages.gnss import GnssFix
from ..messages.navigation import NavigationSolution
from ..messages.operation import Origin, Outage
from ..messages.replay import TrustChange
from ..messages.trust import TrustState
from .index import RecordingIndex
from .reader import Recording

POINTS = 100  # of the outline
SPACING_NS = 1_000_000_000  # of positions
TOPICS = ("navigation/solution", "gnss/fix", "trust/state", "outage/event", "origin/state")


def summarise(path: Path) -> RecordingSummary:
    """Summarise a recording; raises `BadRecording` for a file without a message."""
    with Recording(path) as recording:
        stamps: list[int] = []
        solutions, fixes = _Way(), _Way()
        trust: list[TrustChange] = []
        outages: dict[tuple[str, int], Outage] = {}
        origin: Name | None = None
        for envelope in _wanted(recording, stamps):
            if envelope.topic == "navigation/solution" and not solutions.due(envelope.received_ns):
                continue
            with suppress(BadPayload):
                match envelope.decode():
                    case NavigationSolution(latitude_deg=latitude, longitude_deg=longitude):
                        solutions.add(envelope.received_ns, latitude, longitude)
                    case GnssFix(latitude_deg=float(latitude), longitude_deg=float(longitude)):
                        fixes.add(envelope.received_ns, latitude, longitude)
                    case TrustState(state=state) if not trust or trust[-1].state != state:
                        trust.append(TrustChange(since_ns=envelope.received_ns, state=state))
                    case Outage() as outage:
                        outages[outage.what, outage.since_ns] = outage
                    case Origin(kind=kind):
                        origin = kind.value
                    case _:
                        pass
        if not stamps:
            raise BadRecording(f"{path} holds no message")
        way = solutions if solutions.points else fixes
        return RecordingSummary(
            size_bytes=recording.size,
            vehicle=recording.metadata.get("obu", {}).get("vehicle", ""),
            origin=origin,
            begin_ns=stamps[0],
            end_ns=stamps[-1],
            distance_m=way.length_m if way.points else None,
            track=way.outline(),
            trust=tuple(trust[-MAX_LENGTH:]),
            outages=tuple(outages.values())[-MAX_LENGTH:],
            solved=bool(solutions.points),
        )


def _wanted(recording: Recording, stamps: list[int]) -> Iterator[Envelope]:
    """Yield the messages of interest; `stamps` receives the first and the last arrival of all messages."""
    try:
        index = RecordingIndex(recording)
    except BadRecording:  # it was not closed: all of it has to be read
        for envelope in recording:
            stamps[1:] = [envelope.received_ns]
            if len(stamps) == 1:
                stamps.append(envelope.received_ns)
            if envelope.topic in TOPICS:
                yield envelope
        return
    stamps += [index.begin_ns, index.end_ns]
    yield from index.between(index.begin_ns - 1, index.end_ns, TOPICS)


class _Way:
    """Positions of one source, a second apart, and the distance along them."""

    def __init__(self) -> None:
        self.points: list[tuple[float, float]] = []
        self.lengths_m: list[float] = []  # from the first point to each
        self._last_ns: int | None = None

    @property
    def length_m(self) -> float:
        """Length of the track [m]."""
        return self.lengths_m[-1] if self.lengths_m else 0.0

    def due(self, arrival_ns: int) -> bool:
        """Whether a second has passed since the last position."""
        return self._last_ns is None or arrival_ns - self._last_ns >= SPACING_NS

    def add(self, arrival_ns: int, latitude_deg: float, longitude_deg: float) -> None:
        """Append a position unless it follows the last one too closely."""
        if not self.due(arrival_ns):
            return
        self._last_ns = arrival_ns
        step_m = 0.0 if not self.points else distance_m(self.points[-1], (latitude_deg, longitude_deg))
        self.points.append((latitude_deg, longitude_deg))
        self.lengths_m.append(self.length_m + step_m)

    def outline(self) -> tuple[Point, ...]:
        """Choose at most `POINTS` positions, evenly spaced along the track, the first and the last among them."""
        if len(self.points) <= POINTS:
            return tuple(self.points)
        chosen, step_m = [0], self.length_m / (POINTS - 1)
        for place, length_m in enumerate(self.lengths_m):
            if len(chosen) < POINTS - 1 and place > chosen[-1] and length_m >= len(chosen) * step_m:
                chosen.append(place)
        return tuple(self.points[place] for place in (*chosen, len(self.points) - 1))


def distance_m(first: tuple[float, float], second: tuple[float, float]) -> float:
    """Distance [m] of two geodetic positions [deg] that are near each other, by the radii of curvature."""
    latitude = radians((first[0] + second[0]) / 2.0)
    meridian, transverse = curvature_radii(latitude)
    east_deg = (second[1] - first[1] + 180.0) % 360.0 - 180.0
    return hypot(radians(second[0] - first[0]) * meridian, radians(east_deg) * transverse * cos(latitude))


def write_summary(recording: Path, output: Path) -> None:
    """Write a summary atomically."""
    draft = output.with_name(f"{output.name}.{os.getpid()}.new")
    try:
        draft.write_text(json.dumps(summarise(recording).model_dump(mode="json", exclude_none=True)))
        draft.replace(output)
    finally:
        draft.unlink(missing_ok=True)


def main(arguments: Iterable[str]) -> int:
    """Compute the summary of a recording into a file."""
    recording, output, *nice = arguments
    os.nice(int(nice[0]) if nice else NICE)
    try:
        write_summary(Path(recording), Path(output))
    except (BadRecording, OSError) as error:
        sys.stderr.write(f"{recording}: no summary: {error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""The list of recordings as JSON: what is known of each, and the outline of its track as an SVG path."""

from collections.abc import Callable, Iterable, Sequence
from math import cos, radians

from shared.library.library import Entry
from shared.library.summary import RecordingSummary

from .models.recordings import RecordingShown, SummaryShown

WIDTH, HEIGHT = 100.0, 60.0  # of the outline's view box


def recordings(
    entries: Iterable[Entry], open_name: str | None, has_report: Callable[[str], bool]
) -> list[RecordingShown]:
    """Show each recording."""
    return [_recording(entry, recording=entry.name == open_name, report=has_report(entry.name)) for entry in entries]


def _recording(entry: Entry, *, recording: bool, report: bool) -> RecordingShown:
    return {
        "name": entry.name, "size_bytes": entry.size_bytes, "kept": entry.kept, "recording": recording,
        "failed": entry.failed, "summary": None if entry.summary is None else _summary(entry.summary), "report": report,
    }  # fmt: skip


def _summary(s: RecordingSummary) -> SummaryShown:
    return {
        "begin_ns": s.begin_ns,
        "end_ns": s.end_ns,
        "origin": s.origin,
        "distance_m": None if s.distance_m is None else round(s.distance_m),
        "outline": outline(s.track),
        "trust": [change.model_dump() for change in s.trust],
        "outages": [outage.model_dump(include={"what", "since_ns", "until_ns", "cause"}) for outage in s.outages],
    }


def outline(track: Sequence[tuple[float, float]]) -> str | None:
    """Draw positions [deg] north up into the view box, to scale; None of fewer than two."""
    if len(track) < 2:
        return None
    shrink = cos(radians(track[0][0]))
    xs = [((longitude - track[0][1] + 180.0) % 360.0 - 180.0) * shrink for _, longitude in track]
    ys = [-latitude for latitude, _ in track]
    width, height = max(xs) - min(xs), max(ys) - min(ys)
    scale = min(WIDTH / max(width, 1e-9), HEIGHT / max(height, 1e-9))
    left, top = (WIDTH - width * scale) / 2.0 - min(xs) * scale, (HEIGHT - height * scale) / 2.0 - min(ys) * scale
    return "M" + "L".join(f"{x * scale + left:.1f} {y * scale + top:.1f}" for x, y in zip(xs, ys, strict=True))

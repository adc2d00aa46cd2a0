"""Writes the output files of `obu solve`."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from shared.errors import UserError
from shared.runtime.reports import tell
from shared.track_files import TrackPoint, cut_at_antimeridian, kml_lines

from .metrics.drift import drift_lines
from .metrics.metrics import Run, Value
from .reference_track import Reference
from .report.report import Heading, document, page, verdict
from .track import NAMES, Track

HEADER = ("sampled_ns", "time_s", "phase", *NAMES, "verdict")
# Rounding is below 1 mm, 0.1 mm/s and 1 microradian.
DECIMALS = {
    "latitude_deg": 9,
    "longitude_deg": 9,
    "height_ellipsoid_m": 4,
    "protection_level_horizontal_m": 4,
    "protection_level_vertical_m": 4,
    "stationary": 0,
    "gnss_age_s": 3,
}
KML_POINTS = 20_000


def write(
    folder: Path, runs: tuple[Run, Run | None], reference: Reference | None, heading: Heading, metrics: dict[str, Value]
) -> None:
    """Write tracks, metrics and report of a drive, filtered and optionally smoothed."""
    from .report.plots import figures_of  # matplotlib takes 0.5 s to import
    from .report.plots_smoothed import figures_of_both

    run, smoothed = runs
    figures = figures_of(run, reference)
    tracks = {"solution": run.track}
    if smoothed is not None:
        figures += figures_of_both(run, smoothed)
        tracks["solution_smoothed"] = smoothed.track
    report = page(heading, metrics, figures)
    try:
        for name, track in tracks.items():
            verdicts = [] if run.trust is None else run.trust.verdicts.at(track.stamps_ns)
            with (folder / f"{name}.csv").open("w", encoding="utf-8") as file:
                file.writelines(csv_lines(track, verdicts))
            with (folder / f"{name}.kml").open("w", encoding="utf-8") as file:
                file.writelines(kml_lines(heading.name, cut_at_antimeridian(kml_points(track, run.utc_offset_ns))))
        if heading.outage is not None:
            with (folder / "outages.csv").open("w", encoding="utf-8") as file:
                file.writelines(drift_lines(run.drifts(), run.first_ns))
        (folder / "metrics.json").write_text(json.dumps(document(heading, metrics), indent=2) + "\n", encoding="utf-8")
        (folder / "report.html").write_text(report, encoding="utf-8")
        tell(finding=verdict(metrics, heading.clocks))
    except OSError as error:
        raise UserError(f"cannot write to {folder}: {error.strerror}; choose another folder with --out") from error


def csv_lines(track: Track, verdicts: Sequence[str] = ()) -> Iterator[str]:
    """Format a track as CSV, one line per solution, each with its verdict if given; unknown values are empty."""
    yield ",".join(HEADER) + "\n"
    formats = [f"%.{DECIMALS.get(name, 7)}f" for name in NAMES]
    line = "%d,%.6f,%s," + ",".join(formats) + ",%s"
    first = int(track.stamps_ns[0]) if len(track) else 0
    said = verdicts or [""] * len(track)
    for stamp, phase, row, level in zip(
        track.stamps_ns.tolist(), track.phases, track.values.tolist(), said, strict=True
    ):
        text = line % (stamp, (stamp - first) * 1e-9, phase.value, *row, level)
        yield text.replace("nan", "") + "\n"


def kml_points(track: Track, utc_offset_ns: int = 0) -> list[TrackPoint]:
    """At most `KML_POINTS` points of a track and its last one, in UTC."""
    position = track.columns("latitude_deg")
    step = -(-len(position) // KML_POINTS) or 1
    chosen: list[int] = np.unique(np.r_[0 : len(position) : step, len(position) - 1]).tolist() if len(position) else []
    return [TrackPoint(int(track.stamps_ns[k]) + utc_offset_ns, *position[k].tolist()) for k in chosen]

"""Writes the output files of `obu solve`."""

import json
from pathlib import Path

from shared.errors import UserError
from shared.track_files import kml_lines

from .metrics.drift import drift_lines
from .metrics.metrics import Run, Value
from .reference_track import Reference
from .report.export import csv_lines, kml_points
from .report.report import Heading, page


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
            with (folder / f"{name}.csv").open("w", encoding="utf-8") as file:
                file.writelines(csv_lines(track))
            with (folder / f"{name}.kml").open("w", encoding="utf-8") as file:
                file.writelines(kml_lines(heading.name, [kml_points(track)]))
        if heading.outage is not None:
            with (folder / "outages.csv").open("w", encoding="utf-8") as file:
                file.writelines(drift_lines(run.drifts(), run.first_ns))
        (folder / "metrics.json").write_text(json.dumps(metrics, indent=2) + "\n", encoding="utf-8")
        (folder / "report.html").write_text(report, encoding="utf-8")
    except OSError as error:
        raise UserError(f"cannot write to {folder}: {error.strerror}; choose another folder with --out") from error

"""The figures that compare the smoothed with the filtered drive."""

from collections.abc import Iterator

import numpy as np

from shared.maths.earth import FloatArray

from ..metrics.metrics import Run
from .drawing import BLUE, GREEN, Figure, inline_svg, label_decades, seconds_since, shade_gaps, stacked_axes, thinned

BANDS = 3.0  # standard deviations


def figures_of_both(filtered: Run, smoothed: Run) -> list[Figure]:
    """Draw the errors and the standard deviations of both."""
    return list(_figures(filtered, smoothed))


def _figures(filtered: Run, smoothed: Run) -> Iterator[Figure]:
    errors = (filtered.errors, smoothed.errors)
    if all(e is not None and e.position_n is not None and len(e) for e in errors):
        yield _errors(filtered, smoothed)
    yield _deviations(filtered, smoothed, "position", ("position_sd_north_m", "m", 1.0))
    degree = float(np.degrees(1.0))
    yield _deviations(filtered, smoothed, "attitude", ("attitude_sd_north_rad", "deg", degree))


def _errors(filtered: Run, smoothed: Run) -> Figure:
    drawn: list[str] = []
    with stacked_axes(3, 5.0, drawn.append) as rows:
        for run, colour, word in ((filtered, BLUE, "filter"), (smoothed, GREEN, "smoothed")):
            assert run.errors is not None and run.errors.position_n is not None
            time_s = seconds_since(run.errors.stamps_ns, run.first_ns)
            for column, axes in enumerate(rows):
                at, edge = thinned(time_s, BANDS * run.errors.position_sd_n[:, column])
                axes.fill_between(at, -edge, edge, color=colour, alpha=0.14, linewidth=0)
                axes.plot(*thinned(time_s, run.errors.position_n[:, column]), color=colour, label=word)
        for axes, name in zip(rows, ("north [m]", "east [m]", "down [m]"), strict=True):
            shade_gaps(axes, filtered.gaps, filtered.first_ns)
            axes.set_ylabel(name)
        rows[0].legend(loc="upper right", ncols=2)
        rows[-1].set_xlabel("time [s]")
    title = "Position errors, filtered and smoothed"
    caption = "Estimate minus truth; the bands are three standard deviations."
    return Figure(title, caption, inline_svg(drawn[0], title))


def _deviations(filtered: Run, smoothed: Run, what: str, column: tuple[str, str, float]) -> Figure:
    name, unit, scale = column
    drawn: list[str] = []
    with stacked_axes(3, 4.4, drawn.append) as rows:
        for run, colour, word in ((filtered, BLUE, "filter"), (smoothed, GREEN, "smoothed")):
            time_s, sd = seconds_since(run.track.stamps_ns, run.first_ns), _sd(run, name, scale)
            for place, axes in enumerate(rows):
                axes.plot(*thinned(time_s, sd[:, place]), color=colour, label=word)
        for axes, axis in zip(rows, ("north", "east", "down"), strict=True):
            shade_gaps(axes, filtered.gaps, filtered.first_ns)
            axes.set(ylabel=f"{axis} [{unit}]", yscale="log")
            label_decades(axes.yaxis)
        rows[0].legend(loc="upper right", ncols=2)
        rows[-1].set_xlabel("time [s]")
    title = f"Standard deviation of the {what}, filtered and smoothed"
    return Figure(title, "Standard deviations of the estimates.", inline_svg(drawn[0], title))


def _sd(run: Run, name: str, scale: float) -> FloatArray:
    found: FloatArray = scale * run.track.columns(name)
    return found

"""The figures of the report as inline SVG."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from io import StringIO
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from shared.maths.earth import FloatArray, Geodetic, ned_track
from shared.messages.navigation import AidingKind

from ..metrics.integrity import protected
from ..metrics.metrics import Run
from ..outages import Gap
from ..reference_track import Reference

if TYPE_CHECKING:
    from matplotlib.axes import Axes

POINTS = 1500  # maximum points per line
BLUE, ORANGE, GREEN, RED, GREY = "#0a5fb4", "#c75b00", "#2b7a3f", "#c01c28", "#8a8f98"
COLOURS = (BLUE, ORANGE, GREEN)
WIDTH_IN = 5.6  # at the width of a phone, text of 10 pt has 9 pixels
# Colours that a page replaces in its dark mode, each by the CSS variable of this name.
VARIABLES = {
    BLUE: "blue", ORANGE: "orange", GREEN: "green", RED: "red", GREY: "grey", "#000000": "ink", "#e3e6ea": "grid",
}  # fmt: skip
STYLE = {
    "svg.hashsalt": "obu",  # reproducible identifiers
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.size": 10.0,
    "axes.grid": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": "#e3e6ea",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.1,
    "legend.frameon": False,
    "legend.fontsize": 9.0,
    "path.simplify": False,  # would remove dots; lines are decimated in `thinned`
}


@dataclass(frozen=True)
class Figure:
    """One figure of the report."""

    title: str
    caption: str
    svg: str


def figures_of(run: Run, reference: Reference | None) -> list[Figure]:
    """Draw every figure for which there are data."""
    return list(_figures(run, reference))


def _figures(run: Run, reference: Reference | None) -> Iterator[Figure]:
    yield _trajectory(run, reference)
    errors, gaps = run.errors, run.gaps
    if errors is not None and len(errors):
        time_s = seconds_since(errors.stamps_ns, run.first_ns)
        if errors.position_n is not None:
            labels = _Labels(("north [m]", "east [m]", "down [m]"), gaps, run.first_ns)
            caption = "Solution minus truth; the band is three standard deviations of the filter."
            band = 3.0 * errors.position_sd_n
            yield _three("Position errors", caption, time_s, errors.position_n, labels, band=band)
        if errors.velocity_n is not None:
            labels = _Labels(("north [m/s]", "east [m/s]", "down [m/s]"), gaps, run.first_ns)
            yield _three("Velocity errors", "Solution minus truth.", time_s, errors.velocity_n, labels)
        if errors.attitude is not None:
            labels = _Labels(("roll [deg]", "pitch [deg]", "heading [deg]"), gaps, run.first_ns)
            yield _three("Attitude errors", "Solution minus truth.", time_s, np.degrees(errors.attitude), labels)
        yield from _integrity(run)
    yield _speed(run)
    yield _innovations(run)
    yield _biases(run)


def _integrity(run: Run) -> Iterator[Figure]:
    from .stanford import stanford  # imports this module

    scored = run.scored()
    if scored is not None:
        yield from map(stanford, protected(scored, run.alert_limits_m))


@dataclass(frozen=True)
class _Labels:
    """Labels of three axes, and the gaps shaded in them."""

    names: tuple[str, str, str]
    gaps: Sequence[Gap]
    first_ns: int


@contextmanager
def stacked_axes(
    rows: int, height: float, store: Callable[[str], None], width: float = WIDTH_IN
) -> Iterator[list["Axes"]]:
    """Create stacked axes; on exit pass the figure to `store` as SVG."""
    from matplotlib import style
    from matplotlib.figure import Figure as Canvas

    with style.context(STYLE):
        canvas = Canvas(figsize=(width, height), layout="constrained")
        axes = np.atleast_1d(canvas.subplots(rows, 1, sharex=True)).tolist()
        yield axes
        text = StringIO()
        canvas.savefig(text, format="svg", metadata={"Date": None, "Creator": None}, transparent=True)
    store(text.getvalue())


def inline_svg(svg: str, title: str, variables: Mapping[str, str] = VARIABLES) -> str:
    """Remove the prologue, make identifiers unique within the page, and colours those of its CSS variables."""
    prefix = re.sub(r"\W+", "-", title.lower())
    body = svg[svg.index("<svg") :]
    body = re.sub(r'(\bid="|url\(#|href="#)', rf"\g<1>{prefix}-", body)
    body = re.sub(r"<metadata>.*?</metadata>", "", body, flags=re.DOTALL)
    for colour, name in variables.items():
        body = body.replace(f": {colour}", f": var(--{name}, {colour})")
        body = body.replace(f'fill="{colour}"', f'style="fill: var(--{name}, {colour})"')
    # Coordinates are truncated to 0.01 pt, which halves the size of the page.
    body = re.sub(r' d="[^"]*"', lambda path: re.sub(r"(\.\d\d)\d+", r"\1", path[0]), body)
    return re.sub(r'<svg[^>]*?viewBox="([^"]*)"[^>]*>',
                  rf'<svg viewBox="\1" role="img" aria-label="{title}" xmlns:xlink="http://www.w3.org/1999/xlink">',
                  body, count=1)  # fmt: skip


def _trajectory(run: Run, reference: Reference | None) -> Figure:
    drawn: list[str] = []
    origin = Geodetic(*run.track.geodetic[0].tolist())
    path = ned_track(run.track.geodetic, origin)
    with stacked_axes(1, 4.2, drawn.append) as (axes,):
        if reference is not None and reference.geodetic is not None:
            true = ned_track(reference.geodetic, origin)
            true = true[:: max(1, len(true) // POINTS)]
            _dots(axes, true[:, 1], true[:, 0], GREY, "truth")
        step = max(1, len(path) // POINTS)
        axes.plot(path[::step, 1], path[::step, 0], color=BLUE, label="solution")
        for number, (first, last) in enumerate(run.gaps):
            rows = (run.track.stamps_ns >= first) & (run.track.stamps_ns < last)
            axes.plot(path[rows, 1], path[rows, 0], color=ORANGE, label=None if number else "without GNSS")
        axes.plot(0.0, 0.0, "o", color=GREEN, markersize=6, label="first solution")
        axes.set_aspect("equal", adjustable="datalim")
        axes.set(xlabel="east [m]", ylabel="north [m]")
        axes.legend(loc="best")
    title = "Trajectory"
    return Figure(title, "Relative to the first solution; north is up.", inline_svg(drawn[0], title))


def _three(
    title: str, caption: str, time_s: FloatArray, values: FloatArray, labels: _Labels, band: FloatArray | None = None
) -> Figure:
    """Three stacked components, each with its band."""
    drawn: list[str] = []
    with stacked_axes(3, 5.0, drawn.append) as rows:
        for column, axes in enumerate(rows):
            shade_gaps(axes, labels.gaps, labels.first_ns)
            if band is not None:
                at, edge = thinned(time_s, band[:, column])
                axes.fill_between(at, -edge, edge, color=BLUE, alpha=0.14, linewidth=0)
            axes.plot(*thinned(time_s, values[:, column]), color=BLUE)
            axes.set_ylabel(labels.names[column])
        rows[-1].set_xlabel("time [s]")
    return Figure(title, caption + (" Shaded: GNSS outage." if labels.gaps else ""), inline_svg(drawn[0], title))


def _speed(run: Run) -> Figure:
    drawn: list[str] = []
    time_s = seconds_since(run.track.stamps_ns, run.first_ns)
    speed = np.sqrt((run.track.columns("velocity_north_m_s") ** 2).sum(axis=1))
    still = run.track.columns("stationary", 1)[:, 0] > 0.5
    with stacked_axes(1, 2.4, drawn.append) as (axes,):
        shade_gaps(axes, run.gaps, run.first_ns)
        axes.plot(*thinned(time_s, speed), color=BLUE)
        axes.fill_between(time_s, 0.0, 1.0, where=still.tolist(), transform=axes.get_xaxis_transform(),
                          color=GREEN, alpha=0.12, linewidth=0)  # fmt: skip
        axes.set(xlabel="time [s]", ylabel="speed [m/s]")
    return Figure("Speed", "Green: standstill detected.", inline_svg(drawn[0], "Speed"))


def _innovations(run: Run) -> Figure:
    drawn: list[str] = []
    updates = run.counters.updates(AidingKind.GNSS_POSITION)
    time_s = seconds_since(updates.stamps_ns, run.first_ns)
    with stacked_axes(2, 4.0, drawn.append) as (size, ratio):
        for used, colour, word in ((updates.used, BLUE, "used"), (~updates.used, RED, "rejected")):
            if used.any():
                at, horizontal = thinned(time_s[used], np.hypot(*updates.innovation[used, :2].T))
                _dots(size, at, horizontal, colour, word)
                at, values = thinned(time_s[used], np.maximum(updates.test_ratio[used], 1e-4))
                _dots(ratio, at, values, colour)
        ratio.axhline(1.0, color=GREY, linewidth=1.0, linestyle="--")
        size.set(ylabel="horizontal [m]", yscale=_scale(np.hypot(*updates.innovation[:, :2].T)))
        ratio.set(xlabel="time [s]", ylabel="test ratio", yscale="log" if len(updates) else "linear")
        if len(updates):
            size.legend(loc="upper right")
            ratio.set_ylim(bottom=1e-4)
    caption = "Innovations of the GNSS positions. Measurements with a test ratio above 1 are rejected."
    return Figure("Innovations", caption, inline_svg(drawn[0], "Innovations"))


def _scale(values: FloatArray) -> str:
    """Logarithmic if the largest value exceeds 30 times the median."""
    return "log" if len(values) and values.max() > 30.0 * np.median(values) > 0.0 else "linear"


def _biases(run: Run) -> Figure:
    drawn: list[str] = []
    time_s = seconds_since(run.track.stamps_ns, run.first_ns)
    accelerometer = run.track.columns("accelerometer_bias_forward_m_s2")
    gyroscope = np.degrees(run.track.columns("gyroscope_bias_forward_rad_s"))
    with stacked_axes(2, 3.6, drawn.append) as rows:
        for axes, values, label in ((rows[0], accelerometer, "accelerometer [m/s²]"),
                                    (rows[1], gyroscope, "gyroscope [deg/s]")):  # fmt: skip
            for column, (colour, axis) in enumerate(zip(COLOURS, ("forward", "right", "down"), strict=True)):
                axes.plot(*thinned(time_s, values[:, column]), color=colour, label=axis)
            axes.set_ylabel(label)
        rows[0].legend(loc="upper right", ncols=3)
        rows[1].set_xlabel("time [s]")
    return Figure("Sensor biases", "Estimates of the filter.", inline_svg(drawn[0], "Sensor biases"))


def _dots(axes: "Axes", x: FloatArray, y: FloatArray, colour: str, label: str | None = None) -> None:
    """Draw dots as one line of zero-length strokes with round caps: a third of the size of markers."""
    nothing = np.full(len(x), np.nan)
    at, values = np.column_stack([x, x, nothing]).ravel(), np.column_stack([y, y, nothing]).ravel()
    axes.plot(at, values, color=colour, linewidth=2.2, solid_capstyle="round", label=label)


def shade_gaps(axes: "Axes", gaps: Sequence[Gap], first_ns: int) -> None:
    """Shade the GNSS outages."""
    for first, last in gaps:
        axes.axvspan((first - first_ns) * 1e-9, (last - first_ns) * 1e-9, color=ORANGE, alpha=0.13, linewidth=0)


def seconds_since(stamps_ns: npt.NDArray[np.int64], first_ns: int) -> FloatArray:
    """Times [s] since the first input."""
    return np.asarray((stamps_ns - first_ns) * 1e-9, dtype=np.float64)


def thinned(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Decimate a line to the minimum and maximum of each interval, which preserves peaks."""
    width = -(-len(x) // (POINTS // 2))
    if width < 3:
        return x, y
    whole = len(x) // width * width
    intervals = y[:whole].reshape(-1, width)
    starts = np.arange(0, whole, width)
    rows = np.sort(np.concatenate([starts + intervals.argmin(axis=1), starts + intervals.argmax(axis=1),
                                   np.arange(whole, len(x))]))  # fmt: skip
    return x[rows], y[rows]

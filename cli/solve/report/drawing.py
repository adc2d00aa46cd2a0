"""Drawing of figures as inline SVG."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from io import StringIO
from math import log10
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from shared.maths.earth import FloatArray

from ..outages import Gap

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis

SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
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
    "figure.facecolor": "none",
    "axes.facecolor": "none",
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


@contextmanager
def stacked_axes(
    rows: int, height: float, store: Callable[[str], None], width: float = WIDTH_IN
) -> Iterator[list["Axes"]]:
    """Create stacked axes; on exit pass the figure to `store` as SVG."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure as Drawn

    with rc_context(STYLE):  # type: ignore[arg-type]  # which names every key
        figure = Drawn(figsize=(width, height), layout="constrained")
        axes = np.atleast_1d(figure.subplots(rows, 1, sharex=True)).tolist()
        yield axes
        text = StringIO()
        # As `savefig`, which draws everything twice.
        FigureCanvasSVG(figure).print_svg(text, metadata={"Date": None, "Creator": None})  # type: ignore[no-untyped-call]
    store(text.getvalue())


def label_decades(*axes: "Axis") -> None:
    """Label logarithmic axes with 10⁻² as plain text: as formulae the labels take a seventh of the time of a report."""
    for axis in axes:
        if axis.get_scale() == "log":
            axis.set_major_formatter(lambda value, _: "10" + str(round(log10(value))).translate(SUPERSCRIPTS))


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


def dots(axes: "Axes", x: FloatArray, y: FloatArray, colour: str, label: str | None = None) -> None:
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

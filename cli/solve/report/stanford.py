"""The Stanford diagram: position error against protection level."""

from typing import TYPE_CHECKING

import numpy as np

from shared.maths.earth import FloatArray

from ..metrics.integrity import AxisProtection, Region
from .drawing import GREY, VARIABLES, Figure, inline_svg, label_decades, stacked_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CELLS = 56  # per axis
HEIGHT_IN = 7.6  # of the figure: a square diagram, and five lines of legend below it
DECADES = 4.0  # range of the axes
MIN_DISTANCE_M = 1e-3
# Fill, hatch and hatch colour of each region; hatched: error above the protection level.
MARKER_STYLES = {
    Region.NOMINAL: ("#f4faf4", None, "#b9c7b9"),
    Region.UNAVAILABLE: ("#eceef1", None, "#b6bbc3"),
    Region.MISLEADING: ("#f3f0ea", "///", "#b9b3a6"),
    Region.UNAVAILABLE_MISLEADING: ("#ece4d3", "\\\\\\", "#b0a283"),
    Region.HAZARDOUS: ("#e2d6cf", "xxx", "#7a6f66"),
}
# CSS variables of the fills and hatches: --nominal and --nominal-line, and so on.
SHADES = {
    colour: region.name.lower().replace("_", "-") + suffix
    for region, (face, _, edge) in MARKER_STYLES.items()
    for colour, suffix in ((face, ""), (edge, "-line"))
}
CAPTION = (
    "Number of epochs by error and protection level (colour, logarithmic); values below the axis range are shown at "
    "its edge. Hatched: error above the protection level. Dashed: alert limit of {limit:g} m."
)


def stanford(one: AxisProtection) -> Figure:
    """Draw the diagram of one axis, with the counts of its regions as legend."""
    drawn: list[str] = []
    title = f"Stanford diagram, {one.axis}"
    with stacked_axes(1, HEIGHT_IN, drawn.append) as (axes,):
        draw(axes, one)
    return Figure(title, CAPTION.format(limit=one.alert_limit_m), inline_svg(drawn[0], title, VARIABLES | SHADES))


def draw(axes: "Axes", one: AxisProtection) -> None:
    """Draw cells and regions; the counts are in the legend, since a region may be too small for text."""
    low, high = _range(one)
    _regions(axes, one, low, high)
    _cells(axes, one, np.geomspace(low, high, CELLS + 1))
    axes.axhline(one.alert_limit_m, color=GREY, linestyle="--", linewidth=1.0)
    axes.axvline(one.alert_limit_m, color=GREY, linestyle="--", linewidth=1.0)
    axes.set(xscale="log", yscale="log", xlim=(low, high), ylim=(low, high), aspect="equal",
             xlabel=f"{one.axis} error [m]", ylabel=f"{one.axis} protection level [m]")  # fmt: skip
    label_decades(axes.xaxis, axes.yaxis)
    axes.legend(loc="upper left", bbox_to_anchor=(0.0, -0.13), borderaxespad=0.0, frameon=False, fontsize=9,
                labelspacing=0.7, handlelength=2.2, handleheight=1.4)  # fmt: skip


def _range(one: AxisProtection) -> tuple[float, float]:
    high = 2.0 * max(float(one.level_m.max()), float(one.error_m.max()), one.alert_limit_m)
    least = min(float(one.level_m.min()), float(np.quantile(one.error_m, 0.05)), one.alert_limit_m)
    return max(MIN_DISTANCE_M, min(0.5 * least, high), high * 10.0**-DECADES), high


def _regions(axes: "Axes", one: AxisProtection, low: float, high: float) -> None:
    """Fill each region, and hatch those with errors above the protection level."""
    limit, total = one.alert_limit_m, len(one.error_m)
    areas = {
        Region.NOMINAL: ([low, limit], [low, limit], [limit, limit]),
        Region.UNAVAILABLE: ([low, limit, high], [limit, limit, high], [high, high, high]),
        Region.MISLEADING: ([low, limit], [low, low], [low, limit]),
        Region.UNAVAILABLE_MISLEADING: ([limit, high], [limit, limit], [limit, high]),
        Region.HAZARDOUS: ([limit, high], [low, low], [limit, limit]),
    }
    for region, count in one.regions().items():
        face, hatch, edge = MARKER_STYLES[region]
        axes.fill_between(*areas[region], facecolor=face, hatch=hatch, edgecolor=edge, linewidth=0, zorder=0,
                          label=f"{region.value}: {count} ({100.0 * count / total:.3g} %)")  # fmt: skip
    axes.plot([low, high], [low, high], color="#000000", linewidth=1.2)


def _cells(axes: "Axes", one: AxisProtection, edges: FloatArray) -> None:
    """Draw one rectangle per non-empty cell, from light to dark blue by the logarithm of its count."""
    from matplotlib import colormaps
    from matplotlib.collections import PolyCollection

    error, level = (np.clip(values, edges[0], edges[-1]) for values in (one.error_m, one.level_m))
    counts, _, _ = np.histogram2d(error, level, bins=[edges, edges])
    rows, columns = np.nonzero(counts)
    density = np.log1p(counts[rows, columns])
    left, right, lower, upper = edges[rows], edges[rows + 1], edges[columns], edges[columns + 1]
    corners = np.stack([left, lower, right, lower, right, upper, left, upper], axis=1).reshape(-1, 4, 2)
    colours = colormaps["Blues"](0.35 + 0.65 * density / density.max())
    axes.add_collection(PolyCollection(list(corners), facecolors=colours, edgecolors="none", zorder=2))

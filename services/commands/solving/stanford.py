"""The Stanford diagram: every error against the protection level that should have been above it."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from shared.maths.earth import FloatArray

from .integrity import Protected, Region
from .plots import GREY, Figure, inline_svg, stacked_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CELLS = 56  # on each side
DECADES = 4.0  # that the diagram shows below its largest number
SMALLEST_M = 1e-3
CAPTION = (
    "Each instant with a truth, by its error and its protection level; darker cells hold more of them (logarithmic); "
    "what is smaller than the axis begins stands at its edge. "
    "Hatched: the error is above the level. The dashed lines are the alert limit of {limit:g} m."
)


def stanford(one: Protected) -> Figure:
    """Draw the diagram of one axis, with the counts of its regions."""
    drawn: list[str] = []
    title = f"Stanford diagram, {one.axis}"
    with stacked_axes(1, 5.6, drawn.append) as (axes,):
        low, high = _range(one)
        edges = np.geomspace(low, high, CELLS + 1)
        _regions(axes, one.alert_limit_m, low, high)
        _cells(axes, one, edges)
        for text, x, y, horizontal, vertical in _notes(one, low, high):
            axes.text(x, y, text, ha=horizontal, va=vertical, fontsize=8, linespacing=1.3,
                      bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.5})  # fmt: skip
        axes.set(xscale="log", yscale="log", xlim=(low, high), ylim=(low, high), aspect="equal",
                 xlabel=f"{one.axis} error [m]", ylabel=f"{one.axis} protection level [m]")  # fmt: skip
    return Figure(title, CAPTION.format(limit=one.alert_limit_m), inline_svg(drawn[0], title))


def _range(one: Protected) -> tuple[float, float]:
    high = 2.0 * max(float(one.level_m.max()), float(one.error_m.max()), one.alert_limit_m)
    least = min(float(one.level_m.min()), float(np.quantile(one.error_m, 0.05)), one.alert_limit_m)
    return max(SMALLEST_M, min(0.5 * least, high), high * 10.0**-DECADES), high


def _regions(axes: "Axes", limit: float, low: float, high: float) -> None:
    """Hatch where errors are above levels, and lay the alert limit across."""
    axes.fill_between([low, high], [low, low], [low, high], facecolor="#f3f0ea", edgecolor="#b9b3a6", hatch="///",
                      linewidth=0, zorder=0)  # fmt: skip
    axes.fill_between([limit, high], [low, low], [limit, limit], facecolor="#e2d6cf", edgecolor="#7a6f66",
                      hatch="xxx", linewidth=0, zorder=0.1)  # fmt: skip
    axes.plot([low, high], [low, high], color="#1d2129", linewidth=1.2)
    axes.axhline(limit, color=GREY, linestyle="--", linewidth=1.0)
    axes.axvline(limit, color=GREY, linestyle="--", linewidth=1.0)


def _cells(axes: "Axes", one: Protected, edges: FloatArray) -> None:
    """One rectangle a cell that is not empty, from light to dark blue by the logarithm of its count."""
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


def _notes(one: Protected, low: float, high: float) -> Iterator[tuple[str, float, float, str, str]]:
    """Name each region that has room or instants, with its count, at one of its corners."""
    limit, total = one.alert_limit_m, len(one.error_m)
    margin = (high / low) ** 0.015
    corners = {
        Region.NOMINAL: (low * margin, limit / margin, "left", "top"),
        Region.UNAVAILABLE: (low * margin, high / margin, "left", "top"),
        Region.MISLEADING: (limit / margin, low * margin, "right", "bottom"),
        Region.UNAVAILABLE_MISLEADING: (high / margin, limit * margin, "right", "bottom"),
        Region.HAZARDOUS: (high / margin, low * margin, "right", "bottom"),
    }
    for region, count in one.regions().items():
        x, y, horizontal, vertical = corners[region]
        yield f"{region.value}\n{count} ({100.0 * count / total:.3g} %)", x, y, horizontal, vertical

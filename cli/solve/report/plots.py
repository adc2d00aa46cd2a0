"""The figures of the report."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from shared.maths.earth import FloatArray, Geodetic, ned_track
from shared.messages.navigation import AidingKind
from shared.messages.trust import TrustLevel

from ..metrics.integrity import protected
from ..metrics.metrics import Run
from ..metrics.trust import WORDS
from ..outages import Gap
from ..reference_track import Reference
from ..verdicts import Verdicts
from .drawing import (
    BLUE,
    COLOURS,
    GREEN,
    GREY,
    ORANGE,
    POINTS,
    RED,
    Figure,
    dots,
    inline_svg,
    label_decades,
    seconds_since,
    shade_gaps,
    stacked_axes,
    thinned,
)
from .stanford import stanford

VERDICTS = {
    TrustLevel.SAFE: GREEN,
    TrustLevel.CAUTION: ORANGE,
    TrustLevel.UNSAFE: RED,
    TrustLevel.DEAD_RECKONING: BLUE,
    TrustLevel.NO_FIX: RED,
    TrustLevel.INITIALISING: GREY,
}


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
        scored = run.scored()
        if scored is not None:
            yield from map(stanford, protected(scored, run.alert_limits_m))
    if run.trust is not None:
        yield _verdicts(run.trust.verdicts, run)
    yield _speed(run)
    yield _innovations(run)
    yield _biases(run)


@dataclass(frozen=True)
class _Labels:
    """Labels of three axes, and the gaps shaded in them."""

    names: tuple[str, str, str]
    gaps: Sequence[Gap]
    first_ns: int


def _trajectory(run: Run, reference: Reference | None) -> Figure:
    drawn: list[str] = []
    origin = Geodetic(*run.track.geodetic[0].tolist())
    path = ned_track(run.track.geodetic, origin)
    with stacked_axes(1, 4.2, drawn.append) as (axes,):
        if reference is not None and reference.geodetic is not None:
            true = ned_track(reference.geodetic, origin)
            true = true[:: max(1, len(true) // POINTS)]
            dots(axes, true[:, 1], true[:, 0], GREY, "truth")
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


def _verdicts(verdicts: Verdicts, run: Run) -> Figure:
    """One row for each verdict, and one for the exclusion of GNSS."""
    drawn: list[str] = []
    time_s = seconds_since(verdicts.edges_ns, run.first_ns)
    intervals = list(zip(time_s[:-1].tolist(), np.diff(time_s).tolist(), strict=True))
    with stacked_axes(1, 2.6, drawn.append) as (axes,):
        shade_gaps(axes, run.gaps, run.first_ns)
        for row, (level, colour) in enumerate(reversed(VERDICTS.items()), 1):
            here = [interval for interval, state in zip(intervals, verdicts.states, strict=True) if state is level]
            axes.broken_barh(_joined(here), (row - 0.4, 0.8), color=colour, linewidth=0)
        gone = [((begin - run.first_ns) * 1e-9, (end - begin) * 1e-9) for begin, end in verdicts.exclusions()]
        axes.broken_barh(gone, (-0.4, 0.8), color=GREY, linewidth=0)
        axes.set_yticks(range(len(VERDICTS) + 1), ["GNSS excluded", *(WORDS[level] for level in reversed(VERDICTS))])
        axes.set(xlabel="time [s]", xlim=(0.0, float(time_s[-1])))
    caption = "Verdict of core.trust over time." + (" Shaded: GNSS outage." if run.gaps else "")
    return Figure("Verdict", caption, inline_svg(drawn[0], "Verdict"))


def _joined(intervals: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Join intervals (begin and length [s]) that follow one another, for a smaller page."""
    found: list[tuple[float, float]] = []
    for begin, length in intervals:
        if found and begin - sum(found[-1]) < 1e-6:
            found[-1] = (found[-1][0], begin + length - found[-1][0])
        else:
            found.append((begin, length))
    return found


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
                dots(size, at, horizontal, colour, word)
                at, values = thinned(time_s[used], np.maximum(updates.test_ratio[used], 1e-4))
                dots(ratio, at, values, colour)
        ratio.axhline(1.0, color=GREY, linewidth=1.0, linestyle="--")
        size.set(ylabel="horizontal [m]", yscale=_scale(np.hypot(*updates.innovation[:, :2].T)))
        ratio.set(xlabel="time [s]", ylabel="test ratio", yscale="log" if len(updates) else "linear")
        label_decades(size.yaxis, ratio.yaxis)
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

"""Gap, delay and scale sweeps of the tachograph's statistics over a drive.

Windows are the paper's: every sample time counts, statistics of full windows only, strictly above 10 km/h.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Protocol

from services.core.motion_conflict.tachograph import EVENT_S, KM_H, SpeedWindow, WindowMode

from .profiles import PERIOD_S

LIMIT_KM_H = 10.0
GAP_S = 600  # [s] start of a gap
MAX_GAP = 60  # samples
DELAYS_S = tuple(0.5 * k for k in range(1, 60))
SCALES = tuple(0.005 * k for k in range(1, 100))
EVENT_SCALES = (0.05, 0.08, 0.09, 0.095, 0.10, 0.12, 0.2, 0.3, 0.34, 0.35, 0.36, 0.4)
FIRST_DELAYED = 5  # index of the first sample of a delayed run
Triples = Iterable[tuple[float, float, float]]  # s, GNSS and odometer in km/h


class Speeds(Protocol):
    """Both speeds [km/h] of a drive at any time."""

    @property
    def times_s(self) -> range:
        """Sample times."""

    def gnss(self, time_s: float) -> float:
        """Speed of GNSS."""

    def odometer(self, time_s: float, scale: float = 1.0) -> float:
        """Speed of an odometer that indicates `scale` times the true speed."""


@dataclass(frozen=True)
class Statistics:
    """Largest statistics [km/h] of a run; first times [s] with MT above 10 km/h, and of the regulation's event."""

    mean: float
    median: float
    first_s: float | None
    event_s: float | None
    windows: int = 0
    mean_above: int = 0  # windows with MT above 10 km/h
    median_above: int = 0


def statistics(samples: Triples) -> Statistics:
    """Run the window over a drive."""
    window, rows = SpeedWindow(WindowMode.WALL), []
    for time_s, gnss, odometer in samples:
        window.add(int(time_s * 1e9), gnss * KM_H, odometer * KM_H)
        if window.complete:
            rows.append((time_s, window.trimmed_mean() / KM_H, window.median() / KM_H, window.exceeded_s))
    above = [time_s for time_s, mean, _, _ in rows if mean > LIMIT_KM_H]
    return Statistics(
        max(row[1] for row in rows),
        max(row[2] for row in rows),
        above[0] if above else None,
        next((row[0] for row in rows if row[3] > EVENT_S), None),
        len(rows),
        len(above),
        sum(row[2] > LIMIT_KM_H for row in rows),
    )


def with_gap(drive: Speeds, zeros: int, hold: int = 0) -> Statistics:
    """GNSS repeats the speed at 600 s for `hold` samples, then reads zero for `zeros` samples."""
    lost, zero, end = GAP_S, GAP_S + hold * PERIOD_S, GAP_S + (hold + zeros) * PERIOD_S

    def gnss(time_s: float) -> float:
        if zero <= time_s < end:
            return 0.0
        return drive.gnss(lost if lost <= time_s < zero else time_s)

    return statistics((t, gnss(t), drive.odometer(t)) for t in drive.times_s)


def with_delay(drive: Speeds, delay_s: float) -> Statistics:
    """GNSS is late by `delay_s`."""
    return statistics((t, drive.gnss(t - delay_s), drive.odometer(t)) for t in drive.times_s[FIRST_DELAYED:])


def with_scale(drive: Speeds, reduction: float) -> Statistics:
    """Indicate (1 - reduction) times the true speed by the odometer."""
    return statistics((t, drive.gnss(t), drive.odometer(t, 1.0 - reduction)) for t in drive.times_s)


def meaconing(drive: Speeds) -> Statistics:
    """GNSS reads zero from 600 s on."""
    return statistics((t, 0.0 if t >= GAP_S else drive.gnss(t), drive.odometer(t)) for t in drive.times_s)


def first(steps: Iterable[float], exceeds: Callable[[float], bool]) -> float | None:
    """First step at which a condition holds."""
    return next((step for step in steps if exceeds(step)), None)


@dataclass(frozen=True)
class BreakPoints:
    """Where the statistics cross 10 km/h; None where no step of the sweep does."""

    bias_zeros: float | None  # MT more than 1 km/h above the nominal one
    mean_zeros: float | None
    median_zeros: float | None
    event_zeros: float | None
    outages_s: tuple[float | None, float | None]  # MT and median, a hold of 10 s included
    delay_s: tuple[float | None, float | None]  # MT, median
    scale: tuple[float | None, float | None]
    event_scale: float | None


def delay_break_points(drive: Speeds) -> tuple[float | None, float | None]:
    """Smallest delays [s] with MT and with the median above 10 km/h."""
    swept = [(d, with_delay(drive, d)) for d in DELAYS_S]
    return _crossings(swept)


def scale_break_points(drive: Speeds) -> tuple[float | None, float | None]:
    """Smallest reductions of the odometer's scale with MT and with the median above 10 km/h."""
    return _crossings([(k, with_scale(drive, k)) for k in SCALES])


def _crossings(swept: list[tuple[float, Statistics]]) -> tuple[float | None, float | None]:
    mean = next((step for step, statistics in swept if statistics.mean > LIMIT_KM_H), None)
    return mean, next((step for step, statistics in swept if statistics.median > LIMIT_KM_H), None)


def break_points(drive: Speeds) -> BreakPoints:
    """Sweep gaps, delays and scales."""
    nominal = with_scale(drive, 0.0).mean
    gaps = {k: with_gap(drive, k) for k in range(1, MAX_GAP)}
    held = {(k + 1) * PERIOD_S: with_gap(drive, k, hold=1) for k in range(1, MAX_GAP)}
    return BreakPoints(
        first(gaps, lambda k: gaps[int(k)].mean > nominal + 1.0),
        first(gaps, lambda k: gaps[int(k)].mean > LIMIT_KM_H),
        first(gaps, lambda k: gaps[int(k)].median > LIMIT_KM_H),
        first(gaps, lambda k: gaps[int(k)].event_s is not None),
        _crossings(list(held.items())),
        delay_break_points(drive),
        scale_break_points(drive),
        first(EVENT_SCALES, lambda k: with_scale(drive, k).event_s is not None),
    )

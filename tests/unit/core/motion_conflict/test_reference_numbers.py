"""Reference numbers of the smart-tachograph speed check: vectors exactly, deterministic profiles within tolerance."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import pytest

from services.core.motion_conflict.tachograph import EVENT_S, KM_H, SpeedWindow, WindowMode, median, trimmed_mean
from tests.support.speed_profiles import PERIOD_S, Drive

GAP_S = 600
Triples = Iterable[tuple[float, float, float]]  # s, GNSS and odometer in km/h


@pytest.mark.parametrize(
    ("large", "expected_mean", "expected_median"),
    [(6, 0.5, 0.5), (7, 5.0625, 0.5), (8, 9.625, 0.5), (9, 14.1875, 0.5), (15, None, 55.25), (16, None, 110.0)],
)
def test_window_of_small_and_large_differences(large: int, expected_mean: float | None, expected_median: float) -> None:
    window = [110.0] * large + [0.5] * (30 - large)
    assert median(window) == expected_median
    if expected_mean is not None:
        assert trimmed_mean(window) == pytest.approx(expected_mean, abs=1e-12)


def test_window_of_zero_to_29() -> None:
    window = [float(k) for k in reversed(range(30))]
    assert trimmed_mean(window) == 11.5
    assert median(window) == 14.5


@pytest.mark.parametrize(("count", "kept"), [(30, 24), (5, 4), (10, 8), (15, 12), (35, 28), (4, 3)])
def test_the_number_of_kept_values_does_not_suffer_from_rounding(count: int, kept: int) -> None:
    window = [1.0] * kept + [1000.0] * (count - kept)
    assert trimmed_mean(window) == 1.0
    assert trimmed_mean([*window[1:], 1000.0]) > 1.0


def test_an_empty_window_is_an_error() -> None:
    for statistic in (trimmed_mean, median):
        with pytest.raises(ValueError, match="no value"):
            statistic([])


@dataclass(frozen=True)
class Run:
    """Statistics [km/h] of every full window of a run, the largest ones, and the first times [s] above 10 km/h."""

    mean: float
    median: float
    first_s: float | None
    event_s: float | None


def run(samples: Triples) -> Run:
    window, rows = SpeedWindow(WindowMode.WALL), []
    for time_s, gnss, odometer in samples:
        window.add(int(time_s * 1e9), gnss * KM_H, odometer * KM_H)
        if window.complete:
            rows.append((time_s, window.trimmed_mean() / KM_H, window.median() / KM_H, window.exceeded_s))
    return Run(
        max(row[1] for row in rows),
        max(row[2] for row in rows),
        next((row[0] for row in rows if row[1] > 10.0), None),
        next((row[0] for row in rows if row[3] > EVENT_S), None),
    )


def gap(drive: Drive, zeros: int, hold: int = 0) -> Run:
    """GNSS repeats the speed at 600 s for `hold` samples, then reads zero for `zeros` samples."""
    lost, zero, end = GAP_S, GAP_S + hold * PERIOD_S, GAP_S + (hold + zeros) * PERIOD_S

    def gnss(time_s: float) -> float:
        if zero <= time_s < end:
            return 0.0
        return drive.gnss(lost if lost <= time_s < zero else time_s)

    return run((t, gnss(t), drive.odometer(t)) for t in drive.times_s)


def late(drive: Drive, delay_s: float) -> Run:
    return run((t, drive.gnss(t - delay_s), drive.odometer(t)) for t in drive.times_s[5:])


def scaled(drive: Drive, reduction: float) -> Run:
    return run((t, drive.gnss(t), drive.odometer(t, 1.0 - reduction)) for t in drive.times_s)


def first(steps: Iterable[float], exceeds: Callable[[float], bool]) -> float:
    return next(step for step in steps if exceeds(step))


@dataclass(frozen=True)
class Expected:
    nominal: tuple[float, float]
    gap_means: tuple[float, ...]  # of 6 to 10 zeros
    gap_medians: tuple[float, ...]  # of 14 to 16 zeros
    bias_zeros: int
    mean_zeros: int
    median_zeros: int
    outages_s: tuple[int, int]
    delay_s: tuple[float, float]  # median, trimmed mean
    delayed_5_s: tuple[float, float]
    scale: tuple[float, float]  # median, trimmed mean
    meaconing_s: tuple[float, float]
    event_zeros: int
    event_scale: float


HIGHWAY = Expected(
    (0.092, 0.118), (0.10, 4.47, 9.01, 13.54, 18.08), (0.15, 52.57, 105.0), 7, 9, 15, (100, 160), (6.0, 11.5),
    (5.67, 8.88), (0.09, 0.095), (80.0, 380.0), 18, 0.095,
)  # fmt: skip
URBAN = Expected(
    (0.476, 0.532), (0.52, 0.96, 1.78, 2.64, 3.86), (0.65, 5.82, 11.0), 8, 16, 16, (170, 170), (5.0, 6.0),
    (9.10, 10.47), (0.32, 0.34), (150.0, 450.0), 33, 0.40,
)  # fmt: skip
BOTH = pytest.mark.parametrize(("name", "expected"), [("highway", HIGHWAY), ("urban", URBAN)], ids=["highway", "urban"])


@BOTH
def test_normal_driving_stays_below_1_km_h(name: str, expected: Expected) -> None:
    nominal = scaled(Drive(name), 0.0)
    assert (nominal.mean, nominal.median) == pytest.approx(expected.nominal, abs=0.01)
    assert nominal.first_s is None


@BOTH
def test_statistics_of_a_gap_at_speed_zero(name: str, expected: Expected) -> None:
    drive = Drive(name)
    assert [gap(drive, k).mean for k in range(6, 11)] == pytest.approx(expected.gap_means, abs=0.02)
    assert [gap(drive, k).median for k in range(14, 17)] == pytest.approx(expected.gap_medians, abs=0.02)


@BOTH
def test_smallest_gaps_that_bias_and_that_exceed_the_threshold(name: str, expected: Expected) -> None:
    drive = Drive(name)
    nominal = scaled(drive, 0.0).mean
    assert first(range(1, 40), lambda k: gap(drive, int(k)).mean > nominal + 1.0) == expected.bias_zeros
    assert first(range(1, 40), lambda k: gap(drive, int(k)).mean > 10.0) == expected.mean_zeros
    assert first(range(1, 40), lambda k: gap(drive, int(k)).median > 10.0) == expected.median_zeros
    assert first(range(1, 60), lambda k: gap(drive, int(k)).event_s is not None) == expected.event_zeros


@BOTH
def test_an_outage_lasts_10_s_longer_if_the_receiver_first_holds_its_speed(name: str, expected: Expected) -> None:
    drive = Drive(name)
    mean = first(range(1, 40), lambda k: gap(drive, int(k), hold=1).mean > 10.0)
    middle = first(range(1, 40), lambda k: gap(drive, int(k), hold=1).median > 10.0)
    assert ((mean + 1) * PERIOD_S, (middle + 1) * PERIOD_S) == expected.outages_s


@BOTH
def test_smallest_delays_that_exceed_the_threshold(name: str, expected: Expected) -> None:
    drive, steps = Drive(name), [0.5 * k for k in range(1, 60)]
    assert first(steps, lambda d: late(drive, d).median > 10.0) == pytest.approx(expected.delay_s[0], abs=0.5)
    assert first(steps, lambda d: late(drive, d).mean > 10.0) == pytest.approx(expected.delay_s[1], abs=0.5)
    assert (late(drive, 5.0).mean, late(drive, 5.0).median) == pytest.approx(expected.delayed_5_s, abs=0.05)


@BOTH
def test_smallest_scales_that_exceed_the_threshold(name: str, expected: Expected) -> None:
    drive, steps = Drive(name), [0.005 * k for k in range(1, 100)]
    assert first(steps, lambda k: scaled(drive, k).median > 10.0) == pytest.approx(expected.scale[0], abs=0.005)
    assert first(steps, lambda k: scaled(drive, k).mean > 10.0) == pytest.approx(expected.scale[1], abs=0.005)
    of_events = (0.05, 0.08, 0.09, 0.095, 0.10, 0.12, 0.2, 0.3, 0.34, 0.35, 0.36, 0.4)
    assert first(of_events, lambda k: scaled(drive, k).event_s is not None) == expected.event_scale


@BOTH
def test_a_lasting_zero_is_a_conflict_and_300_s_later_an_event(name: str, expected: Expected) -> None:
    drive = Drive(name)
    found = run((t, 0.0 if t >= GAP_S else drive.gnss(t), drive.odometer(t)) for t in drive.times_s)
    assert found.first_s is not None
    assert found.event_s is not None
    assert (found.first_s - GAP_S, found.event_s - GAP_S) == expected.meaconing_s


def test_the_profiles_have_the_stated_means() -> None:
    for name, mean in (("highway", 109.91), ("urban", 33.0)):
        drive = Drive(name)
        speeds = [drive.speed(0.1 * (k + 0.5)) for k in range(10 * drive.duration_s)]
        assert sum(speeds) / len(speeds) == pytest.approx(mean, abs=0.01)

"""Reference numbers of the smart-tachograph speed check: vectors exactly, deterministic profiles within tolerance."""

from dataclasses import dataclass

import pytest

from cli.papers.motion_conflict.profiles import Drive
from cli.papers.motion_conflict.sweeps import GAP_S, break_points, meaconing, with_delay, with_gap, with_scale
from services.core.motion_conflict.tachograph import median, trimmed_mean


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
class ReferenceNumbers:
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


HIGHWAY = ReferenceNumbers(
    (0.092, 0.118), (0.10, 4.47, 9.01, 13.54, 18.08), (0.15, 52.57, 105.0), 7, 9, 15, (100, 160), (6.0, 11.5),
    (5.67, 8.88), (0.09, 0.095), (80.0, 380.0), 18, 0.095,
)  # fmt: skip
URBAN = ReferenceNumbers(
    (0.476, 0.532), (0.52, 0.96, 1.78, 2.64, 3.86), (0.65, 5.82, 11.0), 8, 16, 16, (170, 170), (5.0, 6.0),
    (9.10, 10.47), (0.32, 0.34), (150.0, 450.0), 33, 0.40,
)  # fmt: skip
BOTH = pytest.mark.parametrize(("name", "expected"), [("highway", HIGHWAY), ("urban", URBAN)], ids=["highway", "urban"])


@BOTH
def test_normal_driving_stays_below_1_km_h(name: str, expected: ReferenceNumbers) -> None:
    nominal = with_scale(Drive(name), 0.0)
    assert (nominal.mean, nominal.median) == pytest.approx(expected.nominal, abs=0.01)
    assert nominal.first_s is None and nominal.mean_above == nominal.median_above == 0


@BOTH
def test_statistics_of_a_gap_at_speed_zero(name: str, expected: ReferenceNumbers) -> None:
    drive = Drive(name)
    assert [with_gap(drive, k).mean for k in range(6, 11)] == pytest.approx(expected.gap_means, abs=0.02)
    assert [with_gap(drive, k).median for k in range(14, 17)] == pytest.approx(expected.gap_medians, abs=0.02)


@pytest.mark.slow
@BOTH
def test_break_points_of_gaps_delays_and_scales(name: str, expected: ReferenceNumbers) -> None:
    """An outage lasts 10 s longer if the receiver first repeats its speed."""
    found = break_points(Drive(name))
    zeros = (found.bias_zeros, found.mean_zeros, found.median_zeros, found.event_zeros)
    assert zeros == (expected.bias_zeros, expected.mean_zeros, expected.median_zeros, expected.event_zeros)
    assert found.outages_s == expected.outages_s
    assert found.delay_s[::-1] == pytest.approx(expected.delay_s, abs=0.5)
    assert found.scale[::-1] == pytest.approx(expected.scale, abs=0.005)
    assert found.event_scale == expected.event_scale


@BOTH
def test_statistics_of_a_delay_of_5_s(name: str, expected: ReferenceNumbers) -> None:
    found = with_delay(Drive(name), 5.0)
    assert (found.mean, found.median) == pytest.approx(expected.delayed_5_s, abs=0.05)


@BOTH
def test_a_lasting_zero_is_a_conflict_and_300_s_later_an_event(name: str, expected: ReferenceNumbers) -> None:
    found = meaconing(Drive(name))
    assert found.first_s is not None
    assert found.event_s is not None
    assert (found.first_s - GAP_S, found.event_s - GAP_S) == expected.meaconing_s


def test_the_profiles_have_the_stated_means() -> None:
    for name, mean in (("highway", 109.91), ("urban", 33.0)):
        drive = Drive(name)
        speeds = [drive.speed(0.1 * (k + 0.5)) for k in range(10 * drive.duration_s)]
        assert sum(speeds) / len(speeds) == pytest.approx(mean, abs=0.01)

"""Tunnels, correlation and histograms of the smart tachograph's paper."""

import numpy as np
import pytest

from cli.papers.motion_conflict.profiles import Drive
from cli.papers.motion_conflict.tunnels import LAGS_S, TUNNELS, correlation, in_tunnels, window_statistics


def test_the_receiver_holds_its_speed_for_10_s_and_is_zero_until_the_end_of_the_tunnel() -> None:
    run = in_tunnels(Drive("highway"), ((900.0, 60.0),))
    inside = (run.times_s >= 900.0) & (run.times_s < 960.0)
    assert run.gnss[inside].tolist() == [run.gnss[run.times_s == 900.0][0], 0.0, 0.0, 0.0, 0.0, 0.0]
    assert (run.gnss[~inside] > 10.0).all()


def test_two_short_tunnels_count_as_one_of_their_zeros() -> None:
    """Three zeros each: the six largest of a window are dropped, and MT stays below 10 km/h; eleven pass it."""
    largest = {name: float(in_tunnels(Drive("highway"), tunnels).mean.max()) for name, tunnels in TUNNELS.items()}
    assert largest["one tunnel of 60 s"] < 1.0 and largest["two tunnels of 40 s"] < 1.0
    zeros = 11
    assert largest["one tunnel of 120 s"] == pytest.approx((zeros - 6) * 112.0 / 24.0, rel=0.1)


@pytest.mark.parametrize("delay_s", [0.0, 2.0, 5.0])
def test_the_correlation_is_greatest_at_the_delay(delay_s: float) -> None:
    """The odometer is read 0.25 s after the sample time."""
    found = correlation(Drive("urban"), delay_s)
    assert LAGS_S[int(np.argmax(found))] == pytest.approx(delay_s + 0.25, abs=0.3)
    assert found.max() > 0.99


def test_statistics_of_windows_are_those_of_their_sorted_values() -> None:
    values = np.random.default_rng(1).normal(0.0, 2.0, 40)
    rows = window_statistics(values.tolist())
    assert rows.shape == (11, 2)
    last = np.sort(np.abs(values[-30:]))
    assert rows[-1] == pytest.approx([last[:24].mean(), np.median(last)])
    assert window_statistics(values[:29].tolist()).shape == (0, 2)

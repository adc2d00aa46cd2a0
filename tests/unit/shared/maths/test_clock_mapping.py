import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from shared.maths.clock_mapping import ClockMapping, lower_hull
from tests.support.cases import each

NS = 1_000_000_000
MS = 1_000_000
START_NS = 1_764_000_000 * NS


def arrivals(
    *,
    seconds: float,
    rate_hz: float,
    drift: float = 0.0,
    minimum_s: float = 0.0,
    excess_s: float = 0.004,
    seed: int = 1,
) -> list[tuple[int, int, int]]:
    """Simulate (device time, arrival, truth): a clock with a rate error `drift` and an exponential delay."""
    rng = np.random.default_rng(seed)
    rows, arrival = [], 0
    for k in range(int(seconds * rate_hz)):
        device_ns = round(k * NS / rate_hz)
        true_ns = START_NS + round(device_ns * (1 + drift))
        arrival = max(arrival, true_ns + round((minimum_s + rng.exponential(excess_s)) * NS))
        rows.append((device_ns, arrival, true_ns))
    return rows


@each("drift", [-100e-6, 0.0, 20e-6, 100e-6])
@each("rate_hz", [1.0, 100.0])
def test_stamp_errors_are_a_fraction_of_the_jitter_once_the_window_is_full(rate_hz: float, drift: float) -> None:
    clock = ClockMapping(minimum_delay_s=0.05)
    rows = arrivals(seconds=240, rate_hz=rate_hz, drift=drift, minimum_s=0.05)
    errors_ms = [(clock.stamp(device, arrival) - truth) / MS for device, arrival, truth in rows]
    settled = np.array(errors_ms[len(rows) // 4 :])
    # The jitter is 4 ms. At 1 Hz the envelope has few points; at 100 Hz the best of each second.
    assert np.sqrt(np.mean(settled**2)) < (1.5 if rate_hz == 1.0 else 0.25)
    assert np.max(np.abs(settled)) < (4.0 if rate_hz == 1.0 else 1.5)


def test_the_drift_is_estimated_within_one_minute_of_arrivals() -> None:
    clock = ClockMapping()
    for device, arrival, _ in arrivals(seconds=120, rate_hz=100, drift=50e-6):
        clock.stamp(device, arrival)
    assert clock.drift == pytest.approx(50e-6, abs=5e-6)


def test_the_minimum_delay_is_subtracted() -> None:
    assert ClockMapping(minimum_delay_s=0.05).stamp(0, START_NS) == START_NS - 50 * MS


def test_a_burst_after_a_stall_has_the_intervals_of_the_device() -> None:
    clock = ClockMapping()
    for k in range(2000):
        clock.stamp(k * 10 * MS, START_NS + k * 10 * MS)
    # 0.4 s of samples arrive at once
    stamps = [clock.stamp((2000 + k) * 10 * MS, START_NS + 20_400 * MS) for k in range(40)]
    assert np.diff(stamps).tolist() == pytest.approx([10 * MS] * 39, abs=100)
    assert stamps[0] == pytest.approx(START_NS + 20_000 * MS, abs=1000)


def test_samples_that_arrive_together_are_stamped_by_the_one_with_the_least_delay() -> None:
    stamps = ClockMapping(minimum_delay_s=0.003).stamp_all([k * 10 * MS for k in range(5)], START_NS)
    assert list(stamps) == pytest.approx([START_NS - 3 * MS - (4 - k) * 10 * MS for k in range(5)], abs=10)


def test_a_clock_step_between_samples_that_arrive_together_resets_the_mapping() -> None:
    clock = ClockMapping()
    stamps = clock.stamp_all([100 * NS, 100 * NS + 10 * MS, 0, 10 * MS], START_NS)
    assert clock.resets == 1
    assert list(np.diff(stamps)) == pytest.approx([10 * MS, 1, 1], abs=10)  # the arrival time bounds the later stamps


def test_a_smaller_delay_shortens_an_interval_by_at_most_half() -> None:
    clock = ClockMapping()
    first = clock.stamp(0, START_NS + 20 * MS)  # delayed by 20 ms
    second = clock.stamp(10 * MS, START_NS + 10 * MS + 15 * MS)
    assert second - first == 5 * MS


@pytest.mark.parametrize("step_ns", [-3_600 * NS, -NS, 2 * NS, 86_400 * NS])
def test_a_step_of_the_device_clock_resets_the_mapping_at_once(step_ns: int) -> None:
    clock = ClockMapping(minimum_delay_s=0.003)
    for k in range(1000):
        clock.stamp(k * 10 * MS, START_NS + k * 10 * MS + 3 * MS)
    stamp = clock.stamp(10 * NS + step_ns, START_NS + 10 * NS + 3 * MS)
    assert stamp == START_NS + 10 * NS
    assert clock.resets == 1


def test_a_pause_of_the_device_clock_resets_the_mapping_once() -> None:
    clock = ClockMapping()
    for k in range(1000):
        clock.stamp(k * 10 * MS, START_NS + k * 10 * MS)
    pause_ns = 3 * NS
    for k in range(1000, 2000):
        stamp = clock.stamp(k * 10 * MS, START_NS + k * 10 * MS + pause_ns)
    assert clock.resets == 1
    assert stamp == pytest.approx(START_NS + 19_990 * MS + pause_ns, abs=1000)


def test_a_longer_delay_is_no_drift_of_a_clock() -> None:
    clock = ClockMapping(window_s=60.0)
    for k in range(200):
        late_ns = 100 * MS if k > 100 else 0
        stamp = clock.stamp(k * NS, START_NS + k * NS + late_ns)
    followed_ns = 99 * 200_000  # at the largest drift
    assert START_NS + 199 * NS <= stamp <= START_NS + 199 * NS + followed_ns
    assert clock.late_s == pytest.approx(0.1, abs=0.02)


def test_arrivals_that_become_late_little_by_little_are_late_and_no_step_of_time() -> None:
    clock = ClockMapping(longest_delay_s=2.0)
    errors = []
    for k in range(600):
        late_ns = round(NS * min(max(0.0, 0.02 * (k - 100)), 1.5))
        errors.append(clock.stamp(k * NS, START_NS + k * NS + late_ns) - START_NS - k * NS)
    assert clock.resets == 0 and clock.late_s == pytest.approx(1.5, abs=0.11)
    assert max(errors) <= 500 * 200_000, "followed at the largest drift of a clock"


def test_what_lasts_beyond_the_longest_delay_is_a_step_of_the_device_clock() -> None:
    clock = ClockMapping(longest_delay_s=2.0)
    for k in range(100):
        stamp = clock.stamp(k * NS, START_NS + k * NS + (2_500 * MS if k > 50 else 0))
    assert clock.resets == 1 and stamp == START_NS + 99 * NS + 2_500 * MS


def test_a_clock_that_drifts_by_the_most_is_followed() -> None:
    clock, rng = ClockMapping(), np.random.default_rng(4)
    for k in range(900):
        true_ns = START_NS + round(k * NS * (1.0 + 190e-6))
        stamp = clock.stamp(k * NS, true_ns + round(rng.exponential(0.02) * NS))
        assert k < 60 or abs(stamp - true_ns) < 15 * MS


def test_a_step_back_of_the_obu_time_line_resets_the_mapping() -> None:
    clock = ClockMapping()
    clock.stamp(0, START_NS)
    assert clock.stamp(NS, START_NS - 100 * NS) == START_NS - 100 * NS


def test_equal_inputs_give_equal_stamps_and_the_memory_is_bounded() -> None:
    rows = arrivals(seconds=200, rate_hz=20)
    one, other = ClockMapping(), ClockMapping()
    first = [one.stamp(d, a) for d, a, _ in rows[:2000]]
    size = len(pickle.dumps(one))
    assert first + [one.stamp(d, a) for d, a, _ in rows[2000:]] == [other.stamp(d, a) for d, a, _ in rows]
    assert len(pickle.dumps(one)) <= size + 100, "at 200 s as at 100 s"


@settings(max_examples=100, deadline=None)
@given(
    st.lists(
        st.tuples(st.integers(-(2**62), 2**62), st.integers(0, 10 * NS)),
        min_size=1,
        max_size=60,
    )
)
def test_stamps_increase_and_exceed_their_arrival_by_at_most_1_ns_each(rows: list[tuple[int, int]]) -> None:
    clock, arrival, last = ClockMapping(), START_NS, 0
    for count, (device, wait) in enumerate(rows):
        arrival += wait
        stamp = clock.stamp(device, arrival)
        assert last < stamp <= arrival + count
        last = stamp


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(0.0, 0.02), min_size=20, max_size=60))
def test_the_line_is_the_optimum_of_linear_programming(offsets: list[float]) -> None:
    clock = ClockMapping(maximum_drift=1.0)
    for k, offset in enumerate(offsets):
        clock.stamp(k * NS, START_NS + k * NS + round(offset * NS))
    times = np.array([time for time, _ in clock._points])
    values = np.array([value for _, value in clock._points])
    # maximise the sum of the line's heights under the points
    best = linprog(
        [-times.sum(), -len(times)],
        A_ub=np.column_stack([times, np.ones_like(times)]),
        b_ub=values,
        bounds=[(None, None)] * 2,
    )
    assert best.fun is not None
    ours = clock._slope * times.sum() + clock._intercept * len(times)
    assert ours == pytest.approx(-best.fun, abs=1e-5)  # the solver keeps each bound to 1e-7


def test_the_hull_of_collinear_points_is_their_end_points() -> None:
    assert lower_hull([(0.0, 0.0), (1.0, 1.0), (2.0, 2.0)]) == [(0.0, 0.0), (2.0, 2.0)]

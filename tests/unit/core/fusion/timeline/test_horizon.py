"""The horizon: its lag by what has arrived."""

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from services.core.fusion.timeline.horizon import STEPS_NS, Horizon
from tests.support.cases import each

MS = 1_000_000
ALLOWANCE_NS, LONGEST_NS = 50 * MS, 2_500 * MS


def horizon() -> Horizon:
    return Horizon(ALLOWANCE_NS, LONGEST_NS)


@each(
    ("late_ms", "lag_ms"),
    [
        (-5_000, 200), (0, 200), (150, 200), (151, 300), (250, 300), (450, 500), (451, 700), (650, 700),
        (950, 1_000), (1_450, 1_500), (1_451, 2_000), (1_951, 2_500), (2_500, 2_500), (2_501, 200), (3_600_000, 200),
    ],
)  # fmt: skip
def test_the_lag_is_the_least_step_that_holds_delay_and_allowance(late_ms: int, lag_ms: int) -> None:
    seen = horizon()
    seen.see(7 * MS, (7 + late_ms) * MS)
    assert seen.lag_ns == lag_ms * MS
    assert seen.behind(10_000 * MS) == (10_000 - lag_ms) * MS


@given(st.lists(st.tuples(st.integers(0, 10**12), st.integers(-(10**10), 10**10)), max_size=30), st.randoms())
def test_the_lag_never_shrinks_and_is_that_of_the_largest_delay(seen: list[tuple[int, int]], random: object) -> None:
    one, lags = horizon(), [horizon().lag_ns]
    for time_ns, late_ns in seen:
        one.see(time_ns, time_ns + late_ns)
        lags.append(one.lag_ns)
    assert all(before <= after for before, after in pairwise(lags)) and set(lags) <= set(STEPS_NS)
    other = horizon()
    for time_ns, late_ns in sorted(seen, key=lambda pair: pair[1]):
        other.see(-time_ns, late_ns - time_ns)
    assert other.lag_ns == one.lag_ns, "in any order, at any time"

import pytest

from shared.messages.operation import Freshness
from shared.runtime.freshness import Limits, freshness_of, limits_of, percentile
from shared.topics import BY_NAME, TOPICS


@pytest.mark.parametrize(
    ("topic", "late_after_s", "stale_after_s"),
    [
        ("imu/sample", 0.5, 1.0),  # three periods are 0.03 s, but nothing is late before 0.5 s
        ("gnss/fix", 3.0, 5.0),
        ("navigation/solution", 0.5, 2.0),
        ("health/+", 1.5, 2.0),
        ("origin/state", 6.0, 10.0),
    ],
)
def test_the_limits_follow_from_the_row_of_the_topic(topic: str, late_after_s: float, stale_after_s: float) -> None:
    assert limits_of(BY_NAME[topic]) == Limits(late_after_s, stale_after_s)


def test_a_topic_without_a_rate_is_quiet_at_any_age() -> None:
    assert limits_of(BY_NAME["gnss/configure"]) is None
    assert freshness_of(1e6, None) is Freshness.QUIET


def test_an_age_is_fresh_late_or_stale_and_a_limit_belongs_to_the_worse() -> None:
    limits = Limits(0.5, 2.0)
    assert [freshness_of(age_s, limits) for age_s in (0.0, 0.499, 0.5, 1.99, 2.0)] == [
        Freshness.FRESH, Freshness.FRESH, Freshness.LATE, Freshness.LATE, Freshness.STALE,
    ]  # fmt: skip


def test_a_topic_that_was_never_received_is_never_and_not_stale() -> None:
    assert freshness_of(None, Limits(0.5, 2.0)) is Freshness.NEVER
    assert freshness_of(None, None) is Freshness.NEVER


def test_no_topic_is_stale_before_it_is_late() -> None:
    limits = [limits for topic in TOPICS if (limits := limits_of(topic))]
    assert limits
    assert all(limit.late_after_s <= limit.stale_after_s for limit in limits)


def test_a_percentile_is_one_of_the_values() -> None:
    assert percentile([5.0, 1.0, 3.0, 2.0, 4.0], 0.5) == 3.0
    assert percentile([float(i) for i in range(1, 101)], 0.99) == 99.0
    assert percentile([2.0], 0.99) == 2.0
    assert percentile([], 0.5) is None

import pytest

from services.monitoring.status import ages
from shared.messages import Freshness
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
    assert ages.limits_of(BY_NAME[topic]) == ages.Limits(late_after_s, stale_after_s)


def test_a_topic_without_a_rate_is_quiet_however_old_it_is() -> None:
    assert ages.limits_of(BY_NAME["gnss/configure"]) is None
    assert ages.freshness(1e6, None) is Freshness.QUIET


def test_an_age_is_fresh_then_late_then_stale_and_the_limit_itself_belongs_to_the_worse() -> None:
    limits = ages.Limits(0.5, 2.0)
    assert [ages.freshness(age_s, limits) for age_s in (0.0, 0.499, 0.5, 1.99, 2.0)] == [
        Freshness.FRESH, Freshness.FRESH, Freshness.LATE, Freshness.LATE, Freshness.STALE,
    ]  # fmt: skip


def test_what_never_came_is_never_and_not_stale() -> None:
    assert ages.freshness(None, ages.Limits(0.5, 2.0)) is Freshness.NEVER
    assert ages.freshness(None, None) is Freshness.NEVER


def test_no_topic_is_stale_before_it_is_late() -> None:
    limits = [limits for topic in TOPICS if (limits := ages.limits_of(topic))]
    assert limits
    assert all(limit.late_after_s <= limit.stale_after_s for limit in limits)

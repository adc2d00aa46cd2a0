"""Episodes, binomial intervals and short campaigns of the false-alarm benchmark."""

import numpy as np
import pytest
from scipy.stats import binomtest

from benchmarks.false_alarms import Count, counted, inertial, jobs_of, motion, motion_at, summed
from services.core.spoofing.settings import LongSettings


def test_overlapping_windows_are_one_episode_and_only_evaluated_ones_count() -> None:
    accuses = [None, False, True, True, False, True, None, True]
    (count,) = counted([("test", 1e-3, accuse)] for accuse in accuses)
    assert count == Count("test", 1e-3, 6, 3, 4)


@pytest.mark.parametrize(("episodes", "evaluations"), [(0, 100), (3, 5000), (120, 100_000), (7, 7)])
def test_the_interval_is_that_of_clopper_and_pearson(episodes: int, evaluations: int) -> None:
    expected = binomtest(episodes, evaluations).proportion_ci(0.95, method="exact")
    assert Count("test", None, evaluations, episodes, episodes).interval == pytest.approx(
        (expected.low, expected.high), rel=1e-9
    )


def test_the_verdict_compares_the_design_rate_with_the_interval() -> None:
    assert Count("test", 1e-3, 100_000, 100, 100).verdict == "inside"
    assert Count("test", 1e-3, 100_000, 130, 130).verdict == "too many"
    assert Count("test", 1e-3, 100_000, 70, 70).verdict == "cautious"
    assert Count("test", None, 100_000, 0, 0).verdict == "none"


def test_the_interval_covers_the_design_rate_with_its_confidence() -> None:
    counts = np.random.default_rng(1).binomial(20_000, 1e-3, 400)
    inside = np.mean([Count("test", 1e-3, 20_000, int(count), int(count)).verdict == "inside" for count in counts])
    assert 0.93 <= inside <= 0.99, "an exact interval covers at least 95 %"


def test_a_short_campaign_of_the_motion_monitor_evaluates_every_test_without_too_many_alarms() -> None:
    counts = summed([motion(1, 1500)])
    tests = {count.test for count in counts}
    assert {"trimmed_mean", "event", "calibrated", "scale_step", "held_speed", "fast"} <= tests
    assert {count.design for count in counts if count.test == "fast"} == {1e-3, 1e-5}
    assert not [count for count in counts if count.verdict == "too many"]


def test_a_fast_test_with_a_low_threshold_raises_alarms() -> None:
    (fast,) = [count for count in motion_at(3, 700, 0.3) if count.test == "fast"]
    assert fast.episodes > 3


@pytest.mark.slow
def test_the_inertial_monitors_are_evaluated_with_the_solutions_of_the_fusion() -> None:
    found = inertial(4, 130)
    counts = {(count.test, count.design): count for count in found}
    assert counts["long_30", 1e-3].evaluations == counts["long_30", LongSettings().false_alarm_rate].evaluations > 10
    (heading,) = [count for count in found if count.test == "heading_rate"]
    assert heading.evaluations > 5
    assert all(count.episodes == 0 for count in counts.values())


def test_a_campaign_has_drives_enough_for_its_epochs_and_adds_their_counts() -> None:
    assert [job.arguments for job in jobs_of("inertial", 2700)] == [(1, 900), (2, 900), (3, 900)]
    assert [job.arguments for job in jobs_of("motion", 700)] == [(1, 700)]
    drives = [[Count("fast", 1e-3, 100, 1, 2), Count("event", None, 5, 0, 0)], [Count("fast", 1e-3, 50, 2, 3)]]
    assert summed(drives) == [Count("fast", 1e-3, 150, 3, 5), Count("event", None, 5, 0, 0)]

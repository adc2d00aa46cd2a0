"""Metrics of a true and of a replayed drive, and the cut-off of the high-pass against the truth."""

import numpy as np
import pytest

from cli.papers.spoofing.campaign import DriveRates, Mode, Sigma, learn, measure
from cli.papers.spoofing.over_time import (
    REPLAY_S,
    above_before_and_after,
    errors_by_cut_off,
    figures_over_time,
    replayed,
    thresholds,
)
from services.core.spoofing.windows.metrics import Metric


@pytest.fixture(scope="module")
def drives() -> list[DriveRates]:
    return [measure(seed) for seed in (1, 2)]


@pytest.fixture(scope="module")
def sigma(drives: list[DriveRates]) -> Sigma:
    return learn(drives, Mode.PAPER_RAW)


def test_a_replay_is_the_drives_own_velocity_until_it_begins(drives: list[DriveRates]) -> None:
    velocity = replayed(drives[0], drives[1])
    assert velocity.shape == drives[0].velocity.shape
    assert np.array_equal(velocity[:REPLAY_S], drives[0].velocity[:REPLAY_S])
    assert np.array_equal(velocity[REPLAY_S:], drives[1].velocity[REPLAY_S : len(velocity)])


def test_a_replay_raises_the_share_above_three_sigma(drives: list[DriveRates], sigma: Sigma) -> None:
    shares = above_before_and_after(drives, sigma)
    assert set(shares) == {metric.value for metric in Metric}
    assert max(true for true, _ in shares.values()) < 1.0
    assert sum(false for _, false in shares.values()) > sum(true for true, _ in shares.values())


def test_thresholds_are_three_sigma(sigma: Sigma) -> None:
    assert thresholds(sigma)["acceleration"] == pytest.approx((3.0 * sigma[Metric.ACCELERATION]).tolist())


def test_against_the_truth_the_papers_cut_off_is_the_worst_and_a_low_one_the_best() -> None:
    errors = errors_by_cut_off(seeds=(1,), cut_offs_hz=(0.005, 0.03, 0.12, 0.45))
    assert max(errors, key=errors.__getitem__) == 0.12 and min(errors, key=errors.__getitem__) == 0.005
    assert errors[0.005] < 0.3 and errors[0.12] > 0.8


@pytest.mark.slow
def test_the_figures_are_drawn(drives: list[DriveRates], sigma: Sigma) -> None:
    titles = [one.title for one in figures_over_time(drives, sigma, {0.03: 0.6, 0.12: 0.9})]
    assert titles == [
        "Metrics of a true drive", "Metrics of a replayed drive", "Altitude and its rate", "Cut-off against the truth"
    ]  # fmt: skip

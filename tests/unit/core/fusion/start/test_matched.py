"""Consistency of a filter whose sensors have exactly the errors of its model: a small `make consistency`."""

import numpy as np
import pytest
from scipy.stats import chi2

from benchmarks.consistency.matched import Model, run
from benchmarks.consistency.report import band, dimension, row_of
from benchmarks.consistency.sizes import BLOCKS, Sizes

RUNS = 8


@pytest.fixture(scope="module", params=[Model(), Model(time_correlated=True)], ids=["white", "60 s"])
def runs(request: pytest.FixtureRequest) -> list[Sizes]:
    return [run(request.param, "urban", seed, 60.0) for seed in range(100, 100 + RUNS)]


def test_normalised_errors_of_a_matched_filter_lie_in_the_99_9_percent_band(runs: list[Sizes]) -> None:
    """Mean over time of every block within the 99.9 % band of a single instant, which is wider than its own."""
    row = row_of("matched", runs)
    for block, size in row.nees.items():
        degrees = RUNS * dimension(block)
        low, high = chi2.ppf(0.0005, degrees) / degrees, chi2.isf(0.0005, degrees) / degrees
        assert low < size < high, block


def test_normalised_innovations_of_a_matched_filter_are_within_10_percent_of_one(runs: list[Sizes]) -> None:
    assert all(0.9 < size < 1.1 for size in row_of("matched", runs).innovations)


def test_doubled_and_halved_normalised_errors_are_outside_the_band(runs: list[Sizes]) -> None:
    doubled = [Sizes(run.time_s, 4.0 * run.errors, run.innovations) for run in runs]
    halved = [Sizes(run.time_s, 0.25 * run.errors, run.innovations) for run in runs]
    assert not row_of("optimistic", doubled).within
    assert not row_of("pessimistic", halved).within


@pytest.mark.parametrize("block", BLOCKS)
def test_the_band_is_that_of_chi_square(block: str) -> None:
    degrees = 50 * dimension(block)
    exact = np.array([chi2.ppf(0.025, degrees), chi2.isf(0.025, degrees)]) / degrees
    assert band(50, dimension(block)) == pytest.approx(exact, rel=1e-12)

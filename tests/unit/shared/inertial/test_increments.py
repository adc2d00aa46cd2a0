"""Increments of 100 ms against sums by hand."""

from collections import Counter

import pytest

from shared.inertial.increments import Decimator
from shared.maths.earth import STANDARD_GRAVITY

MS = 1_000_000


@pytest.mark.parametrize("batch", [1, 7, 31])
def test_the_first_increment_begins_with_the_first_sample_and_holds_the_means_of_those_behind_it(batch: int) -> None:
    """Samples of 100 Hz whose force forwards is their number."""
    rejected: Counter[str] = Counter()
    decimator, found = Decimator(80.0, 20.0, rejected), []
    for first in range(0, 31, batch):
        numbers = range(first, min(first + batch, 31))
        decimator.add(
            [10 * MS * k for k in numbers], [(float(k), 0.0, 0.0) for k in numbers], [(0.0, 0.0, 0.1)] * len(numbers)
        )
        found += decimator.take()
    assert [(increment.start_ns // MS, increment.end_ns // MS) for increment in found] == [
        (0, 100),
        (100, 200),
        (200, 300),
    ]
    for increment, mean in zip(found, (5.5, 15.5, 25.5), strict=True):
        assert increment.row == pytest.approx([mean, 0.0, 0.0, 0.0, 0.0, 0.1, 0.1])
        assert increment.excess_force == pytest.approx(mean - STANDARD_GRAVITY)
    assert [increment.after_gap for increment in found] == [True, False, False] and not rejected

"""Honest traffic is charged once, each vehicle its own passage: the short form of `python -m benchmarks.v2x.honest`."""

import pytest

from benchmarks.v2x.honest import GOALS, part

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("setting", ["detectors that err"])
def test_honest_traffic_is_charged_once_and_few_need_a_person(setting: str) -> None:
    result = part(setting, 2, 130, drain_s=45.0)
    assert result.contracts > 10
    assert result.is_right and result.lanes_wrong == 0, result
    assert result.charged + result.reviews >= result.contracts
    assert result.review_share <= GOALS.get(setting, 5.0) / 100.0 + 1.0 / result.contracts

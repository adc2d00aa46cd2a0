"""How fast a contradiction grew, and what it may have become over a power cut."""

import pytest

from services.core.fusion.conflict_record import held_numbers, held_of, remembered
from services.core.fusion.integrity.disagreement import NO_DISAGREEMENT, Disagreement
from services.core.fusion.integrity.over_a_cut import MAX_DISTANCE_M, MAX_DURATION_S, GrowthRate, RememberedConflict
from shared.messages.navigation import ConflictRecord

SECOND_NS = 1_000_000_000
HELD = Disagreement((30.0, -40.0, 2.0), (1.0, 2.0), slack=(5.0, 6.0), agreeing_ns=7)


def test_the_rate_is_that_of_a_growth_and_not_of_a_step() -> None:
    rate = GrowthRate()
    for k in range(20):
        rate.update(k * SECOND_NS, (3.0 + 1.5 * k, 0.0, -0.5 * k))
    assert rate.largest == pytest.approx((1.5, 0.5))
    step = GrowthRate()
    for k in range(20):
        step.update(k * SECOND_NS, (60.0 if k > 9 else 0.0, 0.0, 0.0))
    assert step.largest == (0.0, 0.0)


def test_the_largest_rate_stays_until_nothing_is_held_and_a_gap_is_no_growth() -> None:
    rate = GrowthRate()
    for k in range(6):
        rate.update(k * SECOND_NS, (2.0 * k, 0.0, 0.0))
    rate.update(6 * SECOND_NS, None)
    rate.update(7 * SECOND_NS, (500.0, 0.0, 0.0))
    assert rate.largest[0] == pytest.approx(2.0)
    rate.update(7 * SECOND_NS, (900.0, 0.0, 0.0))  # a time that stands still has no rate
    assert rate.largest[0] == pytest.approx(2.0)
    rate.forget()
    assert rate.largest == (0.0, 0.0)


def test_the_bound_grows_over_the_cut_by_the_largest_rate() -> None:
    known = RememberedConflict(0, HELD, (3.0, 0.5))
    held = known.at(20 * SECOND_NS)
    assert held.vector_n == HELD.vector_n, "the jump back closes it as before"
    assert held.bound == pytest.approx((50.0 + 5.0 + 60.0, 2.0 + 6.0 + 10.0))
    assert held.agreeing_ns is None
    assert known.at(0).bound == HELD.bound
    assert RememberedConflict(0, NO_DISAGREEMENT, (3.0, 0.5)).at(20 * SECOND_NS) is NO_DISAGREEMENT


@pytest.mark.parametrize("time_ns", [-1, 10**18])
def test_a_clock_that_went_back_and_a_long_cut_are_bounded(time_ns: int) -> None:
    assert RememberedConflict(0, HELD, (3.0, 0.0)).at(time_ns).bound[0] == pytest.approx(55.0 + 3.0 * MAX_DURATION_S)
    assert RememberedConflict(0, HELD, (1e4, 0.0)).at(time_ns).slack[0] == MAX_DISTANCE_M


def test_a_record_gives_back_what_was_held() -> None:
    record = ConflictRecord(sampled_ns=5, held_m=held_numbers(HELD), held_grew=True, growth_m_s=(1.0, 2.0))
    back = remembered(record)
    assert (back.time_ns, back.growth, back.held.grew) == (5, (1.0, 2.0), True)
    assert back.held.bound == HELD.bound
    assert held_of(ConflictRecord(sampled_ns=0)) is NO_DISAGREEMENT
    assert held_of(ConflictRecord(sampled_ns=0, held_m=(1.0, 2.0))) is NO_DISAGREEMENT, "of another layout"

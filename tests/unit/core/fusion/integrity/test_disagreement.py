"""A disagreement of positions: what ends it, and that time does not."""

import pytest

from services.core.fusion.integrity.disagreement import CONFIRMED_S, DRIVEN_M, NOTHING, Disagreement

SECOND_NS = 1_000_000_000


def agreeing(held: Disagreement, seconds: int, *, moved_m: float = 10.0) -> Disagreement:
    """Use a position a second, with the way driven between two of them."""
    for k in range(1, seconds + 1):
        held = held.confirmed(k * SECOND_NS, used=True, since_s=1.0, speed=moved_m)
    return held


def test_a_step_is_held_for_ever_although_the_displacement_agrees() -> None:
    held = NOTHING.after((60.0, 80.0, -5.0), (2.0, 3.0), 0, grew=False)
    assert agreeing(held, 3600).bound == (100.0, 5.0)


def test_a_step_back_by_the_same_vector_closes_it_and_one_by_another_vector_does_not() -> None:
    held = NOTHING.after((60.0, 80.0, 0.0), (2.0, 3.0), 0, grew=False)
    assert held.after((-61.0, -79.0, 0.5), (2.0, 3.0), SECOND_NS, grew=False) == NOTHING
    other = held.after((80.0, -60.0, 0.0), (2.0, 3.0), SECOND_NS, grew=False)
    assert other.bound[0] == pytest.approx((140.0**2 + 20.0**2) ** 0.5)


def test_a_difference_that_grew_ends_after_a_minute_of_positions_without_a_rejection() -> None:
    held = NOTHING.after((8.0, 0.0, 0.0), (2.0, 3.0), 0, grew=True)
    assert agreeing(held, int(CONFIRMED_S) - 1).is_open
    rejected = agreeing(held, 50).confirmed(51 * SECOND_NS, used=False, since_s=1.0, speed=0.0)
    assert rejected.confirmed(70 * SECOND_NS, used=True, since_s=1.0, speed=0.0).is_open, "the minute begins anew"
    assert not agreeing(held, int(CONFIRMED_S) + 2).is_open


def test_a_step_after_a_growth_is_a_step() -> None:
    held = NOTHING.after((8.0, 0.0, 0.0), (1.0, 1.0), 0, grew=True).after((0.0, 50.0, 0.0), (1.0, 1.0), 0, grew=False)
    assert agreeing(held, 600).is_open


def test_a_start_aside_of_the_saved_position_ends_after_two_kilometres_and_not_at_standstill() -> None:
    held = NOTHING.after((0.0, 50.0, 0.0), (2.0, 3.0), 0, grew=False, at_start=True)
    assert agreeing(held, 3600, moved_m=0.0).is_open
    assert agreeing(held, int(DRIVEN_M / 10.0) - 2).is_open
    assert not agreeing(held, int(DRIVEN_M / 10.0) + 2).is_open
    assert held.after((0.0, -49.0, 0.0), (2.0, 3.0), SECOND_NS, grew=False) == NOTHING


def test_an_event_on_another_axis_or_in_the_same_direction_closes_nothing() -> None:
    held = NOTHING.after((20.0, 0.0, 0.0), (11.0, 5.0), 0, grew=False)
    assert held.after((0.0, 0.0, 30.0), (0.0, 5.0), SECOND_NS, grew=False).bound == (20.0, 30.0)
    assert held.after((0.5, 0.0, 0.0), (1.0, 1.0), SECOND_NS, grew=False).bound[0] == 20.5


def test_a_single_position_after_an_outage_is_no_minute_of_agreement_and_no_drive() -> None:
    grew = NOTHING.after((15.0, 0.0, 0.0), (2.0, 2.0), 0, grew=True)
    assert grew.confirmed(100 * SECOND_NS, used=True, since_s=99.0, speed=20.0).is_open
    start = NOTHING.after((300.0, 0.0, 0.0), (2.0, 2.0), 0, grew=False, at_start=True)
    assert start.confirmed(150 * SECOND_NS, used=True, since_s=150.0, speed=20.0).driven_m == 0.0


def test_what_a_given_up_solution_may_have_been_off_by_is_part_of_the_bound() -> None:
    held = NOTHING.after((3.0, 4.0, 0.0), (1.0, 1.0), 0, grew=False, slack=(30.0, 12.0))
    assert held.bound == (35.0, 12.0) and held.is_open

"""A disagreement of positions: what ends it, and that time does not."""

from dataclasses import replace

import pytest

from services.core.fusion.codes import Code
from services.core.fusion.integrity.disagreement import CONFIRMATION_S, DRIVEN_M, NO_DISAGREEMENT, Disagreement

SECOND_NS = 1_000_000_000


def agreeing(held: Disagreement, seconds: int, *, moved_m: float = 10.0) -> Disagreement:
    """Use a position a second, with the way driven between two of them."""
    for k in range(1, seconds + 1):
        held = held.confirmed(k * SECOND_NS, used=True, since_s=1.0, speed=moved_m)
    return held


def test_a_step_is_held_for_ever_although_the_displacement_agrees() -> None:
    held = NO_DISAGREEMENT.after((60.0, 80.0, -5.0), (2.0, 3.0), 0, grew=False)
    assert agreeing(held, 3600).bound == (100.0, 5.0)


def test_a_step_back_by_the_same_vector_closes_it_and_one_by_another_vector_does_not() -> None:
    held = NO_DISAGREEMENT.after((60.0, 80.0, 0.0), (1.0, 1.5), 0, grew=False)
    assert held.after((-61.0, -79.0, 0.5), (1.0, 1.5), SECOND_NS, grew=False) == NO_DISAGREEMENT
    other = held.after((80.0, -60.0, 0.0), (1.0, 1.5), SECOND_NS, grew=False)
    assert other.bound[0] == pytest.approx((140.0**2 + 20.0**2) ** 0.5)


def test_a_difference_that_grew_ends_after_a_minute_of_positions_without_a_rejection() -> None:
    held = NO_DISAGREEMENT.after((8.0, 0.0, 0.0), (2.0, 3.0), 0, grew=True)
    assert agreeing(held, int(CONFIRMATION_S) - 1).is_open
    rejected = agreeing(held, 50).confirmed(51 * SECOND_NS, used=False, since_s=1.0, speed=0.0)
    assert rejected.confirmed(70 * SECOND_NS, used=True, since_s=1.0, speed=0.0).is_open, "the minute begins anew"
    assert not agreeing(held, int(CONFIRMATION_S) + 2).is_open


def test_a_step_after_a_growth_is_a_step() -> None:
    held = NO_DISAGREEMENT.after((8.0, 0.0, 0.0), (1.0, 1.0), 0, grew=True).after(
        (0.0, 50.0, 0.0), (1.0, 1.0), 0, grew=False
    )
    assert agreeing(held, 600).is_open


def test_a_start_aside_of_the_saved_position_ends_after_two_kilometres_and_not_at_standstill() -> None:
    held = NO_DISAGREEMENT.after((0.0, 50.0, 0.0), (1.0, 1.5), 0, grew=False, at_start=True)
    assert agreeing(held, 3600, moved_m=0.0).is_open
    assert agreeing(held, int(DRIVEN_M / 10.0) - 2).is_open
    assert not agreeing(held, int(DRIVEN_M / 10.0) + 2).is_open
    assert held.after((0.0, -49.0, 0.0), (1.0, 1.5), SECOND_NS, grew=False) == NO_DISAGREEMENT


def test_an_event_on_another_axis_or_in_the_same_direction_closes_nothing() -> None:
    held = NO_DISAGREEMENT.after((20.0, 0.0, 0.0), (11.0, 5.0), 0, grew=False)
    assert held.after((0.0, 0.0, 30.0), (0.0, 5.0), SECOND_NS, grew=False).bound == (20.0, 30.0)
    assert held.after((0.5, 0.0, 0.0), (1.0, 1.0), SECOND_NS, grew=False).bound[0] == 20.5


def test_a_single_position_after_an_outage_is_no_minute_of_agreement_and_no_drive() -> None:
    grew = NO_DISAGREEMENT.after((15.0, 0.0, 0.0), (2.0, 2.0), 0, grew=True)
    assert grew.confirmed(100 * SECOND_NS, used=True, since_s=99.0, speed=20.0).is_open
    start = NO_DISAGREEMENT.after((300.0, 0.0, 0.0), (2.0, 2.0), 0, grew=False, at_start=True)
    assert start.confirmed(150 * SECOND_NS, used=True, since_s=150.0, speed=20.0).driven_m == 0.0


def test_what_a_given_up_solution_may_have_been_off_by_is_part_of_the_bound() -> None:
    held = NO_DISAGREEMENT.after((3.0, 4.0, 0.0), (1.0, 1.0), 0, grew=False, slack=(30.0, 12.0))
    assert held.bound == (35.0, 12.0) and held.is_open


def test_a_step_back_closes_what_its_spread_tells_from_another_offset_and_leaves_the_rest() -> None:
    held = NO_DISAGREEMENT.after((60.0, 0.0, 0.0), (1.0, 1.0), 0, grew=False, slack=(3.0, 0.0))
    assert held.after((-45.0, 0.0, 0.0), (1.0, 1.0), 1, grew=False).bound[0] == 18.0, "to another offset"
    assert held.after((-30.0, 0.0, 0.0), (20.0, 1.0), 1, grew=False).bound[0] >= 30.0, "half way"
    blunt = held.after((-58.0, 0.0, 0.0), (4.0, 1.0), 1, grew=False)
    assert 4.0 < blunt.bound[0] < 10.0, "that could be another offset of a few metres"


def test_what_still_grows_does_so_until_displacement_agrees_and_never_ends_by_agreement() -> None:
    held = replace(NO_DISAGREEMENT.after((20.0, 0.0, 0.0), (1.0, 1.0), 0, grew=False), growth_m_s=0.5)
    grown = agreeing(held, 100)
    assert grown.bound[0] == pytest.approx(70.0)
    assert agreeing(replace(grown, growth_m_s=0.0), 100).bound[0] == pytest.approx(70.0)


def test_it_says_what_would_end_it_and_names_only_ways_that_exist() -> None:
    def codes(held: Disagreement, place_m: float | None) -> list[str]:
        return [end.code for end in held.ends(place_m)]

    step = NO_DISAGREEMENT.after((60.0, 0.0, 0.0), (1.0, 1.0), 0, grew=False)
    assert codes(NO_DISAGREEMENT, 5.0) == []
    assert codes(step, None) == [Code.ENDS_BY_STEP_BACK, Code.ENDS_BY_OPERATOR]
    assert codes(step, 700.0) == [Code.ENDS_BY_STEP_BACK, Code.ENDS_AT_PLACE, Code.ENDS_BY_OPERATOR]
    start = NO_DISAGREEMENT.after((60.0, 0.0, 0.0), (1.0, 1.0), 0, grew=False, at_start=True)
    assert codes(start, None)[1] == Code.ENDS_BY_DRIVE
    assert codes(NO_DISAGREEMENT.after((60.0, 0.0, 0.0), (1.0, 1.0), 0, grew=True), None)[1] == Code.ENDS_BY_AGREEMENT


def test_a_further_vector_keeps_the_growth_of_what_is_held() -> None:
    grows = replace(NO_DISAGREEMENT.after((20.0, 0.0, 0.0), (1.0, 1.0), 0, grew=False), growth_m_s=0.5)
    assert grows.after((3.0, 0.0, 0.0), (1.0, 1.0), 1, grew=False).growth_m_s == 0.5


def test_a_step_back_ends_what_a_reset_has_left_without_slack() -> None:
    held = NO_DISAGREEMENT.after((60.0, 0.0, 0.0), (5.0, 1.0), 0, grew=False)
    assert held.after((-59.9, 0.0, 0.0), (5.0, 1.0), 1, grew=False) is NO_DISAGREEMENT
    assert held.after((-35.0, 0.0, 0.0), (5.0, 1.0), 1, grew=False).bound[0] == pytest.approx(25.0), "half way"

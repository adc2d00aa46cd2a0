"""A return of GNSS after an outage: what the level holds, and the way that ends it."""

import pytest

from services.core.fusion.integrity.after_loss import DRIVEN_M, NO_LOSS, ReturnSpread
from services.core.fusion.integrity.error_monitor import ErrorMonitor

BEFORE = (4.0, 0.0, 9.0, 1.0)  # [m²] standard deviations of 2, 3 and 1 m


def driven(loss: ReturnSpread, seconds: int, *, used: bool = True) -> ReturnSpread:
    for _ in range(seconds):
        loss = loss.confirmed(used=used, since_s=1.0, speed=10.0)
    return loss


def test_three_standard_deviations_of_the_free_run_are_held_for_500_m_of_agreement() -> None:
    loss = NO_LOSS.returned(0, BEFORE)
    assert loss.bound == pytest.approx((9.0, 3.0))
    assert driven(loss, round(DRIVEN_M / 10.0) - 1).bound == loss.bound
    assert driven(loss, round(DRIVEN_M / 10.0) + 1) == NO_LOSS


def test_a_rejected_position_or_another_outage_begins_the_way_again() -> None:
    almost = driven(NO_LOSS.returned(0, BEFORE), 45)
    assert driven(almost.confirmed(used=False, since_s=1.0, speed=10.0), 45).bound[0] > 0.0
    assert driven(almost.confirmed(used=True, since_s=8.0, speed=10.0), 45).bound[0] > 0.0
    assert driven(almost.returned(1, (1.0, 0.0, 1.0, 1.0)), 45).bound == almost.bound, "the larger one stays"


def test_a_standstill_confirms_nothing_and_without_a_loss_there_is_nothing_to_confirm() -> None:
    loss = NO_LOSS.returned(0, BEFORE)
    assert loss.confirmed(used=True, since_s=1.0, speed=0.0).bound == loss.bound
    assert NO_LOSS.confirmed(used=True, since_s=1.0, speed=100.0) is NO_LOSS


def test_after_interference_the_spread_is_held_as_an_offset_that_displacement_does_not_end() -> None:
    monitor = ErrorMonitor(loss=NO_LOSS.returned(0, BEFORE))
    after = monitor.after_interference()
    held = after.held
    assert after.loss is NO_LOSS and after.after_interference() is after
    assert held.bound == pytest.approx((9.0, 3.0)) and not held.grew
    for k in range(1, 1000):
        held = held.confirmed(k * 10**9, used=True, since_s=1.0, speed=30.0)
    assert held.bound == pytest.approx((9.0, 3.0))

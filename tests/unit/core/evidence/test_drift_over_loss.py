"""The drift of the receiver's clock before and after a loss of the signals."""

import pytest

from services.core.evidence.drift_over_loss import WARM_UP_S, DriftOverLoss
from shared.maths.gnss_signals import SPEED_OF_LIGHT

NS = 1_000_000_000
DRIFT_M_S = 110.0


def second(drift: DriftOverLoss, at_s: float, drift_m_s: float, satellites: int = 12) -> float | None:
    """One epoch; returns the change over its limit, if it is compared."""
    time_ns = round(at_s * NS)
    drift.heard(time_ns)
    drift.clock(time_ns, drift_m_s / SPEED_OF_LIGHT)
    change = drift.epoch(time_ns, satellites)
    return None if change is None else abs(change.drift_m_s) / change.limit_m_s


@pytest.mark.parametrize(
    ("gap_s", "step_m_s", "accuses"), [(12, 15.0, True), (12, 4.0, False), (60, 15.0, False), (60, 25.0, True)]
)
def test_a_step_beyond_what_an_oscillator_does_in_the_loss_is_found(gap_s: int, step_m_s: float, accuses: bool) -> None:
    drift = DriftOverLoss()
    assert [second(drift, k, DRIFT_M_S) for k in range(20)] == [None] * 20
    lost = [second(drift, 20 + k, DRIFT_M_S, satellites=0) for k in range(gap_s)]
    assert lost == [None] * gap_s, "what a receiver states in a loss is extrapolated"
    found = [second(drift, 20 + gap_s + k, DRIFT_M_S + step_m_s) for k in range(20)]
    compared = [value for value in found if value is not None]
    assert 0 < len(compared) <= 7 and all((value > 1.0) is accuses for value in compared)


def test_one_more_statement_of_the_old_drift_after_the_return_hides_nothing() -> None:
    drift = DriftOverLoss()
    for k in range(32):
        second(drift, k, DRIFT_M_S, satellites=12 if k < 20 else 0)
    assert (second(drift, 32, DRIFT_M_S) or 0.0) < 1.0 < (second(drift, 33, DRIFT_M_S + 15.0) or 0.0)


def test_a_change_without_a_loss_is_not_compared() -> None:
    drift = DriftOverLoss()
    assert [second(drift, k, 10.0 * k) for k in range(30)] == [None] * 30


def test_after_silence_of_the_receiver_nothing_is_compared_in_its_first_two_minutes() -> None:
    drift = DriftOverLoss()
    for k in range(20):
        second(drift, k, DRIFT_M_S)
    warming = [second(drift, 40 + k, DRIFT_M_S + 30.0) for k in range(int(WARM_UP_S))]
    assert warming == [None] * int(WARM_UP_S)
    assert (second(drift, 41 + WARM_UP_S, DRIFT_M_S + 30.0) or 0.0) < 1.0, "over 140 s the limit is 43 m/s"

"""Rates of the tests of a vehicle, as delivered, against one budget."""

import pytest

from services.core.cooperative.process import Config as Cooperative
from services.core.motion_conflict.settings import Settings as Motion
from services.core.spoofing.settings import Settings as Spoofing
from shared.trust.budget import PER_HOUR, SHARES, evaluations, rate_of


def test_the_shares_are_one_whole() -> None:
    assert sum(share.share for share in SHARES.values()) == pytest.approx(1.0)


def test_the_rates_as_delivered_are_within_the_budget() -> None:
    spoofing = Spoofing()
    delivered = {
        "long": spoofing.long.false_alarm_rate,
        "gyroscope": spoofing.gyroscope.false_alarm_rate,
        "drift": spoofing.drift.false_alarm_rate,
        "motion_fast": Motion().fast_false_alarm_rate,
        "satellites": Cooperative().false_alarm_rate,
    }
    assert set(delivered) == set(SHARES)
    per_hour = sum(rate * SHARES[name].tests * evaluations(SHARES[name].shortest_s) for name, rate in delivered.items())
    assert per_hour == pytest.approx(PER_HOUR)


def test_a_long_window_is_evaluated_less_often_than_once_a_second() -> None:
    assert evaluations(5.0) == 3600.0 and evaluations(60.0) == pytest.approx(1200.0)
    assert rate_of("long") > rate_of("gyroscope")

"""Detections of an attack, and the time in each state of the verdict."""

import pytest

from cli.demo.detection import seconds_in_states, summarise
from shared.messages.simulation import AttackName, AttackRun
from shared.messages.trust import Outcome, TrustLevel, TrustState
from tests.support.dashboard.status_world import monitor, trust

NS = 1_000_000_000
ACCUSES = {"outcome": Outcome.ACCUSES, "accused": ("gnss",)}

NEIGHBOUR = {"outcome": Outcome.ACCUSES, "accused": ("neighbour 7",)}


def verdict(t_s: float, level: TrustLevel = TrustLevel.SAFE, **changes: object) -> TrustState:
    return trust(round(t_s * NS), level, **changes)


def run(ended_s: float | None = None) -> AttackRun:
    ended_ns = None if ended_s is None else round(ended_s * NS)
    return AttackRun(attack=AttackName.DRAG_OFF, started_ns=60 * NS, ended_ns=ended_ns)


@pytest.mark.parametrize(
    ("sign", "state"),
    [
        ("gnss excluded", verdict(70.0, gnss_excluded=True)),
        ("odometer excluded", verdict(70.0, TrustLevel.CAUTION, odometer_excluded=True)),
        ("verdict unsafe", verdict(70.0, TrustLevel.UNSAFE)),
        ("verdict dead_reckoning", verdict(70.0, TrustLevel.DEAD_RECKONING)),
        ("motion suspects gnss", verdict(70.0, monitors=(monitor(70 * NS, "motion", **ACCUSES),))),
    ],
)
def test_an_exclusion_an_alarm_and_an_accusation_are_detections(sign: str, state: TrustState) -> None:
    (found,) = summarise([run()], [verdict(59.0), verdict(65.0), state, verdict(80.0, gnss_excluded=True)], 10 * NS)
    assert (found.name, found.started_s, found.detected_after_s, found.detected_by) == ("drag_off", 50.0, 10.0, (sign,))


@pytest.mark.parametrize(
    "states",
    [
        [verdict(59.0), verdict(61.0, TrustLevel.CAUTION), verdict(90.0, TrustLevel.NO_FIX)],
        [verdict(59.0, TrustLevel.UNSAFE), verdict(61.0, TrustLevel.UNSAFE)],
        [verdict(50.0, TrustLevel.UNSAFE), verdict(59.0), verdict(101.0, TrustLevel.UNSAFE)],
        [verdict(59.0), verdict(70.0, monitors=(monitor(70 * NS, "satellites", **NEIGHBOUR),))],
    ],
    ids=["less than an alarm", "alarm from before", "after the end", "a neighbour"],
)
def test_signs_without_relation_to_the_attack_are_no_detection(states: list[TrustState]) -> None:
    (found,) = summarise([run(100.0)], states, 0)
    assert found.detected_after_s is None and not found.detected_by


def test_an_accused_neighbour_is_the_detection_of_a_false_one() -> None:
    lie = run().model_copy(update={"attack": AttackName.NEIGHBOUR_LIE})
    (found,) = summarise([lie], [verdict(59.0), verdict(62.0, monitors=(monitor(1, "satellites", **NEIGHBOUR),))], 0)
    assert found.detected_by == ("satellites suspects neighbour 7",)


def test_a_sign_present_before_the_attack_counts_once_it_has_ended_and_recurred() -> None:
    states = [verdict(59.0, TrustLevel.UNSAFE), verdict(61.0), verdict(64.0, TrustLevel.UNSAFE)]
    (found,) = summarise([run()], states, 0)
    assert found.detected_after_s == 4.0


def test_each_state_counts_until_the_next_one_and_missing_states_do_not() -> None:
    states = [verdict(0.0), verdict(1.0), verdict(1.5, TrustLevel.UNSAFE), verdict(100.0)]
    seconds = seconds_in_states(states)
    assert seconds["safe"] == 1.5 and seconds["unsafe"] == 2.0
    assert set(seconds) == set(TrustLevel)

from itertools import permutations

import pytest

from shared.chosen import (
    DECISION_NS,
    SILENCE_TIMEOUT_NS,
    ChosenSource,
    imu_choice,
    receiver_choice,
    receiver_of,
    speed_choice,
)
from shared.messages.operation import Mode, ModeState

NAMES = ("can0/j1939/00", "can0/j1939/0B", "can1/obd")
STEP_NS = 100_000_000


@pytest.mark.parametrize("order", list(permutations(NAMES)))
def test_the_choice_does_not_depend_on_who_was_heard_first(order: tuple[str, ...]) -> None:
    chosen = ChosenSource()
    heard = [(name, k * STEP_NS) for k in range(1, 10) for name in order]
    used = [name for name, at_ns in heard if chosen.takes(name, at_ns)]
    assert set(used[3:]) == {"can0/j1939/00"} and chosen.current(9 * STEP_NS) == "can0/j1939/00"


def test_another_device_takes_the_place_of_one_that_is_silent_and_gives_it_back() -> None:
    chosen = ChosenSource()
    assert chosen.takes("a", 0) and not chosen.takes("b", SILENCE_TIMEOUT_NS)
    assert chosen.current(SILENCE_TIMEOUT_NS + 1) is None
    assert chosen.takes("b", SILENCE_TIMEOUT_NS + 1) and chosen.current(SILENCE_TIMEOUT_NS + 1) == "b"
    assert chosen.takes("a", SILENCE_TIMEOUT_NS + 2) and not chosen.takes("b", SILENCE_TIMEOUT_NS + 3)


def mode(at_ns: int, **chosen: str) -> ModeState:
    return ModeState.model_validate(
        {"sampled_ns": at_ns, "mode": Mode.MEASURING, "since_ns": 0, "reason": "navigating"} | chosen
    )


def test_the_choice_of_the_controller_is_obeyed_until_it_is_old() -> None:
    chosen = ChosenSource(speed_choice)
    assert chosen.takes("a", 0) and not chosen.takes("b", 1)
    chosen.follow(mode(2, speed_source="b", gnss_source="a"))
    assert chosen.takes("b", 3) and not chosen.takes("a", 4)
    late_ns = 3 + DECISION_NS
    assert chosen.takes("a", late_ns), "without a controller the rule holds again"
    assert not chosen.takes("b", late_ns + 1)


def test_without_a_choice_of_its_kind_the_rule_holds() -> None:
    chosen = ChosenSource(imu_choice)
    chosen.follow(mode(0, speed_source="b"))
    assert chosen.takes("a", 1) and not chosen.takes("b", 2)


def test_talkers_of_one_receiver_are_one_receiver() -> None:
    assert receiver_choice(mode(0, gnss_source="gnss0/nmea")) == receiver_of("gnss0") == "gnss0"

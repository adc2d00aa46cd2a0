"""The position in a replay, in closed form."""

import pytest

from services.sensors.replay.position import Position
from shared.messages.replay import ReplayCommand, ReplayControl

S = 1_000_000_000
BEGIN, END = 100 * S, 200 * S


def control(command: str, **values: float) -> ReplayControl:
    return ReplayControl(command=ReplayCommand(command), **values)


def test_recorded_time_passes_at_the_speed_of_the_replay() -> None:
    position = Position(BEGIN, END, 2.0, 10.0)
    assert position.at(13.0) == BEGIN + 6 * S
    assert not position.apply(control("speed", speed=0.5), 13.0)
    assert position.at(17.0) == BEGIN + 8 * S


def test_a_pause_holds_the_position_until_it_plays_on() -> None:
    position = Position(BEGIN, END, 1.0, 0.0)
    position.apply(control("pause"), 5.0)
    assert position.at(50.0) == BEGIN + 5 * S
    position.apply(control("play"), 50.0)
    assert position.at(52.0) == BEGIN + 7 * S


@pytest.mark.parametrize(("wanted_s", "found_s"), [(0.0, 0), (33.0, 33), (1e6, 100)])
def test_a_jump_stays_within_the_recording(wanted_s: float, found_s: int) -> None:
    position = Position(BEGIN, END, 1.0, 0.0)
    assert position.apply(control("seek", position_s=wanted_s), 7.0)
    assert position.at(7.0) == BEGIN + found_s * S


def test_the_replay_pauses_at_its_end_and_plays_again_from_the_beginning() -> None:
    position = Position(BEGIN, END, 10.0, 0.0)
    assert not position.stop_at_end(9.9)
    assert position.stop_at_end(11.0)
    assert (position.at(99.0), position.playing) == (END, False)
    assert not position.stop_at_end(12.0), "it ends once"
    assert position.apply(control("play"), 20.0)
    assert position.at(20.0) == BEGIN

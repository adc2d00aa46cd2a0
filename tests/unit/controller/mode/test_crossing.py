"""Crossings by ferry or train: begun and ended by the driver, closed by the wheels, and open over a restart."""

import pytest

from services.controller.mode.crossing import NS
from shared.messages.base import Message, Tick
from shared.messages.operation import Crossing, CrossingEnd, OperatorCommand
from shared.messages.vehicle import VehicleSpeed
from tests.unit.controller.mode.test_commands import ACCEPTED, DONE, FAILED, answers, command, run, unit
from tests.unit.controller.mode.test_mode import at

BEGIN, END = OperatorCommand.CROSSING_BEGIN, OperatorCommand.CROSSING_END


def wheels(second: float, speed_m_s: float, source: str = "can0/obd") -> VehicleSpeed:
    return VehicleSpeed(sampled_ns=at(second), received_ns=at(second), source=source, speed_m_s=speed_m_s)


def crossings(out: list[Message]) -> list[Crossing]:
    return [message for message in out if isinstance(message, Crossing)]


def test_the_driver_begins_and_ends_a_crossing() -> None:
    process = unit()
    begun = run(process, [Tick(now_ns=at(1.0)), wheels(1.0, 0.0), command(BEGIN)])
    assert answers(begun) == [(ACCEPTED, ""), (DONE, "")]
    assert [(one.is_open, one.since_ns) for one in crossings(begun)] == [(True, at(1.0))]
    assert answers(run(process, [command(BEGIN)])) == [(FAILED, "a crossing is open already; end it first")]
    ended = run(process, [Tick(now_ns=at(3601.0)), command(END)])
    _, over = crossings(ended)  # after the one of each minute
    assert not over.is_open and over.ended_by is CrossingEnd.DRIVER and over.since_ns == at(1.0)
    ((stage, why),) = answers(run(process, [command(END)]))
    assert stage is FAILED and "no crossing is open" in why


@pytest.mark.parametrize("period_s", [0.1, 1.0])
def test_one_left_open_is_closed_by_100_m_of_the_wheels(period_s: float) -> None:
    process = unit()
    run(process, [Tick(now_ns=at(1.0)), wheels(1.0, 0.0), Tick(now_ns=at(1.1)), command(BEGIN)])
    out = run(process, [wheels(2.0 + k * period_s, 10.0) for k in range(round(9.8 / period_s))])
    assert crossings(out) == [], "98 m are fewer"
    (over,) = crossings(run(process, [wheels(12.0 + k * period_s, 10.0) for k in range(round(2.0 / period_s))]))
    assert not over.is_open and over.ended_by is CrossingEnd.WHEELS
    assert over.wheels_m == pytest.approx(100.0, abs=11.0)


def test_another_source_and_old_stamps_move_no_wheels() -> None:
    process = unit()
    run(process, [Tick(now_ns=at(1.0)), wheels(1.0, 0.0), Tick(now_ns=at(1.1)), command(BEGIN)])
    out = run(process, [one for k in range(20) for one in (wheels(2.0 + k, 0.0), wheels(2.0 + k, 40.0, "wheel/other"))])
    assert crossings([*out, *run(process, [wheels(2.0, 40.0)] * 50)]) == []


def test_one_that_was_open_at_the_end_of_the_unit_is_open_from_the_next_start_on() -> None:
    stored = Crossing(sampled_ns=5 + 10 * NS, is_open=True, since_ns=5, wheels_m=60.0)
    process = unit()
    (resumed,) = crossings(run(process, [Tick(now_ns=at(1.0)), stored]))
    assert resumed.is_open and resumed.since_ns == at(1.0) - 10 * NS, (
        "a span, as a stamp of another start means nothing"
    )
    assert resumed.wheels_m == 60.0
    assert crossings(run(process, [resumed])) == [], "its own message comes back"
    assert crossings(run(unit(), [Tick(now_ns=at(1.0)), stored.model_copy(update={"is_open": False})])) == []


def test_restarts_do_not_keep_a_crossing_open_longer_than_100_m_of_the_wheels() -> None:
    """A restart each 25 m: the message that the broker keeps has the distance."""
    kept, out = Crossing(sampled_ns=at(0.0), is_open=True, since_ns=at(0.0)), []
    for start in (100.0, 200.0, 300.0, 400.0, 500.0, 600.0):
        process = unit()
        out = crossings(run(process, [Tick(now_ns=at(start)), kept, wheels(start, 0.5), Tick(now_ns=at(start + 0.1))]))
        drive = [one for k in range(1, 51) for one in (wheels(start + k, 0.5), Tick(now_ns=at(start + k)))]
        out += crossings(run(process, drive))
        kept = out[-1]
        if not kept.is_open:
            break
    assert [one.is_open for one in out][-1] is False and kept.ended_by is CrossingEnd.WHEELS
    assert kept.sampled_ns - kept.since_ns >= 150 * NS

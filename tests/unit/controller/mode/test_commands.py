"""Commands of the operator: accepted, done, failed."""

from collections.abc import Iterable

import pytest

from services.controller.mode.process import Config, Process
from services.parsers.gnss.ubx.reset import reset
from shared.messages.base import Message, Tick
from shared.messages.explanation import explain
from shared.messages.gnss import GnssConfiguration, GnssConfigure, GnssReceiver, GnssReset, GnssStart
from shared.messages.navigation import NavigationState
from shared.messages.operation import CommandStage, ModeAnswer, ModeCommand, ModeState, OperatorCommand
from tests.unit.controller.mode.test_mode import at, fix, imu, solution, state

ACCEPTED, DONE, FAILED = CommandStage.ACCEPTED, CommandStage.DONE, CommandStage.FAILED


def unit() -> Process:
    return Process(Config(configure_gnss=False))


def run(process: Process, messages: Iterable[Message]) -> list[Message]:
    return [out for message in messages for out in process.handle(message)]


def command(kind: OperatorCommand, source: str | None = None, period_s: float | None = None) -> ModeCommand:
    return ModeCommand(request_id="r1", command=kind, source=source, navigation_period_s=period_s)


def answers(out: Iterable[Message]) -> list[tuple[CommandStage, str]]:
    return [(message.stage, message.reason) for message in out if isinstance(message, ModeAnswer)]


def test_a_cold_start_is_done_with_the_next_position_and_its_time_is_published() -> None:
    process = unit()
    run(process, [fix(0.0), Tick(now_ns=at(0.5))])
    out = run(process, [command(OperatorCommand.COLD_START)])
    assert [(message.source, message.start) for message in out if isinstance(message, GnssReset)] == [
        ("gnss0", GnssStart.COLD)
    ]
    assert answers(out) == [(ACCEPTED, "")]
    searching = run(process, [fix(1.0), *(fix(k, good=False) for k in range(2, 30)), Tick(now_ns=at(29.5))])
    assert answers(searching) == []
    assert [message.time_to_first_fix_s for message in searching if isinstance(message, ModeState)][-1] is None
    found = run(process, [fix(31.0), Tick(now_ns=at(31.5))])
    assert answers(found) == [(DONE, "position after 30 s")]
    assert [message.time_to_first_fix_s for message in found if isinstance(message, ModeState)][-1] == pytest.approx(
        30.5
    )


def held(second: float, **fields: object) -> NavigationState:
    return state(second).model_copy(update=fields)


def test_a_confirmed_position_is_done_when_the_level_holds_nothing_any_more() -> None:
    process, why = unit(), explain("fusion.held_step", horizontal_m=30.0, vertical_m=0.0)
    run(process, [held(0.0, held_code=why)])
    out = run(process, [command(OperatorCommand.CONFIRM_POSITION), held(1.0, held_code=why), held(2.0)])
    assert answers(out) == [(ACCEPTED, ""), (DONE, "the level holds no offset")]


def test_a_position_cannot_be_confirmed_while_gnss_contradicts_other_sensors() -> None:
    process = unit()
    run(process, [held(0.0)])
    out = run(process, [command(OperatorCommand.CONFIRM_POSITION), held(1.0, conflict_since_ns=at(0.0))])
    assert answers(out)[-1][0] is FAILED


def test_a_receiver_that_goes_on_did_not_restart() -> None:
    process = unit()
    run(process, [fix(0.0)])
    out = run(process, [command(OperatorCommand.WARM_START), *(fix(k) for k in range(1, 15))])
    assert answers(out)[-1] == (FAILED, "gnss0 did not restart: it goes on with its position")


def test_without_a_sky_a_cold_start_fails_after_five_minutes() -> None:
    process = unit()
    run(process, [fix(0.0)])
    out = run(process, [command(OperatorCommand.COLD_START), *(fix(k, good=False) for k in range(1, 310))])
    (_, (stage, why)) = answers(out)
    assert stage is FAILED and "give its antenna a view of the sky" in why


@pytest.mark.parametrize(
    ("asked", "why"),
    [
        (command(OperatorCommand.COLD_START), "no receiver is received"),
        (command(OperatorCommand.COLD_START, "gnss7"), "no receiver gnss7 is received"),
        (command(OperatorCommand.NAVIGATION_RATE), "name the period"),
        (command(OperatorCommand.SELECT_SOURCE, "imu9"), "no device imu9 is received; received are: imu0"),
    ],
)
def test_what_cannot_be_done_is_refused_with_the_reason(asked: ModeCommand, why: str) -> None:
    process = unit()
    ((stage, reason),) = answers(run(process, [imu(0.0), asked]))
    assert stage is FAILED and reason.startswith(why)


def test_a_receiver_without_ubx_takes_no_reset() -> None:
    process = unit()
    said = GnssReceiver(received_ns=at(0.2), source="gnss0", messages=("NMEA GGA",), received_bytes=700, other_bytes=0)
    run(process, [fix(0.0, source="gnss0/nmea"), said])
    ((stage, why),) = answers(run(process, [command(OperatorCommand.COLD_START)]))
    assert stage is FAILED and "switch it off and on" in why


def test_another_rate_is_done_when_the_receiver_confirms_it() -> None:
    process = unit()
    run(process, [fix(0.0)])
    out = run(process, [command(OperatorCommand.NAVIGATION_RATE, period_s=0.2)])
    (wanted,) = [message for message in out if isinstance(message, GnssConfigure)]
    assert wanted.navigation_period_s == 0.2
    confirmed = GnssConfiguration(request_id=wanted.request_id, source="gnss0", accepted=True)
    assert answers(run(process, [confirmed])) == [(DONE, "")]


def test_a_device_that_the_operator_wants_is_used_and_given_up_by_a_command_without_a_name() -> None:
    process = unit()
    run(process, [imu(0.0), imu(0.1, "imu1"), Tick(now_ns=at(0.2))])
    out = run(process, [command(OperatorCommand.SELECT_SOURCE, "imu1"), Tick(now_ns=at(0.3))])
    assert answers(out) == [(ACCEPTED, ""), (DONE, "")]
    assert [message.imu_source for message in out if isinstance(message, ModeState)][-1] == "imu1"
    assert answers(run(process, [command(OperatorCommand.SELECT_SOURCE)])) == [(ACCEPTED, ""), (DONE, "")]


def test_calibration_at_rest_needs_ten_seconds_of_standstill() -> None:
    process = unit()
    sd = {"gyroscope_bias_sd_rad_s": (1e-4, 1e-4, 2e-4)}
    moving = [solution(float(k)).model_copy(update=sd) for k in range(5)]
    standing = [solution(5.0 + k, stationary=True).model_copy(update=sd) for k in range(12)]
    out = run(process, [*moving[:1], command(OperatorCommand.CALIBRATE_AT_REST), *moving[1:], *standing])
    assert answers(out) == [(ACCEPTED, ""), (DONE, "gyroscope biases known to 0.011 degrees a second")]
    late = unit()
    driving = [solution(float(k)) for k in range(70)]
    out = run(late, [*driving[:1], command(OperatorCommand.CALIBRATE_AT_REST), *driving[1:]])
    assert answers(out)[-1][0] is FAILED


def test_resets_are_the_frames_of_the_interface_description() -> None:
    """Bytes of UBX-CFG-RST for a cold start of GNSS alone, with the checksum by hand (8-bit Fletcher)."""
    assert reset(GnssStart.COLD) == bytes.fromhex("b5620604" + "0400" + "ffff0200" + "0e61")
    assert reset(GnssStart.WARM)[6:10] == bytes.fromhex("01000200")

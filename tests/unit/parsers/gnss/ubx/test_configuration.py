import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyubx2.ubxmessage import UBXMessage
from pyubx2.ubxtypes_core import UBX_MSGIDS

from services.controller.mode.process import Config as Controller
from services.parsers.gnss.process import Config, Process
from services.parsers.gnss.ubx.configuration import protocol_version, read_version
from services.parsers.gnss.ubx.outputs import (
    BY_IMPORTANCE,
    EPOCH_BYTES,
    MESSAGES,
    REQUIRED,
    STEADY_BYTES_S,
    load_bytes_s,
    messages_of,
    plan_outputs,
)
from services.parsers.gnss.ubx.valset import read_values
from services.sensors.simulator.gnss.ubx_encoder import mon_ver
from shared.maths.crc import fletcher
from shared.messages.base import Message, Tick
from shared.messages.gnss import GnssConfiguration, GnssConfigure, GnssOutput, GnssRaw, GnssReceiver, GnssWrite
from shared.messages.operation import DeviceFound, DeviceState
from shared.protocols.ubx import SYNC
from tests.support.cases import each
from tests.support.gnss.generation8 import Generation8, acknowledge, parse_ubx_command
from tests.support.gnss.generation9 import Generation9
from tests.support.gnss.ublox import valset

NS = 1_000_000_000
REQUEST = GnssConfigure(
    request_id=7, source="gnss0", navigation_period_s=0.2, outputs=(GnssOutput.COVARIANCE, GnssOutput.DILUTION)
)
GRANTED = {
    "CFG_RATE_MEAS": 200, "CFG_RATE_NAV": 1,
    "CFG_MSGOUT_UBX_NAV_DOP_UART1": 1, "CFG_MSGOUT_UBX_NAV_DOP_USB": 1,
    "CFG_MSGOUT_UBX_NAV_COV_UART1": 1, "CFG_MSGOUT_UBX_NAV_COV_USB": 1,
}  # fmt: skip


def send_request(process: Process, request: GnssConfigure = REQUEST) -> list[Message]:
    """Ask a receiver of generation 9, which has answered what it is."""
    first = list(process.handle(request))
    return [*first, *feed(process, mon_ver())]


def feed(process: Process, data: bytes) -> list[Message]:
    return list(process.handle(GnssRaw(received_ns=NS, source="gnss0", data=data)))


def tick(process: Process, second: int) -> list[Message]:
    return [item for item in process.handle(Tick(now_ns=second * NS)) if not isinstance(item, GnssReceiver)]


def values(**changes: int) -> bytes:
    """The response to UBX-CFG-VALGET, encoded by pyubx2: its payload is that of VALSET with another first byte."""
    payload = bytes(UBXMessage.config_set(0, 0, list({**GRANTED, **changes}.items())).payload)
    return bytes(UBXMessage("CFG", "CFG-VALGET", 0, payload=b"\x01" + payload[1:]).serialize())


def read_back(**given: int) -> bytes:
    payload = bytes(UBXMessage.config_set(0, 0, list(given.items())).payload)
    return bytes(UBXMessage("CFG", "CFG-VALGET", 0, payload=b"\x01" + payload[1:]).serialize())


def result_of(messages: list[Message]) -> GnssConfiguration:
    (message,) = messages
    assert isinstance(message, GnssConfiguration)
    return message


# Keys of CFG-RATE-MEAS, CFG-RATE-NAV and CFG-MSGOUT of NAV-COV and NAV-DOP at UART1 and USB, interface description 6.9
KEYS = (0x30210001, 0x30210002, 0x20910084, 0x20910086, 0x20910039, 0x2091003B)


def command(message_id: int, payload: bytes) -> bytes:
    body = struct.pack("<BBH", 6, message_id, len(payload)) + payload
    return SYNC + body + fletcher(body)


def test_a_request_is_encoded_as_valset_and_valget_of_the_interface_description() -> None:
    version, reading, setting, poll = send_request(Process(Config()))
    assert isinstance(version, GnssWrite)
    assert isinstance(reading, GnssWrite)
    assert version.data == SYNC + bytes((0x0A, 0x04, 0, 0)) + fletcher(bytes((0x0A, 0x04, 0, 0)))
    assert reading.data == command(0x8B, bytes(4) + struct.pack("<2I", 0x201100A4, 0x20110021))
    assert isinstance(setting, GnssWrite)
    assert isinstance(poll, GnssWrite)
    items = struct.pack(
        "<" + 2 * "IH" + 4 * "IB", *(x for pair in zip(KEYS, (200, 1, 1, 1, 1, 1), strict=True) for x in pair)
    )
    assert setting.data == command(0x8A, bytes((0, 1, 0, 0)) + items)  # layer 1: RAM
    assert poll.data == command(0x8B, bytes(4) + struct.pack("<6I", *KEYS))
    assert (setting.source, poll.source) == ("gnss0", "gnss0")


def test_the_values_read_back_are_reported() -> None:
    process = Process(Config())
    send_request(process)
    assert not feed(process, acknowledge(0x8A))
    result = result_of(feed(process, values() + acknowledge(0x8B)))
    assert (result.request_id, result.accepted, result.reason) == (7, True, None)
    assert (result.navigation_period_s, result.messages) == (0.2, ("UBX NAV-COV", "UBX NAV-DOP"))


def test_a_message_enabled_on_one_port_is_accepted() -> None:
    process = Process(Config())
    send_request(process)
    assert result_of(feed(process, values(CFG_MSGOUT_UBX_NAV_COV_UART1=0))).accepted


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"CFG_RATE_MEAS": 1000}, "period is 1.0 s, not 0.2 s"),
        ({"CFG_RATE_NAV": 5}, "period is 1.0 s, not 0.2 s"),
        ({"CFG_MSGOUT_UBX_NAV_COV_UART1": 0, "CFG_MSGOUT_UBX_NAV_COV_USB": 0}, "does not send NAV-COV"),
    ],
)
def test_a_value_that_differs_when_read_back_is_not_accepted(changes: dict[str, int], reason: str) -> None:
    process = Process(Config())
    send_request(process)
    result = result_of(feed(process, values(**changes)))
    assert not result.accepted
    assert reason in (result.reason or "")


def test_a_setting_that_is_refused_is_reported_with_the_current_values() -> None:
    result = configure(Generation9(shortest_ms=200), REQUEST.model_copy(update={"navigation_period_s": 0.1}))
    assert not result.accepted
    assert "navigation period is 1.0 s, not 0.1 s" in (result.reason or "")
    assert result.navigation_period_s == 1.0
    assert result.messages == ("UBX NAV-COV", "UBX NAV-DOP")


def test_a_request_without_a_response_ends_after_3_s() -> None:
    process = Process(Config())
    send_request(process)
    assert [tick(process, k) for k in range(2)] == [[], []]
    result = result_of(tick(process, 3))
    assert "check that its RX line is connected" in (result.reason or "")
    assert not feed(process, values())  # a response after the timeout


def test_a_receiver_that_does_not_say_what_it_is_has_ubx_switched_on_and_is_given_up_after_3_s() -> None:
    process = Process(Config())
    (first,) = process.handle(REQUEST)
    assert isinstance(first, GnssWrite)
    for k in range(2):
        *switched, again = (
            gnss_write.data for gnss_write in process.handle(Tick(now_ns=k * NS)) if isinstance(gnss_write, GnssWrite)
        )
        assert again == first.data
        assert [parse_ubx_command(payload).identity for payload in switched] == ["CFG-VALSET", "CFG-VALSET", "CFG-PRT"]
        assert parse_ubx_command(switched[2]).portID == 3  # of USB: a serial port needs its rate
    result = result_of(list(process.handle(Tick(now_ns=3 * NS))))
    assert "check that its RX line is connected" in (result.reason or "")


def port_at(rate_baud: int | None) -> DeviceState:
    return DeviceState(
        sampled_ns=NS, source="gnss0", process="sensors.gnss", device="serial:///dev/ttyS0", found=DeviceFound.WORKING,
        rate_baud=rate_baud,
    )  # fmt: skip


def test_the_rate_of_a_serial_port_stays_where_ubx_is_switched_on() -> None:
    process = Process(Config())
    assert not list(process.handle(port_at(9600)))
    list(process.handle(REQUEST))
    writes = [
        parse_ubx_command(gnss_write.data)
        for gnss_write in process.handle(Tick(now_ns=NS))
        if isinstance(gnss_write, GnssWrite)
    ]
    (port,) = [write for write in writes if write.identity == "CFG-PRT" and write.portID == 1]
    assert (port.baudRate, port.outUBX, port.outNMEA, port.inUBX, port.inRTCM3) == (9600, 1, 1, 1, 1)
    assert (port.charLen, port.parity, port.nStopBits) == (3, 4, 0)  # 8 bits, no parity, 1 stop bit


@pytest.mark.parametrize(
    ("change", "reason"),
    [({"navigation_period_s": 0.001}, "outside 0.025 to 65.535 s")],
)  # fmt: skip
def test_an_invalid_request_is_rejected_at_once(change: dict[str, object], reason: str) -> None:
    _, *said = send_request(Process(Config()), REQUEST.model_copy(update=change))
    result = result_of(said)
    assert not result.accepted
    assert reason in (result.reason or "")


def test_unsolicited_responses_are_ignored() -> None:
    assert not feed(Process(Config()), acknowledge(0x8A) + values() + acknowledge(0x8B, good=False))


def test_values_of_every_size_are_decoded() -> None:
    items: list[tuple[int | str, object]] = [
        ("CFG_RATE_MEAS", 500),
        ("CFG_UART1_BAUDRATE", 115200),
        ("CFG_SIGNAL_GPS_ENA", 1),
    ]
    payload = bytes(UBXMessage.config_set(0, 0, items).payload)
    assert list(read_values(payload).values()) == [500, 115200, 1]


WITH_RAW = REQUEST.model_copy(
    update={"outputs": (*REQUEST.outputs, GnssOutput.RAW_MEASUREMENTS, GnssOutput.NAVIGATION_BITS)}
)
OPTIONAL = {
    "CFG_MSGOUT_UBX_RXM_RAWX_UART1": 5, "CFG_MSGOUT_UBX_RXM_RAWX_USB": 5,
    "CFG_MSGOUT_UBX_RXM_SFRBX_UART1": 1, "CFG_MSGOUT_UBX_RXM_SFRBX_USB": 1,
}  # fmt: skip


def optional_values(*kept: str) -> bytes:
    """Responses to the polls of optional messages, one each."""
    answers = b""
    for name in kept:
        pair = [(key, value) for key, value in OPTIONAL.items() if name.replace("-", "_") in key]
        payload = valset(pair)[6:-2]
        answers += UBXMessage("CFG", "CFG-VALGET", 0, payload=b"\x01" + payload[1:]).serialize() + acknowledge(0x8B)
    return answers


def test_each_optional_message_is_asked_for_apart_and_measurements_once_a_second() -> None:
    writes = [message.data for message in send_request(Process(Config()), WITH_RAW) if isinstance(message, GnssWrite)]
    pairs = list(OPTIONAL.items())
    plain = [message.data for message in send_request(Process(Config())) if isinstance(message, GnssWrite)]
    assert writes[2] == valset(pairs[:2])
    assert writes[4] == valset(pairs[2:])
    assert writes[:2] + writes[6:] == plain
    assert len(writes) == 8


def test_granted_optional_messages_are_reported_with_the_others() -> None:
    process = Process(Config())
    send_request(process, WITH_RAW)
    assert not feed(process, acknowledge(0x8A) + optional_values("RXM-RAWX", "RXM-SFRBX") + acknowledge(0x8A))
    result = result_of(feed(process, values()))
    assert result.accepted
    assert result.messages == ("UBX NAV-COV", "UBX NAV-DOP", "UBX RXM-RAWX", "UBX RXM-SFRBX")


def test_an_unsupported_optional_message_does_not_prevent_the_other() -> None:
    process = Process(Config())
    send_request(process, WITH_RAW)
    refused = acknowledge(0x8A, good=False) + acknowledge(0x8B, good=False)
    assert not feed(process, refused + acknowledge(0x8A) + optional_values("RXM-SFRBX") + acknowledge(0x8A))
    said = feed(process, values())
    while not isinstance(said[-1], GnssConfiguration):  # asked for at each port apart
        said = feed(process, refused)
    result = result_of(said)
    assert (result.accepted, result.messages) == (True, ("UBX NAV-COV", "UBX NAV-DOP", "UBX RXM-SFRBX"))


def test_answers_that_are_lost_end_the_second_pass_too() -> None:
    process = Process(Config())
    send_request(process, WITH_RAW)
    refused = acknowledge(0x8A, good=False) + acknowledge(0x8B, good=False)
    assert feed(process, refused * 3)  # parts of what was refused
    said = [
        message
        for second in range(1, 20)
        for message in tick(process, second)
        if isinstance(message, GnssConfiguration)
    ]
    assert "check that its RX line is connected" in (result_of([*said]).reason or "")


@pytest.mark.parametrize("lacks", [("RXM_RAWX", "RXM_SFRBX"), ("RXM",), ("RXM_RAWX", "_USB"), ("_UART1", "RXM")])
def test_with_rejected_optional_messages_the_others_are_kept(lacks: tuple[str, ...]) -> None:
    result = configure(Generation9(*lacks), WITH_RAW)
    kept = [
        name for name in ("RXM-RAWX", "RXM-SFRBX") if not any(word in f"{name}".replace("-", "_") for word in lacks)
    ]
    assert (result.accepted, result.reason) == (True, None)
    assert result.messages == ("UBX NAV-COV", "UBX NAV-DOP", *(f"UBX {name}" for name in kept))


@pytest.mark.parametrize(
    ("lacks", "port"), [(("_USB",), "UART1"), (("_UART1",), "USB"), (("_USB", "NAV_EOE"), "UART1")]
)
def test_a_receiver_without_the_keys_of_a_port_is_configured_at_the_other_one(
    lacks: tuple[str, ...], port: str
) -> None:
    receiver = Generation9(*lacks)
    result = configure(receiver, FULL.model_copy(update={"outputs": CONTROLLED}))
    assert (result.accepted, result.reason, result.navigation_period_s) == (True, None, 0.2)
    assert receiver.every("NAV-PVT", port) == 1 and receiver.every("RXM-RAWX", port) == 5
    assert ("UBX NAV-EOE" in result.messages) is ("NAV_EOE" not in lacks)


def test_a_receiver_that_lacks_the_fix_is_not_accepted() -> None:
    result = configure(Generation9("NAV_PVT"), FULL)
    assert not result.accepted
    assert "has refused, so that it does not send NAV-PVT" in (result.reason or "")


CONTROLLED = Controller().gnss_outputs


@each("period_s", [1.0, 0.2, 0.1, 0.04])
@each("rate_baud", [4800, 9600, 19200, 38400, 57600, 115200, 460800])
def test_no_more_is_asked_for_than_the_port_carries(rate_baud: int, period_s: float) -> None:
    """The fix is always asked for; what is left out, and at which rate it would not be, is said."""
    wanted = FULL.model_copy(update={"outputs": CONTROLLED, "navigation_period_s": period_s})
    receiver = Generation9()
    result = configure(receiver, wanted, rate_baud=rate_baud)
    every = {name: receiver.every(name) or 0 for name in messages_of(CONTROLLED)}
    assert load_bytes_s(every, receiver.period_ms / 1000) <= rate_baud / 10
    assert every["NAV-PVT"] == 1 and {name for name, count in every.items() if count} == {
        name.removeprefix("UBX ") for name in result.messages
    }
    full = plan_outputs(wanted, None).every
    whole = all(count == every[name] for name, count in full.items() if receiver.every(name) is not None)
    whole = whole and result.navigation_period_s == period_s
    assert whole is (result.reason is None)
    assert whole or (result.reason or "").startswith(f"{rate_baud} baud carry")
    assert result.accepted is (result.navigation_period_s == pytest.approx(period_s))


def test_an_older_receiver_is_asked_for_no_more_than_the_port_carries() -> None:
    receiver = Generation8()
    result = configure(receiver, FULL, rate_baud=9600)
    every = {name: count for name, count in receiver.rates.items() if count}
    assert load_bytes_s(every, receiver.period_ms / 1000) <= 960 and every["NAV-PVT"] == 1
    assert (result.accepted, receiver.rates["RXM-RAWX"]) == (True, 0)
    assert "9600 baud carry 1.0 kB/s; without " in (result.reason or "")
    assert "NAV-DOP, NAV-COV once a second" in (result.reason or "")


def test_every_message_has_a_size_and_an_importance() -> None:
    assert EPOCH_BYTES.keys() | STEADY_BYTES_S.keys() == set(messages_of(GnssOutput))
    assert set(BY_IMPORTANCE) == set(messages_of(GnssOutput)) - set(MESSAGES[GnssOutput.FIX])


def test_version_elevation_mask_and_dynamic_model_are_reported_as_read_back() -> None:
    process = Process(Config())
    send_request(process)
    assert not feed(process, read_back(CFG_NAVSPG_INFIL_MINELEV=10, CFG_NAVSPG_DYNMODEL=4))
    result = result_of(feed(process, acknowledge(0x8B) + acknowledge(0x8A) + values()))
    assert (result.accepted, result.model, result.firmware) == (True, "ZED-F9P", "HPG 1.32")
    assert result.dynamic_model == "automotive"
    assert result.elevation_mask_rad == pytest.approx(math.radians(10))


@pytest.mark.parametrize("refused", [b"", acknowledge(0x8B, good=False)])
def test_a_receiver_that_states_neither_is_configured_as_well(refused: bytes) -> None:
    process = Process(Config())
    send_request(process)
    result = result_of(feed(process, refused + acknowledge(0x8A) + values()))
    assert result.accepted
    assert (result.dynamic_model, result.elevation_mask_rad) == (None, None)


@given(st.binary(max_size=200))
def test_any_version_is_decoded_without_error(payload: bytes) -> None:
    assert all(len(text) <= 30 for text in read_version(payload).values())


@given(st.binary(max_size=80))
def test_any_response_is_decoded_without_error(payload: bytes) -> None:
    process = Process(Config())
    send_request(process)
    read_values(payload)
    body = bytes((6, 0x8B)) + len(payload).to_bytes(2, "little") + payload
    feed(process, SYNC + body + fletcher(body))


def configure(
    receiver: Generation8 | Generation9, request: GnssConfigure, *, rate_baud: int | None = None
) -> GnssConfiguration:
    """Let the parser and a receiver talk until there is a result; seconds pass when both are silent."""
    process = Process(Config())
    list(process.handle(port_at(rate_baud)))
    said: list[Message] = list(process.handle(request))
    now_ns = NS
    for _ in range(200):
        if results := [message for message in said if isinstance(message, GnssConfiguration)]:
            return results[0]
        answers = b"".join(receiver.answer(message.data) for message in said if isinstance(message, GnssWrite))
        if answers:
            said = feed(process, answers)
        else:
            now_ns += NS
            said = list(process.handle(Tick(now_ns=now_ns)))
    pytest.fail("no result")


FULL = GnssConfigure(
    request_id=8, source="gnss0", navigation_period_s=0.2, outputs=tuple(MESSAGES), dynamic_model="automotive"
)


@pytest.mark.parametrize("protver", ["PROTVER=18.00", "PROTVER 15.00", "PROTVER=23.01"])
def test_a_receiver_before_generation_9_is_configured_message_by_message(protver: str) -> None:
    receiver = Generation8(protver=protver)
    result = configure(receiver, FULL)
    assert (result.accepted, result.reason, result.navigation_period_s) == (True, None, 0.2)
    assert (result.model, result.dynamic_model) == ("NEO-M8N-0", "automotive")
    assert result.elevation_mask_rad == pytest.approx(math.radians(5))
    assert (receiver.period_ms, receiver.model) == (200, 4)
    assert receiver.rates["NAV-PVT"] == 1
    assert receiver.rates["RXM-RAWX"] == 5  # once a second
    assert {f"UBX {name}" for name in receiver.rates} == set(result.messages)
    assert all(command.identity != "CFG-CFG" for command in receiver.commands)  # nothing is saved in the receiver


def test_what_an_older_receiver_refuses_does_not_prevent_the_rest() -> None:
    result = configure(Generation8(refuses=("NAV-COV", "RXM-RAWX", "NAV-EOE", "CFG-NAV5")), FULL)
    assert result.accepted
    assert "UBX NAV-PVT" in result.messages
    assert "UBX NAV-COV" not in result.messages


def test_a_receiver_without_nav_pvt_is_asked_for_what_tells_the_same() -> None:
    receiver = Generation8(protver="", refuses=("NAV-PVT", "NAV-EOE", "NAV-COV"))
    result = configure(receiver, FULL)
    assert result.accepted
    assert receiver.rates.keys() >= {"NAV-POSLLH", "NAV-SOL", "NAV-VELNED", "NAV-TIMEUTC"}


@pytest.mark.parametrize(
    ("receiver", "reason"),
    [
        (Generation8(refuses=("CFG-RATE",)), "rejected UBX-CFG-RATE"),
        (Generation8(refuses=("NAV-PVT", "NAV-SOL")), "neither NAV-PVT nor NAV-POSLLH and NAV-SOL"),
        (Generation8(mute=True), "check that its RX line is connected"),
    ],
)
def test_an_older_receiver_that_cannot_is_named(receiver: Generation8, reason: str) -> None:
    result = configure(receiver, FULL)
    assert not result.accepted
    assert reason in (result.reason or "")


def test_every_output_has_messages_that_u_blox_has() -> None:
    assert set(MESSAGES) == set(GnssOutput)
    assert set(messages_of(GnssOutput)) <= set(UBX_MSGIDS.values())
    assert set(messages_of(GnssOutput)) >= REQUIRED


@pytest.mark.parametrize(("version", "number"), [({"PROTVER": "27.31"}, 27.31), ({"PROTVER": "x"}, 0.0), ({}, 0.0)])
def test_the_protocol_version_is_read(version: dict[str, str], number: float) -> None:
    assert protocol_version(version) == number

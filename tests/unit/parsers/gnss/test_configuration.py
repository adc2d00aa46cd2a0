import math
import re
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyubx2.ubxmessage import UBXMessage
from pyubx2.ubxtypes_configdb import UBX_CONFIG_DATABASE

from services.parsers.gnss.configuration import read_values, read_version
from services.parsers.gnss.framer import UBX_SYNC, ubx_checksum
from services.parsers.gnss.process import Config, Process
from services.sensors.simulator.gnss.ubx_encoder import mon_ver
from shared.messages.base import Message, Tick
from shared.messages.gnss import GnssConfiguration, GnssConfigure, GnssRaw, GnssWrite
from tests.support.gnss.ublox import valset

NS = 1_000_000_000
REQUEST = GnssConfigure(request_id=7, source="gnss0", navigation_period_s=0.2, messages=("NAV-PVT", "NAV-COV"))
GRANTED = {
    "CFG_RATE_MEAS": 200, "CFG_RATE_NAV": 1,
    "CFG_MSGOUT_UBX_NAV_PVT_UART1": 1, "CFG_MSGOUT_UBX_NAV_PVT_USB": 1,
    "CFG_MSGOUT_UBX_NAV_COV_UART1": 1, "CFG_MSGOUT_UBX_NAV_COV_USB": 1,
}  # fmt: skip
MANY = sorted(key[19:-4] for key in UBX_CONFIG_DATABASE if re.fullmatch("CFG_MSGOUT_UBX_NAV_[A-Z]+_USB", key))


def send_request(process: Process, request: GnssConfigure = REQUEST) -> list[Message]:
    return list(process.handle(request))


def feed(process: Process, data: bytes) -> list[Message]:
    return list(process.handle(GnssRaw(received_ns=NS, source="gnss0", data=data)))


def acknowledge(message_id: int, *, good: bool = True) -> bytes:
    name = "ACK-ACK" if good else "ACK-NAK"
    return bytes(UBXMessage("ACK", name, 0, clsID=6, msgID=message_id).serialize())


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


# Keys of CFG-RATE-MEAS, CFG-RATE-NAV and CFG-MSGOUT of NAV-PVT and NAV-COV at UART1 and USB, interface description 6.9
KEYS = (0x30210001, 0x30210002, 0x20910007, 0x20910009, 0x20910084, 0x20910086)


def command(message_id: int, payload: bytes) -> bytes:
    body = struct.pack("<BBH", 6, message_id, len(payload)) + payload
    return UBX_SYNC + body + ubx_checksum(body)


def test_a_request_is_encoded_as_valset_and_valget_of_the_interface_description() -> None:
    version, reading, setting, poll = send_request(Process(Config()))
    assert isinstance(version, GnssWrite)
    assert isinstance(reading, GnssWrite)
    assert version.data == UBX_SYNC + bytes((0x0A, 0x04, 0, 0)) + ubx_checksum(bytes((0x0A, 0x04, 0, 0)))
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
    assert (result.navigation_period_s, result.messages) == (0.2, ("NAV-PVT", "NAV-COV"))


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


def test_a_rejected_valset_is_reported_with_the_current_values() -> None:
    process = Process(Config())
    send_request(process)
    feed(process, acknowledge(0x8A, good=False))
    result = result_of(feed(process, values(CFG_RATE_MEAS=1000)))
    assert not result.accepted
    assert "rejected UBX-CFG-VALSET" in (result.reason or "")
    assert result.navigation_period_s == 1.0


def test_a_rejected_valget_is_reported_as_an_unsupported_receiver() -> None:
    process = Process(Config())
    send_request(process)
    result = result_of(feed(process, acknowledge(0x8A, good=False) + acknowledge(0x8B, good=False)))
    assert "older than generation 9" in (result.reason or "")


def test_a_request_without_a_response_ends_after_3_s() -> None:
    process = Process(Config())
    send_request(process)
    assert [list(process.handle(Tick(now_ns=k * NS))) for k in range(2)] == [[], []]
    result = result_of(list(process.handle(Tick(now_ns=3 * NS))))
    assert "check that its RX line is connected" in (result.reason or "")
    assert not feed(process, values())  # a response after the timeout


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"messages": ("NAV-PTV",)}, "did you mean NAV-PVT?"),
        ({"navigation_period_s": 0.001}, "outside 0.025 to 65.535 s"),
        ({"messages": tuple(f"NAV-{name}" for name in MANY)}, "too many"),
    ],
)  # fmt: skip
def test_an_invalid_request_is_rejected_at_once(change: dict[str, object], reason: str) -> None:
    result = result_of(send_request(Process(Config()), REQUEST.model_copy(update=change)))
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


WITH_RAW = REQUEST.model_copy(update={"optional_messages": ("RXM-RAWX", "RXM-SFRBX")})
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
    writes = [one.data for one in send_request(Process(Config()), WITH_RAW) if isinstance(one, GnssWrite)]
    pairs = list(OPTIONAL.items())
    plain = [one.data for one in send_request(Process(Config())) if isinstance(one, GnssWrite)]
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
    assert result.messages == ("NAV-PVT", "NAV-COV", "RXM-RAWX", "RXM-SFRBX")


def test_an_unsupported_optional_message_does_not_prevent_the_other() -> None:
    process = Process(Config())
    send_request(process, WITH_RAW)
    refused = acknowledge(0x8A, good=False) + acknowledge(0x8B, good=False)
    assert not feed(process, refused + acknowledge(0x8A) + optional_values("RXM-SFRBX") + acknowledge(0x8A))
    result = result_of(feed(process, values()))
    assert (result.accepted, result.messages) == (True, ("NAV-PVT", "NAV-COV", "RXM-SFRBX"))


@pytest.mark.parametrize("refusals", [(0x8A, 0x8B) * 2, (0x8A,), (0x8B,), ()])
def test_with_rejected_optional_messages_the_others_are_kept(refusals: tuple[int, ...]) -> None:
    process = Process(Config())
    send_request(process, WITH_RAW)
    assert not feed(process, b"".join(acknowledge(one, good=False) for one in refusals))
    result = result_of(feed(process, acknowledge(0x8A) + values() + acknowledge(0x8B)))
    assert (result.accepted, result.reason, result.messages) == (True, None, ("NAV-PVT", "NAV-COV"))


def test_version_elevation_mask_and_dynamic_model_are_reported_as_read_back() -> None:
    process = Process(Config())
    send_request(process)
    assert not feed(process, mon_ver() + read_back(CFG_NAVSPG_INFIL_MINELEV=10, CFG_NAVSPG_DYNMODEL=4))
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
    assert (result.model, result.firmware, result.dynamic_model, result.elevation_mask_rad) == (None, None, None, None)


@given(st.binary(max_size=200))
def test_any_version_is_decoded_without_error(payload: bytes) -> None:
    assert all(len(text) <= 30 for text in read_version(payload).values())


@given(st.binary(max_size=80))
def test_any_response_is_decoded_without_error(payload: bytes) -> None:
    process = Process(Config())
    send_request(process)
    read_values(payload)
    body = bytes((6, 0x8B)) + len(payload).to_bytes(2, "little") + payload
    feed(process, UBX_SYNC + body + ubx_checksum(body))

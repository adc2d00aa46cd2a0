import re
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyubx2.ubxmessage import UBXMessage
from pyubx2.ubxtypes_configdb import UBX_CONFIG_DATABASE

from services.parsers.gnss.configuration import read_values
from services.parsers.gnss.framer import UBX_SYNC, ubx_checksum
from services.parsers.gnss.process import Config, Process
from shared.messages.base import Message, Tick
from shared.messages.gnss import GnssConfiguration, GnssConfigure, GnssRaw, GnssWrite

NS = 1_000_000_000
ASKED = GnssConfigure(request_id=7, source="gnss0", navigation_period_s=0.2, messages=("NAV-PVT", "NAV-COV"))
GRANTED = {
    "CFG_RATE_MEAS": 200, "CFG_RATE_NAV": 1,
    "CFG_MSGOUT_UBX_NAV_PVT_UART1": 1, "CFG_MSGOUT_UBX_NAV_PVT_USB": 1,
    "CFG_MSGOUT_UBX_NAV_COV_UART1": 1, "CFG_MSGOUT_UBX_NAV_COV_USB": 1,
}  # fmt: skip
MANY = sorted(key[19:-4] for key in UBX_CONFIG_DATABASE if re.fullmatch("CFG_MSGOUT_UBX_NAV_[A-Z]+_USB", key))


def ask(process: Process, request: GnssConfigure = ASKED) -> list[Message]:
    return list(process.handle(request))


def say(process: Process, data: bytes) -> list[Message]:
    return list(process.handle(GnssRaw(received_ns=NS, source="gnss0", data=data)))


def acknowledge(message_id: int, *, good: bool = True) -> bytes:
    name = "ACK-ACK" if good else "ACK-NAK"
    return bytes(UBXMessage("ACK", name, 0, clsID=6, msgID=message_id).serialize())


def values(**changes: int) -> bytes:
    """The answer to UBX-CFG-VALGET, encoded by pyubx2: its payload is that of VALSET with another first byte."""
    payload = bytes(UBXMessage.config_set(0, 0, list({**GRANTED, **changes}.items())).payload)
    return bytes(UBXMessage("CFG", "CFG-VALGET", 0, payload=b"\x01" + payload[1:]).serialize())


def answer(messages: list[Message]) -> GnssConfiguration:
    (message,) = messages
    assert isinstance(message, GnssConfiguration)
    return message


# Keys of CFG-RATE-MEAS, CFG-RATE-NAV and CFG-MSGOUT of NAV-PVT and NAV-COV at UART1 and USB, interface description 6.9
KEYS = (0x30210001, 0x30210002, 0x20910007, 0x20910009, 0x20910084, 0x20910086)


def command(message_id: int, payload: bytes) -> bytes:
    body = struct.pack("<BBH", 6, message_id, len(payload)) + payload
    return UBX_SYNC + body + ubx_checksum(body)


def test_a_request_becomes_valset_and_a_poll_as_the_interface_description_has_them() -> None:
    setting, poll = ask(Process(Config()))
    assert isinstance(setting, GnssWrite)
    assert isinstance(poll, GnssWrite)
    items = struct.pack(
        "<" + 2 * "IH" + 4 * "IB", *(x for pair in zip(KEYS, (200, 1, 1, 1, 1, 1), strict=True) for x in pair)
    )
    assert setting.data == command(0x8A, bytes((0, 1, 0, 0)) + items)  # layer 1: RAM
    assert poll.data == command(0x8B, bytes(4) + struct.pack("<6I", *KEYS))
    assert (setting.source, poll.source) == ("gnss0", "gnss0")


def test_what_was_read_back_is_what_is_reported() -> None:
    process = Process(Config())
    ask(process)
    assert not say(process, acknowledge(0x8A))
    result = answer(say(process, values() + acknowledge(0x8B)))
    assert (result.request_id, result.accepted, result.reason) == (7, True, None)
    assert (result.navigation_period_s, result.messages) == (0.2, ("NAV-PVT", "NAV-COV"))


def test_one_port_is_enough() -> None:
    process = Process(Config())
    ask(process)
    assert answer(say(process, values(CFG_MSGOUT_UBX_NAV_COV_UART1=0))).accepted


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"CFG_RATE_MEAS": 1000}, "period is 1.0 s, not 0.2 s"),
        ({"CFG_RATE_NAV": 5}, "period is 1.0 s, not 0.2 s"),
        ({"CFG_MSGOUT_UBX_NAV_COV_UART1": 0, "CFG_MSGOUT_UBX_NAV_COV_USB": 0}, "does not send NAV-COV"),
    ],
)
def test_a_setting_that_did_not_take_effect_is_not_accepted(changes: dict[str, int], reason: str) -> None:
    process = Process(Config())
    ask(process)
    result = answer(say(process, values(**changes)))
    assert not result.accepted
    assert reason in (result.reason or "")


def test_a_refusal_is_reported_with_what_is_in_force() -> None:
    process = Process(Config())
    ask(process)
    say(process, acknowledge(0x8A, good=False))
    result = answer(say(process, values(CFG_RATE_MEAS=1000)))
    assert not result.accepted
    assert "refused UBX-CFG-VALSET" in (result.reason or "")
    assert result.navigation_period_s == 1.0


def test_a_receiver_that_is_too_old_says_so() -> None:
    process = Process(Config())
    ask(process)
    result = answer(say(process, acknowledge(0x8A, good=False) + acknowledge(0x8B, good=False)))
    assert "older than generation 9" in (result.reason or "")


def test_a_receiver_that_does_not_answer_is_given_up_after_three_seconds() -> None:
    process = Process(Config())
    ask(process)
    assert [list(process.handle(Tick(now_ns=k * NS))) for k in range(2)] == [[], []]
    result = answer(list(process.handle(Tick(now_ns=3 * NS))))
    assert "check that its receiving line is connected" in (result.reason or "")
    assert not say(process, values())  # an answer that comes too late


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"messages": ("NAV-PTV",)}, "did you mean NAV-PVT?"),
        ({"navigation_period_s": 0.001}, "outside 0.025 to 65.535 s"),
        ({"messages": tuple(f"NAV-{name}" for name in MANY)}, "too many"),
    ],
)  # fmt: skip
def test_a_request_that_cannot_be_is_refused_at_once(change: dict[str, object], reason: str) -> None:
    result = answer(ask(Process(Config()), ASKED.model_copy(update=change)))
    assert not result.accepted
    assert reason in (result.reason or "")


def test_answers_of_nobodys_asking_are_ignored() -> None:
    assert not say(Process(Config()), acknowledge(0x8A) + values() + acknowledge(0x8B, good=False))


def test_values_of_every_size_are_read() -> None:
    items: list[tuple[int | str, object]] = [
        ("CFG_RATE_MEAS", 500),
        ("CFG_UART1_BAUDRATE", 115200),
        ("CFG_SIGNAL_GPS_ENA", 1),
    ]
    payload = bytes(UBXMessage.config_set(0, 0, items).payload)
    assert list(read_values(payload).values()) == [500, 115200, 1]


WITH_RAW = ASKED.model_copy(update={"optional_messages": ("RXM-RAWX", "RXM-SFRBX")})
OPTIONAL = {
    "CFG_MSGOUT_UBX_RXM_RAWX_UART1": 5, "CFG_MSGOUT_UBX_RXM_RAWX_USB": 5,
    "CFG_MSGOUT_UBX_RXM_SFRBX_UART1": 1, "CFG_MSGOUT_UBX_RXM_SFRBX_USB": 1,
}  # fmt: skip


def optional_values() -> bytes:
    payload = bytes(UBXMessage.config_set(0, 0, list(OPTIONAL.items())).payload)
    return bytes(UBXMessage("CFG", "CFG-VALGET", 0, payload=b"\x01" + payload[1:]).serialize())


def test_optional_messages_are_asked_for_apart_and_measurements_once_a_second() -> None:
    writes = [one.data for one in ask(Process(Config()), WITH_RAW) if isinstance(one, GnssWrite)]
    assert writes[0] == UBXMessage.config_set(1, 0, list(OPTIONAL.items())).serialize()
    assert writes[2:] == [one.data for one in ask(Process(Config())) if isinstance(one, GnssWrite)]
    assert len(writes) == 4


def test_granted_optional_messages_are_reported_with_the_others() -> None:
    process = Process(Config())
    ask(process, WITH_RAW)
    assert not say(process, acknowledge(0x8A) + optional_values() + acknowledge(0x8B) + acknowledge(0x8A))
    result = answer(say(process, values()))
    assert result.accepted
    assert result.messages == ("NAV-PVT", "NAV-COV", "RXM-RAWX", "RXM-SFRBX")


@pytest.mark.parametrize("refusals", [(0x8A, 0x8B), (0x8A,), (0x8B,), ()])
def test_a_receiver_that_refuses_the_optional_messages_keeps_the_others(refusals: tuple[int, ...]) -> None:
    process = Process(Config())
    ask(process, WITH_RAW)
    assert not say(process, b"".join(acknowledge(one, good=False) for one in refusals))
    result = answer(say(process, acknowledge(0x8A) + values() + acknowledge(0x8B)))
    assert (result.accepted, result.reason, result.messages) == (True, None, ("NAV-PVT", "NAV-COV"))


@given(st.binary(max_size=80))
def test_any_answer_is_read_as_far_as_it_goes(payload: bytes) -> None:
    process = Process(Config())
    ask(process)
    read_values(payload)
    body = bytes((6, 0x8B)) + len(payload).to_bytes(2, "little") + payload
    say(process, UBX_SYNC + body + ubx_checksum(body))

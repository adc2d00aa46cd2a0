"""What a receiver sends is said by its bytes, whether or not they hold a position."""

import pytest

from services.parsers.gnss.process import Config, Process
from services.parsers.gnss.seen import MAX_KINDS
from shared.maths.crc import crc16_ccitt, fletcher
from shared.messages.base import Tick
from shared.messages.gnss import GnssRaw, GnssReceiver
from shared.protocols.ubx import SYNC

NS = 1_000_000_000
START_NS = 1_795_000_000 * NS


def ubx(kind: int, number: int, payload: bytes = b"") -> bytes:
    body = bytes((kind, number)) + len(payload).to_bytes(2, "little") + payload
    return SYNC + body + fletcher(body)


def nmea(text: str) -> bytes:
    checksum = 0
    for byte in text.encode():
        checksum ^= byte
    return f"${text}*{checksum:02X}\r\n".encode()


def said(process: Process, data: bytes, second: float) -> list[GnssReceiver]:
    now_ns = START_NS + round(second * NS)
    list(process.handle(GnssRaw(received_ns=now_ns, source="gnss0", data=data)))
    return [message for message in process.handle(Tick(now_ns=now_ns)) if isinstance(message, GnssReceiver)]


POSLLH = ubx(0x01, 0x02, bytes(28))


def test_the_first_message_of_a_protocol_is_said_with_the_next_tick_and_the_rest_every_two_seconds() -> None:
    process = Process(Config())
    [first] = said(process, POSLLH, 0.0)
    assert (first.source, first.messages, first.received_bytes, first.other_bytes) == (
        "gnss0", ("UBX NAV-POSLLH",), 36, 0,
    )  # fmt: skip
    assert said(process, ubx(0x01, 0x06, bytes(52)), 0.5) == []
    [second] = said(process, nmea("GNGGA,,,,,,0,,,,,,,,"), 1.0)
    assert second.messages == ("NMEA GGA", "UBX NAV-POSLLH", "UBX NAV-SOL")
    assert said(process, POSLLH, 2.9) == []
    assert len(said(process, POSLLH, 3.0)) == 1


@pytest.mark.parametrize(
    ("data", "kind"),
    [
        (ubx(0x77, 0x01), "UBX 77-01"),
        (nmea("PUBX,00"), "NMEA PUBX00"),
        (nmea("GPHDT,274.1,T"), "NMEA HDT"),
        (bytes.fromhex("d300133ed7d30202980edeef34b4bd62ac0941986f33360b98"), "RTCM 1005"),
    ],
)
def test_kinds_have_the_names_of_their_protocols_and_unknown_ones_their_numbers(data: bytes, kind: str) -> None:
    [found] = said(Process(Config()), data, 0.0)
    assert found.messages == (kind,)


def test_bytes_that_are_no_message_are_counted_and_silence_says_nothing() -> None:
    process = Process(Config())
    [found] = said(process, b"\x80\xfe\x1c" * 100, 0.0)
    assert found.messages == () and (found.received_bytes, found.other_bytes) == (300, 300)
    assert said(process, b"", 10.0) == []


def test_kinds_are_forgotten_after_ten_seconds_and_bounded() -> None:
    process = Process(Config())
    said(process, b"".join(ubx(0x70, number) for number in range(200)), 0.0)
    [many] = said(process, POSLLH, 2.0)
    assert len(many.messages) <= MAX_KINDS
    said(process, POSLLH, 13.0)
    [later] = said(process, POSLLH, 15.0)
    assert later.messages == ("UBX NAV-POSLLH",)


def test_blocks_of_sbf_are_named_and_sentences_between_them_are_read() -> None:
    rest = bytes.fromhex("a70f6000") + bytes(88)  # block 4007 of 96 bytes
    sbf = b"$@" + crc16_ccitt(rest).to_bytes(2, "little") + rest
    process = Process(Config())
    [found] = said(process, sbf * 5, 0.0)
    assert (found.messages, found.other_protocols) == ((), ("SBF",))
    assert process.rejects == {"garbage_bytes": 480}, "and nothing of it is taken for a sentence"
    [mixed] = said(process, sbf + nmea("GNGGA,,,,,,0,,,,,,,,") + sbf, 3.0)
    assert mixed.messages == ("NMEA GGA",)

import math
import pickle
import struct
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.protocols import xbus
from shared.protocols.framing.finder import TAIL
from shared.protocols.xbus import XbusReader, decode_field, decode_mtdata2, encode_field, encode_message, encode_mtdata2
from tests.support.cases import each
from tests.support.data import recording

GOLDEN_NAMES = {
    "PacketCounter": xbus.PACKET_COUNTER,
    "SampleTimeFine": xbus.SAMPLE_TIME_FINE,
    "SampleTimeCoarse": xbus.SAMPLE_TIME_COARSE,
    "StatusWord": xbus.STATUS_WORD,
    "StatusByte": xbus.STATUS_BYTE,
    "EulerAngles": xbus.EULER_ANGLES,
    "Acceleration": xbus.ACCELERATION,
    "DeltaV": xbus.DELTA_V,
    "RateOfTurn": xbus.RATE_OF_TURN,
    "DeltaQ": xbus.DELTA_Q,
    "Quaternion": xbus.QUATERNION,
    "Temperature": xbus.TEMPERATURE,
    "MagneticField": xbus.MAGNETIC_FIELD,
    "BaroPressure": xbus.BARO_PRESSURE,
}


def golden(text: str) -> list[dict[int, list[float]]]:
    """Read the decode of an independent implementation (einride/xsens-go)."""
    messages = []
    for block in text.strip().split("\n\n"):
        fields: dict[int, list[float]] = {}
        values: list[float] = []
        for line in block.splitlines():
            if not line.startswith(" "):
                name = line.split("(")[0].rstrip(":")
                values = []
                if name in GOLDEN_NAMES:
                    fields[GOLDEN_NAMES[name]] = values
                base = 2 if name.startswith("Status") else 10
            elif "T" not in line:
                text_value = line.split(":")[-1].strip()
                values.append(int(text_value, 2) if base == 2 else float(text_value) if text_value else math.nan)
        messages.append(fields)
    return messages


@pytest.mark.recording
@pytest.mark.parametrize("number", ["1", "3", "5"])
def test_a_recording_is_decoded_as_by_an_independent_implementation(number: str) -> None:
    folder = recording(f"xsens_xbus/{number}")
    reader = XbusReader()
    data = (folder / "output.bin").read_bytes()
    payloads = [m.payload for i in range(0, len(data), 11) for m in reader.feed(data[i : i + 11])]
    expected = golden((folder / "output.golden").read_text())
    assert not reader.rejects
    assert len(payloads) == len(expected) == 100
    for payload, fields in zip(payloads, expected, strict=True):
        decoded = decode_mtdata2(payload, reader.rejects)
        assert decoded.keys() == fields.keys()
        for kind, values in fields.items():
            assert decoded[kind] == pytest.approx(values, rel=1e-15)
    assert not reader.rejects


@pytest.mark.recording
def test_decoding_and_encoding_a_recording_reproduces_its_bytes() -> None:
    data = (recording("xsens_xbus/3/output.bin")).read_bytes()
    again = b"".join(encode_mtdata2(dict(xbus.split_mtdata2(m.payload))) for m in XbusReader().feed(data))
    assert again == data


def test_a_message_is_framed_by_the_protocol_document() -> None:
    assert encode_message(0x30, b"") == bytes.fromhex("fa ff 30 00 d1")  # GoToConfig, as printed in the document


def test_a_long_message_uses_the_extended_length() -> None:
    data = encode_message(0x36, bytes(300))
    assert data[:6] == bytes.fromhex("fa ff 36 ff 01 2c")
    assert [m.payload for m in XbusReader().feed(data)] == [bytes(300)]


def test_a_payload_beyond_the_limit_is_rejected() -> None:
    with pytest.raises(ValueError, match="2049"):
        encode_message(0x36, bytes(2049))


@pytest.mark.parametrize("number_format", [0, 1, 2, 3])
def test_every_number_format_is_encoded_and_decoded_within_its_resolution(number_format: int) -> None:
    sent = (-9.80665, 0.0, 1024.25)
    data_id = xbus.ACCELERATION | number_format
    quantum = (2**-14, 2**-20, 2**-32, 0.0)[number_format]  # half a float32 step at 1024 is 2**-14
    assert decode_field(data_id, encode_field(data_id, *sent)) == pytest.approx(sent, abs=quantum)


@pytest.mark.parametrize(("data_id", "values"), [(0x1234, (1.0,)), (xbus.ACCELERATION, (1.0,)), (0x4021, (1e9, 0, 0))])
def test_a_field_that_cannot_be_encoded_is_rejected(data_id: int, values: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match=r"field 0x"):
        encode_field(data_id, *values)


def test_a_field_of_the_wrong_size_is_counted_and_the_others_are_decoded() -> None:
    rejects: Counter[str] = Counter()
    payload = struct.pack(">HBHHBHHB2s", 0x1020, 2, 7, 0x4020, 2, 0, 0x8020, 12, b"\0\0")
    assert decode_mtdata2(payload, rejects) == {xbus.PACKET_COUNTER: (7,)}
    assert rejects == {"bad_field": 1, "cut_field": 1}


def test_a_wrong_checksum_invalidates_one_message_only() -> None:
    good = encode_message(0x36, b"good")
    bad = bytearray(encode_message(0x36, b"bad!"))
    bad[-1] ^= 1
    reader = XbusReader()
    assert [m.payload for m in reader.feed(bytes(good + bad + good))] == [b"good", b"good"]
    assert reader.rejects == {"bad_checksum": 1, "garbage_bytes": len(bad)}


def test_an_invalid_length_is_skipped_at_once() -> None:
    reader = XbusReader()
    message = encode_message(0x36, b"x")
    assert len(list(reader.feed(bytes.fromhex("fa ff 36 ff ff ff") + message))) == 1
    assert reader.rejects == {"oversize": 1, "garbage_bytes": 6}


def test_the_buffer_is_bounded_for_any_input() -> None:
    reader = XbusReader()
    for _ in range(200):
        list(reader.feed(bytes.fromhex("fa ff 36 ff 07 00") + bytes(94)))
        assert len(pickle.dumps(reader)) < 2 * xbus.MAX_PAYLOAD_BYTES + 1000


@each("size", [64, 1000, 10**9])
@each(
    "pattern", [b"\xfa", b"\xfa\xff", b"\xfa\xff\x36\xf0", b"\xfa\xff\x36\xff\x07\xff", b"\xfa\xff\x36\x00", bytes(7)]
)
def test_each_byte_is_summed_once_and_no_place_is_judged_twice(pattern: bytes, size: int) -> None:
    data, reader = pattern * (40_000 // len(pattern)), XbusReader()
    feeds = [data[i : i + size] for i in range(0, len(data), size)]
    for part in feeds:
        reader.feed(part)
    assert reader.judged <= len(data) / 4
    assert reader.summed <= len(data) + TAIL * max(len(feeds), len(data) / xbus.MAX_PAYLOAD_BYTES + 1)


@pytest.mark.parametrize("cut", [1, 2, 7])
def test_a_valid_message_that_must_wait_is_the_same_when_its_bytes_arrive_one_by_one(cut: int) -> None:
    """The running sums at its ends are gone by the time that no incomplete message is around it."""
    inner = encode_message(0x12, bytes(range(20)))
    data = b"\xfa\xff\x36\xc8" + bytes(10) + inner + bytes(250)  # a header of 200 bytes whose checksum is wrong
    reader = XbusReader()
    found = [message for at in range(0, len(data), cut) for message in reader.feed(data[at : at + cut])]
    assert [(message.mid, message.payload) for message in found] == [(0x12, bytes(range(20)))]


def test_a_message_that_is_no_measurement_comes_when_the_incomplete_one_around_it_is_over() -> None:
    reader, other = XbusReader(), encode_message(0x42, b"ack")
    around = bytes.fromhex("fa ff 36 40")
    assert not reader.feed(around + other)
    assert [message.mid for message in reader.feed(bytes(80))] == [0x42]
    assert reader.rejects["bad_checksum"] == 1 and not reader.rejects["cut_message"]


MEASUREMENT = encode_mtdata2({xbus.PACKET_COUNTER: encode_field(xbus.PACKET_COUNTER, 1)})


@given(garbage=st.lists(st.binary(max_size=40), max_size=5), cut=st.integers(1, 50))
def test_every_message_after_random_bytes_is_found_without_delay(garbage: list[bytes], cut: int) -> None:
    stream = b"".join(part + MEASUREMENT for part in garbage)
    reader = XbusReader()
    found = [m for i in range(0, len(stream), cut) for m in reader.feed(stream[i : i + cut])]
    assert [m.payload for m in found].count(MEASUREMENT[4:-1]) == len(garbage)


def test_messages_after_a_corrupted_length_are_found_without_delay() -> None:
    damaged = bytearray(MEASUREMENT)
    damaged[3] = 0xF0
    reader = XbusReader()
    assert [m.payload for m in reader.feed(bytes(damaged) + MEASUREMENT * 2)] == [MEASUREMENT[4:-1]] * 2
    assert reader.rejects["cut_message"] == 1


def test_the_message_after_a_truncated_one_is_found() -> None:
    for cut in range(1, len(MEASUREMENT)):
        assert len(list(XbusReader().feed(MEASUREMENT[:cut] + MEASUREMENT))) == 1


@given(payload=st.binary(max_size=120))
def test_any_payload_is_decoded_or_counted(payload: bytes) -> None:
    decode_mtdata2(payload, Counter())

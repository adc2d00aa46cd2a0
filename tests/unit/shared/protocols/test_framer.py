import functools
import operator
import pickle
import re
import struct
from collections import Counter
from collections.abc import Iterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyubx2.ubxhelpers import calc_checksum
from pyubx2.ubxmessage import UBXMessage
from pyubx2.ubxreader import UBXReader

from services.parsers.gnss.protocols import FRAMINGS
from shared.maths.crc import crc24q, crc_of_zeros, fletcher
from shared.protocols.framing.finder import TAIL
from shared.protocols.framing.framer import Framer
from shared.protocols.ubx import MAX_PAYLOAD
from tests.support.cases import each
from tests.support.data import recording

UBX = UBXMessage("NAV", "NAV-EOE", 0, iTOW=1000).serialize()
NMEA = b"$GNZDA,000000.00,01,01,2026,00,00*7E\r\n"
GOOD = (UBX, NMEA)


def frames(data: bytes, size: int = 10**9) -> tuple[list[bytes], Counter[str]]:
    framer = Framer(FRAMINGS)
    found = [frame.data for i in range(0, len(data), size) for frame in framer.feed(data[i : i + size])]
    return found, framer.rejects


@pytest.mark.parametrize("size", [1, 7, 64, 1000])
def test_chunks_of_any_size_give_the_same_frames(size: int) -> None:
    assert frames((UBX + NMEA) * 5, size) == ([UBX, NMEA] * 5, Counter())


def test_invalid_bytes_between_frames_are_counted_and_all_frames_are_found() -> None:
    found, rejects = frames(b"\x00\xff" + UBX + b"noise" + NMEA + b"\x01" + UBX)
    assert found == [UBX, NMEA, UBX]
    assert rejects == {"garbage_bytes": 8}


def test_the_time_of_arrival_behind_a_sentence_in_an_android_log_is_no_part_of_it() -> None:
    logged = b"NMEA," + NMEA.strip() + b",1699400577561\n"
    found, rejects = frames(logged * 2 + NMEA.strip() + b",x\n")
    assert [payload.partition(b",1699")[0] for payload in found] == [NMEA.strip()] * 2
    assert rejects["nmea_form"] == 1 and not rejects["nmea_checksum"]


def test_a_wrong_checksum_invalidates_its_own_frame_only() -> None:
    bad = UBX[:-1] + bytes([UBX[-1] ^ 1])
    found, rejects = frames(UBX + bad + NMEA.replace(b"*7E", b"*7F") + UBX)
    assert found == [UBX, UBX]
    assert rejects["ubx_checksum"] == rejects["nmea_checksum"] == 1


def test_frames_after_a_corrupted_length_are_found_without_delay() -> None:
    framer = Framer(FRAMINGS)
    damaged = UBX[:4] + struct.pack("<H", 4000) + UBX[6:]
    assert [frame.data for frame in framer.feed(damaged + NMEA + UBX)] == [NMEA, UBX]
    assert framer.rejects["cut_frame"] == 1


def test_the_frame_after_a_truncated_one_is_found() -> None:
    for cut in range(1, len(UBX)):
        assert frames(UBX[:cut] + UBX + NMEA)[0] == [UBX, NMEA]
    for cut in range(1, len(NMEA) - 2):
        assert frames(NMEA[:cut] + NMEA + UBX)[0] == [NMEA, UBX]


def test_rtcm_messages_are_frames() -> None:
    # Example of RTCM 10403.3, section 4.2: message 1005 with its parity
    rtcm = bytes.fromhex("D300133ED7D30202980EDEEF34B4BD62AC0941986F33360B98")
    assert crc24q(rtcm) == 0
    framer = Framer(FRAMINGS)
    assert [frame.protocol for frame in framer.feed(rtcm + UBX)] == ["RTCM", "UBX"]
    assert not framer.rejects


def test_the_checksum_equals_that_of_pyubx2() -> None:
    for size in (0, 1, 4, 300, 2000):
        data = bytes(i * 7 & 0xFF for i in range(size))
        assert fletcher(data) == (calc_checksum(data) if size else b"\0\0")


def test_the_buffer_is_bounded_for_any_input() -> None:
    framer = Framer(FRAMINGS)
    for filler in (b"\xb5\x62\x01\x07\x00\x10", b"$" * 10, b"\xd3\x03\xff", b"\xb5", b"$GNRMC,"):
        for _ in range(400):
            framer.feed(filler + bytes(200))
            assert len(pickle.dumps(framer)) < 2 * MAX_PAYLOAD + 1000


@given(st.lists(st.tuples(st.binary(max_size=60), st.sampled_from(GOOD)), max_size=6), st.integers(1, 200))
def test_every_frame_after_random_bytes_is_found_without_delay(parts: list[tuple[bytes, bytes]], size: int) -> None:
    stream = b"".join(noise + frame for noise, frame in parts)
    found = frames(stream, size)[0]
    assert [frame for frame in found if frame in GOOD] == [frame for _, frame in parts]


@given(st.binary(max_size=600))
def test_all_bytes_are_framed_or_counted(data: bytes) -> None:
    framer, end = Framer(FRAMINGS), bytes(2 * MAX_PAYLOAD)  # completes every frame that has begun
    taken = sum(len(frame.data) for part in (data, end) for frame in framer.feed(part))
    assert taken + framer.rejects["garbage_bytes"] == len(data) + len(end)


PATTERNS = (
    b"\xd3\x03\xff",
    b"\xd3\x03\xff\xff",
    b"\xd3\x00\xd3\x3e",
    b"\xb5\x62\x01\x07\xf0\x0f",
    b"\xb5\x62\x00",
    b"\xb5\x62",
    b"\xb5",
    b"\xb5\x62\xb5\x62\x00\x10",
    b"\xd3\xb5\x62\x00",
    b"$",
    b"$G",
    b"$GPGSA,*00\n",
    b"$" + b"A" * 251,
    b"$\r",
    bytes(8),
)
RTCM = bytes.fromhex("D300133ED7D30202980EDEEF34B4BD62AC0941986F33360B98")


@each("size", [64, 1000, 10**9])
@each("pattern", PATTERNS)
def test_each_byte_is_summed_once_and_no_place_is_judged_twice(pattern: bytes, size: int) -> None:
    """Checksums over overlapping candidates would look at each byte up to a thousand times."""
    data, framer = pattern * (40_000 // len(pattern)), Framer(FRAMINGS)
    feeds = [data[i : i + size] for i in range(0, len(data), size)]
    for part in feeds:
        framer.feed(part)
    assert framer.judged <= len(data) / 3
    assert framer.summed <= len(data) + TAIL * max(len(feeds), len(data) / MAX_PAYLOAD + 1)


@given(st.sampled_from(PATTERNS), st.integers(0, 3000), st.integers(1, 5000))
@settings(deadline=None)
def test_frames_behind_any_pattern_are_found(pattern: bytes, repeats: int, size: int) -> None:
    end = bytes(2 * MAX_PAYLOAD)  # completes every frame that has begun
    stream = pattern * (repeats // len(pattern)) + b"\n" + UBX + RTCM + NMEA + UBX + end
    assert [frame for frame in frames(stream, size)[0] if frame in (UBX, NMEA, RTCM)][-4:] == [UBX, RTCM, NMEA, UBX]


def plainly(data: bytes) -> list[bytes]:
    """Find the frames of a whole stream as slowly as the definition says."""
    found, start = list[bytes](), 0
    while start < len(data):
        size = next((n for n in _sizes(data[start : start + 4200]) if n), 0)
        found += [data[start : start + size]] if size else []
        start += size or 1
    return found


def _sizes(data: bytes) -> Iterator[int]:
    if data[:2] == b"\xb5\x62" and len(data) > 7:
        size = 8 + int.from_bytes(data[4:6], "little")
        yield size if size <= min(len(data), 4104) and fletcher(data[2 : size - 2]) == data[size - 2 : size] else 0
    if data[:1] == b"\xd3" and len(data) > 3 and data[1] < 4 and (62 <= data[3] <= 81 or data[3] >= 250):
        size = 6 + int.from_bytes(data[1:3])
        yield size if size <= len(data) and crc24q(data[:size]) == 0 else 0
    if (sentence := re.match(rb"\$([ -#%-\x7f]*)\*([0-9A-Fa-f]{2})\r?\n", data)) and len(sentence[0]) <= 250:
        yield len(sentence[0]) if functools.reduce(operator.xor, sentence[1], 0) == int(sentence[2], 16) else 0


PIECES = st.sampled_from(
    (UBX, NMEA, RTCM, UBX[:9], NMEA[:20], RTCM[:12], b"\xb5\x62\x01\x07\x20\x00", b"\xd3\x00\x30\x3e", b"$GNRMC,1*")
)


@given(st.lists(PIECES | st.binary(max_size=12), max_size=30))
@settings(max_examples=300, deadline=None)
def test_all_at_once_gives_the_frames_of_the_definition(pieces: list[bytes]) -> None:
    data = b"".join(pieces)
    end = bytes(2 * MAX_PAYLOAD)
    assert frames(data + end)[0] == plainly(data + end)


@given(st.binary(max_size=300), st.integers(0, 1029))
def test_a_crc_is_continued_over_zero_bytes(data: bytes, count: int) -> None:
    assert crc_of_zeros(crc24q(data), count) == crc24q(data + bytes(count))


@pytest.mark.recording
@pytest.mark.parametrize("name", ["ublox-zed-f9r.log", "ublox-neo-m8l.log", "ublox-zed-f9p-hp.log", "ublox-glo.log"])
def test_a_recording_gives_the_ubx_messages_that_pyubx2_finds(name: str) -> None:
    path = recording(f"gpsd_receiver_logs/{name}")
    with path.open("rb") as stream:
        expected = [raw for raw, _ in UBXReader(stream, protfilter=2, quitonerror=0, parsing=0) if raw]
    ours = [frame.data for frame in Framer(FRAMINGS).feed(path.read_bytes()) if frame.protocol == "UBX"]
    assert len(ours) > 20
    assert ours == expected

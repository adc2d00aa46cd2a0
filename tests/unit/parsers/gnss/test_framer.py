import pickle
import struct
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyubx2.ubxhelpers import calc_checksum
from pyubx2.ubxmessage import UBXMessage
from pyubx2.ubxreader import UBXReader

from services.parsers.gnss.framer import MAX_UBX_PAYLOAD, Framer, Protocol, crc24q, ubx_checksum
from tests.support.data import recording

UBX = UBXMessage("NAV", "NAV-EOE", 0, iTOW=1000).serialize()
NMEA = b"$GNZDA,000000.00,01,01,2026,00,00*7E\r\n"
GOOD = (UBX, NMEA)


def frames(data: bytes, size: int = 10**9) -> tuple[list[bytes], Counter[str]]:
    framer = Framer()
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
    assert [one.partition(b",1699")[0] for one in found] == [NMEA.strip()] * 2
    assert rejects["nmea_form"] == 1 and not rejects["nmea_checksum"]


def test_a_wrong_checksum_invalidates_its_own_frame_only() -> None:
    bad = UBX[:-1] + bytes([UBX[-1] ^ 1])
    found, rejects = frames(UBX + bad + NMEA.replace(b"*7E", b"*7F") + UBX)
    assert found == [UBX, UBX]
    assert rejects["ubx_checksum"] == rejects["nmea_checksum"] == 1


def test_frames_after_a_corrupted_length_are_found_without_delay() -> None:
    framer = Framer()
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
    framer = Framer()
    assert [frame.protocol for frame in framer.feed(rtcm + UBX)] == [Protocol.RTCM, Protocol.UBX]
    assert not framer.rejects


def test_the_checksum_equals_that_of_pyubx2() -> None:
    for size in (0, 1, 4, 300, 2000):
        data = bytes(i * 7 & 0xFF for i in range(size))
        assert ubx_checksum(data) == (calc_checksum(data) if size else b"\0\0")


def test_the_buffer_is_bounded_for_any_input() -> None:
    framer = Framer()
    for filler in (b"\xb5\x62\x01\x07\x00\x10", b"$" * 10, b"\xd3\x03\xff", b"\xb5", b"$GNRMC,"):
        for _ in range(400):
            framer.feed(filler + bytes(200))
            assert len(pickle.dumps(framer)) < 2 * MAX_UBX_PAYLOAD + 1000


@given(st.lists(st.tuples(st.binary(max_size=60), st.sampled_from(GOOD)), max_size=6), st.integers(1, 200))
def test_every_frame_after_random_bytes_is_found_without_delay(parts: list[tuple[bytes, bytes]], size: int) -> None:
    stream = b"".join(noise + frame for noise, frame in parts)
    found = frames(stream, size)[0]
    assert [frame for frame in found if frame in GOOD] == [frame for _, frame in parts]


@given(st.binary(max_size=600))
def test_all_bytes_are_framed_or_counted(data: bytes) -> None:
    framer, end = Framer(), bytes(2 * MAX_UBX_PAYLOAD)  # completes every frame that has begun
    taken = sum(len(frame.data) for part in (data, end) for frame in framer.feed(part))
    assert taken + framer.rejects["garbage_bytes"] == len(data) + len(end)


@pytest.mark.recording
@pytest.mark.parametrize("name", ["ublox-zed-f9r.log", "ublox-neo-m8l.log", "ublox-zed-f9p-hp.log", "ublox-glo.log"])
def test_a_recording_gives_the_ubx_messages_that_pyubx2_finds(name: str) -> None:
    path = recording("gpsd_receiver_logs") / name
    with path.open("rb") as stream:
        expected = [raw for raw, _ in UBXReader(stream, protfilter=2, quitonerror=0, parsing=0) if raw]
    ours = [frame.data for frame in Framer().feed(path.read_bytes()) if frame.protocol is Protocol.UBX]
    assert len(ours) > 20
    assert ours == expected

"""Frames of corrections against their definitions, against pyspartn, and against rubbish."""

import io
import random
from collections import Counter
from itertools import pairwise
from pathlib import Path

import pytest
from pyrtcm.rtcmtypes_core import RTCM_MSGIDS
from pyspartn.spartnreader import SPARTNReader

from services.parsers.corrections.frames import CorrectionFrame, CorrectionFramer
from services.parsers.corrections.names import name_of
from shared.messages.corrections import CorrectionProtocol
from tests.support.cases import each
from tests.support.data import recording
from tests.support.gnss.frames import rtcm, spartn, ubx

BASE = [rtcm(1005, 19), rtcm(1077, 600), rtcm(1087, 400), rtcm(1230, 10), rtcm(4072, 30)]
SPARTN = [spartn(0, 0), spartn(1, 2, 1023), spartn(2, 0, 20), spartn(0, 1, crc_kind=1), spartn(0, 3, crc_kind=3)]
KEY = ubx(0x02, 0x36, bytes(60))
PMP = ubx(0x02, 0x72, b"".join(SPARTN[:1]) + bytes(100))


def framed(data: bytes, cuts: list[int] | None = None) -> tuple[list[CorrectionFrame], Counter[str]]:
    framer = CorrectionFramer()
    found = [
        frame for start, stop in pairwise([0, *(cuts or []), len(data)]) for frame in framer.feed(data[start:stop])
    ]
    return found, framer.rejects


@pytest.mark.parametrize(
    "frames", [BASE, SPARTN, [KEY, PMP], [*BASE, *SPARTN, KEY]], ids=["rtcm", "spartn", "ubx", "all"]
)
def test_frames_are_found_whole_however_the_stream_is_cut(frames: list[bytes]) -> None:
    data, chance = b"".join(frames), random.Random(1)
    for cuts in ([], list(range(1, len(data))), sorted(chance.sample(range(1, len(data)), 40))):
        found, rejects = framed(data, cuts)
        assert [frame.data for frame in found] == frames and not rejects


@each("frame", [*BASE, *SPARTN, KEY])
def test_a_frame_with_one_wrong_bit_is_no_frame_and_the_next_one_is_found(frame: bytes) -> None:
    chance = random.Random(2)
    for _ in range(20):
        wrong = bytearray(frame)
        wrong[chance.randrange(4, len(frame))] ^= 1 << chance.randrange(8)
        found, rejects = framed(bytes(wrong) + BASE[0] + bytes(1300))
        assert [correction_frame.data for correction_frame in found] == [BASE[0]] and rejects["garbage_bytes"] == len(
            frame
        ) + 1300


def test_a_ubx_message_that_could_configure_the_receiver_does_not_pass() -> None:
    """UBX-CFG-VALSET, CFG-RST and MGA: only RXM-PMP and RXM-SPARTNKEY carry corrections."""
    others = [
        ubx(0x06, 0x8A, bytes(12)),
        ubx(0x06, 0x04, bytes(4)),
        ubx(0x13, 0x40, bytes(8)),
        ubx(0x02, 0x15, bytes(16)),
    ]
    found, rejects = framed(b"".join(others) + KEY)
    assert [frame.data for frame in found] == [KEY] and rejects["ubx_no_correction"] == len(others)


def test_eight_bits_of_crc_are_too_few() -> None:
    found, rejects = framed(spartn(0, 0, crc_kind=0) + BASE[0])
    assert [frame.data for frame in found] == [BASE[0]] and rejects["spartn_crc_8"] == 1


def test_a_spartn_frame_inside_of_rxm_pmp_goes_on_once_as_part_of_it() -> None:
    found, rejects = framed(PMP, [len(PMP) - 5])
    assert [frame.data for frame in found] == [PMP] and not rejects


@pytest.mark.parametrize("unit", [b"\xd3\x03\xff\x3f", b"s\x03\xff\xef", b"\xb5\x62\x02\x72\x10\x02", None])
def test_bytes_made_to_look_like_headers_cost_no_more_than_others(unit: bytes | None) -> None:
    """Rubbish costs a bounded number of checks: `judged` is at most one for each four bytes."""
    size = 40_000
    data = random.Random(3).randbytes(size) if unit is None else unit * (size // len(unit))
    framer = CorrectionFramer()
    assert framer.feed(data) == [] and framer.judged <= size / 4 + 1
    assert framer.rejects["garbage_bytes"] >= size - 1200


@pytest.mark.parametrize(
    ("name", "frames", "size"), [("spartnMIXED.log", 422, 82_674), ("d9s_spartn_data.bin", 3007, 710_634)]
)
@pytest.mark.recording
def test_recorded_spartn_is_read_as_pyspartn_reads_it_and_every_byte_is_accounted_for(
    name: str, frames: int, size: int
) -> None:
    data = (recording(f"spartn_logs/{name}")).read_bytes()
    found, rejects = framed(data, list(range(777, len(data), 777)))
    theirs = [raw for raw, _ in SPARTNReader(io.BytesIO(data), quitonerror=0, decode=False) if raw]
    assert [frame.data for frame in found] == theirs
    assert (len(found), sum(len(frame.data) for frame in found)) == (frames, size)
    left = len(data) - size - rejects.pop("garbage_bytes", 0)
    assert not rejects and 0 <= left < 1200  # the last frame of the longer file is cut


@pytest.mark.recording
def test_recorded_bytes_of_an_l_band_receiver_are_whole_frames() -> None:
    data = (recording("spartn_logs/d9s_rxmpmp_data.ubx")).read_bytes()
    found, rejects = framed(data, list(range(500, len(data), 500)))
    assert b"".join(frame.data for frame in found) == data and not rejects
    assert Counter(name_of(frame.protocol, frame.kind) for frame in found) == {"UBX RXM-PMP": 1678}


@pytest.mark.recording
def test_a_recorded_base_is_read_to_its_last_byte() -> None:
    path = Path(recording("spartn_logs")).parents[1] / "cases" / "devices" / "base.rtcm3"
    if not path.exists():
        pytest.skip(f"no recording of a base at {path}")
    found, rejects = framed(path.read_bytes())
    assert b"".join(frame.data for frame in found) == path.read_bytes() and not rejects
    names = Counter(name_of(frame.protocol, frame.kind) for frame in found)
    assert names["RTCM 1077 GPS MSM7"] == 26 and names["RTCM 1005 station position"] == 26


def test_names_agree_with_those_of_pyrtcm() -> None:
    """Of each MSM its system and number, and of others a word that theirs has as well."""
    words = {"observations": "observables", "station position": "station", "biases": "biases", "ephemeris": "ephemer"}
    for text, theirs in RTCM_MSGIDS.items():
        number = int(text[:4])
        ours = name_of(CorrectionProtocol.RTCM3, (number, 0))
        if " MSM" in ours:
            system, msm = ours.split()[2:]
            assert (
                msm in theirs
                and {"NavIC": "NavIC", "BeiDou": "BeiDou"}.get(system, system)[:3].lower() in theirs.lower()
            )
        for word, other in words.items():
            if ours.endswith(word):
                assert other.lower() in theirs.lower(), (ours, theirs)

"""RTCM 3 logs: ephemerides come back from their bits, and damage is passed over."""

from dataclasses import fields
from io import BytesIO
from math import pi
from types import SimpleNamespace

import pytest
from pyubx2.ubxreader import UBXReader

from services.core.cooperative.broadcast.ephemeris import Ephemeris
from services.core.cooperative.measurements import WEEK_NS, Constellation
from shared.maths.gnss_signals import L1_FREQUENCY, SPEED_OF_LIGHT
from shared.maths.navigation_words import crc24q
from tests.support.gnss.constellation import NOW_NS, constellation
from tests.support.gnss.rtcm import measurements_of, read_rtcm

TOLERANCES = {"group_delay_s": 2.0**-32, **dict.fromkeys(("cuc", "cus", "cic", "cis"), 2.0**-30)}  # half of a bit


def bits_1019(one: Ephemeris) -> str:
    """The message without its frame, each field with its bits and scale: RTCM 10403.3, table 3.5-21."""
    angle = 1.0 / pi
    rows: tuple[tuple[int, int, float], ...] = (
        (12, 0, 1019), (6, 0, one.satellite.number), (10, 0, one.toe_ns // WEEK_NS % 1024), (4, 0, 0), (2, 0, 1),
        (14, 43, one.inclination_rate * angle), (8, 0, one.issue), (16, -4, one.toc_ns % WEEK_NS // 10**9),
        (8, 55, one.clock[2]), (16, 43, one.clock[1]), (22, 31, one.clock[0]), (10, 0, one.issue), (16, 5, one.crs),
        (16, 43, one.mean_motion_difference * angle), (32, 31, one.mean_anomaly * angle), (16, 29, one.cuc),
        (32, 33, one.eccentricity), (16, 29, one.cus), (32, 19, one.sqrt_a), (16, -4, one.toe_ns % WEEK_NS // 10**9),
        (16, 29, one.cic), (32, 31, one.node * angle), (16, 29, one.cis), (32, 31, one.inclination * angle),
        (16, 5, one.crc), (32, 31, one.perigee * angle), (24, 43, one.node_rate * angle),
        (8, 31, one.group_delay_s), (6, 0, 0), (1, 0, 0), (1, 0, 0),
    )  # fmt: skip
    return "".join(format(round(value * 2.0**power) % (1 << length), f"0{length}b") for length, power, value in rows)


def framed(bits: str) -> bytes:
    """Preamble, length, message and CRC-24Q."""
    padded = bits.ljust(-(-len(bits) // 8) * 8, "0")
    head = "11010011" + format(len(padded) // 8, "016b") + padded
    return int(head + format(crc24q(int(head, 2), len(head)), "024b"), 2).to_bytes(len(head) // 8 + 3, "big")


def messages(log: bytes) -> list[object]:
    return [message for _, message in UBXReader(BytesIO(log), protfilter=4, quitonerror=0)]


GPS = [ephemeris for ephemeris in constellation() if ephemeris.satellite.constellation is Constellation.GPS][:3]


def test_ephemerides_come_back_from_their_bits_with_anything_in_between() -> None:
    log = b"$GNRMC,*00\r\n".join(framed(bits_1019(ephemeris)) for ephemeris in GPS)
    ephemerides, epochs = read_rtcm(messages(log), NOW_NS)
    assert [ephemeride.satellite for ephemeride in ephemerides] == [
        ephemeris.satellite for ephemeris in GPS
    ] and not epochs
    for ephemeride, sent in zip(ephemerides, GPS, strict=True):
        assert (ephemeride.toe_ns, ephemeride.toc_ns, ephemeride.issue, ephemeride.healthy) == (
            sent.toe_ns,
            sent.toc_ns,
            sent.issue,
            True,
        )
        for field in fields(Ephemeris):
            a, b = getattr(ephemeride, field.name), getattr(sent, field.name)
            if isinstance(b, float) and field.name != "accuracy_m":
                assert a == pytest.approx(b, rel=1e-4, abs=TOLERANCES.get(field.name, 1e-12)), field.name


def test_a_damaged_or_cut_message_is_passed_over() -> None:
    whole = framed(bits_1019(GPS[0]))
    wrong = bytes([*whole[:20], whole[20] ^ 1, *whole[21:]])
    assert read_rtcm(messages(wrong + framed(bits_1019(GPS[1]))), NOW_NS)[0][0].satellite == GPS[1].satellite
    assert read_rtcm(messages(whole[:-4]), NOW_NS) == ([], [])


CELL = {
    "NSat": 1, "PRN_01": "007", "DF397_01": 75, "DF398_01": 0.5, "DF399_01": -300, "NCell": 1, "CELLPRN_01": "007",
    "CELLSIG_01": "1C", "DF400_01": 1e-4, "DF403_01": 44, "DF404_01": 0.25,
}  # fmt: skip


def test_a_measurement_is_the_sum_of_its_parts() -> None:
    (one,) = measurements_of(SimpleNamespace(**CELL), Constellation.GPS)
    assert str(one.satellite) == "G07" and one.cn0_db_hz == 44.0
    assert one.pseudorange_m == pytest.approx(SPEED_OF_LIGHT * 75.5001e-3)
    assert one.doppler_hz == pytest.approx(299.75 * L1_FREQUENCY / SPEED_OF_LIGHT)


@pytest.mark.parametrize(
    "change", [{"DF397_01": 255}, {"DF400_01": -(2.0**-10)}, {"CELLSIG_01": "2W"}, {"CELLSIG_01": "5Q"}]
)
def test_what_is_marked_as_invalid_or_on_another_frequency_is_left_out(change: dict[str, object]) -> None:
    assert not list(measurements_of(SimpleNamespace(**(CELL | change)), Constellation.GPS))


def test_an_invalid_rate_leaves_no_doppler() -> None:
    for change in ({"DF399_01": -8192}, {"DF404_01": -1.6384}):
        (one,) = measurements_of(SimpleNamespace(**(CELL | change)), Constellation.GPS)
        assert one.doppler_hz is None

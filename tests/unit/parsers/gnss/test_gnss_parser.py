import json
import math
import struct
from collections import Counter
from datetime import datetime
from functools import reduce
from operator import xor
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyubx2.ubxmessage import UBXMessage

from services.parsers.gnss.process import Config, Process
from shared.maths.dates import GPS_EPOCH_UTC_NS
from shared.messages.base import Message
from shared.messages.corrections import CorrectionsState
from shared.messages.gnss import (
    CarrierSolution,
    FixType,
    GnssFix,
    GnssRaw,
    GnssSatellites,
    GnssSignalQuality,
    GnssSignals,
)
from tests.support.data import recording

NS = 1_000_000_000
MS = 1_000_000
START_NS = 1_767_225_600 * NS  # 2026-01-01 00:00:00
ITOW_MS = 4 * 86_400_000 + 18_000  # the same instant: a Thursday


def ubx(kind: str, itow_ms: int, **fields: Any) -> bytes:
    return bytes(UBXMessage("NAV", f"NAV-{kind}", 0, iTOW=itow_ms, **fields).serialize())


def pvt(second: int = 0, **fields: Any) -> bytes:
    """A valid fix at the given second of 2026."""
    values: dict[str, Any] = {
        "year": 2026, "month": 1, "day": 1, "hour": 0, "min": 0, "second": second, "validDate": 1, "validTime": 1,
        "fullyResolved": 1, "fixType": 3, "gnssFixOk": 1, "numSV": 12, "lat": 42.5, "lon": 13.25, "height": 700_000,
        "hMSL": 650_000, "hAcc": 1_414, "vAcc": 2_000, "sAcc": 173, "velN": 3_000, "velE": -4_000, "velD": 0,
        "gSpeed": 5_000, "headMot": 306.86990, "pDOP": 1.5,
        **fields,
    }  # fmt: skip
    return ubx("PVT", ITOW_MS + second * 1000, **values)


def cov(second: int = 0, **fields: Any) -> bytes:
    values = {"posCovValid": 1, "velCovValid": 1, "posCovNN": 4.0, "posCovEE": 9.0, "posCovDD": 16.0,
              "velCovNN": 0.01, "velCovEE": 0.04, "velCovDD": 0.09, **fields}  # fmt: skip
    return ubx("COV", ITOW_MS + second * 1000, **values)


def dop(second: int = 0) -> bytes:
    return ubx("DOP", ITOW_MS + second * 1000, pDOP=2.5, hDOP=1.25, vDOP=2.0)


def eoe(second: int = 0) -> bytes:
    return ubx("EOE", ITOW_MS + second * 1000)


def nmea(body: str) -> bytes:
    return f"${body}*{reduce(xor, body.encode(), 0):02X}\r\n".encode()


def rmc(second: int = 0, status: str = "A", speed: str = "10.0") -> bytes:
    return nmea(f"GNRMC,0000{second:02}.00,{status},4230.0000,N,01315.0000,E,{speed},90.0,010126,,,A,V")


def gga(second: int = 0, quality: int = 1, altitude: str = "650.0") -> bytes:
    return nmea(f"GNGGA,0000{second:02}.00,4230.0000,N,01315.0000,E,{quality},12,1.25,{altitude},M,50.0,M,,")


def feed(process: Process, data: bytes, second: float = 0.0, source: str = "gnss0") -> list[Message]:
    return list(process.handle(GnssRaw(received_ns=START_NS + round(second * NS), source=source, data=data)))


def fixes(messages: list[Message]) -> list[GnssFix]:
    return [message for message in messages if isinstance(message, GnssFix)]


def only_fix(data: bytes) -> GnssFix:
    (fix,) = fixes(feed(Process(Config()), data))
    return fix


@pytest.mark.parametrize(
    ("date", "recorded", "utc_ns"),
    [
        ("050207", False, 1_789_948_800 * NS),  # 2026-09-21 in the era of the host
        ("050207", True, 1_170_633_600 * NS),  # 2007-02-05: a file is as recorded
        ("010175", False, None),
    ],
)
def test_a_date_of_rmc_is_that_of_the_hosts_era_and_an_impossible_one_is_one_reject(
    date: str, recorded: bool, utc_ns: int | None
) -> None:
    process = Process(Config())
    data = nmea(f"GNRMC,000000.00,A,4230.0,N,01315.0,E,10.0,90.0,{date},,,A,V") + rmc(1)
    (fix,) = fixes(list(process.handle(GnssRaw(received_ns=START_NS, source="g", data=data, recorded=recorded))))
    assert (fix.utc_ns, fix.latitude_deg) == (utc_ns, 42.5)
    assert process.rejects == ({"nmea_date": 1} if utc_ns is None else {})


@pytest.mark.parametrize("impossible", [{"year": 2300}, {"year": 1979}, {"month": 13}, {"day": 0}, {"hour": 24}])
def test_an_impossible_date_of_nav_pvt_is_one_reject_and_the_fix_is_without_utc(impossible: dict[str, int]) -> None:
    process = Process(Config())
    fix, good = fixes(feed(process, pvt(**impossible) + eoe() + pvt(1) + eoe(1)))
    assert (fix.utc_ns, fix.gps_time_ns, fix.latitude_deg, good.utc_ns) == (None, None, 42.5, START_NS + NS)
    assert process.rejects == {"ubx_date": 1}


def test_a_date_of_nav_pvt_that_is_not_called_valid_is_no_reject() -> None:
    process = Process(Config())
    (fix,) = fixes(feed(process, pvt(year=2300, validDate=0) + eoe()))
    assert fix.utc_ns is None and not process.rejects


def test_a_date_of_nav_pvt_is_that_of_the_hosts_era() -> None:
    process = Process(Config())
    (fix,) = fixes(feed(process, pvt(year=2006, month=5, day=18) + eoe()))  # 1024 weeks before 2026-01-01
    assert fix.utc_ns == START_NS and fix.gps_time_ns is not None
    assert fix.gps_time_ns == START_NS - GPS_EPOCH_UTC_NS + 18 * NS


def test_an_epoch_gives_one_fix_with_the_values_of_all_its_messages() -> None:
    fix = only_fix(pvt() + dop() + cov() + eoe())
    assert (fix.fix_type, fix.satellites_used, fix.source) == (FixType.THREE_D, 12, "gnss0")
    assert (fix.latitude_deg, fix.longitude_deg) == pytest.approx((42.5, 13.25), abs=1e-12)
    assert (fix.height_ellipsoid_m, fix.height_msl_m) == pytest.approx((700.0, 650.0))
    assert fix.velocity_ned_m_s == pytest.approx((3.0, -4.0, 0.0))
    assert fix.course_rad == pytest.approx(math.atan2(-4, 3) % (2 * math.pi), abs=1e-6)
    assert fix.position_cov_ned_m2 == (4.0, 0.0, 0.0, 9.0, 0.0, 16.0)
    assert fix.position_sd_ned_m == (2.0, 3.0, 4.0)
    assert fix.velocity_sd_ned_m_s == pytest.approx((0.1, 0.2, 0.3))
    assert (fix.pdop, fix.hdop, fix.vdop) == (2.5, 1.25, 2.0)
    assert fix.utc_ns == START_NS
    assert fix.gps_time_ns == START_NS - 315_964_800 * NS + 18 * NS


def test_without_nav_cov_the_accuracies_are_divided_among_the_axes() -> None:
    fix = only_fix(pvt() + cov(posCovValid=0, velCovValid=0) + eoe())
    assert fix.position_sd_ned_m == pytest.approx((1.0, 1.0, 2.0), abs=1e-3)
    assert fix.velocity_sd_ned_m_s == pytest.approx((0.1, 0.1, 0.1), abs=1e-3)
    assert fix.position_cov_ned_m2 == pytest.approx((1.0, 0.0, 0.0, 1.0, 0.0, 4.0), abs=2e-3)


def test_a_valid_high_precision_position_is_used() -> None:
    payload = struct.pack("<BxxBI4i4b2I", 0, 0, ITOW_MS, 132_500_000, 425_000_001, 700_001, 650_001, 45, 23, 3, 4,
                          141, 200)  # fmt: skip
    precise = bytes(UBXMessage("NAV", "NAV-HPPOSLLH", 0, payload=payload).serialize())
    fix = only_fix(pvt() + precise + eoe())
    assert fix.latitude_deg == pytest.approx(42.500000123, abs=1e-11)
    assert fix.longitude_deg == pytest.approx(13.250000045, abs=1e-11)
    assert fix.height_ellipsoid_m == pytest.approx(700.0013, abs=1e-9)
    assert fix.height_msl_m == pytest.approx(650.0014, abs=1e-9)
    assert fix.position_sd_ned_m == pytest.approx((0.01, 0.01, 0.02), abs=1e-4)


def test_a_fix_of_time_alone_states_the_surveyed_position_and_no_motion() -> None:
    fix = only_fix(pvt(fixType=5) + cov() + eoe())
    assert fix.fix_type is FixType.TIME_ONLY
    assert fix.latitude_deg is not None
    assert (fix.velocity_ned_m_s, fix.ground_speed_m_s, fix.course_rad) == (None,) * 3


@pytest.mark.parametrize("fields", [{"gnssFixOk": 0}, {"fixType": 0, "gnssFixOk": 1}, {"gnssFixOk": 0, "fixType": 3}])
def test_values_not_marked_valid_by_the_receiver_are_none(fields: dict[str, int]) -> None:
    fix = only_fix(pvt(**fields) + cov() + eoe())
    assert (fix.latitude_deg, fix.height_ellipsoid_m, fix.position_cov_ned_m2, fix.position_sd_ned_m) == (None,) * 4
    assert (fix.velocity_ned_m_s, fix.ground_speed_m_s, fix.course_rad, fix.velocity_cov_ned_m2_s2) == (None,) * 4


@pytest.mark.parametrize("flag", ["validDate", "validTime", "fullyResolved", "gnssFixOk"])
def test_time_is_none_until_it_is_valid(flag: str) -> None:
    fix = only_fix(pvt(**{flag: 0}) + eoe())
    assert (fix.utc_ns, fix.gps_time_ns) == (None, None)


def test_a_fix_is_published_when_the_message_kinds_of_the_previous_epochs_are_complete() -> None:
    process = Process(Config())
    assert not fixes(feed(process, pvt() + dop() + cov()))  # the kinds of messages of this receiver are not known yet
    assert len(fixes(feed(process, pvt(1) + dop(1) + cov(1), 1.0))) == 1  # a new epoch completes the previous one
    assert len(fixes(feed(process, pvt(2), 2.0))) == 1
    assert not fixes(feed(process, dop(2), 2.01))
    assert len(fixes(feed(process, cov(2), 2.02))) == 1


def test_a_corrupted_epoch_does_not_truncate_the_next_one() -> None:
    process = Process(Config())
    for k in range(3):
        feed(process, pvt(k) + dop(k) + cov(k), float(k))
    feed(process, pvt(3) + dop(3)[:-1] + b"?" + cov(3)[:20], 3.0)
    found = fixes(feed(process, pvt(4) + dop(4) + cov(4), 4.0))
    assert [fix.hdop for fix in found] == [None, 1.25]


def test_after_a_message_kind_stops_two_fixes_are_late() -> None:
    process = Process(Config())
    counts = [len(fixes(feed(process, pvt(k) + (cov(k) if k < 4 else b""), float(k)))) for k in range(8)]
    assert counts == [0, 1, 2, 1, 0, 1, 2, 1]


def test_each_epoch_is_published_once_for_any_chunk_size() -> None:
    stream = b"".join(pvt(k) + dop(k) + cov(k) + eoe(k) for k in range(5))
    for size in (1, 50, 1000):
        process, found = Process(Config()), []
        for i in range(0, len(stream), size):
            found += fixes(feed(process, stream[i : i + size]))
        assert [fix.utc_ns for fix in found] == [START_NS + k * NS for k in range(5)]
        assert all(fix.hdop and fix.position_cov_ned_m2 for fix in found)


def test_an_epoch_without_nav_pvt_is_counted_and_the_next_one_is_complete() -> None:
    process = Process(Config())
    assert not fixes(feed(process, dop() + cov() + eoe()))
    assert len(fixes(feed(process, pvt(1) + eoe(1), 1.0))) == 1
    assert process.rejects == {"epoch_without_fix": 1}


def test_an_invalid_message_is_counted_and_the_rest_of_the_epoch_is_used() -> None:
    process = Process(Config())
    (fix,) = fixes(feed(process, pvt(velN=900_000_000) + cov(posCovNN=math.nan) + dop() + eoe()))
    assert fix.latitude_deg is not None
    assert fix.velocity_ned_m_s is None
    assert fix.position_sd_ned_m == pytest.approx((1.0, 1.0, 2.0), abs=1e-3)
    assert fix.hdop == 1.25
    assert process.rejects == {"ubx_covariance": 1}


def test_satellites_and_signals_have_the_stamp_of_their_epoch_in_any_order_of_arrival() -> None:
    sig = bytes(UBXMessage("NAV", "NAV-SIG", 0, iTOW=ITOW_MS, numSigs=1, gnssId_01=2, svId_01=7, sigId_01=6, cno_01=40,
                           prUsed_01=1).serialize())  # fmt: skip
    sat = bytes(UBXMessage("NAV", "NAV-SAT", 0, iTOW=ITOW_MS, version=1, numSvs=1, gnssId_01=2, svId_01=7, cno_01=40,
                           elev_01=30, azim_01=90, svUsed_01=1).serialize())  # fmt: skip
    for data in (sig + pvt() + sat + eoe(), pvt() + eoe() + sat + sig):
        messages = feed(Process(Config()), data)
        (fix,), (satellites,) = fixes(messages), [m for m in messages if isinstance(m, GnssSatellites)]
        assert satellites.sampled_ns == fix.sampled_ns
        assert satellites.satellites[0].number == 7
        (signals,) = [m for m in messages if isinstance(m, GnssSignals)]
        assert (signals.sampled_ns, signals.signals[0].signal) == (fix.sampled_ns, "7Q")


def test_the_stamp_is_the_time_of_the_epoch() -> None:
    process = Process(Config(minimum_delay_s=0.05))
    late_ms = [70, 90, 50, 120, 60, 55, 50, 51, 300, 70]
    found = [fix for k, late in enumerate(late_ms) for fix in fixes(feed(process, pvt(k) + eoe(k), k + late * 1e-3))]
    # from the third epoch on the minimum delay has occurred
    errors_ms = [(fix.sampled_ns - START_NS) / MS - k * 1000 for k, fix in enumerate(found)]
    assert errors_ms[0] == pytest.approx(20.0)
    assert errors_ms[2:] == pytest.approx([0.0] * 8, abs=1e-3)


def test_stamps_are_continuous_at_the_week_rollover() -> None:
    process, found = Process(Config()), []
    for k in range(4):
        itow_ms = (604_798_000 + k * 1000) % 604_800_000
        found += fixes(feed(process, ubx("PVT", itow_ms, fixType=3, gnssFixOk=1) + ubx("EOE", itow_ms), k + 0.05))
    assert [fix.sampled_ns - START_NS for fix in found] == [k * NS for k in range(4)]


def test_stamps_are_continuous_after_a_week_number_rollover_of_the_receiver() -> None:
    """Its week number has rolled over (1024 weeks back), and its time of week is unrelated."""
    process = Process(Config())
    before = [fix for k in range(10) for fix in fixes(feed(process, pvt(k) + eoe(k), k + 0.08))]
    back = {"year": 2006, "month": 5, "day": 18, "hour": 3}
    after = []
    for k in range(20, 40):
        itow_ms = ITOW_MS + (k - 3) * 1000 + 3 * 3_600_000
        restarted = pvt(k, **back)[:6] + struct.pack("<I", itow_ms) + pvt(k, **back)[10:-2]
        checked = restarted + bytes(checksum(restarted[2:])) + ubx("EOE", itow_ms)
        after += fixes(feed(process, checked, k + 0.08))
    assert len(before) >= 8 and len(after) >= 15
    for gnss_fix in (*before, *after):
        assert abs(gnss_fix.sampled_ns - gnss_fix.received_ns) < 0.2 * NS


def checksum(body: bytes) -> tuple[int, int]:
    """8-bit Fletcher checksum of UBX."""
    a = b = 0
    for byte in body:
        a = (a + byte) & 0xFF
        b = (b + a) & 0xFF
    return a, b


def test_a_receiver_with_nmea_only_gives_fixes() -> None:
    process = Process(Config())
    feed(process, rmc() + gga())
    gsa = nmea("GNGSA,A,3,01,02,03,04,,,,,,,,,2.50,1.25,2.00,1")
    gst = nmea("GNGST,000001.00,10.0,2.0,1.0,45.0,1.5,2.5,3.5")
    found = fixes(feed(process, rmc(1) + gga(1) + gsa + gst, 1.0))
    found += fixes(feed(process, rmc(2) + gga(2) + gsa + gst.replace(b"01.00", b"02.00"), 2.0))
    fix = found[1]
    assert (fix.source, fix.fix_type) == ("gnss0/nmea", FixType.THREE_D)
    assert (fix.latitude_deg, fix.longitude_deg) == pytest.approx((42.5, 13.25))
    assert fix.height_ellipsoid_m == pytest.approx(700.0)  # geoid 50 m above the ellipsoid
    assert fix.height_msl_m == pytest.approx(650.0)
    assert fix.ground_speed_m_s == pytest.approx(10 * 1852 / 3600)
    assert fix.course_rad == pytest.approx(math.pi / 2)
    assert fix.velocity_ned_m_s is None  # NMEA has no vertical velocity
    assert fix.utc_ns == START_NS + NS
    assert fix.satellites_used == 12


def test_nmea_fixes_are_suppressed_until_5_s_after_the_last_ubx_fix() -> None:
    process, sources = Process(Config()), []
    for k in range(20):
        ubx_too = pvt(k) + eoe(k) if k < 10 else b""
        sources += [fix.source for fix in fixes(feed(process, rmc(k) + gga(k) + ubx_too, float(k)))]
    assert sources[:10] == ["gnss0"] * 10
    assert set(sources[10:]) == {"gnss0/nmea"}
    assert len(sources) == 10 + 5  # quiet for five seconds after the last fix in UBX


@pytest.mark.parametrize(
    ("sentences", "fix_type"),
    [
        (rmc(status="V") + gga(quality=0), FixType.NONE),
        (rmc(status="A") + gga(quality=0), FixType.NONE),
        (rmc() + gga(quality=8), FixType.NONE),  # simulated
        (rmc() + gga(quality=6), FixType.DEAD_RECKONING),
        (rmc() + gga(quality=1) + nmea("GNGSA,A,2,01,02,03,,,,,,,,,,2.5,1.2,2.0,1"), FixType.TWO_D),
    ],
)
def test_the_fix_type_follows_from_nmea_quality_and_status(sentences: bytes, fix_type: FixType) -> None:
    process = Process(Config())
    feed(process, sentences)
    (fix,) = fixes(feed(process, rmc(1), 1.0))
    assert fix.fix_type is fix_type
    assert (fix.latitude_deg is None) == (fix_type is FixType.NONE)


@pytest.mark.parametrize(("quality", "solution"), [(1, "none"), (2, "none"), (4, "fixed"), (5, "float")])
def test_the_carrier_solution_follows_from_nmea_quality(quality: int, solution: str) -> None:
    process = Process(Config())
    feed(process, rmc() + gga(quality=quality))
    (fix,) = fixes(feed(process, rmc(1), 1.0))
    assert fix.carrier_solution is CarrierSolution(solution)
    assert fix.differential == (quality > 1)


def test_invalid_nmea_fields_are_omitted_and_counted() -> None:
    process = Process(Config())
    feed(process, rmc(speed="fast") + gga(altitude="high"))
    (fix,) = fixes(feed(process, rmc(1), 1.0))
    assert (fix.ground_speed_m_s, fix.height_msl_m, fix.height_ellipsoid_m) == (None, None, None)
    assert fix.latitude_deg == pytest.approx(42.5)
    assert process.rejects == {"nmea_field": 2}


def test_receivers_are_decoded_separately_and_excess_ones_are_rejected() -> None:
    process = Process(Config())
    half = len(pvt()) // 2
    feed(process, pvt()[:half], source="front")
    assert len(fixes(feed(process, pvt() + eoe(), source="rear"))) == 1
    assert len(fixes(feed(process, pvt()[half:] + eoe(), source="front"))) == 1
    for k in range(20):
        feed(process, b"x", source=f"more{k}")
    assert process.rejects["too_many_sources"] == 14


@given(st.lists(st.one_of(st.binary(max_size=40), st.sampled_from([pvt(), dop(), cov(), eoe(), rmc(), gga()])),
                max_size=12), st.integers(1, 300))  # fmt: skip
def test_every_epoch_after_invalid_bytes_is_decoded(parts: list[bytes], size: int) -> None:
    process, stream = Process(Config()), b"".join(parts)
    for i in range(0, len(stream), size):
        feed(process, stream[i : i + size], i * 1e-3)
    for k in range(30, 33):
        found = fixes(feed(process, pvt(k) + dop(k) + cov(k) + eoe(k), float(k)))
    assert [(fix.utc_ns, fix.hdop) for fix in found] == [(START_NS + 32 * NS, 1.25)]


@pytest.mark.recording
@pytest.mark.parametrize(
    ("name", "least"),
    [("ublox-zed-f9p-hp", 25), ("ublox-zed-f9p-rtk", 9), ("ublox-neo-m8l", 15), ("ublox-glo", 15), ("ublox-8", 70),
     ("ublox-zed-f9p-nmea", 27)],
)  # fmt: skip
def test_fixes_of_a_recording_equal_those_of_gpsd(name: str, least: int) -> None:
    folder = recording("gpsd_receiver_logs")
    process, ours = Process(Config()), {}
    data = (folder / f"{name}.log").read_bytes()
    for i in range(0, len(data), 100):
        for fix in fixes(feed(process, data[i : i + 100], i * 1e-4)):
            if fix.utc_ns is not None:
                ours[round(fix.utc_ns / MS)] = fix
    compared = Counter[str]()
    for line in (folder / f"{name}.log.chk").read_text().splitlines():
        report = json.loads(line) if '"TPV"' in line else {}
        if "lat" not in report or "time" not in report:
            continue
        known = ours.get(round(datetime.fromisoformat(report["time"]).timestamp() * 1000))
        if known is None or known.latitude_deg is None or known.longitude_deg is None:
            continue
        # gpsd reports some epochs twice, once for each kind of message, and those of HNR, which is not decoded here.
        error_deg = max(abs(known.latitude_deg - report["lat"]), abs(known.longitude_deg - report["lon"]))
        assert error_deg < 2e-5
        compared["position"] += error_deg < 6e-8
        compared["height"] += abs((known.height_ellipsoid_m or 0) - report.get("altHAE", math.inf)) < 2e-3
        compared["speed"] += abs((known.ground_speed_m_s or 0) - report.get("speed", math.inf)) < 2e-3
    assert min(compared["position"], compared["height"], compared["speed"]) >= least


def test_the_clock_of_an_epoch_whose_fix_was_lost_is_not_that_of_a_later_fix() -> None:
    """A gap in the bytes after NAV-CLOCK: a bias of then with the stamp of now looks like a jump of the clock."""

    def clock(second: int, bias_ns: int) -> bytes:
        fields: dict[str, Any] = {"iTOW": 1000 * second, "clkB": bias_ns, "clkD": 50, "tAcc": 20, "fAcc": 1000}
        return bytes(UBXMessage("NAV", "NAV-CLOCK", 0, **fields).serialize())

    process = Process(Config())
    biases = []
    for second, data in (
        (0, clock(0, 100) + pvt(0) + eoe(0)),
        (1, clock(1, 150)),
        (10, pvt(10) + eoe(10) + clock(10, 600)),
        (11, clock(11, 650) + pvt(11) + eoe(11)),
    ):
        for message in feed(process, data, second):
            if isinstance(message, GnssSignalQuality) and message.clock:
                biases.append((round((message.received_ns - START_NS) * 1e-9), round(message.clock.bias_s * 1e9)))
    assert (10, 150) not in biases
    assert biases[0][1] == 100 and biases[-1][1] == 650
    assert process.rejects["ubx_signal_without_fix"] == 1


def test_a_fix_made_with_corrections_names_their_source_for_a_minute() -> None:
    """The state of corrections counts while it is fresh, and only for a fix that has used some."""

    def stated(active: str | None) -> CorrectionsState:
        return CorrectionsState(sampled_ns=START_NS, active=active, reason="")

    def source(process: Process, quality: int, second: int) -> str | None:
        return fixes(feed(process, gga(0, quality) + rmc(0), second) + feed(process, gga(1), second + 1))[
            0
        ].correction_source

    assert source(Process(Config()), 2, 0) is None
    for quality, expected in ((1, None), (2, "base"), (4, "base"), (5, "base")):
        process = Process(Config())
        assert list(process.handle(stated("base"))) == list(process.handle(stated(None))) == []
        assert source(process, quality, 0) == expected
    process = Process(Config())
    list(process.handle(stated("base")))
    assert source(process, 4, 30) == "base" and source(process, 4, 90) is None

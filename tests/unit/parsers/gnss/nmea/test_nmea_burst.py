"""Whole streams of NMEA, as receivers send them: a burst a second, its sentences 20 ms apart, in any order."""

import random
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import reduce
from itertools import pairwise
from operator import xor

import pytest

from services.parsers.gnss.process import Config, Process
from shared.messages.gnss import (
    CarrierSolution,
    Constellation,
    FixType,
    GnssFix,
    GnssRaw,
    GnssSatellites,
    GnssSignalQuality,
)
from shared.messages.operation import MessageUse
from tests.support.cases import each

NS = 1_000_000_000
START_NS = 1_795_521_720 * NS  # 2026-11-24 12:02:00 UTC
BEFORE_S, STEP_S = 0.1, 0.02  # from the epoch to its first sentence, and between two
SENTENCES: dict[str, str] = {
    "RMC": "GNRMC,{t},A,4807.038,N,01131.000,E,5.0,90.0,241126,,,A",
    "GGA": "GNGGA,{t},4807.038,N,01131.000,E,1,08,0.9,500.0,M,46.9,M,,",
    "GNS": "GNGNS,{t},4807.038,N,01131.000,E,RRNN,18,0.6,500.0,46.9,1.0,0,V",
    "GST": "GNGST,{t},10.0,2.0,1.0,45.0,1.5,2.5,3.5",
    "VTG": "GNVTG,90.0,T,,M,5.0,N,9.3,K,A",
    "ZDA": "GNZDA,{t},24,11,2026,00,00",
    "HDT": "GNHDT,123.4,T",
    "none": "GNGSA,A,1,,,,,,,,,,,,,99.99,99.99,99.99,2",
    "2-D": "GNGSA,A,2,01,02,,,,,,,,,,,3.3,2.3,2.9,1",
    "3-D": "GNGSA,A,3,01,02,,,,,,,,,,,2.2,1.2,1.9,1",
    "GSV": "GPGSV,1,1,03,01,40,083,46,02,17,308,41,33,30,200,38,1",
    "GLO": "GLGSV,1,1,01,72,55,010,,1",
}


@dataclass
class StreamResult:
    """What came of a stream, with the time since the epoch in which each fix was published [s]."""

    process: Process
    fixes: list[GnssFix] = field(default_factory=list)
    after_s: list[float] = field(default_factory=list)
    satellites: list[GnssSatellites] = field(default_factory=list)
    steps_s: list[float] = field(default_factory=list)


def sentence(kind: str, second: float) -> bytes:
    clock = f"{12 + int(second // 3600):02d}{int(second // 60) % 60:02d}{second % 60:05.2f}"
    body = SENTENCES[kind].format(t=clock)
    return f"${body}*{reduce(xor, body.encode()):02X}\r\n".encode()


def told(order: Callable[[int], Iterable[str]], seconds: Iterable[float], period_s: float = 1.0) -> StreamResult:
    found = StreamResult(Process(Config()))
    for epoch, second in enumerate(seconds):
        epoch_ns = START_NS + round(epoch * period_s * NS)
        for place, kind in enumerate(order(epoch)):
            received_ns = epoch_ns + round((BEFORE_S + place * STEP_S) * NS)
            raw = GnssRaw(received_ns=received_ns, source="g", data=sentence(kind, second), recorded=True)
            for message in found.process.handle(raw):
                if isinstance(message, GnssFix):
                    found.fixes.append(message)
                    found.after_s.append((received_ns - epoch_ns) / NS)
                elif isinstance(message, GnssSatellites):
                    found.satellites.append(message)
                elif isinstance(message, GnssSignalQuality) and message.time_step_s is not None:
                    found.steps_s.append(message.time_step_s)
    return found


def shuffled(epoch: int) -> list[str]:
    kinds = ["RMC", "GGA", "GST", "VTG", "none", "3-D", "GSV"]
    random.Random(epoch).shuffle(kinds)
    return kinds


@pytest.mark.parametrize(
    "kinds",
    [
        ["none", "3-D", "RMC", "GGA"], ["RMC", "GGA", "none", "3-D"], ["RMC", "none", "GGA", "3-D"],
        ["3-D", "RMC", "none", "GGA"], ["VTG", "GGA", "3-D", "RMC"], ["ZDA", "VTG", "GNS"],
        ["GSV", "3-D", "GGA", "RMC", "VTG"],
    ],
)  # fmt: skip
def test_an_epoch_is_published_within_its_burst_in_any_order(kinds: list[str]) -> None:
    found = told(lambda _: kinds, range(20))
    assert len(found.fixes) == 20
    assert found.after_s[2:] == pytest.approx([BEFORE_S + STEP_S * (len(kinds) - 1)] * 18)
    assert {fix.fix_type for fix in found.fixes} == {FixType.THREE_D}
    assert {b.sampled_ns - a.sampled_ns for a, b in pairwise(found.fixes)} == {NS}


def test_an_order_that_changes_with_every_epoch_costs_no_fix() -> None:
    found = told(shuffled, range(30))
    assert len(found.fixes) == 30
    assert max(found.after_s[2:]) <= BEFORE_S + 6 * STEP_S + 1e-9
    assert {fix.pdop for fix in found.fixes} == {2.2}
    assert {len(satellite.satellites) for satellite in found.satellites} == {3} and len(found.satellites) >= 28


@pytest.mark.parametrize("rate_hz", [5.0, 10.0])
def test_bursts_that_follow_each_other_quickly_are_kept_apart(rate_hz: float) -> None:
    found = told(lambda _: ["3-D", "RMC", "GGA"], [k / rate_hz for k in range(50)], 1.0 / rate_hz)
    assert len(found.fixes) == 50 and max(found.after_s[2:]) < 0.15
    assert {b.sampled_ns - a.sampled_ns for a, b in pairwise(found.fixes)} == {round(NS / rate_hz)}


@pytest.mark.parametrize(
    ("kinds", "fix_type", "pdop"),
    [
        (["RMC", "GGA", "none", "3-D"], FixType.THREE_D, 2.2), (["RMC", "GGA", "3-D", "none"], FixType.THREE_D, 2.2),
        (["RMC", "GGA", "none", "2-D", "none"], FixType.TWO_D, 3.3),
        (["RMC", "GGA", "2-D", "3-D"], FixType.THREE_D, 2.2), (["RMC", "GGA", "none"], FixType.NONE, 99.99),
        (["RMC", "GGA"], FixType.THREE_D, None),
    ],
)  # fmt: skip
def test_the_best_mode_of_all_gsa_decides(kinds: list[str], fix_type: FixType, pdop: float | None) -> None:
    found = told(lambda _: kinds, range(10))
    assert {(fix.fix_type, fix.pdop) for fix in found.fixes} == {(fix_type, pdop)}
    assert all((fix.latitude_deg is None) == (fix_type is FixType.NONE) for fix in found.fixes)


def test_a_receiver_that_sends_gns_and_vtg_gives_fixes_with_speed() -> None:
    found = told(lambda _: ["GNS", "VTG", "ZDA", "HDT"], range(60))
    assert len(found.fixes) == 60
    fix = found.fixes[-1]
    assert fix.ground_speed_m_s == pytest.approx(5.0 * 1852 / 3600) and fix.course_rad == pytest.approx(1.5707963)
    assert (fix.fix_type, fix.carrier_solution, fix.satellites_used) == (FixType.THREE_D, CarrierSolution.FIXED, 18)
    assert (fix.hdop, fix.height_msl_m, fix.height_ellipsoid_m) == (0.6, 500.0, 546.9)
    assert fix.correction_age_s == 1.0
    assert fix.utc_ns == 1_795_521_600 * NS + 59 * NS, "2026-11-24 12:00:59, by ZDA"
    assert not found.process.rejects
    assert {kind.kind: (kind.use, kind.count) for kind in found.process.kinds.table()} == {
        f"NMEA {name}": (MessageUse.USED, 60) for name in ("GNS", "VTG", "ZDA", "HDT")
    }


@pytest.mark.parametrize(
    ("modes", "fix_type", "carrier"),
    [
        ("NNNN", FixType.NONE, CarrierSolution.NONE), ("A", FixType.THREE_D, CarrierSolution.NONE),
        ("NFAN", FixType.THREE_D, CarrierSolution.FLOAT), ("ER", FixType.THREE_D, CarrierSolution.FIXED),
        ("E", FixType.DEAD_RECKONING, CarrierSolution.NONE), ("", FixType.NONE, CarrierSolution.NONE),
        ("S", FixType.NONE, CarrierSolution.NONE),
    ],
)  # fmt: skip
def test_the_best_constellation_of_gns_decides(
    modes: str, fix_type: FixType, carrier: CarrierSolution, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(SENTENCES, "GNS", SENTENCES["GNS"].replace("RRNN", modes))
    found = told(lambda _: ["GNS"], range(5))
    assert {(fix.fix_type, fix.carrier_solution) for fix in found.fixes} == {(fix_type, carrier)}


def test_a_speed_of_vtg_that_is_marked_invalid_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(SENTENCES, "VTG", "GNVTG,90.0,T,,M,5.0,N,9.3,K,N")
    assert {fix.ground_speed_m_s for fix in told(lambda _: ["GGA", "VTG"], range(5)).fixes} == {None}
    monkeypatch.setitem(SENTENCES, "VTG", "GNVTG,90.0,T,,M,,N,9.0,K,A")
    assert {fix.ground_speed_m_s for fix in told(lambda _: ["GGA", "VTG"], range(5)).fixes} == {2.5}


def test_satellites_in_view_have_their_constellation_and_whether_they_are_used() -> None:
    found = told(lambda _: ["RMC", "GGA", "3-D", "GSV", "GLO"], range(10))
    assert len(found.satellites) == 9, "with the burst behind"
    shown = {(s.constellation, s.number): (s.used, s.cn0_db_hz) for s in found.satellites[-1].satellites}
    assert shown == {
        (Constellation.GPS, 1): (True, 46.0), (Constellation.GPS, 2): (True, 41.0),
        (Constellation.SBAS, 120): (False, 38.0), (Constellation.GLONASS, 8): (False, None),
    }  # fmt: skip
    assert found.satellites[-1].sampled_ns == found.fixes[-2].sampled_ns


@pytest.mark.parametrize(
    ("talker", "number", "constellation", "within"),
    [
        ("GP", 32, Constellation.GPS, 32), ("GP", 46, Constellation.SBAS, 133), ("GP", 133, Constellation.SBAS, 133),
        ("GP", 72, Constellation.GLONASS, 8), ("GP", 195, Constellation.QZSS, 3),
        ("GL", 72, Constellation.GLONASS, 8), ("GL", 8, Constellation.GLONASS, 8),
        ("GA", 5, Constellation.GALILEO, 5), ("GA", 305, Constellation.GALILEO, 5),
        ("GB", 45, Constellation.BEIDOU, 45), ("GB", 145, Constellation.BEIDOU, 45),
        ("BD", 202, Constellation.BEIDOU, 2),
        ("GB", 445, Constellation.BEIDOU, 45), ("BD", 70, Constellation.BEIDOU, 70),
        ("GQ", 3, Constellation.QZSS, 3), ("QZ", 195, Constellation.QZSS, 3), ("GQ", 183, Constellation.QZSS, 1),
        ("GI", 9, Constellation.NAVIC, 9),
        ("GN", 7, Constellation.GPS, 7), ("GN", 46, Constellation.SBAS, 133), ("GN", 72, Constellation.GLONASS, 8),
        ("GN", 195, Constellation.QZSS, 3), ("GN", 214, Constellation.BEIDOU, 14),
        ("GN", 305, Constellation.GALILEO, 5),
        ("GN", 414, Constellation.BEIDOU, 14), ("GN", 999, Constellation.UNKNOWN, 999),
    ],
)  # fmt: skip
def test_every_form_of_numbering_gives_the_number_in_the_system(
    talker: str, number: int, constellation: Constellation, within: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(SENTENCES, "GSV", f"{talker}GSV,1,1,01,{number},40,083,46")
    monkeypatch.setitem(SENTENCES, "3-D", f"{talker}GSA,A,3,{number},,,,,,,,,,,,1.9,1.0,1.6")
    (satellite,) = told(lambda _: ["RMC", "GGA", "3-D", "GSV"], range(10)).satellites[-1].satellites
    assert (satellite.constellation, satellite.number, satellite.used) == (constellation, within, True)


@each("step_s", [-1, 1, -3, 18])
@each("kinds", [["RMC", "GGA", "3-D"], ["3-D", "GGA", "RMC"], ["RMC"]])
def test_a_step_of_utc_by_whole_seconds_leaves_the_stamps_even(step_s: int, kinds: list[str]) -> None:
    found = told(lambda _: kinds, [100 + k + (step_s if k >= 10 else 0) for k in range(30)])
    assert len(found.fixes) == 30
    assert {b.sampled_ns - a.sampled_ns for a, b in pairwise(found.fixes)} == {NS}
    assert found.steps_s == [step_s]
    told_utc = [fix.utc_ns for fix in found.fixes]
    assert told_utc[-1] == 1_795_521_600 * NS + (129 + step_s) * NS


def test_lost_and_late_epochs_are_no_step_of_utc() -> None:
    kept = [k for k in range(40) if not 10 <= k < 13]
    process, fixes, steps = Process(Config()), list[GnssFix](), list[GnssSignalQuality]()
    for k in kept:
        delay_s = BEFORE_S + (0.8 if k == 30 else 0.0)
        for place, kind in enumerate(("RMC", "GGA")):
            received_ns = START_NS + round((k + delay_s + place * STEP_S) * NS)
            raw = GnssRaw(received_ns=received_ns, source="g", data=sentence(kind, k), recorded=True)
            for message in process.handle(raw):
                fixes += [message] if isinstance(message, GnssFix) else []
                steps += [message] if isinstance(message, GnssSignalQuality) else []
    assert [(fix.sampled_ns - fixes[0].sampled_ns) / NS for fix in fixes] == pytest.approx(kept, abs=1e-6)
    assert not steps

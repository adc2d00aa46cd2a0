import functools
import operator
from collections import Counter
from datetime import UTC, datetime
from typing import Any

import pynmea2
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyubx2.ubxmessage import UBXMessage

from services.parsers.gnss.nmea.burst import MAX_GSA, USED_SENTENCES, NmeaAssembler, NmeaError, kind_of, time_of_day_ns
from services.parsers.gnss.nmea.epoch import KNOT_M_S, fix_from_sentences
from services.parsers.gnss.nmea.satellites import satellites_of
from services.parsers.gnss.process import Config, Process
from services.parsers.gnss.protocols import FRAMINGS
from shared.messages.gnss import CarrierSolution, FixType, GnssFix, GnssRaw
from shared.messages.operation import MessageUse
from shared.protocols.framing.framer import Framer
from tests.support.cases import each
from tests.support.data import recording

NS = 1_000_000_000


def read(data: bytes) -> list[tuple[GnssFix, dict[str, list[str]]]]:
    """Parse an NMEA stream; return each fix with the fields of its sentences."""
    assembler, rejects, found = NmeaAssembler(), Counter[str](), []
    for frame in Framer(FRAMINGS).feed(data):
        if frame.protocol != "NMEA" or kind_of(frame.data) not in USED_SENTENCES:
            continue
        for epoch in assembler.take(frame.data, 1):
            fix = fix_from_sentences(epoch, sampled_ns=1, source="x", rejects=rejects)
            found.append((fix, {kind: parsed.data for kind, parsed in epoch.sentences.items()}))
    assert not rejects
    return found


@pytest.mark.recording
@pytest.mark.parametrize(
    ("name", "least"), [("ublox-8.log", 70), ("ublox-zed-f9p-nmea.log", 25), ("ublox-zed-f9r.log", 25)]
)
def test_recorded_sentences_are_decoded_by_the_standard(name: str, least: int) -> None:
    found = read((recording(f"gpsd_receiver_logs/{name}")).read_bytes())
    assert len(found) >= least
    for fix, sentences in found:
        rmc, gga = sentences["RMC"], sentences["GGA"]
        latitude = (float(gga[1][:2]) + float(gga[1][2:]) / 60) * (1 if gga[2] == "N" else -1)
        longitude = (float(gga[3][:3]) + float(gga[3][3:]) / 60) * (1 if gga[4] == "E" else -1)
        utc = datetime.strptime(rmc[8] + rmc[0], "%d%m%y%H%M%S.%f").replace(tzinfo=UTC)
        assert fix.fix_type is FixType.THREE_D
        assert (fix.latitude_deg, fix.longitude_deg) == pytest.approx((latitude, longitude), abs=1e-12)
        assert fix.height_msl_m == pytest.approx(float(gga[8]))
        assert fix.height_ellipsoid_m == pytest.approx(float(gga[8]) + float(gga[10]))
        assert fix.satellites_used == int(gga[6])
        assert fix.ground_speed_m_s == pytest.approx(float(rmc[6]) * KNOT_M_S)
        assert fix.utc_ns == round(utc.timestamp() * 1000) * 1_000_000


@pytest.mark.recording
def test_a_receiver_without_a_fix_gives_no_position_and_no_time() -> None:
    found = read((recording("pyubx2_logs/2023-4-17_82912_serial-COM3.ubx")).read_bytes())
    assert len(found) > 80
    assert {(fix.fix_type, fix.latitude_deg, fix.utc_ns) for fix, _ in found} == {(FixType.NONE, None, None)}


def fix_of(*bodies: str, rejects: Counter[str] | None = None) -> GnssFix:
    """The fix of the sentences of one epoch."""
    assembler = NmeaAssembler()
    for body in bodies:
        assert not list(assembler.take(f"${body}*00\r\n".encode(), 1))
    (epoch,) = assembler.take(b"$GNRMC,235959.00,V*00\r\n", 2)
    found = Counter[str]() if rejects is None else rejects
    return fix_from_sentences(epoch, sampled_ns=1, source="x", rejects=found)


RMC = "RMC,010203.50,A,4230.6000,S,01315.3000,W,10.0,90.0,311225,,,R,V"
GGA = "GGA,010203.50,4230.6000,S,01315.3000,W,4,12,1.1,650.5,M,-49.5,M,2.5,0042"
GSA = "GSA,A,3,01,02,03,04,05,06,07,08,09,10,11,12,2.2,1.2,1.9,1"
GST = "GST,010203.50,10.0,2.0,1.0,45.0,1.5,2.5,3.5"


@each("talker", ["GP", "GN", "GL", "GA", "GB", "BD", "GQ", "GI"])
def test_every_field_is_decoded_with_its_unit_for_any_talker(talker: str) -> None:
    fix = fix_of(*(talker + body for body in (RMC, GGA, GSA, GST)))
    assert (fix.fix_type, fix.carrier_solution, fix.differential) == (FixType.THREE_D, CarrierSolution.FIXED, True)
    assert (fix.latitude_deg, fix.longitude_deg) == pytest.approx((-42.51, -13.255), abs=1e-12)
    assert (fix.height_msl_m, fix.height_ellipsoid_m) == (650.5, 601.0)
    assert fix.ground_speed_m_s == pytest.approx(5.144444, abs=1e-6)
    assert fix.course_rad == pytest.approx(1.570796, abs=1e-6)
    assert fix.position_sd_ned_m == (1.5, 2.5, 3.5)
    assert (fix.pdop, fix.hdop, fix.vdop) == (2.2, 1.2, 1.9)
    assert (fix.satellites_used, fix.correction_age_s) == (12, 2.5)
    assert fix.utc_ns == 1_767_142_923 * NS + NS // 2


def test_an_incomplete_position_is_none() -> None:
    for place in (",,,", ",N,,E", "4230.6,,01315.3,", "4230.6,N,,E", "4230.6,X,01315.3,E"):
        assert fix_of(f"GNRMC,000000.00,A,{place},,,311225,,").latitude_deg is None
    rejects = Counter[str]()
    assert fix_of("GNRMC,000000.00,A,42x0.6,N,01315.3,E,,,311225,,", rejects=rejects).latitude_deg is None
    assert fix_of("GNRMC,000000.00,A,9130.6,N,01315.3,E,,,311225,,", rejects=rejects).latitude_deg is None
    assert rejects == {"nmea_field": 2}


@pytest.mark.parametrize("date", ["", "320126", "xx0126", "1"])
def test_an_invalid_date_gives_no_utc(date: str) -> None:
    rejects = Counter[str]()
    assert fix_of(f"GNRMC,000000.00,A,4230.6,N,01315.3,E,,,{date},,", rejects=rejects).utc_ns is None
    assert rejects == ({"nmea_date": 1} if date else {}), "an absent date is none that is wrong"


def test_a_leap_second_is_accepted() -> None:
    fix = fix_of("GNRMC,235960.00,A,4230.6,N,01315.3,E,,,311216,,")
    assert fix.utc_ns == 1_483_228_800 * NS  # POSIX repeats it


@pytest.mark.parametrize("sentence", [b"$GNRMC,1*2*00\r\n", b"$GNGSA,*,*00\r\n"])
def test_a_sentence_rejected_by_pynmea2_raises_nmea_form(sentence: bytes) -> None:
    with pytest.raises(NmeaError, match="nmea_form"):
        list(NmeaAssembler().take(sentence, 1))


@pytest.mark.parametrize(
    ("body", "kind", "use"),
    [
        ("PGRME,A", "PGRME", MessageUse.UNUSED), ("PUBX,04,000000.00", "PUBX04", MessageUse.UNUSED),
        ("GNTXT,1", "TXT", MessageUse.UNUSED), ("GNXYZ,1", "XYZ", MessageUse.UNKNOWN),
        ("RMC,1", "?RMC", MessageUse.UNKNOWN),
    ],
)  # fmt: skip
def test_sentences_that_are_not_used_are_counted(body: str, kind: str, use: MessageUse) -> None:
    process = Process(Config())
    checksum = functools.reduce(operator.xor, body.encode(), 0)
    data = f"${body}*{checksum:02X}\r\n".encode()
    assert not [m for m in process.handle(GnssRaw(received_ns=1, source="g", data=data)) if isinstance(m, GnssFix)]
    assert not process.rejects
    (counted,) = process.kinds.table()
    assert (counted.kind, counted.use, counted.count) == (f"NMEA {kind}", use, 1)


@pytest.mark.parametrize("body", ["GNRMC", "GNRMC,1", "PUBX,00"])
def test_a_used_sentence_without_its_fields_is_rejected_with_its_reason(body: str) -> None:
    process = Process(Config())
    checksum = functools.reduce(operator.xor, body.encode(), 0)
    assert not list(process.handle(GnssRaw(received_ns=1, source="g", data=f"${body}*{checksum:02X}\r\n".encode())))
    (counted,) = process.kinds.table()
    assert (counted.rejected, counted.reason) == (1, next(iter(process.rejects)))


def test_ubx_messages_that_are_not_used_are_counted() -> None:
    process = Process(Config())
    data = UBXMessage("NAV", "NAV-EOE", 0, iTOW=1000).serialize() + UBXMessage("TIM", "TIM-TP", 0).serialize()
    list(process.handle(GnssRaw(received_ns=1, source="g", data=data)))
    uses = {counted.kind: counted.use for counted in process.kinds.table()}
    assert uses == {"UBX NAV-EOE": MessageUse.USED, "UBX TIM-TP": MessageUse.UNUSED}


@pytest.mark.parametrize("text", ["", "12", "126000.00", "240000.00", "aabbcc.dd", "12345", "123x56"])
def test_an_invalid_time_raises_nmea_time(text: str) -> None:
    with pytest.raises(NmeaError, match="nmea_time"):
        time_of_day_ns(text if text != "12345" else "129945")


def test_a_time_of_day_is_decoded_to_the_millisecond() -> None:
    assert time_of_day_ns("010203.456") == (3723 * 1000 + 456) * NS // 1000


@given(st.text(st.characters(codec="ascii", exclude_characters="\r\n*$"), max_size=80))
def test_any_sentence_is_accepted_or_raises_nmea_error(body: str) -> None:
    for kind in ("GNRMC,", "GNGGA,", "GNGSA,", "GNGST,", "PUBX,00,"):
        try:
            for epoch in NmeaAssembler().take(f"${kind}{body}*00\r\n".encode(), 1):
                fix_from_sentences(epoch, sampled_ns=1, source="x", rejects=Counter())
        except NmeaError as fault:
            assert str(fault) in ("nmea_time", "nmea_form")


def test_sentences_without_a_time_of_day_are_kept_in_bounds() -> None:
    assembler = NmeaAssembler()
    sentences = {}
    for body in ("GNRMC,000000.00,A,4230.6,N,01315.3,E,,,311225,,", *["GNGSA,A,3,,,,,,,,,,,,,1.0,1.0,1.0"] * 500):
        for epoch in assembler.take(f"${body}*00\r\n".encode(), 1):
            sentences = epoch.sentences
    for epoch in assembler.take(b"$GNRMC,000001.00,A,4230.6,N,01315.3,E,,,311225,,*00\r\n", 2):
        sentences = epoch.sentences
    assert len(sentences) == 1 + MAX_GSA


CONTENTS = ("", "A", "1", "-1", "nan", "inf", "1e400", "9999.99", "N", "E", "4230.5", "010126", "x")


@given(st.lists(st.sampled_from(CONTENTS), min_size=18, max_size=18))
def test_fields_of_any_content_give_a_fix_or_are_omitted(fields: list[str]) -> None:
    classes: dict[str, Any] = {"RMC": pynmea2.RMC, "GGA": pynmea2.GGA, "GSA0": pynmea2.GSA, "GST": pynmea2.GST,
                               "VTG": pynmea2.VTG, "ZDA": pynmea2.ZDA, "GSV0": pynmea2.GSV}  # fmt: skip
    sentences = {kind: create("GN", kind[:3], ["000000.00", *fields]) for kind, create in classes.items()}
    assembler = NmeaAssembler()
    list(assembler.take(b"$GNRMC,000000.00,V*00\r\n", 1))
    (epoch,) = assembler.take(b"$GNRMC,000001.00,V*00\r\n", 2)
    epoch.sentences.update(sentences)
    fix = fix_from_sentences(epoch, sampled_ns=1, source="x", rejects=Counter())
    assert fix.ground_speed_m_s is None or 0 <= fix.ground_speed_m_s <= 600
    satellites_of(epoch, sampled_ns=1, source="x")
    del epoch.sentences["GGA"]
    epoch.sentences["GNS"] = pynmea2.GNS("GN", "GNS", ["000000.00", *fields])  # type: ignore[no-untyped-call]
    fix_from_sentences(epoch, sampled_ns=1, source="x", rejects=Counter())


@pytest.mark.parametrize("altitude", ["1e300", "9" * 150, "nan", "-1e9", "inf"])
def test_an_implausible_height_is_counted_and_omitted(altitude: str) -> None:
    parser = Process(Config())
    fixes = []
    for second in range(1, 5):
        body = f"GNGGA,12000{second}.00,4807.038,N,01131.000,E,1,08,0.9,{altitude},M,46.9,M,,"
        checksum = functools.reduce(operator.xor, body.encode())
        raw = GnssRaw(received_ns=second * 10**9, source="g", data=f"${body}*{checksum:02X}\r\n".encode())
        fixes += [m for m in parser.handle(raw) if isinstance(m, GnssFix)]
    assert fixes and fixes[0].latitude_deg and fixes[0].height_ellipsoid_m is None
    assert parser.rejects["nmea_field"] >= 1

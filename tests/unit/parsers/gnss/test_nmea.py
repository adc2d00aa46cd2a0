from collections import Counter
from collections.abc import Callable
from typing import Any

import pynmea2
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.parsers.gnss.framer import Framer, Protocol
from services.parsers.gnss.nmea import KNOT_M_S, NmeaAssembler, NmeaError, fix_from_sentences, time_of_day_ns
from shared.messages import FixType, GnssFix
from tests.support.data import recording

NS = 1_000_000_000
theirs: Callable[[str], Any] = pynmea2.parse  # it publishes no types


def read(data: bytes) -> list[tuple[GnssFix, dict[str, list[str]]]]:
    """Parse a stream of NMEA; give each fix with the sentences that it was made of."""
    assembler, rejects, found = NmeaAssembler(), Counter[str](), []
    for frame in Framer().feed(data):
        if frame.protocol is Protocol.NMEA:
            for epoch in assembler.take(frame.data, 1):
                fix = fix_from_sentences(epoch, sampled_ns=1, source="x", rejects=rejects)
                found.append((fix, dict(epoch.sentences)))
    assert not rejects
    return found


@pytest.mark.recording
@pytest.mark.parametrize(
    ("name", "least"), [("ublox-8.log", 70), ("ublox-zed-f9p-nmea.log", 25), ("ublox-zed-f9r.log", 25)]
)
def test_recorded_sentences_are_read_as_pynmea2_reads_them(name: str, least: int) -> None:
    found = read((recording("gpsd_receiver_logs") / name).read_bytes())
    assert len(found) >= least
    for fix, sentences in found:
        rmc, gga = (theirs("$" + ",".join(sentences[kind])) for kind in ("RMC", "GGA"))
        assert fix.fix_type is FixType.THREE_D
        assert (fix.latitude_deg, fix.longitude_deg) == pytest.approx((gga.latitude, gga.longitude), abs=1e-12)
        assert fix.height_msl_m == pytest.approx(float(gga.altitude))
        assert fix.height_ellipsoid_m == pytest.approx(float(gga.altitude) + float(gga.geo_sep))
        assert fix.satellites_used == int(gga.num_sats)
        assert fix.ground_speed_m_s == pytest.approx(float(rmc.spd_over_grnd) * KNOT_M_S)
        assert fix.utc_ns == round(rmc.datetime.timestamp() * 1000) * 1_000_000


@pytest.mark.recording
def test_a_receiver_indoors_gives_no_position_and_no_time() -> None:
    found = read((recording("pyubx2_logs") / "2023-4-17_82912_serial-COM3.ubx").read_bytes())
    assert len(found) > 80
    assert {(fix.fix_type, fix.latitude_deg, fix.utc_ns) for fix, _ in found} == {(FixType.NONE, None, None)}


@pytest.mark.parametrize("text", ["", "12", "126000.00", "240000.00", "aabbcc.dd", "12345", "123x56"])
def test_a_time_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(NmeaError, match="nmea_time"):
        time_of_day_ns(text if text != "12345" else "129945")


def test_a_time_of_day_is_read_to_the_millisecond() -> None:
    assert time_of_day_ns("010203.456") == (3723 * 1000 + 456) * NS // 1000


@given(st.text(st.characters(codec="ascii", exclude_characters="\r\n*$"), max_size=80))
def test_any_sentence_is_taken_or_refused(body: str) -> None:
    for kind in ("GNRMC,", "GNGGA,", "GNGSA,", "GNGST,", ""):
        try:
            for epoch in NmeaAssembler().take(f"${kind}{body}*00\r\n".encode(), 1):
                fix_from_sentences(epoch, sampled_ns=1, source="x", rejects=Counter())
        except NmeaError as fault:
            assert str(fault) == "nmea_time"


CONTENTS = ("", "A", "1", "-1", "nan", "inf", "1e400", "9999.99", "N", "E", "4230.5", "010126", "x")


@given(st.lists(st.sampled_from(CONTENTS), min_size=18, max_size=18))
def test_fields_of_any_content_make_a_fix_or_are_left_out(fields: list[str]) -> None:
    sentences = {kind: [kind, "000000.00", *fields] for kind in ("RMC", "GGA", "GSA0", "GST")}
    assembler = NmeaAssembler()
    list(assembler.take(b"$GNRMC,000000.00,V*00\r\n", 1))
    (epoch,) = assembler.take(b"$GNRMC,000001.00,V*00\r\n", 2)
    epoch.sentences.update(sentences)
    fix = fix_from_sentences(epoch, sampled_ns=1, source="x", rejects=Counter())
    assert fix.ground_speed_m_s is None or 0 <= fix.ground_speed_m_s <= 600

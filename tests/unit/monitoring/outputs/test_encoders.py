"""Sentences and objects: form, length, and what an independent decoder reads from them."""

import json
from functools import reduce
from itertools import pairwise
from operator import xor
from typing import Any

import pynmea2
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.monitoring.outputs import gpsd_reports
from services.monitoring.outputs.nmea import ENCODERS, burst
from services.monitoring.outputs.report import LatestMessages, Report
from shared.messages.gnss import Constellation, Satellite
from shared.messages.navigation import NavigationPhase
from shared.messages.operation import OriginKind
from shared.messages.trust import TrustLevel
from tests.support.outputs import LATITUDE_DEG, LONGITUDE_DEG, fix, origin, satellites, solution, verdict

NS = 1_000_000_000
T = 1_700_000_000 * NS  # 2023-11-14T22:13:20Z
NAMES = tuple(ENCODERS)
OPTIONAL = (gpsd_reports.gst, gpsd_reports.sky, gpsd_reports.att)


def report(state: TrustLevel = TrustLevel.SAFE, kind: OriginKind = OriginKind.LIVE, utc: bool = True,
           seen: int = 12, time_ns: int = T, **changes: object) -> Report:  # fmt: skip
    made = LatestMessages()
    made.add_origin(origin(time_ns, kind), "sensors.gnss", time_ns, retained=False)
    made.add_trust(verdict(time_ns, state))
    made.add_fix(fix(time_ns, time_ns if utc else None))
    made.add_satellites(satellites(time_ns, seen=seen))
    made.add_solution(solution(time_ns, **changes), time_ns, recorded_ns=None)
    return made.report(time_ns)


def lines(made: Report) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for line in burst(made, NAMES).decode().split("\r\n")[:-1]:
        found.setdefault(line[3:6], []).append(line)
    return found


def parsed(line: str) -> Any:
    return pynmea2.parse(line, check=True)  # type: ignore[no-untyped-call]


def test_an_independent_decoder_reads_the_position() -> None:
    found = lines(report())
    gga, rmc = parsed(found["GGA"][0]), parsed(found["RMC"][0])
    assert gga.latitude == pytest.approx(LATITUDE_DEG, abs=1e-8)
    assert gga.longitude == pytest.approx(LONGITUDE_DEG, abs=1e-8)
    assert (gga.gps_qual, float(gga.altitude), float(gga.geo_sep)) == (1, 513.5, 46.5)
    assert rmc.datetime.isoformat() == "2023-11-14T22:13:20+00:00"
    assert rmc.spd_over_grnd == pytest.approx(5.0 * 3600 / 1852, abs=0.005)
    assert rmc.true_course == pytest.approx(53.1)
    assert parsed(found["VTG"][0]).spd_over_grnd_kmph == pytest.approx(18.0)
    assert float(parsed(found["HDT"][0]).heading) == pytest.approx(331.35)
    zda = parsed(found["ZDA"][0])
    assert (zda.day, zda.month, zda.year) == (14, 11, 2023)
    gst = parsed(found["GST"][0])
    assert (gst.std_dev_latitude, gst.std_dev_longitude, gst.std_dev_altitude) == (1.0, 2.0, 3.0)
    assert (gst.std_dev_major, gst.std_dev_minor, gst.orientation) == (2.0, 1.0, 90.0)


@pytest.mark.parametrize(
    ("made", "gga", "rmc"),
    [
        (report(), "1", ("A", "A", "S")),
        (report(TrustLevel.CAUTION), "1", ("A", "A", "C")),
        (report(phase=NavigationPhase.COASTING), "6", ("A", "E", "S")),
        (report(TrustLevel.DEAD_RECKONING), "6", ("A", "E", "C")),
        (report(kind=OriginKind.SIMULATED), "8", ("A", "S", "S")),
        (report(TrustLevel.UNSAFE), "0", ("V", "N", "U")),
        (Report(None), "0", ("V", "N", "V")),
    ],
)
def test_quality_and_verdict_stand_in_gga_and_rmc(made: Report, gga: str, rmc: tuple[str, str, str]) -> None:
    found = lines(made)
    fields = found["RMC"][0].split("*")[0].split(",")
    assert found["GGA"][0].split(",")[6] == gga
    assert (fields[2], *fields[-2:]) == rmc


def test_without_a_fix_no_number_of_a_position_is_sent() -> None:
    found = lines(report(TrustLevel.UNSAFE))
    assert found["GGA"][0].split("*")[0] == "$GNGGA,221320.00,,,,,0,00,,,M,,M,,"
    assert found["RMC"][0].split("*")[0] == "$GNRMC,221320.00,V,,,,,,,141123,,,N,U"
    assert found["VTG"][0].split("*")[0] == "$GNVTG,,T,,M,,N,,K,N"
    assert not found.keys() & {"GST", "HDT"}
    tpv = gpsd_reports.tpv(report(TrustLevel.UNSAFE))
    assert tpv.keys() == {"class", "device", "mode", "time"} and tpv["mode"] == 1


@given(
    latitude=st.floats(-90, 90), longitude=st.floats(-180, 180), height=st.floats(-500, 20_000),
    speed=st.floats(-150, 150), seconds=st.floats(0, 86_400),
)  # fmt: skip
def test_every_sentence_has_its_checksum_and_length(
    latitude: float, longitude: float, height: float, speed: float, seconds: float
) -> None:
    made = report(latitude_deg=latitude, longitude_deg=longitude, height_ellipsoid_m=height,
                  velocity_ned_m_s=(speed, speed, speed), time_ns=T + round(seconds * NS))  # fmt: skip
    for row in lines(made).values():
        for line in row:
            assert len(line) + 2 <= 82
            body, checksum = line[1:].split("*")
            assert reduce(xor, body.encode()) == int(checksum, 16)
            parsed(line)
    gga = parsed(lines(made)["GGA"][0])
    assert gga.latitude == pytest.approx(latitude, abs=1e-8)
    assert gga.longitude == pytest.approx(longitude, abs=1e-8)


def test_minutes_and_seconds_never_show_sixty() -> None:
    found = lines(report(latitude_deg=47.99999999999, time_ns=T - 1))
    fields = found["GGA"][0].split(",")
    assert fields[2] == "4800.000000"
    assert fields[1] == "221320.00"


def test_satellites_of_a_constellation_stand_in_its_own_gsa() -> None:
    found = lines(report())["GSA"]
    assert [line.split("*")[0].split(",")[-1] for line in found] == ["1", "3"]
    assert found[0].split(",")[3:7] == ["01", "03", "05", "07"]
    coasting = lines(report(TrustLevel.DEAD_RECKONING))["GSA"]
    assert len(coasting) == 1 and coasting[0].split(",")[2:4] == ["3", ""]


def test_without_utc_time_is_left_empty_and_zda_is_not_sent() -> None:
    found = lines(report(utc=False))
    assert "ZDA" not in found
    assert found["RMC"][0].split(",")[1] == found["RMC"][0].split(",")[9] == ""
    assert "time" not in gpsd_reports.tpv(report(utc=False))


def test_tpv_holds_95_percent_errors_and_no_null() -> None:
    tpv = gpsd_reports.tpv(report())
    assert None not in tpv.values()
    assert (tpv["status"], tpv["time"]) == (6, "2023-11-14T22:13:20.000Z")
    assert tpv["epy"] == pytest.approx(1.96, abs=1e-3)
    assert tpv["epx"] == pytest.approx(3.92, abs=1e-3)
    assert tpv["epv"] == pytest.approx(5.88, abs=1e-3)
    assert tpv["eph"] == pytest.approx(2.0 * 2.4477, abs=1e-3)
    assert tpv["eps"] == pytest.approx(0.196, abs=1e-3)
    assert tpv["epd"] == pytest.approx(2.2459, abs=1e-3)
    assert tpv["climb"] == 0.5
    assert tpv["altMSL"] == 513.5


@pytest.mark.parametrize(
    ("made", "status"),
    [
        (report(), 6),
        (report(phase=NavigationPhase.COASTING), 5),
        (report(kind=OriginKind.SIMULATED), 8),
        (report(TrustLevel.DEAD_RECKONING, OriginKind.SIMULATED), 8),
        (report(TrustLevel.NO_FIX), None),
    ],
)
def test_status_tells_how_the_position_came_about(made: Report, status: int | None) -> None:
    assert gpsd_reports.tpv(made).get("status") == status


def test_the_longest_sky_fits_and_used_satellites_come_first() -> None:
    rows = tuple(
        Satellite(constellation=Constellation.BEIDOU, number=number, cn0_db_hz=-55.55, elevation_rad=-1.5555,
                  azimuth_rad=6.2831, used=number >= 200, healthy=True)
        for number in range(256)
    )  # fmt: skip
    made = Report(T, satellites=satellites(T).model_copy(update={"satellites": rows}), fix=fix(T, T))
    sky = gpsd_reports.sky(made)
    assert sky is not None
    assert sky["uSat"] == 56
    assert len(gpsd_reports.encoded(sky)) <= gpsd_reports.MAX_LENGTH
    assert gpsd_reports.encoded(sky).endswith(b"}\r\n")


def test_times_round_to_the_next_second() -> None:
    stamps = [gpsd_reports.iso(T + n * 100_000_000 - 1) for n in range(12)]
    assert stamps[0] == "2023-11-14T22:13:20.000Z"
    assert all(later > earlier for earlier, later in pairwise(stamps))


def test_objects_are_json_without_what_is_not_known() -> None:
    for content in (
        gpsd_reports.tpv(Report(None)),
        gpsd_reports.gst(report()),
        gpsd_reports.sky(report()),
        gpsd_reports.att(report()),
    ):
        assert content is not None and "null" not in json.dumps(content)
    assert (
        gpsd_reports.att(Report(None)) is gpsd_reports.gst(Report(None)) is None
        and gpsd_reports.sky(Report(None)) is None
    )

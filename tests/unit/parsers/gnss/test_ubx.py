import math
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyubx2.ubxmessage import UBXMessage
from pyubx2.ubxreader import UBXReader

from services.parsers.gnss import ubx
from services.parsers.gnss.framer import Framer, Protocol
from shared.messages import CarrierSolution, Constellation, FixType
from tests.support.data import recording

RECORDINGS = (
    ("gpsd_receiver_logs", "ublox-zed-f9p-hp.log"),
    ("gpsd_receiver_logs", "ublox-zed-f9p-rtk.log"),
    ("gpsd_receiver_logs", "ublox-zed-f9r.log"),
    ("gpsd_receiver_logs", "ublox-neo-m8l.log"),
    ("gpsd_receiver_logs", "ublox-glo.log"),
    ("pyubx2_logs", "pygpsdata-MIXED.log"),
)
Pair = tuple[bytes, Any]  # pyubx2's messages have attributes that only exist at run time


def encode(name: str, **fields: Any) -> bytes:
    """Let pyubx2 encode the payload of a message that a receiver sends."""
    return bytes(UBXMessage("NAV", name, 0, **fields).payload)


def messages(path: Path, kind: str) -> list[Pair]:
    """Find the payloads of one kind, each with what pyubx2 reads in it."""
    return [
        (frame.data[6:-2], UBXReader.parse(frame.data))
        for frame in Framer().feed(path.read_bytes())
        if frame.protocol is Protocol.UBX and frame.data[2] == ubx.NAV and ubx.KINDS.get(frame.data[3]) == kind
    ]


@pytest.mark.recording
@pytest.mark.parametrize(("folder", "name"), RECORDINGS)
def test_every_recorded_nav_pvt_is_read_as_pyubx2_reads_it(folder: str, name: str) -> None:
    pairs = messages(recording(folder) / name, "PVT")
    assert pairs
    for payload, theirs in pairs:
        ours = ubx.decode_pvt(payload)
        assert ours.itow_ms == theirs.iTOW
        assert ours.calendar == (theirs.year, theirs.month, theirs.day, theirs.hour, theirs.min, theirs.second)
        assert ours.nanosecond == theirs.nano
        assert ours.time_valid == bool(theirs.validDate and theirs.validTime and theirs.fullyResolved)
        assert ours.fix_type is tuple(FixType)[theirs.fixType]
        assert (ours.fix_ok, ours.differential) == (bool(theirs.gnssFixOk), bool(theirs.diffSoln))
        assert ours.carrier_solution is tuple(CarrierSolution)[theirs.carrSoln]
        assert ours.satellites_used == theirs.numSV
        assert ours.velocity_ned_m_s == pytest.approx((theirs.velN / 1e3, theirs.velE / 1e3, theirs.velD / 1e3))
        assert ours.ground_speed_m_s == pytest.approx(theirs.gSpeed / 1e3)
        assert ours.course_rad == pytest.approx(math.radians(theirs.headMot))
        assert ours.speed_sd_m_s == pytest.approx(theirs.sAcc / 1e3)
        if ours.position is not None:
            assert ours.position.latitude_deg == pytest.approx(theirs.lat, abs=1e-10)
            assert ours.position.longitude_deg == pytest.approx(theirs.lon, abs=1e-10)
            assert ours.position.height_ellipsoid_m == pytest.approx(theirs.height / 1e3)
            assert ours.position.height_msl_m == pytest.approx(theirs.hMSL / 1e3)


@pytest.mark.recording
@pytest.mark.parametrize(("folder", "name"), RECORDINGS)
def test_every_recorded_nav_sat_is_read_as_pyubx2_reads_it(folder: str, name: str) -> None:
    pairs = messages(recording(folder) / name, "SAT")
    assert pairs
    for payload, theirs in pairs:
        ours = ubx.decode_satellites(payload)
        assert len(ours) == theirs.numSvs
        for i, satellite in enumerate(ours, 1):
            field = {
                key: getattr(theirs, f"{key}_{i:02}") for key in ("svId", "cno", "elev", "azim", "prRes", "svUsed")
            }
            assert satellite.number == field["svId"]
            assert (satellite.cn0_db_hz or 0) == field["cno"]
            assert satellite.used == bool(field["svUsed"])
            if satellite.elevation_rad is not None and satellite.azimuth_rad is not None:
                assert math.degrees(satellite.elevation_rad) == pytest.approx(field["elev"])
                assert math.degrees(satellite.azimuth_rad) == pytest.approx(field["azim"])
            if satellite.used:
                assert satellite.residual_m == pytest.approx(field["prRes"])


@pytest.mark.recording
def test_recorded_dop_and_high_precision_are_read_as_pyubx2_reads_them() -> None:
    path = recording("gpsd_receiver_logs") / "ublox-zed-f9p-hp.log"
    for payload, theirs in messages(path, "DOP"):
        dop = ubx.decode_dop(payload)
        assert (dop.pdop, dop.vdop, dop.hdop) == pytest.approx((theirs.pDOP, theirs.vDOP, theirs.hDOP))
    for payload, theirs in messages(path, "HPPOSLLH"):
        position = ubx.decode_high_precision(payload).position
        assert position is not None
        assert position.latitude_deg == pytest.approx(theirs.lat, abs=1e-9)  # pyubx2 adds the 1e-9 part itself
        assert position.longitude_deg == pytest.approx(theirs.lon, abs=1e-9)
        assert position.height_ellipsoid_m == pytest.approx(theirs.height / 1e3, abs=1e-3)
        assert position.horizontal_sd_m == pytest.approx(theirs.hAcc / 1e3)


def covariance(**fields: float) -> bytes:
    values: dict[str, Any] = {"posCovValid": 1,
              "velCovValid": 1, "posCovNN": 4.0, "posCovEE": 9.0, "posCovDD": 16.0, "posCovNE": 1.0,
              "velCovNN": 0.01, "velCovEE": 0.02, "velCovDD": 0.03, **fields}  # fmt: skip
    return encode("NAV-COV", iTOW=1, **values)


def test_a_covariance_comes_as_the_upper_triangle() -> None:
    decoded = ubx.decode_covariance(covariance())
    assert decoded.position_ned_m2 == (4.0, 1.0, 0.0, 9.0, 0.0, 16.0)
    assert decoded.velocity_ned_m2_s2 == pytest.approx((0.01, 0, 0, 0.02, 0, 0.03))


def test_a_covariance_that_is_not_valid_is_missing() -> None:
    decoded = ubx.decode_covariance(covariance(posCovValid=0, velCovValid=0))
    assert decoded.position_ned_m2 is None
    assert decoded.velocity_ned_m2_s2 is None


@pytest.mark.parametrize("field", [{"posCovNN": math.nan}, {"posCovNE": 7.0}, {"velCovDD": 0.0}, {"posCovEE": -1.0}])
def test_a_matrix_that_is_no_covariance_is_refused(field: dict[str, float]) -> None:
    with pytest.raises(ubx.UbxError, match="covariance"):
        ubx.decode_covariance(covariance(**field))


def test_what_a_receiver_does_not_know_is_missing() -> None:
    payload = encode("NAV-PVT", lat=0, lon=0, hAcc=0xFFFFFFFF, vAcc=0, sAcc=0, pDOP=99.99)
    pvt = ubx.decode_pvt(payload)
    assert pvt.position is not None
    assert (pvt.position.horizontal_sd_m, pvt.position.vertical_sd_m, pvt.speed_sd_m_s, pvt.pdop) == (None,) * 4
    assert pvt.correction_age_s is None


@pytest.mark.parametrize("fields", [{"lat": 91.0}, {"lon": -181.0}, {"height": 2_000_000_000}, {"invalidLlh": 1}])
def test_a_position_that_is_none_is_missing(fields: dict[str, float]) -> None:
    assert ubx.decode_pvt(encode("NAV-PVT", **fields)).position is None


def test_satellites_without_a_place_in_the_sky_have_none() -> None:
    payload = struct.pack("<IBB2xBBBbhhI", 0, 1, 1, 6, 255, 0, -91, 0, 0, 0)
    (satellite,) = ubx.decode_satellites(payload)
    assert satellite.constellation is Constellation.GLONASS
    assert (satellite.elevation_rad, satellite.azimuth_rad, satellite.cn0_db_hz) == (None, None, None)


@given(st.sampled_from(sorted(set(ubx.KINDS.values()))), st.binary(max_size=120))
def test_any_payload_is_decoded_or_refused(kind: str, payload: bytes) -> None:
    decoders: dict[str, Callable[[bytes], object]] = {
        "PVT": ubx.decode_pvt,
        "DOP": ubx.decode_dop,
        "COV": ubx.decode_covariance,
        "HPPOSLLH": ubx.decode_high_precision,
        "SAT": ubx.decode_satellites,
        "EOE": lambda data: ubx.itow_ms("EOE", data),
    }
    try:
        assert decoders[kind](payload) is not None
    except ubx.UbxError as fault:
        assert str(fault)

import contextlib
import math
import struct
from collections import Counter
from collections.abc import Callable
from dataclasses import astuple
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyubx2.ubxmessage import UBXMessage
from pyubx2.ubxreader import UBXReader
from pyubx2.ubxtypes_core import UBX_MSGIDS

from services.parsers.gnss.gnss_time import utc_ns
from services.parsers.gnss.protocols import FRAMINGS
from services.parsers.gnss.ubx import messages
from services.parsers.gnss.ubx.epoch import DECODERS, EpochAssembler
from shared.maths.dates import GPS_EPOCH_UTC_NS
from shared.maths.earth import Geodetic, ecef_from_geodetic, ned_from_ecef
from shared.messages.gnss import CarrierSolution, Constellation, FixType, GnssSignal, SignalQuality
from shared.protocols.framing.framer import Framer
from tests.support.data import recording

RECORDINGS = (
    ("gpsd_receiver_logs", "ublox-zed-f9p-hp.log"),
    ("gpsd_receiver_logs", "ublox-zed-f9p-rtk.log"),
    ("gpsd_receiver_logs", "ublox-zed-f9r.log"),
    ("gpsd_receiver_logs", "ublox-neo-m8l.log"),
    ("gpsd_receiver_logs", "ublox-glo.log"),
    ("pyubx2_logs", "pygpsdata-MIXED.log"),
)
Pair = tuple[bytes, Any]  # messages have attributes that only exist at run time

# Layout and names of the fields by the interface description, independent of pyubx2.
PVT = struct.Struct("<IH5BBIi4B4iII4iiIIHH")
PVT_FIELDS = (
    "iTOW year month day hour min second valid tAcc nano fixType flags flags2 numSV lon lat height hMSL hAcc vAcc "
    "velN velE velD gSpeed headMot sAcc headAcc pDOP flags3"
)
DOP = struct.Struct("<I7H")
DOP_FIELDS = "iTOW gDOP pDOP tDOP vDOP hDOP nDOP eDOP"
HPPOSLLH = struct.Struct("<B2xBI4i4bII")
HPPOSLLH_FIELDS = "version flags iTOW lon lat height hMSL lonHp latHp heightHp hMSLHp hAcc vAcc"
COV = struct.Struct("<IBBB9x12f")


def encode(name: str, **fields: Any) -> bytes:
    """Encode the payload of an output message with pyubx2."""
    return bytes(UBXMessage("NAV", name, 0, **fields).payload)


def decode(kind: str, payload: bytes) -> Any:
    """Decode as an epoch does, which reads the time of week first."""
    messages.itow_of(kind, payload)
    return DECODERS[kind][1](payload)


def decode_pvt(payload: bytes) -> messages.Pvt:
    return cast(messages.Pvt, decode("PVT", payload))


def decode_covariance(payload: bytes) -> messages.Covariance:
    return cast(messages.Covariance, decode("COV", payload))


def unpack(layout: struct.Struct, names: str, payload: bytes) -> Any:
    """Decode a payload with the tables above."""
    return SimpleNamespace(**dict(zip(names.split(), layout.unpack_from(payload), strict=True)))


def recorded(path: Path, kind: str) -> list[Pair]:
    """The payloads of one kind, each with the message parsed by pyubx2."""
    return [
        (frame.data[6:-2], UBXReader.parse(frame.data))
        for frame in Framer(FRAMINGS).feed(path.read_bytes())
        if frame.protocol == "UBX" and UBX_MSGIDS.get(frame.data[2:4]) == f"NAV-{kind}"
    ]


@pytest.mark.recording
@pytest.mark.parametrize(("folder", "name"), RECORDINGS)
def test_every_recorded_nav_pvt_is_decoded_by_the_interface_description(folder: str, name: str) -> None:
    pairs = recorded(recording(folder) / name, "PVT")
    assert pairs
    for payload, _ in pairs:
        ours, theirs = decode_pvt(payload), unpack(PVT, PVT_FIELDS, payload)
        assert ours.itow_ms == theirs.iTOW
        calendar = theirs.year, theirs.month, theirs.day, theirs.hour, theirs.min, theirs.second
        assert ours.utc_ns == utc_ns(calendar, theirs.nano)
        assert ours.time_valid == (theirs.valid & 7 == 7)
        assert ours.fix_type is tuple(FixType)[theirs.fixType]
        assert (ours.fix_ok, ours.differential) == (bool(theirs.flags & 1), bool(theirs.flags & 2))
        assert ours.carrier_solution is tuple(CarrierSolution)[theirs.flags >> 6]
        assert ours.satellites_used == theirs.numSV
        assert ours.velocity_ned_m_s == pytest.approx((theirs.velN / 1e3, theirs.velE / 1e3, theirs.velD / 1e3))
        assert ours.ground_speed_m_s == pytest.approx(theirs.gSpeed / 1e3)
        assert ours.course_rad == pytest.approx(math.radians(theirs.headMot / 1e5))
        assert ours.speed_sd_m_s == pytest.approx(theirs.sAcc / 1e3)
        if ours.position is not None:
            assert ours.position.latitude_deg == pytest.approx(theirs.lat / 1e7, abs=1e-10)
            assert ours.position.longitude_deg == pytest.approx(theirs.lon / 1e7, abs=1e-10)
            assert ours.position.height_ellipsoid_m == pytest.approx(theirs.height / 1e3)
            assert ours.position.height_msl_m == pytest.approx(theirs.hMSL / 1e3)


@pytest.mark.recording
@pytest.mark.parametrize(("folder", "name"), RECORDINGS)
def test_every_recorded_nav_sat_is_decoded_as_by_pyubx2(folder: str, name: str) -> None:
    pairs = recorded(recording(folder) / name, "SAT")
    assert pairs
    for payload, theirs in pairs:
        ours = messages.decode_satellites(payload)
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
            assert satellite.quality is tuple(SignalQuality)[min(getattr(theirs, f"qualityInd_{i:02}"), 5)]
            assert satellite.healthy == {1: True, 2: False}.get(getattr(theirs, f"health_{i:02}"))
            assert satellite.orbit_known == (getattr(theirs, f"orbitSource_{i:02}") > 0)


def matches_pyubx2(ours: tuple[GnssSignal, ...], theirs: Any) -> bool:
    """Compare the signals of UBX-NAV-SIG one by one."""

    def fields(i: int) -> list[Any]:
        names = ("svId", "cno", "prUsed", "crUsed", "doUsed", "prCorrUsed", "health")
        return [getattr(theirs, f"{name}_{i:02}") for name in names]

    health = {None: 0, True: 1, False: 2}
    codes = messages.SIGNALS
    return len(ours) == theirs.numSigs and all(
        [gnss_signal.number, gnss_signal.cn0_db_hz or 0, gnss_signal.pseudorange_used,
        gnss_signal.carrier_phase_used, gnss_signal.doppler_used, gnss_signal.corrected,
         health[gnss_signal.healthy]] == fields(i)
        and gnss_signal.quality is tuple(SignalQuality)[min(getattr(theirs, f"qualityInd_{i:02}"), 5)]
        and (gnss_signal.residual_m is None or math.isclose(gnss_signal.residual_m, getattr(theirs,
        f"prRes_{i:02}"), abs_tol=1e-9))
        and codes.get((getattr(theirs, f"gnssId_{i:02}"), getattr(theirs, f"sigId_{i:02}"))) == gnss_signal.signal
        for i, gnss_signal in enumerate(ours, 1)
    )  # fmt: skip


def test_signals_written_by_pyubx2_are_decoded() -> None:
    payload = encode(
        "NAV-SIG", iTOW=1000, version=0, numSigs=2, gnssId_01=0, svId_01=7, sigId_01=3, prRes_01=-1.5, cno_01=41,
        qualityInd_01=7, health_01=1, prUsed_01=1, crUsed_01=1, doUsed_01=1, prCorrUsed_01=1,
        gnssId_02=2, svId_02=11, sigId_02=6, cno_02=0, qualityInd_02=1,
    )  # fmt: skip
    first, second = messages.decode_signals(payload)
    assert first == GnssSignal(
        constellation=Constellation.GPS, number=7, signal="2L", cn0_db_hz=41.0, quality=SignalQuality.CARRIER_LOCKED,
        healthy=True, residual_m=-1.5, pseudorange_used=True, carrier_phase_used=True, doppler_used=True,
        corrected=True,
    )  # fmt: skip
    assert second == GnssSignal(
        constellation=Constellation.GALILEO, number=11, signal="7Q", quality=SignalQuality.SEARCHING,
        pseudorange_used=False, carrier_phase_used=False, doppler_used=False, corrected=False,
    )  # fmt: skip


@pytest.mark.recording
@pytest.mark.parametrize(
    ("folder", "name", "least"),
    [
        ("gpsd_receiver_logs", "ublox-zed-f9r.log", 30),
        ("gpsd_receiver_logs", "ublox-glo.log", 30),
        ("pyubx2_logs", "pygpsdata-ALL.log", 1),
    ],
)
def test_every_recorded_nav_sig_is_decoded_as_by_pyubx2(folder: str, name: str, least: int) -> None:
    pairs = recorded(recording(folder) / name, "SIG")
    assert len(pairs) >= least
    assert all(matches_pyubx2(messages.decode_signals(payload), theirs) for payload, theirs in pairs)


@pytest.mark.recording
def test_recorded_dop_and_high_precision_are_decoded_by_the_interface_description() -> None:
    path = recording("gpsd_receiver_logs/ublox-zed-f9p-hp.log")
    for payload, _ in recorded(path, "DOP"):
        dop, theirs = messages.decode_dop(payload), unpack(DOP, DOP_FIELDS, payload)
        assert (dop.pdop, dop.vdop, dop.hdop) == pytest.approx(
            (theirs.pDOP / 100, theirs.vDOP / 100, theirs.hDOP / 100)
        )
    for payload, _ in recorded(path, "HPPOSLLH"):
        position, theirs = messages.decode_high_precision(payload), unpack(HPPOSLLH, HPPOSLLH_FIELDS, payload)
        assert position is not None
        assert position.latitude_deg == pytest.approx(theirs.lat / 1e7 + theirs.latHp / 1e9, abs=1e-10)
        assert position.longitude_deg == pytest.approx(theirs.lon / 1e7 + theirs.lonHp / 1e9, abs=1e-10)
        assert position.height_ellipsoid_m == pytest.approx(theirs.height / 1e3 + theirs.heightHp / 1e4, abs=1e-9)
        assert position.horizontal_sd_m == pytest.approx(theirs.hAcc / 1e4)


def pvt_bytes(*, pvt_flags: int = 0b01_0_000_11, flags3: int = 0b0110, size: int = 92) -> bytes:
    payload = PVT.pack(
        396_018_250, 2026, 1, 2, 3, 4, 5, 7, 21, -123_456, 3, pvt_flags, 0xE0, 17, -132_500_001, 425_000_002, 700_003,
        650_004, 1_005, 2_006, 3_007, -4_008, 5_009, 5_010, 306_86990, 111, 1_234_567, 234, flags3,
    )  # fmt: skip
    return (payload + bytes(92 - PVT.size))[:size]


def test_every_field_of_nav_pvt_is_decoded_with_its_unit() -> None:
    pvt = decode_pvt(pvt_bytes())
    assert (pvt.itow_ms, pvt.utc_ns) == (396_018_250, utc_ns((2026, 1, 2, 3, 4, 5), -123_456))
    assert (pvt.time_valid, pvt.fix_ok, pvt.differential) == (True, True, True)
    assert (pvt.fix_type, pvt.carrier_solution) == (FixType.THREE_D, CarrierSolution.FLOAT)
    assert pvt.satellites_used == 17
    assert pvt.position is not None
    assert astuple(pvt.position) == pytest.approx((42.5000002, -13.2500001, 700.003, 650.004, 1.005, 2.006), rel=1e-12)
    assert pvt.velocity_ned_m_s == pytest.approx((3.007, -4.008, 5.009))
    assert (pvt.ground_speed_m_s, pvt.speed_sd_m_s, pvt.pdop) == pytest.approx((5.010, 0.111, 2.34))
    assert pvt.course_rad == pytest.approx(math.radians(306.8699))
    assert pvt.correction_age_s == 5  # class 3


def test_the_shorter_nav_pvt_of_generation_7_has_no_flags3() -> None:
    assert decode_pvt(pvt_bytes(flags3=0b0101)).position is None
    old = decode_pvt(pvt_bytes(flags3=0b0101, size=84))
    assert old.position is not None
    assert (old.correction_age_s, old.pdop) == (None, 2.34)
    with pytest.raises(messages.UbxError, match="short"):
        decode_pvt(pvt_bytes(size=77))


@pytest.mark.parametrize(("flags", "solution"), [(0x41, "float"), (0x81, "fixed"), (0xC1, "none"), (0x01, "none")])
def test_the_carrier_solution_follows_from_the_flags_of_nav_pvt(flags: int, solution: str) -> None:
    assert decode_pvt(pvt_bytes(pvt_flags=flags)).carrier_solution is CarrierSolution(solution)


def test_every_field_of_nav_dop_is_decoded_with_its_unit() -> None:
    dop = decode("DOP", DOP.pack(250, 1, 202, 3, 304, 405, 9999, 0))
    assert (dop.pdop, dop.vdop, dop.hdop) == pytest.approx((2.02, 3.04, 4.05))
    assert (dop.gdop, dop.tdop) == pytest.approx((0.01, 0.03))


def test_every_field_of_nav_cov_is_decoded_with_its_unit() -> None:
    position, velocity = (4.0, 1.0, 0.5, 9.0, -0.25, 16.0), (8.0, 2.0, 1.0, 18.0, -0.5, 32.0)
    decoded = decode_covariance(COV.pack(250, 0, 1, 1, *position, *velocity))
    assert decoded == messages.Covariance(position, velocity)
    assert decode_covariance(COV.pack(250, 0, 0, 1, *position, *velocity)) == messages.Covariance(None, velocity)
    with pytest.raises(messages.UbxError, match="short"):
        decode_covariance(COV.pack(250, 0, 1, 1, *position, *velocity)[:-1])


def test_every_field_of_nav_hpposllh_is_decoded_with_its_unit() -> None:
    def payload(flags: int, accuracy: int) -> bytes:
        return HPPOSLLH.pack(0, flags, 250, -132_500_000, 425_000_001, 700_001, 650_001, -45, 23, -3, 4, 141, accuracy)

    decoded = messages.decode_high_precision(payload(0, 200))
    expected = (42.500000123, -13.250000045, 700.0007, 650.0014, 0.0141, 0.02)
    assert decoded is not None
    assert astuple(decoded) == pytest.approx(expected, rel=0, abs=1e-10)
    assert messages.decode_high_precision(payload(1, 200)) is None
    unknown = messages.decode_high_precision(payload(0, 0xFFFFFFFF))
    assert unknown is not None
    assert unknown.horizontal_sd_m == pytest.approx(0.0141)
    assert unknown.vertical_sd_m is None


@pytest.mark.parametrize("kind", ["EOE", "DOP", "SAT", "SIG"])
def test_a_time_of_week_beyond_the_week_is_rejected(kind: str) -> None:
    def itow_ms(value: int) -> int:
        payload = struct.pack("<I14x", value)
        return messages.itow_ms(payload) if kind in ("SAT", "SIG") else messages.itow_of(kind, payload)

    assert itow_ms(604_799_999) == 604_799_999
    with pytest.raises(messages.UbxError, match="time_of_week"):
        itow_ms(604_800_000)


def covariance(**fields: float) -> bytes:
    values: dict[str, Any] = {"posCovValid": 1,
              "velCovValid": 1, "posCovNN": 4.0, "posCovEE": 9.0, "posCovDD": 16.0, "posCovNE": 1.0,
              "velCovNN": 0.01, "velCovEE": 0.02, "velCovDD": 0.03, **fields}  # fmt: skip
    return encode("NAV-COV", iTOW=1, **values)


def test_a_covariance_is_decoded_as_its_upper_triangle() -> None:
    decoded = decode_covariance(covariance())
    assert decoded.position_ned_m2 == (4.0, 1.0, 0.0, 9.0, 0.0, 16.0)
    assert decoded.velocity_ned_m2_s2 == pytest.approx((0.01, 0, 0, 0.02, 0, 0.03))


def test_a_covariance_marked_invalid_is_none() -> None:
    decoded = decode_covariance(covariance(posCovValid=0, velCovValid=0))
    assert decoded.position_ned_m2 is None
    assert decoded.velocity_ned_m2_s2 is None


@pytest.mark.parametrize("field", [{"posCovNN": math.nan}, {"posCovNE": 7.0}, {"velCovDD": 0.0}, {"posCovEE": -1.0}])
def test_a_covariance_that_is_not_positive_definite_is_rejected(field: dict[str, float]) -> None:
    with pytest.raises(messages.UbxError, match="covariance"):
        decode_covariance(covariance(**field))


def test_unknown_values_are_none() -> None:
    payload = encode("NAV-PVT", lat=0, lon=0, hAcc=0xFFFFFFFF, vAcc=0, sAcc=0, pDOP=99.99)
    pvt = decode_pvt(payload)
    assert pvt.position is not None
    assert (pvt.position.horizontal_sd_m, pvt.position.vertical_sd_m, pvt.speed_sd_m_s, pvt.pdop) == (None,) * 4
    assert pvt.correction_age_s is None


@pytest.mark.parametrize("fields", [{"lat": 91.0}, {"lon": -181.0}, {"height": 2_000_000_000}, {"invalidLlh": 1}])
def test_an_invalid_position_is_none(fields: dict[str, float]) -> None:
    assert decode_pvt(encode("NAV-PVT", **fields)).position is None


def test_satellites_without_a_direction_have_none() -> None:
    payload = struct.pack("<IBB2xBBBbhhI", 0, 1, 1, 6, 255, 0, -91, 0, 0, 0)
    (satellite,) = messages.decode_satellites(payload)
    assert satellite.constellation is Constellation.GLONASS
    assert (satellite.elevation_rad, satellite.azimuth_rad, satellite.cn0_db_hz) == (None, None, None)


@given(st.sampled_from(sorted(messages.SIZES)), st.binary(max_size=120))
def test_any_payload_is_decoded_or_raises_ubx_error(kind: str, payload: bytes) -> None:
    with contextlib.suppress(messages.UbxError):
        assert 0 <= messages.itow_of(kind, payload) < messages.WEEK_MS
        if kind != "EOE":
            decode(kind, payload)


@given(st.sampled_from([messages.decode_satellites, messages.decode_signals]), st.binary(max_size=120))
def test_any_list_is_decoded_or_raises_ubx_error(
    decoder: Callable[[bytes], tuple[object, ...]], payload: bytes
) -> None:
    with contextlib.suppress(messages.UbxError):
        assert len(decoder(payload)) == payload[5]


GOOD_LINE = {"version": 1, "iTOW": 1000, "relPosLength": 120, "relPosHeading": 12.3, "accHeading": 0.2, "gnssFixOK": 1,
             "relPosValid": 1, "isMoving": 1, "relPosHeadingValid": 1, "carrSoln": 2}  # fmt: skip


def baseline(**changes: int) -> messages.Baseline:
    return messages.decode_baseline(encode("NAV-RELPOSNED", **{**GOOD_LINE, **changes}))


def test_the_baseline_of_two_antennas_on_the_vehicle_gives_a_heading() -> None:
    line = baseline()
    assert line.length_m == pytest.approx(1.2)
    assert line.heading_rad == pytest.approx(math.radians(12.3))
    assert line.heading_sd_rad == pytest.approx(math.radians(0.2))


@pytest.mark.parametrize(
    "flag", ["gnssFixOK", "relPosValid", "isMoving", "relPosHeadingValid", "carrSoln", "accHeading"]
)
def test_a_baseline_with_a_missing_validity_flag_gives_no_heading(flag: str) -> None:
    line = baseline(**{flag: 1 if flag == "carrSoln" else 0})
    assert line == messages.Baseline(None, None, None)


def test_the_older_messages_are_decoded_as_by_pyubx2() -> None:
    place, velocity = (48.1, 11.6, 520.0), (3.0, -4.0, 0.5)
    ecef = ecef_from_geodetic(Geodetic(math.radians(place[0]), math.radians(place[1]), place[2]))
    velocity_e = ned_from_ecef(math.radians(place[0]), math.radians(place[1])).T @ velocity
    x, y, z = (round(value * 100) for value in ecef)
    v_x, v_y, v_z = (round(float(value) * 100) for value in velocity_e)
    solution = messages.decode_solution(
        encode("NAV-SOL", iTOW=1, gpsFix=3, gpsfixOK=1, diffSoln=1, ecefX=x, ecefY=y, ecefZ=z, pAcc=173, ecefVX=v_x,
               ecefVY=v_y, ecefVZ=v_z, sAcc=20, pDOP=1.5, numSV=9)
    )  # fmt: skip
    assert solution.status == messages.Status(FixType.THREE_D, True, True)
    assert solution.position is not None
    assert (solution.position.latitude_deg, solution.position.longitude_deg) == pytest.approx(place[:2], abs=1e-7)
    assert solution.position.height_ellipsoid_m == pytest.approx(place[2], abs=0.01)
    assert solution.position.vertical_sd_m == pytest.approx(1.73 / math.sqrt(3))
    assert solution.motion is not None
    assert solution.motion.velocity_ned_m_s == pytest.approx(velocity, abs=0.02)
    assert (solution.satellites_used, solution.pdop, solution.motion.speed_sd_m_s) == pytest.approx((9, 1.5, 0.2))
    motion = messages.decode_velocity(
        encode("NAV-VELNED", iTOW=1, velN=300, velE=-400, velD=50, gSpeed=500, heading=306.87, sAcc=20)
    )
    assert motion.velocity_ned_m_s == pytest.approx(velocity)
    assert (motion.ground_speed_m_s, motion.course_rad) == pytest.approx((5.0, math.radians(306.87)))
    position = messages.decode_position(encode("NAV-POSLLH", lat=48.1, lon=11.6, height=520000, hMSL=473000, hAcc=1500))
    assert position is not None
    assert astuple(position) == pytest.approx((48.1, 11.6, 520.0, 473.0, 1.5, None))
    assert messages.decode_status(encode("NAV-STATUS", gpsFix=2, gpsFixOk=1)) == messages.Status(
        FixType.TWO_D, True, False
    )
    assert messages.decode_time_utc(
        encode("NAV-TIMEUTC", nano=-5, year=2026, month=11, day=25, hour=1, min=2, sec=3, validUTC=1)
    ) == (utc_ns((2026, 11, 25, 1, 2, 3), -5), True)


def test_a_solution_without_a_place_on_earth_has_no_position() -> None:
    solution = messages.decode_solution(encode("NAV-SOL", iTOW=1, gpsFix=0))
    assert (solution.status.fix_type, solution.position, solution.motion) == (FixType.NONE, None, None)


def test_time_of_gps_and_of_utc_agree() -> None:
    utc = utc_ns((2026, 11, 25, 1, 2, 3), 0)
    assert utc is not None
    gps_s = (utc - GPS_EPOCH_UTC_NS) // 1_000_000_000 + 18
    payload = encode(
        "NAV-TIMEGPS", iTOW=gps_s % 604800 * 1000, week=gps_s // 604800, leapS=18, towValid=1, weekValid=1,
        leapSValid=1,
    )  # fmt: skip
    assert messages.decode_time_gps(payload) == (utc, True)


def test_nav_pvat_and_nav_pl_are_decoded_as_by_pyubx2() -> None:
    pvt = messages.decode_pvat(
        encode(
            "NAV-PVAT", iTOW=5, validDate=1, validTime=1, fullyResolved=1, year=2026, month=1, day=2, hour=3, min=4,
            sec=5, nano=7, fixType=4, gnssFixOK=1, diffSoln=1, carrSoln=2, numSV=21, lat=48.1, lon=11.6, height=520000,
            hMSL=473000, hAcc=1000, vAcc=2000, velN=3000, velE=-4000, velD=500, gSpeed=5000, sAcc=100,
            motHeading=306.87,
        )
    )  # fmt: skip
    assert pvt.position is not None
    assert astuple(pvt.position) == pytest.approx((48.1, 11.6, 520.0, 473.0, 1.0, 2.0))
    assert (pvt.utc_ns, pvt.time_valid, pvt.fix_ok) == (utc_ns((2026, 1, 2, 3, 4, 5), 7), True, True)
    assert (pvt.fix_type, pvt.carrier_solution) == (FixType.GNSS_DEAD_RECKONING, CarrierSolution.FIXED)
    assert pvt.velocity_ned_m_s == pytest.approx((3.0, -4.0, 0.5))
    assert (pvt.ground_speed_m_s, pvt.speed_sd_m_s, pvt.course_rad) == pytest.approx((5.0, 0.1, math.radians(306.87)))
    along = encode("NAV-PL", version=1, plPosValid=1, plPosFrame=2, plPos1=3000, plPos2=4000, plPos3=7000)
    assert messages.decode_levels(along) == messages.Levels(5.0, 7.0)
    ellipse = encode("NAV-PL", version=1, plPosValid=1, plPosFrame=3, plPos1=3000, plPos2=2000, plPos3=7000)
    assert messages.decode_levels(ellipse) == messages.Levels(3.0, 7.0)
    assert messages.decode_levels(encode("NAV-PL", version=1, plPosFrame=1)) == messages.Levels(None, None)
    axes = encode("NAV-PL", version=1, plPosValid=1, plPosFrame=1, plPos1=3000, plPos2=4000, plPos3=7000)
    assert messages.decode_levels(axes) == messages.Levels(5.0, 7.0, (3.0, 4.0, 7.0))


@pytest.mark.parametrize("kind", ["PVT", "PVAT"])
def test_an_epoch_with_a_fix_does_not_wait_for_a_message_that_says_less(kind: str) -> None:
    """NAV-STATUS came once behind the first fix; from the third epoch on a fix is given as it comes."""
    fix = pvt_bytes() if kind == "PVT" else bytes(116)
    assembler, given = EpochAssembler(Counter()), []
    for second in range(4):
        now = struct.pack("<I", 1000 * second)
        given.append(len(list(assembler.take(kind, now + fix[4:], second))))
        if second == 0:
            status = encode("NAV-STATUS", iTOW=0, gpsFix=3, gpsFixOk=1)
            given[-1] += len(list(assembler.take("STATUS", status, second)))
    assert given == [0, 1, 2, 1]

"""Logs of Android's GnssLogger: of three versions of the app, against computed pseudoranges, and damaged lines."""

import csv
import math
from functools import reduce
from itertools import pairwise
from operator import xor
from pathlib import Path

import numpy as np
import pytest

from cli.import_drive.import_drive import body_from_phone, import_drive
from cli.import_drive.readers.gnss_logger import messages_of, read_log
from shared.errors import UserError
from shared.maths.gnss_signals import SPEED_OF_LIGHT
from shared.messages.gnss import Constellation, GnssFix, GnssRawEpoch, GnssSatellites
from shared.messages.imu import ImuSamples
from shared.recording import Recording
from tests.support.cases import each
from tests.support.data import recording

NS = 1_000_000_000
FLAT = body_from_phone("y,x,-z")
UTC_MS, ELAPSED_NS = 1_699_400_000_000, 16_000 * NS
HEADER = """#
# Header Description:
#
# Fix,Provider,LatitudeDegrees,LongitudeDegrees,AltitudeMeters,SpeedMps,AccuracyMeters,BearingDegrees,UnixTimeMillis,\
SpeedAccuracyMps,BearingAccuracyDegrees,elapsedRealtimeNanos,VerticalAccuracyMeters
# Accel,utcTimeMillis,elapsedRealtimeNanos,AccelXMps2,AccelYMps2,AccelZMps2
# Gyro,utcTimeMillis,elapsedRealtimeNanos,GyroXRadPerSec,GyroYRadPerSec,GyroZRadPerSec
# Mag,utcTimeMillis,elapsedRealtimeNanos,MagXMicroT,MagYMicroT,MagZMicroT
# Pressure,utcTimeMillis,elapsedRealtimeNanos,PressureHpa
# Status,UnixTimeMillis,SignalCount,SignalIndex,ConstellationType,Svid,CarrierFrequencyHz,Cn0DbHz,AzimuthDegrees,\
ElevationDegrees,UsedInFix,HasAlmanacData,HasEphemerisData
"""


def sensor(kind: str, k: int, *values: float) -> str:
    """A line 10 ms after the one before, with the phone's two clocks."""
    return f"{kind},{UTC_MS + 10 * k},{ELAPSED_NS + 10_000_000 * k}," + ",".join(map(str, values))


def fix(k: int, provider: str = "GPS", latitude: str = "37.5", speed: str = "12.0") -> str:
    return (
        f"Fix,{provider},{latitude},-122.25,20.0,{speed},4.5,90.0,{UTC_MS + 1000 * k},0.3,2.0,{ELAPSED_NS + k * NS},3.0"
    )


def converted(*lines: str) -> tuple[list[object], dict[str, int]]:
    log = read_log([*HEADER.splitlines(), *lines])
    messages = list[object](messages_of(log, FLAT))
    return messages, dict(log.rejects)


def test_a_fix_has_its_own_fields_and_no_vertical_velocity() -> None:
    (one,), rejects = converted(fix(3))
    assert isinstance(one, GnssFix) and not rejects
    assert (one.latitude_deg, one.longitude_deg, one.height_ellipsoid_m) == (37.5, -122.25, 20.0)
    assert one.ground_speed_m_s == 12.0 and one.course_rad == pytest.approx(math.pi / 2.0)
    assert one.velocity_ned_m_s is None and one.utc_ns == (UTC_MS + 3000) * 1_000_000
    assert one.position_sd_ned_m is not None
    assert one.position_sd_ned_m == pytest.approx((2.981, 2.981, 3.0), abs=1e-3)
    # Of a circular distribution, 68 % are within the accuracy.
    share = np.hypot(*np.random.default_rng(1).normal(0.0, one.position_sd_ned_m[0], (2, 100_000))) < 4.5
    assert share.mean() == pytest.approx(0.68, abs=0.005)


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (fix(1, provider="NLP"), "fix of another provider"),
        (fix(1, latitude="-29co.19"), "fix without position or time"),
        (fix(1, latitude="95.0"), "fix without position or time"),
        (fix(1, latitude="nan"), "fix without position or time"),
        ("Fix,GPS,1.0", "too few fields"),
        ("Humidity,1,2,3,4,5,6,7", "line without header"),
        ("Status,,1,1,1,5,1.5e9,40.0,10.0,20.0,1,1,1", "status without time or satellite"),
    ],
)
def test_a_line_that_cannot_be_used_is_counted_and_the_others_are_kept(line: str, reason: str) -> None:
    found, rejects = converted(line, fix(2))
    assert len(found) == 1 and rejects == {reason: 1}


def test_a_repeated_fix_is_rejected() -> None:
    found, rejects = converted(fix(2), fix(2), fix(3))
    assert len(found) == 2 and rejects == {"fix not later than the previous one": 1}


def test_the_sensors_of_a_phone_that_lies_flat_are_in_body_axes_on_one_clock() -> None:
    lines = [sensor("Accel", 2 * k, 0.5, 1.5, 9.8) for k in range(100)]
    lines += [sensor("Gyro", 2 * k + 1, 0.1, 0.2, 0.3) for k in range(99)]
    lines += [sensor("Mag", 20 * k, 5.0, 20.0, -45.0) for k in range(10)]
    lines += [sensor("Pressure", 20 * k, 1007.0) for k in range(10)] + [fix(1)]
    found, rejects = converted(*lines)
    samples = [message for message in found if isinstance(message, ImuSamples)]
    assert not rejects and sum(len(sample.sampled_ns) for sample in samples) == 99
    first = samples[0]
    assert first.specific_force_body_m_s2[0] == pytest.approx((1.5, 0.5, -9.8))
    assert first.angular_rate_body_rad_s[0] == pytest.approx((0.2, 0.1, -0.3))
    assert first.magnetic_field_body == pytest.approx((0.4, 0.1, 0.9)) and first.pressure_pa == pytest.approx(100_700.0)
    assert first.sampled_ns[0] == (UTC_MS + 10) * 1_000_000, "the sensors' clock by its offset to UTC"
    place = next(message for message in found if isinstance(message, GnssFix))
    assert place.sampled_ns == (UTC_MS + 1000) * 1_000_000
    assert found == sorted(found, key=lambda m: getattr(m, "received_ns"))  # noqa: B009


def test_rates_without_acceleration_are_rejected_instead_of_interpolated_over_a_gap() -> None:
    lines = [sensor("Accel", k, 0.0, 0.0, 9.8) for k in (*range(20), *range(60, 80))]
    lines += [sensor("Gyro", k, 0.0, 0.0, 0.0) for k in range(80)]
    found, rejects = converted(*lines)
    count = sum(len(value.sampled_ns) for value in found if isinstance(value, ImuSamples))
    # The first rate after the gap has its acceleration at the gap's end only.
    assert (count, rejects) == (39, {"inertial: no acceleration at the time of the rate": 41})


def test_status_lines_of_one_time_are_the_satellites_of_one_epoch() -> None:
    (one,), _ = converted(
        f"Status,{UTC_MS},2,0,1,5,1575420032,40.5,10.0,20.0,1,1,1",
        f"Status,{UTC_MS},2,1,6,11,1575420032,,200.0,70.0,0,1,1"
    )  # fmt: skip
    assert isinstance(one, GnssSatellites)
    assert [(s.constellation, s.number, s.cn0_db_hz, s.used) for s in one.satellites] == [
        (Constellation.GPS, 5, 40.5, True), (Constellation.GALILEO, 11, None, False)
    ]  # fmt: skip
    assert one.satellites[1].elevation_rad == pytest.approx(math.radians(70.0))


@pytest.mark.parametrize("axes", ["y,x,z", "x,x,y", "y,x", "up,x,y", ""])
def test_axes_that_are_not_a_right_handed_system_are_an_error_that_says_what_to_try(axes: str) -> None:
    with pytest.raises(UserError, match="try y,x,-z"):
        body_from_phone(axes)


def test_a_log_becomes_a_recording_and_an_empty_one_an_error(tmp_path: Path) -> None:
    log = tmp_path / "gnss_log.txt"
    log.write_text(HEADER + "\n".join(fix(k) for k in range(1, 5)) + "\n")
    import_drive(log, None, tmp_path / "phone.mcap")
    with Recording(tmp_path / "phone.mcap") as file:
        assert [envelope.topic for envelope in file] == ["gnss/fix"] * 4
    log.write_text(HEADER)
    with pytest.raises(UserError, match="holds nothing that can be used"):
        import_drive(log, None, tmp_path / "other.mcap")
    (tmp_path / "notes.txt").write_text("no log\n")
    with pytest.raises(UserError, match="give a mapping"):
        import_drive(tmp_path / "notes.txt", None, tmp_path / "third.mcap")


@pytest.mark.recording
def test_pseudoranges_of_a_recorded_phone_are_those_that_the_decimeter_challenge_computed() -> None:
    folder = recording("gsdc_samples")
    (log_path,) = folder.glob("2023_*gnss_log.txt")
    (oracle_path,) = folder.glob("2023_*device_gnss.csv")
    log = read_log(log_path.read_text().splitlines())
    epochs = [message for message in messages_of(log, FLAT) if isinstance(message, GnssRawEpoch)]
    computed: dict[tuple[int, int], dict[tuple[int, str], float]] = {}
    names = {"GPS_L1_CA": "1C", "GPS_L5_Q": "5Q", "GAL_E1_C_P": "1C", "GAL_E5A_Q": "5Q"}
    with oracle_path.open(newline="") as file:
        for row in csv.DictReader(file):
            if row["SignalType"] in names:
                system = int(row["ConstellationType"])
                place = computed.setdefault((int(row["utcTimeMillis"]), system), {})
                place[int(row["Svid"]), names[row["SignalType"]]] = float(row["RawPseudorangeMeters"])
    systems = {Constellation.GPS: 1, Constellation.GALILEO: 6}
    compared = 0
    for epoch in epochs:
        differences = []
        for measurement in epoch.measurements:
            oracle = computed.get((epoch.sampled_ns // 1_000_000, systems.get(measurement.constellation, 0)), {})
            if (
                measurement.signal is not None
                and (measurement.number, measurement.signal) in oracle
                and measurement.pseudorange_m is not None
            ):
                differences.append(measurement.pseudorange_m - oracle[measurement.number, measurement.signal])
        # The oracle has the full bias of the first epoch, this has each epoch's own: one clock error an epoch.
        assert np.ptp(differences) < 1e-5 and abs(differences[0]) < 1e-6 * SPEED_OF_LIGHT
        compared += len(differences)
    assert compared >= 40


@pytest.mark.recording
@pytest.mark.parametrize(
    ("path", "fixes", "epochs"),
    [
        ("android_gnsslogger_static/pseudoranges_log_2016_06_30_21_26_07.txt", 216, 223),
        ("gsdc_samples/android_measurements_pixel6.txt", 94, 31),
        ("gsdc_samples/2021_Pixel4_GnssLog.txt", 2, 1),
    ],
)
def test_recorded_logs_of_three_versions_are_read(path: str, fixes: int, epochs: int) -> None:
    folder, name = path.split("/")
    messages = messages_of(read_log((recording(folder) / name).read_text(errors="replace").splitlines()), FLAT)
    assert sum(isinstance(message, GnssFix) for message in messages) == fixes
    raw = [message for message in messages if isinstance(message, GnssRawEpoch)]
    assert len(raw) == epochs
    utc_ns = [gnss_raw_epoch.gps_time_ns + (315_964_800 - 18) * NS for gnss_raw_epoch in raw]
    assert all(
        abs(gnss_raw_epoch.sampled_ns - true_ns) < 60 * NS for gnss_raw_epoch, true_ns in zip(raw, utc_ns, strict=True)
    )


RAW = (
    "# Raw,utcTimeMillis,TimeNanos,LeapSecond,FullBiasNanos,BiasNanos,Svid,TimeOffsetNanos,State,ReceivedSvTimeNanos,"
    "ReceivedSvTimeUncertaintyNanos,Cn0DbHz,CarrierFrequencyHz,ConstellationType"
)
WEEK, TOW_NS = 2278, 414_016 * NS  # of the reception, GPS time


def raw(state: int, system: int, frequency_hz: float = 1.57542e9, behind_ns: int = 0) -> str:
    """A signal that was sent 75 ms before its reception."""
    sent_ns = TOW_NS - behind_ns - 75_000_000
    return (
        f"Raw,,{NS},18,{NS - WEEK * 604_800 * NS - TOW_NS},0.0,7,0.0,{state},{sent_ns},10,40.0,{frequency_hz},{system}"
    )


@pytest.mark.parametrize(
    ("state", "system", "frequency_hz", "signal"),
    [
        (1 | 8, 1, 1.57542e9, "1C"),  # TOW_DECODED
        (1 | 1 << 14, 1, 1.57542e9, "1C"),  # TOW_KNOWN: the time of week comes from elsewhere
        (81921, 1, 1.17645e9, "5Q"),
        (84003, 6, 1.17645e9, "5Q"),
        (85026, 6, 1.57542e9, "1C"),  # of Galileo E1 the lock to the code has a bit of its own
        (1 | 1 << 14, 4, 1.17645e9, "5Q"),
        (1 | 1 << 14, 5, 1.17645e9, "5P"),
    ],
)
def test_a_time_of_week_that_is_known_counts_as_one_that_is_decoded(
    state: int, system: int, frequency_hz: float, signal: str
) -> None:
    (one,), rejects = converted(RAW, raw(state, system, frequency_hz, 14 * NS if system == 5 else 0))
    assert isinstance(one, GnssRawEpoch) and not rejects
    assert one.measurements[0].signal == signal
    assert one.measurements[0].pseudorange_m == pytest.approx(0.075 * SPEED_OF_LIGHT)


@pytest.mark.parametrize(
    ("state", "system", "reason"),
    [
        (1, 1, "raw: no time of week"),
        (1 << 14, 4, "raw: no lock to the code"),
        (32995, 3, "raw: GLONASS is not used"),
        (1 | 1 << 15, 3, "raw: GLONASS is not used"),
        (1 | 1 << 14, 3, "raw: no time of day"),
        (1 | 1 << 15, 1, "raw: no time of week"),
    ],
)
def test_a_signal_without_its_time_of_transmission_is_rejected(state: int, system: int, reason: str) -> None:
    assert converted(RAW, raw(state, system)) == ([], {reason: 1})


@each(
    ("state", "cycles", "locked", "resolved"),
    [(0, None, True, False), (1, 100.0, True, False), (1 | 8, 100.0, True, True), (1 | 2, 100.0, False, False),
     (1 | 4 | 8, 100.0, False, True), (16, None, True, False)],
)  # fmt: skip
def test_a_phase_that_was_reset_or_has_slipped_is_not_locked(
    state: int, cycles: float | None, locked: bool, resolved: bool
) -> None:
    header = f"{RAW},AccumulatedDeltaRangeState,AccumulatedDeltaRangeMeters"
    (one,), _ = converted(header, f"{raw(1 | 8, 1)},{state},{100.0 * SPEED_OF_LIGHT / 1.57542e9}")
    assert isinstance(one, GnssRawEpoch)
    found = one.measurements[0]
    assert found.carrier_phase_cycles == (None if cycles is None else pytest.approx(cycles))
    assert (found.lock_time_s != 0.0, found.half_cycle_resolved) == (locked, resolved)


def test_a_log_of_which_nothing_can_be_used_says_what_it_holds_and_what_is_missing(tmp_path: Path) -> None:
    log = tmp_path / "gnss_log.txt"
    log.write_text(HEADER + "\n".join([sensor("Accel", 0, 0.0, 0.0, 9.8), sensor("Mag", 0, 1.0, 2.0, 3.0)]))
    with pytest.raises(UserError) as error:
        import_drive(log, output=tmp_path / "phone.mcap")
    said = str(error.value)
    assert "1 Accel, 1 Mag; missing: `Fix` and `Raw` and `Status` lines (GNSS)" in said
    assert "`UncalAccel` or `Accel` lines (1, at least 2 are required)" in said
    assert "`UncalGyro` or `Gyro` lines (0, at least 2 are required)" in said
    log.write_text(HEADER)
    with pytest.raises(UserError, match="no lines of a known kind"):
        import_drive(log, output=tmp_path / "phone.mcap")


def nmea(second: int) -> list[str]:
    """GGA and RMC of one second, as GnssLogger writes them."""
    bodies = (
        f"GPGGA,2342{second:02d}.00,3725.590397,N,12210.422534,W,1,24,0.4,51.9,M,-28.4,M,,",
        f"GPRMC,2342{second:02d}.00,A,3725.590397,N,12210.422534,W,002.0,90.0,071123,,,A",
    )
    sums = [reduce(xor, body.encode()) for body in bodies]
    return [
        f"NMEA,${body}*{checksum:02X},{UTC_MS + 577_000 + 1000 * (second - 57) + 5 * k}"
        for k, (body, checksum) in enumerate(zip(bodies, sums, strict=True))
    ]


@pytest.mark.parametrize("header", ["", HEADER])
def test_the_nmea_sentences_of_a_log_are_fixes(tmp_path: Path, header: str) -> None:
    log = tmp_path / "gnss_log.nmea"
    log.write_text(header + "\n".join(line for second in range(50, 58) for line in nmea(second)) + "\n")
    assert import_drive(log, output=tmp_path / "phone.mcap") == 0
    with Recording(tmp_path / "phone.mcap") as made:
        fixes = [message for message in (envelope.decode() for envelope in made) if isinstance(message, GnssFix)]
    assert len(fixes) == 8
    assert fixes[-1].utc_ns == 1_699_400_577 * NS  # 2023-11-07 23:42:57
    assert fixes[-1].latitude_deg == pytest.approx(37.42650662) and fixes[-1].height_msl_m == 51.9
    assert fixes[-1].ground_speed_m_s == pytest.approx(2.0 * 1852 / 3600)
    steps = {b.sampled_ns - a.sampled_ns for a, b in pairwise(fixes)}
    assert steps == {NS}


def test_sentences_beside_fixes_are_not_fixes_again() -> None:
    messages, rejects = converted(fix(1), *nmea(50), *nmea(51))
    assert len(messages) == 1 and not rejects

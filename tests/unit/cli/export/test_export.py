"""`obu export`: each format is read by a reader of its own, and compared with the drive."""

import csv
import json
import shutil
import subprocess
from itertools import pairwise
from math import radians
from pathlib import Path
from xml.etree import ElementTree

import pynmea2
import pytest
import zstandard
from mcap.writer import CompressionType

from cli.__main__ import main
from cli.export.export import Format, export
from cli.export.positions import of_fixes
from cli.utc import UtcLine
from shared.errors import UserError
from shared.maths.geoid.geoid import separation_m
from shared.messages.gnss import Constellation, FixType, GnssFix, GnssRawEpoch, RawMeasurement
from shared.recording import RecordingWriter
from tests.support.bus.envelopes import sent
from tests.support.drives.meridian import (
    BEGIN_NS,
    LATITUDE_DEG,
    LONGITUDE_DEG,
    NORTH_M_S,
    SECOND,
    record,
    solution,
)
from tests.support.patience import HANGS_S
from tests.support.rewritten import chunk, file_of, rewrite

SECONDS = 20
GPX = {"g": "http://www.topografix.com/GPX/1/1"}
GPS_NS = 1_384_035_218_000_000_000  # of BEGIN_NS, 2023-11-14 22:13:20 UTC, in GPS time since 1980: 18 s ahead


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("drive") / "drive.mcap", SECONDS)


def exported(drive: Path, to: Format, folder: Path, **options: object) -> Path:
    out = folder / f"drive.{to}"
    assert export(drive, to=to, out=out, **options) == 0  # type: ignore[arg-type]  # the options are typed there
    return out


def latitude_at(second: float) -> float:
    return solution(BEGIN_NS + round(second * SECOND)).latitude_deg


def test_csv_has_a_row_for_each_message_and_a_column_for_each_element(drive: Path, tmp_path: Path) -> None:
    rows = list(csv.DictReader(exported(drive, Format.CSV, tmp_path).read_text().splitlines()))
    assert len(rows) == SECONDS * 10
    assert int(rows[15]["sampled_ns"]) == BEGIN_NS + 15 * SECOND // 10
    assert float(rows[15]["latitude_deg"]) == latitude_at(1.5)
    assert float(rows[0]["velocity_ned_m_s.0"]) == NORTH_M_S
    assert rows[0]["protection_level_horizontal_m"] == "", "unknown values are empty"
    fixes = list(csv.DictReader(exported(drive, Format.CSV, tmp_path, topic="gnss/fix").read_text().splitlines()))
    assert [fix["satellites_used"] for fix in fixes] == ["9"] * SECONDS


def test_gpx_has_the_positions_with_their_times(drive: Path, tmp_path: Path) -> None:
    points = ElementTree.parse(exported(drive, Format.GPX, tmp_path, period=1.0)).findall(".//g:trkpt", GPX)
    assert len(points) == SECONDS
    assert float(points[7].attrib["lat"]) == pytest.approx(latitude_at(7.0), abs=1e-9)
    assert points[7].findtext("g:time", namespaces=GPX) == "2023-11-14T22:13:27.000Z"


def test_kml_has_as_many_times_as_places(drive: Path, tmp_path: Path) -> None:
    root = ElementTree.parse(exported(drive, Format.KML, tmp_path)).getroot()
    tags = [element.tag.split("}")[1] for element in root.iter()]
    assert tags.count("when") == tags.count("coord") == SECONDS * 10


@pytest.mark.parametrize("form", [Format.GPX, Format.KML])
def test_gpsbabel_reads_the_places_heights_and_times_of_the_drive(drive: Path, tmp_path: Path, form: Format) -> None:
    if shutil.which("gpsbabel") is None:
        pytest.skip("gpsbabel is not installed: apt-get install gpsbabel")
    out = exported(drive, form, tmp_path, period=1.0)
    command = ["gpsbabel", "-t", "-i", form.value, "-f", str(out), "-o", "gpx,gpxver=1.1", "-F", "-"]
    read = subprocess.run(command, capture_output=True, text=True, check=True, timeout=HANGS_S)
    assert read.stderr == "", "not even a warning"
    points = ElementTree.fromstring(read.stdout).findall(".//g:trkpt", GPX)
    latitudes = [float(p.attrib["lat"]) for p in points]
    assert latitudes == pytest.approx([latitude_at(s) for s in range(SECONDS)], abs=1e-9)
    assert {float(p.attrib["lon"]) for p in points} == {LONGITUDE_DEG}
    above_sea_m = [500.0 - separation_m(latitude_at(s), LONGITUDE_DEG) for s in range(SECONDS)]
    assert [float(p.findtext("g:ele", "", GPX)) for p in points] == pytest.approx(above_sea_m, abs=1.1e-3)
    times = [p.findtext("g:time", namespaces=GPX) for p in points]
    assert times == [f"2023-11-14T22:13:{20 + s}Z" for s in range(SECONDS)]


def test_geojson_is_a_line_with_the_times_of_its_points(drive: Path, tmp_path: Path) -> None:
    [feature] = json.loads(exported(drive, Format.GEOJSON, tmp_path).read_text())["features"]
    places, times = feature["geometry"]["coordinates"], feature["properties"]["times"]
    assert feature["geometry"]["type"] == "LineString" and len(places) == len(times) == SECONDS * 10
    assert places[0] == [LONGITUDE_DEG, LATITUDE_DEG, 500.0]


def test_nmea_has_valid_checksums_and_the_positions(drive: Path, tmp_path: Path) -> None:
    lines = exported(drive, Format.NMEA, tmp_path, period=1.0).read_text().splitlines()
    sentences = [pynmea2.parse(line, check=True) for line in lines]  # type: ignore[no-untyped-call]  # it has no types
    assert [type(sentence).__name__ for sentence in sentences] == ["GGA", "RMC"] * SECONDS
    gga, rmc = sentences[14], sentences[15]
    assert gga.latitude == pytest.approx(latitude_at(7.0), abs=2e-9)
    assert (gga.gps_qual, gga.num_sats) == (1, "09")
    assert gga.altitude is None, "the receiver stated no height of the geoid"
    assert rmc.datetime.isoformat() == "2023-11-14T22:13:27+00:00"
    assert rmc.spd_over_grnd == pytest.approx(NORTH_M_S * 3600 / 1852, abs=1e-3)


@pytest.mark.skipif(shutil.which("gpsdecode") is None, reason="gpsdecode is not installed: apt install gpsd-clients")
def test_gpsd_reads_the_nmea(drive: Path, tmp_path: Path) -> None:
    text = exported(drive, Format.NMEA, tmp_path, period=1.0).read_bytes()
    output = subprocess.run(["gpsdecode"], input=text, capture_output=True, check=True, timeout=HANGS_S).stdout
    reports = [json.loads(line) for line in output.splitlines()]
    fixes = [report for report in reports if report.get("class") == "TPV" and "lat" in report]
    assert len(fixes) >= SECONDS - 1
    assert fixes[-1]["lat"] == pytest.approx(latitude_at(SECONDS - 1), abs=1e-7)
    assert fixes[-1]["speed"] == pytest.approx(NORTH_M_S, abs=0.01)


def raw_drive(path: Path) -> Path:
    """Record two epochs: GPS L1 and L5, Galileo E1 whose lock is younger in the second."""
    writer = RecordingWriter(path, vehicle="car", vehicle_toml='[vehicle]\nname = "car"\n')
    for k in range(2):
        gps = [
            RawMeasurement(constellation=Constellation.GPS, number=5, signal=signal, pseudorange_m=21_000_000.1234 + k,
                           carrier_phase_cycles=110_355_000.5 + k, half_cycle_resolved=True, doppler_hz=-1234.5678,
                           cn0_db_hz=45.0, lock_time_s=10.0 + k)
            for signal in ("1C", "5Q")
        ]  # fmt: skip
        galileo = RawMeasurement(constellation=Constellation.GALILEO, number=11, signal="1C",
                                 pseudorange_m=25_000_000.0, carrier_phase_cycles=-7.25, half_cycle_resolved=k == 0,
                                 lock_time_s=5.0 - 4.0 * k)  # fmt: skip
        qzss = RawMeasurement(constellation=Constellation.QZSS, number=194, signal="1C", pseudorange_m=38_000_000.0)
        epoch = GnssRawEpoch(
            sampled_ns=BEGIN_NS + k * SECOND, received_ns=BEGIN_NS + k * SECOND, source="gnss0",
            gps_time_ns=GPS_NS + k * SECOND + 300_000, leap_seconds=18, measurements=(*gps, galileo, qzss),
        )  # fmt: skip
        writer.write(sent(epoch, BEGIN_NS + k * SECOND, "parsers.gnss", 1, k + 1))
    writer.close()
    return path


def test_rinex_has_every_observation_in_its_columns(tmp_path: Path) -> None:
    text = exported(raw_drive(tmp_path / "raw.mcap"), Format.RINEX, tmp_path).read_text()
    header, body = text.split("END OF HEADER\n")
    labels = [line[60:].strip() for line in header.splitlines()]
    assert labels[0] == "RINEX VERSION / TYPE" and header.startswith("     3.05           OBSERVATION DATA    M")
    assert "G    8 C1C L1C D1C S1C C5Q L5Q D5Q S5Q" in header and "J    4 C1C" in header
    assert all(len(line) <= 80 for line in header.splitlines())
    lines = body.splitlines()
    assert lines[0] == "> 2023 11 14 22 13 38.0003000  0  3"
    assert [line[:3] for line in lines[1:4]] == ["E11", "G05", "J02"]
    gps = lines[2]
    fields = [gps[3 + 16 * n : 19 + 16 * n] for n in range(8)]
    assert [float(field[:14]) for field in fields[:4]] == [21_000_000.123, 110_355_000.5, -1234.568, 45.0]
    assert fields[0][15] == "7", "45 dB-Hz are strength 7 of 9"
    galileo = [line for line in lines if line.startswith("E11")]
    assert [line[3 + 16 + 14 : 3 + 16 + 15] for line in galileo] == ["", "3"], "lock lost, half a cycle open"
    assert float(galileo[0][19:33]) == -7.25


def test_missing_content_of_a_recording_is_named_with_a_remedy(drive: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"holds no raw measurements; .*--format nmea"):
        exported(drive, Format.RINEX, tmp_path)
    with pytest.raises(UserError, match=r"holds no imu/sample; it holds .*gnss/fix.*--topic"):
        exported(drive, Format.CSV, tmp_path, topic="imu/sample")
    with pytest.raises(UserError, match="gpx is made of positions: give --topic navigation/solution"):
        exported(drive, Format.GPX, tmp_path, topic="trust/state")
    assert not list(tmp_path.iterdir()), "no incomplete file"


def test_a_recording_that_was_not_closed_is_exported_up_to_its_end(tmp_path: Path) -> None:
    cut = record(tmp_path / "cut.mcap", 3, close=False)
    assert len(exported(cut, Format.CSV, tmp_path).read_text().splitlines()) == 31


BEHIND_NS = 5_000_000_000_000  # by which the clock of the unit is wrong in the drives below


def stepping_drive(path: Path, steps_s: dict[int, int], longitude_deg: float = 11.0, step_deg: float = 1e-4) -> Path:
    """Record fixes at 1 Hz whose UTC is off by `steps_s` from an epoch on; the unit's clock is far behind."""
    writer = RecordingWriter(path, vehicle="car", vehicle_toml='[vehicle]\nname = "car"\n')
    off_s = 0
    for k in range(SECONDS):
        off_s = steps_s.get(k, off_s)
        at_ns = BEGIN_NS + k * SECOND
        fix = GnssFix(
            sampled_ns=at_ns - BEHIND_NS, received_ns=at_ns - BEHIND_NS, source="gnss0", fix_type=FixType.THREE_D,
            latitude_deg=-16.5, longitude_deg=(longitude_deg + k * step_deg + 180.0) % 360.0 - 180.0,
            height_ellipsoid_m=500.0, utc_ns=at_ns + off_s * SECOND,
        )  # fmt: skip
        writer.write(sent(fix, at_ns - BEHIND_NS, "parsers.gnss", 1, k + 1))
    writer.close()
    return path


def gpx_times(path: Path) -> list[str | None]:
    points = ElementTree.parse(path).findall(".//g:trkpt", GPX)
    return [point.findtext("g:time", namespaces=GPX) for point in points]


@pytest.mark.parametrize("steps_s", [{}, {0: 2, 5: 0}, {0: 18, 5: 0}, {0: -3, 5: 0}, {0: 1, 4: 17, 9: 0}, {7: 2, 8: 0}])
def test_times_are_utc_as_far_apart_as_the_fixes_were(steps_s: dict[int, int], tmp_path: Path) -> None:
    drive = stepping_drive(tmp_path / "drive.mcap", steps_s)
    right = [f"2023-11-14T22:13:{20 + k}.000Z" for k in range(SECONDS)]
    assert gpx_times(exported(drive, Format.GPX, tmp_path)) == right
    rows = list(csv.DictReader(exported(drive, Format.CSV, tmp_path).read_text().splitlines()))
    assert [row["time_utc"] for row in rows] == right
    assert int(rows[0]["sampled_ns"]) == BEGIN_NS - BEHIND_NS, "fields are as recorded"
    [feature] = json.loads(exported(drive, Format.GEOJSON, tmp_path).read_text())["features"]
    assert feature["properties"]["times"] == right
    sentences = exported(drive, Format.NMEA, tmp_path).read_text().splitlines()
    assert [line.split(",")[1] for line in sentences[1::2]] == [f"2213{20 + k}.000" for k in range(SECONDS)]


@pytest.mark.parametrize(("longitude_deg", "step_deg"), [(179.999, 1.5e-4), (-179.999, -1.5e-4), (179.9994, 1.5e-4)])
def test_a_line_is_cut_at_the_antimeridian(longitude_deg: float, step_deg: float, tmp_path: Path) -> None:
    drive = stepping_drive(tmp_path / "drive.mcap", {}, longitude_deg, step_deg)
    features = json.loads(exported(drive, Format.GEOJSON, tmp_path).read_text())["features"]
    lines = [feature["geometry"]["coordinates"] for feature in features]
    assert len(lines) == 2 and sum(map(len, lines)) == SECONDS
    assert all(abs(a[0] - b[0]) < 1.0 for line in lines for a, b in pairwise(line))
    assert [len(feature["properties"]["times"]) for feature in features] == list(map(len, lines))
    for to, tag in ((Format.GPX, "trkseg"), (Format.KML, "Track")):
        root = ElementTree.parse(exported(drive, to, tmp_path)).getroot()
        assert [element.tag.split("}")[1] for element in root.iter()].count(tag) == 2


def test_rinex_names_slot_and_frequency_number_of_each_glonass_satellite(tmp_path: Path) -> None:
    """RINEX 3.05, table A2: the number of satellites, then eight a line."""
    writer = RecordingWriter(tmp_path / "raw.mcap", vehicle="car", vehicle_toml='[vehicle]\nname = "car"\n')
    channels = {number: (number * 3) % 14 - 7 for number in range(1, 11)}
    measured = [
        RawMeasurement(constellation=Constellation.GLONASS, number=number, signal=signal, pseudorange_m=2.1e7,
                       glonass_frequency_number=channels.get(number))
        for number in range(1, 12) for signal in ("1C", "2C")
    ]  # fmt: skip
    epoch = GnssRawEpoch(sampled_ns=BEGIN_NS, received_ns=BEGIN_NS, source="gnss0", gps_time_ns=GPS_NS,
                         measurements=tuple(measured))  # fmt: skip
    writer.write(sent(epoch, BEGIN_NS, "parsers.gnss", 1, 1))
    writer.close()
    header = exported(tmp_path / "raw.mcap", Format.RINEX, tmp_path).read_text().split("END OF HEADER")[0]
    lines = [line[:60] for line in header.splitlines() if line[60:].strip() == "GLONASS SLOT / FRQ #"]
    assert lines[0].startswith(" 10 R01 -4 R02 -1 R03  2 ") and lines[1].startswith("    R09 ")
    named = [line[at : at + 6] for line in lines for at in range(4, 60, 7) if line[at : at + 3].strip()]
    assert {int(name[1:3]): int(name[3:]) for name in named} == channels, "that of 11 is not known"


def test_speed_and_course_of_a_fix_without_a_velocity_are_exported() -> None:
    fix = GnssFix(
        sampled_ns=1, received_ns=1, source="nmea", fix_type=FixType.THREE_D, latitude_deg=45.0, longitude_deg=10.0,
        ground_speed_m_s=12.0, course_rad=radians(120.0),
    )  # fmt: skip
    (position,) = of_fixes([fix], UtcLine(()))
    assert (position.speed_m_s, position.course_deg) == pytest.approx((12.0, 120.0))


@pytest.mark.parametrize("to", list(Format))
def test_a_recording_that_another_tool_packed_with_lz4_gives_the_same_files(
    drive: Path, to: Format, tmp_path: Path
) -> None:
    rewrite(drive, tmp_path / "drive.mcap", CompressionType.LZ4)
    if to is Format.RINEX:
        with pytest.raises(UserError, match="raw measurements"):
            exported(tmp_path / "drive.mcap", to, tmp_path)
        return
    (tmp_path / "before").mkdir()
    before = exported(drive, to, tmp_path / "before").read_text()
    assert exported(tmp_path / "drive.mcap", to, tmp_path).read_text() == before


@pytest.mark.parametrize("to", list(Format))
def test_an_export_of_nothing_is_an_error_and_leaves_no_file(drive: Path, to: Format, tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    rewrite(drive, path, CompressionType.LZ4)
    data = path.read_bytes()
    path.write_bytes(data.replace(b"\x03\0\0\0lz4", b"\x03\0\0\0xyz"))
    with pytest.raises(UserError, match=r"holds no .*packed with 'xyz' are not read"):
        exported(path, to, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["drive.mcap"]


def test_a_topic_without_a_position_is_no_nmea(tmp_path: Path) -> None:
    writer = RecordingWriter(tmp_path / "drive.mcap", vehicle="car", vehicle_toml="")
    fix = GnssFix(sampled_ns=BEGIN_NS, received_ns=BEGIN_NS, source="gnss0", fix_type=FixType.NONE)
    writer.write(sent(fix, BEGIN_NS, "parsers.gnss", 0, 1))
    writer.close()
    with pytest.raises(UserError, match="holds no position that can be read, and nothing was written"):
        exported(tmp_path / "drive.mcap", Format.NMEA, tmp_path)
    assert exported(tmp_path / "drive.mcap", Format.CSV, tmp_path, topic="gnss/fix").read_text().count("\n") == 2


def test_a_recording_that_unpacks_to_gigabytes_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    data = zstandard.compress(bytes(16 << 20))
    (tmp_path / "a.mcap").write_bytes(file_of(*[chunk(b"zstd", 16 << 20, data)] * 10))
    monkeypatch.setattr("sys.argv", ["obu", "export", str(tmp_path / "a.mcap"), "--format", "csv"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert "MB or more, over 100 times their size" in capsys.readouterr().err

"""A draft of a mapping, from tables whose units are known."""

from math import cos, degrees, pi, sin
from pathlib import Path

import pytest

from cli.import_drive.draft import draft_of
from cli.import_drive.import_drive import import_drive
from cli.import_drive.mapping.mapping import Mapping, parse_mapping
from cli.import_drive.mapping.units import FORCE, RATE, SPEED, TIME
from shared.errors import UserError
from shared.messages.gnss import GnssFix
from shared.recording import Recording

START_S, SPEED_M_S, RADIUS_M, EARTH_M = 1_760_000_000.0, 12.0, 300.0, 6_371_000.0
ISO = "date"


def table(  # one argument a unit
    folder: Path, *, time: str = "s", speed: str = "m/s", force: str = "g", rate: str = "deg/s",
    separator: str = ",", names: dict[str, str] | None = None,
) -> Path:  # fmt: skip
    """Two minutes on a circle at 5 Hz."""
    names = {
        name: name for name in ("time", "lat", "lon", "alt", "speed", "heading", "ax", "ay", "az", "gx", "gy", "gz")
    } | (names or {})
    path = folder / "log.csv"
    lines = [separator.join(names.values())]
    for row in range(600):
        seconds, turn = 0.2 * row, SPEED_M_S / RADIUS_M
        angle = turn * seconds
        minute, second = divmod(20 + seconds, 60)
        iso = f"2025-10-09T08:{53 + int(minute):02d}:{second:09.6f}Z"
        values = (
            iso if time == ISO else f"{(START_S + seconds) / TIME[time]:.3f}",
            f"{48.0 + degrees(RADIUS_M * sin(angle) / EARTH_M):.9f}",
            f"{11.0 + degrees(RADIUS_M * (1 - cos(angle)) / EARTH_M / cos(48.0 * pi / 180)):.9f}",
            "500.0", f"{SPEED_M_S / SPEED[speed]:.4f}", f"{degrees(angle) % 360:.4f}",
            f"{0.1 / FORCE[force]:.5f}", f"{SPEED_M_S * turn / FORCE[force]:.5f}", f"{-9.8 / FORCE[force]:.5f}",
            "0.0", "0.0", f"{(turn if row % 50 else 0.3) / RATE[rate]:.5f}",
        )  # fmt: skip
        lines.append(separator.join(values))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def mapping(path: Path) -> Mapping:
    return parse_mapping(draft_of(path).text, "draft")


@pytest.mark.parametrize("unit", ["m/s", "km/h", "mph", "kn"])
def test_the_unit_of_a_speed_follows_from_the_positions(tmp_path: Path, unit: str) -> None:
    gnss = mapping(table(tmp_path, speed=unit)).gnss
    assert gnss is not None and gnss.ground_speed is not None and gnss.ground_speed.unit == unit


@pytest.mark.parametrize("unit", ["m/s2", "g", "mg"])
def test_the_unit_of_an_acceleration_follows_from_gravity(tmp_path: Path, unit: str) -> None:
    imu = mapping(table(tmp_path, force=unit)).imu
    assert imu is not None and imu.specific_force.unit == unit


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns", ISO])
def test_the_unit_of_a_stamp_follows_from_its_size(tmp_path: Path, unit: str) -> None:
    gnss = mapping(table(tmp_path, time=unit)).gnss
    assert gnss is not None and gnss.time.unit == unit


def test_a_unit_in_a_name_decides_and_other_separators_are_seen(tmp_path: Path) -> None:
    names = {"gz": "Gyro Z (deg/s)", "gx": "Gyro X (deg/s)", "gy": "Gyro Y (deg/s)", "speed": "GPS Speed [km/h]"}
    found = mapping(table(tmp_path, speed="km/h", separator=";", names=names))
    assert found.imu is not None and found.imu.angular_rate is not None and found.gnss is not None
    assert found.imu.angular_rate.unit == "deg/s" and found.imu.separator == ";"
    assert found.gnss.ground_speed is not None and found.gnss.ground_speed.column == "GPS Speed [km/h]"


def test_what_is_drafted_can_be_imported_and_gives_the_speeds_of_the_table(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = table(tmp_path, speed="kn")
    assert import_drive(path, draft=True) == 0
    printed = capsys.readouterr().out
    assert "is in kn: the positions move" in printed and "to be checked by you:" in printed
    draft = tmp_path / "log.toml"  # the circle is driven at one speed, which says nothing of the mounting
    draft.write_text(draft.read_text().replace("estimate_axes = true", 'axes = ["forward", "right", "down"]'))
    assert import_drive(draft, tmp_path, output=tmp_path / "drive.mcap") == 0
    with Recording(tmp_path / "drive.mcap") as recording:
        fixes = [message for message in (e.decode() for e in recording) if isinstance(message, GnssFix)]
    assert len(fixes) == 600
    assert fixes[100].ground_speed_m_s == pytest.approx(SPEED_M_S, abs=0.01)
    with pytest.raises(UserError, match="exists already"):
        import_drive(path, draft=True)


@pytest.mark.parametrize(
    ("content", "why"),
    [
        ("", "is no table"),
        ("1,2,3\n4,5,6\n7,8,9\n", "is no table"),
        ("time,colour\n1,red\n2,blue\n3,red\n", "neither latitude"),
        ("time,lat,lon\n1,48,11\n2,48,11\n3,48,11\n", "height or altitude"),
        ("lat,lon\n48,11\n48,11\n48,11\n", "says time"),
        ("time,lat,lon\nsoon,48,11\nlater,48,11\nnever,48,11\n", "is no time"),
        ("a" * 100_000 + "\n", "is no table"),
        ("\0\1\2,\xff\n\n", "is no table"),
    ],
)
def test_what_cannot_be_drafted_is_refused_with_what_to_do(tmp_path: Path, content: str, why: str) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(content.encode("latin-1"))
    with pytest.raises(UserError, match=why):
        draft_of(path)


def test_a_clock_since_boot_is_no_unix_time(tmp_path: Path) -> None:
    rows = "\n".join(f"{50_000_000_000_000 + 10_000_000 * row},0.1,0.2,9.8,0,0,0.01" for row in range(100))
    path = tmp_path / "log.csv"
    path.write_text(f"timestamp,ax,ay,az,gx,gy,gz\n{rows}\n")
    imu = mapping(path).imu
    assert imu is not None and imu.time.unit == "ns"
    assert any("a beginning of its own" in reason for reason in draft_of(path).reasons)


def test_a_day_and_a_time_of_day_are_one_stamp_and_millimetres_are_seen(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    rows = "\n".join(f"2025-10-09,08:53:{row:02d},48.0,11.{row:03d},1500,{500 + row},1" for row in range(50))
    path.write_text(f"date,time,lat,lon,hacc,alt,colour\n{rows}\n")
    draft = draft_of(path)
    gnss = parse_mapping(draft.text, "draft").gnss
    assert gnss is not None and gnss.time.date_column == "date" and gnss.position_sd is not None
    assert gnss.position_sd.scale == 0.001 and any("not used: colour" in one for one in draft.open)

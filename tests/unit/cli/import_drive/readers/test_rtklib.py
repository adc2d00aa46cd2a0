"""Solutions of RTKLIB in the forms of its options: dates or GPS weeks, GPS time or UTC, degrees or ECEF."""

from datetime import UTC, datetime
from pathlib import Path

import pytest

from cli.import_drive.import_drive import import_drive
from shared.errors import UserError
from shared.messages.gnss import CarrierSolution, GnssFix
from shared.recording import Recording

START_NS = round(datetime(2026, 9, 21, 10, 20, tzinfo=UTC).timestamp()) * 1_000_000_000
GEODETIC = "latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)  sdne(m)  sdeu(m)  sdun(m)"
VALUES = "47.205666667 8.5535 459.5 {q} 14 0.01 0.02 0.03 0.001 0.001 0.001"


def fixes_of(folder: Path, text: str) -> list[GnssFix]:
    (folder / "rover.pos").write_text(text)
    assert import_drive(folder / "rover.pos", output=folder / "out.mcap") == 0
    with Recording(folder / "out.mcap") as recording:
        messages = [envelope.decode() for envelope in recording]
    return [message for message in messages if isinstance(message, GnssFix)]


@pytest.mark.parametrize(
    ("scale", "times", "utc_s"),
    [
        ("GPST", ("2026/09/21 10:20:18.000", "2026/09/21 10:20:18.200"), 0),
        ("UTC", ("2026/09/21 10:20:00.000", "2026/09/21 10:20:00.200"), 0),
        ("JST", ("2026/09/21 19:20:00.000", "2026/09/21 19:20:00.200"), 0),
        ("GPST", ("2437 123618.000", "2437 123618.200"), 0),
        ("GPST", ("2436 604799.900", "2437      0.100"), -123_618.1),
    ],
)
@pytest.mark.parametrize("separator", [" ", ",", ";"])
def test_a_solution_needs_no_mapping(
    tmp_path: Path, scale: str, times: tuple[str, str], utc_s: float, separator: str
) -> None:
    rows = [f"{time} {VALUES.format(q=q)}" for time, q in zip(times, (1, 2), strict=True)]
    if separator != " ":
        rows = [separator.join(row.split()) for row in rows]
        if "/" in times[0]:  # RTKLIB keeps the blank between date and time of day
            rows = [row.replace(separator, " ", 1) for row in rows]
    found = fixes_of(tmp_path, "\n".join([f"% program : RTKPOST\n%\n%  {scale}   {GEODETIC}", *rows]))
    assert [fix.sampled_ns for fix in found] == [START_NS + round(utc_s * 1e9) + k * 200_000_000 for k in (0, 1)]
    assert found[0].latitude_deg == 47.205666667 and found[0].satellites_used == 14
    assert found[0].position_sd_ned_m == (0.01, 0.02, 0.03)
    assert [fix.carrier_solution for fix in found] == [CarrierSolution.FIXED, CarrierSolution.FLOAT]


def test_ecef_and_velocities_are_read(tmp_path: Path) -> None:
    names = "x-ecef(m) y-ecef(m) z-ecef(m) Q ns vn(m/s) ve(m/s) vu(m/s)"
    (fix,) = fixes_of(
        tmp_path, f"%  UTC {names}\n2026/09/21 10:20:00.000 4278990.0 643590.0 4671180.0 5 7 3.0 4.0 0.5\n"
    )
    assert fix.latitude_deg == pytest.approx(47.38, abs=0.1)
    assert fix.velocity_ned_m_s == (3.0, 4.0, -0.5)


def test_a_baseline_alone_is_an_error_that_names_the_output_to_choose(tmp_path: Path) -> None:
    (tmp_path / "rover.pos").write_text("%  GPST e-baseline(m) n-baseline(m) u-baseline(m)\n2437 1.0 1 2 3\n")
    with pytest.raises(UserError, match="choose latitude and longitude in degrees, or ECEF"):
        import_drive(tmp_path / "rover.pos", output=tmp_path / "out.mcap")


MAPPING = """
name = "pos"
[gnss]
file = "rover.pos"
separator = "whitespace"
skip_rows = {skip}
header = ["day", "clock", "lat", "lon", "h", "Q", "ns"]
time = {{ {time} }}
latitude = {{ column = "lat", unit = "deg" }}
longitude = {{ column = "lon", unit = "deg" }}
height = {{ column = "h", kind = "ellipsoid" }}
"""
ROW = "47.2 8.5 459.5 1 14"


@pytest.mark.parametrize(
    ("time", "head", "row"),
    [
        ('column = "clock", unit = "date"', "%  GPST lat\n", f"2026/09/21 10:20:18.000 {ROW}"),
        ('column = "clock", unit = "date", date_column = "day", scale = "gps"', "", f"21.09.2026 10:20:18.000 {ROW}"),
        ('column = "clock", date_column = "day"', "", f"2026-09-21 37200.0 {ROW}"),
        ('column = "clock", unit = "ms", week_column = "day"', "", f"2437 123618000 {ROW}"),
        ('column = "clock", unit = "date", date_column = "day", offset_s = -3600.0', "", f"2026-09-21 11:20:00 {ROW}"),
    ],
)
def test_a_mapping_reads_a_day_in_a_column_of_its_own(tmp_path: Path, time: str, head: str, row: str) -> None:
    (tmp_path / "rover.pos").write_text(f"{head}{row}\n")
    (tmp_path / "m.toml").write_text(MAPPING.format(skip=head.count("\n"), time=time))
    assert import_drive(tmp_path / "m.toml", tmp_path, tmp_path / "out.mcap") == 0
    with Recording(tmp_path / "out.mcap") as recording:
        (fix,) = [envelope.decode() for envelope in recording]
    assert isinstance(fix, GnssFix) and fix.sampled_ns == START_NS


def test_times_of_day_without_a_date_are_an_error_that_names_the_setting(tmp_path: Path) -> None:
    (tmp_path / "rover.pos").write_text(f"x 10:20:18.000 {ROW}\n")
    (tmp_path / "m.toml").write_text(MAPPING.format(skip=0, time='column = "clock", unit = "date"'))
    with pytest.raises(UserError, match=r"times of day without a date; name the column of the dates by `date_column`"):
        import_drive(tmp_path / "m.toml", tmp_path, tmp_path / "out.mcap")

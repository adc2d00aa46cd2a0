import gzip
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from cli.import_drive.import_drive import import_drive
from shared.errors import UserError
from shared.messages.gnss import GnssFix
from shared.messages.imu import ImuSamples
from shared.messages.navigation import TruthState
from shared.messages.vehicle import VehicleSpeed
from shared.recording import Recording

MAPPING = """
name = "yard"
vehicle_file = "car.toml"
truth_is = "fixes"

[imu]
file = "log.csv"
separator = ";"
skip_rows = 1
time = { column = "t" }
specific_force = { columns = ["ax", "ay", "az"], unit = "m/s2" }
angular_rate = { columns = ["gx", "gy", "gz"], unit = "rad/s" }
axes = ["forward", "right", "down"]

[gnss]
file = "fix.csv"
header = ["t", "lat", "lon", "h"]
time = { column = "t" }
latitude = { column = "lat", unit = "deg" }
longitude = { column = "lon", unit = "deg" }
height = { column = "h", kind = "ellipsoid" }
quality = "fixed"
"""


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    (tmp_path / "m.toml").write_text(MAPPING)
    (tmp_path / "car.toml").write_text('[vehicle]\nname = "yard"\n')
    rows = "".join(f"{k * 0.01:.2f};0;0;-9.8;0;0;0;\n" for k in range(50))
    (tmp_path / "log.csv").write_text("made by hand\nt; ax; ay; az; gx; gy; gz;\n" + rows)
    (tmp_path / "fix.csv").write_text("0.1,49,6,300\n0.3,49,6,300\n")
    return tmp_path


def test_a_folder_of_csv_files_is_imported_in_order_of_arrival(drive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert import_drive(drive / "m.toml", drive, drive / "out.mcap") == 0
    with Recording(drive / "out.mcap") as recording:
        messages = [envelope.decode() for envelope in recording]
        assert not recording.problems
        assert recording.attachments["vehicle.toml"].decode() == '[vehicle]\nname = "yard"\n'
        provenance = recording.metadata["provenance"]
    assert sum(isinstance(m, ImuSamples) for m in messages) == 50
    assert [m.sampled_ns for m in messages if isinstance(m, GnssFix)] == [100_000_000, 300_000_000]
    arrivals = [m.received_ns for m in messages if isinstance(m, GnssFix | ImuSamples)]
    assert arrivals == sorted(arrivals)
    assert provenance["mapping"] == MAPPING and provenance["truth_is"] == "fixes"
    assert set(json.loads(provenance["files"])) == {"log.csv", "fix.csv"}
    printed = capsys.readouterr()
    assert "50" in printed.out and "obu solve" in printed.out
    assert printed.err == "", "no progress bar without a terminal"


def test_the_same_folder_imported_twice_gives_the_same_bytes(drive: Path) -> None:
    import_drive(drive / "m.toml", drive, drive / "a.mcap")
    import_drive(drive / "m.toml", drive, drive / "b.mcap")
    assert (drive / "a.mcap").read_bytes() == (drive / "b.mcap").read_bytes()


def test_an_existing_recording_is_not_overwritten(drive: Path) -> None:
    (drive / "out.mcap").write_bytes(b"precious")
    with pytest.raises(UserError, match="already exists"):
        import_drive(drive / "m.toml", drive, drive / "out.mcap")
    assert (drive / "out.mcap").read_bytes() == b"precious"


def test_a_missing_file_folder_mapping_or_vehicle_is_reported_in_one_sentence(drive: Path) -> None:
    empty = drive / "empty"
    empty.mkdir()
    with pytest.raises(UserError, match=r"holds no file 'log\.csv'"):
        import_drive(drive / "m.toml", empty, drive / "out.mcap")
    with pytest.raises(UserError, match="cannot read the mapping"):
        import_drive(drive / "absent.toml", drive, drive / "out.mcap")
    with pytest.raises(UserError, match="cannot read the vehicle's file"):
        import_drive(drive / "m.toml", drive, drive / "out.mcap", drive / "absent.toml")
    with pytest.raises(UserError, match="cannot write"):
        import_drive(drive / "m.toml", drive, drive / "absent" / "out.mcap")


def test_a_failed_import_writes_no_output_file(drive: Path) -> None:
    shutil.copy(drive / "fix.csv", drive / "log.csv")
    with pytest.raises(UserError):
        import_drive(drive / "m.toml", drive, drive / "out.mcap")
    assert not (drive / "out.mcap").exists()


def test_a_byte_order_mark_is_ignored(drive: Path) -> None:
    mapping = MAPPING.replace("skip_rows = 1\n", "")
    (drive / "m.toml").write_text(mapping)
    text = (drive / "log.csv").read_text().split("\n", 1)[1]
    (drive / "log.csv").write_text(text, encoding="utf-8-sig", newline="\r\n")
    assert import_drive(drive / "m.toml", drive, drive / "out.mcap") == 0


ARRAYS = """
name = "arrays"
truth_is = "recorded"

[imu]
file = "imu.npz"
time = { column = "t" }
specific_force = { columns = ["dv[0]", "dv[1]", "dv[2]"], unit = "m/s" }
angular_rate = { columns = ["da[0]", "da[1]", "da[2]"], unit = "rad" }
axes = ["forward", "right", "down"]

[speed]
file = "odo.txt"
separator = "whitespace"
header = ["t", "v"]
time = { column = "t" }
column = "v"

[truth]
file = "truth.npz"
time = { column = "t" }
latitude = { column = "lla[0]", unit = "rad" }
longitude = { column = "lla[1]", unit = "rad" }
height = { column = "lla[2]", kind = "ellipsoid" }
velocity = { columns = ["v[0]", "v[1]", "v[2]"], unit = "m/s", axes = "ned" }
attitude = { columns = ["rpy[0]", "rpy[1]", "rpy[2]"], unit = "rad" }
"""


@pytest.fixture
def arrays(tmp_path: Path) -> Path:
    (tmp_path / "m.toml").write_text(ARRAYS)
    (tmp_path / "odo.txt").write_text("   0.000   1.000\n\t0.100 \t 1.500  \n")
    force, angle = np.tile([0.0, 0.0, -0.049], (40, 1)), np.tile([0.0, 0.0, 0.001], (40, 1))
    force[7, 1] = np.nan
    np.savez(tmp_path / "imu.npz", t=np.arange(40) * 0.005, dv=force.astype(np.float32), da=angle, bias=np.zeros(3))
    np.savez(
        tmp_path / "truth.npz", t=[0.0, 0.1], lla=[[0.5, 0.1, 200.0]] * 2, v=np.zeros((2, 3)), rpy=np.zeros((2, 3))
    )
    return tmp_path


def test_arrays_and_whitespace_separated_tables_are_imported(arrays: Path) -> None:
    assert import_drive(arrays / "m.toml", arrays, arrays / "out.mcap") == 0
    with Recording(arrays / "out.mcap") as recording:
        messages = [envelope.decode() for envelope in recording]
    batches = [m for m in messages if isinstance(m, ImuSamples)]
    assert sum(len(m.sampled_ns) for m in batches) == 39, "without the row that is no number"
    assert batches[0].specific_force_body_m_s2[0] == pytest.approx((0.0, 0.0, -9.8), rel=1e-6)
    assert batches[0].angular_rate_body_rad_s[0] == pytest.approx((0.0, 0.0, 0.2))
    assert [m.speed_m_s for m in messages if isinstance(m, VehicleSpeed)] == [1.0, 1.5]
    truth = [m for m in messages if isinstance(m, TruthState)]
    assert truth[0].latitude_deg == pytest.approx(np.degrees(0.5)) and truth[0].angular_rate_body_rad_s is None


def test_missing_or_unequal_arrays_are_named_in_the_error(arrays: Path) -> None:
    (arrays / "m.toml").write_text(ARRAYS.replace("dv[2]", "dv[3]"))
    with pytest.raises(UserError, match=r"imu.npz has no column 'dv\[3\]'; did you mean 'dv\["):
        import_drive(arrays / "m.toml", arrays, arrays / "out.mcap")
    (arrays / "m.toml").write_text(ARRAYS.replace('["da[0]", "da[1]", "da[2]"]', '["bias", "da[1]", "da[2]"]'))
    with pytest.raises(UserError, match=r"imu.npz: the arrays differ in length \(.*bias 3"):
        import_drive(arrays / "m.toml", arrays, arrays / "out.mcap")


def test_an_invalid_npz_file_is_reported_in_one_sentence(arrays: Path) -> None:
    whole = (arrays / "imu.npz").read_bytes()
    for broken in (b"", b"t,x\n1,2\n", whole[: len(whole) // 2]):
        (arrays / "imu.npz").write_bytes(broken)
        with pytest.raises(UserError, match=r"imu.npz is not an archive of NumPy arrays .* numpy.savez"):
            import_drive(arrays / "m.toml", arrays, arrays / "out.mcap")
    assert not list(arrays.glob("out*"))


def test_an_optional_file_may_be_missing(drive: Path) -> None:
    extra = '\n[speed]\nfile = "wheel.csv"\ntime = { column = "t" }\ncolumn = "v"\n'
    (drive / "m.toml").write_text(MAPPING + extra)
    with pytest.raises(UserError, match=r"holds no file 'wheel.csv'"):
        import_drive(drive / "m.toml", drive, drive / "out.mcap")
    (drive / "m.toml").write_text(MAPPING + extra + "optional = true\n")
    assert import_drive(drive / "m.toml", drive, drive / "out.mcap") == 0


def test_times_before_1970_are_reported_in_one_sentence(drive: Path) -> None:
    (drive / "m.toml").write_text(MAPPING.replace("[imu]", "[imu]\nstamps_late_s = 5.0"))
    with pytest.raises(UserError, match="are before 1970; add `start_utc_s"):
        import_drive(drive / "m.toml", drive, drive / "out.mcap")
    assert not list(drive.glob("out*"))


def test_a_drive_over_the_end_of_the_gps_week_is_imported_whole(
    drive: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = "".join(f"{(604_799.75 + k * 0.01) % 604_800.0:.2f};0;0;-9.8;0;0;0;\n" for k in range(50))
    (drive / "log.csv").write_text("made by hand\nt; ax; ay; az; gx; gy; gz;\n" + rows)
    (drive / "fix.csv").write_text("604799.8,49,6,300\n0.2,49,6,300\n")
    (drive / "m.toml").write_text("start_utc_s = 1789862400.0\n" + MAPPING)
    assert import_drive(drive / "m.toml", drive, drive / "out.mcap") == 0
    with Recording(drive / "out.mcap") as recording:
        messages = [envelope.decode() for envelope in recording]
    stamps = [stamp for m in messages if isinstance(m, ImuSamples) for stamp in m.sampled_ns]
    assert len(stamps) == 50 and stamps[-1] - stamps[0] == 490_000_000
    assert [m.sampled_ns - stamps[0] for m in messages if isinstance(m, GnssFix)] == [50_000_000, 450_000_000]
    out = capsys.readouterr().out
    assert "log.csv: the clock 't' starts anew after a week at row 26; the stamps were continued." in out
    assert "not later" not in out


def test_clocks_that_do_not_overlap_are_told(drive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (drive / "fix.csv").write_text("3600.1,49,6,300\n3600.3,49,6,300\n")
    assert import_drive(drive / "m.toml", drive, drive / "out.mcap") == 0
    out = capsys.readouterr().out
    assert "log.csv and fix.csv do not overlap in time" in out
    assert "a time zone of 1 h" in out and "Add -3600 to `offset_s` in `time` of fix.csv" in out


def test_a_file_of_which_no_row_can_be_used_is_an_error(drive: Path) -> None:
    (drive / "fix.csv").write_text("0.1,149,6,300\n0.3,149,6,300\n")
    with pytest.raises(UserError, match=r"fix\.csv holds no row that can be used: 2 invalid position"):
        import_drive(drive / "m.toml", drive, drive / "out.mcap")


def test_a_file_that_is_packed_is_an_error_that_says_so(drive: Path) -> None:
    (drive / "fix.csv").write_bytes(gzip.compress((drive / "fix.csv").read_bytes()))
    with pytest.raises(UserError, match=r"fix\.csv is packed with gzip; unpack it"):
        import_drive(drive / "m.toml", drive, drive / "out.mcap")

"""The same drive in every accepted form gives the same messages."""

import json
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from cli.import_drive.import_drive import import_drive
from cli.import_drive.mapping.mapping import parse_mapping
from shared.errors import UserError
from shared.maths.earth import Geodetic, ecef_from_geodetic, ned_from_ecef
from shared.messages.gnss import CarrierSolution, GnssFix
from shared.messages.imu import ImuSamples
from shared.messages.navigation import TruthState
from shared.recording import Recording

IMU = """
name = "forms"
[imu]
file = "imu.csv"
time = { column = "t" }
specific_force = { columns = ["ax", "ay", "az"], unit = "m/s2" }
angular_rate = { columns = ["gx", "gy", "gz"], unit = "rad/s" }
axes = ["forward", "right", "down"]
"""
GEODETIC = """latitude = { column = "lat", unit = "deg" }
longitude = { column = "lon", unit = "deg" }
height = { column = "h", kind = "ellipsoid" }
"""
GNSS = '\n[gnss]\nfile = "fix.csv"\ntime = { column = "t" }\n'
TRUTH = '\n[truth]\nfile = "truth.csv"\ntime = { column = "t" }\n'
ORIGIN = Geodetic(math.radians(48.0), math.radians(9.0), 300.0)
NED_FROM_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def write(folder: Path, name: str, header: str, rows: Sequence[Sequence[object]]) -> None:
    lines = "\n".join(",".join(map(str, row)) for row in rows)
    (folder / name).write_text(f"{header}\n{lines}\n")


def messages(folder: Path, mapping: str) -> list[object]:
    if not (folder / "imu.csv").exists():
        write(folder, "imu.csv", "t,ax,ay,az,gx,gy,gz", [(0.01 * k, 0, 0, -9.8, 0, 0, 0) for k in range(100)])
    (folder / "m.toml").write_text(mapping)
    out = folder / "out.mcap"
    out.unlink(missing_ok=True)
    assert import_drive(folder / "m.toml", folder, out) == 0
    with Recording(out) as recording:
        return [envelope.decode() for envelope in recording]


def fix_of(folder: Path, form: str, header: str, row: Sequence[object]) -> GnssFix:
    write(folder, "fix.csv", header, [row])
    (found,) = (m for m in messages(folder, IMU + GNSS + form) if isinstance(m, GnssFix))
    return found


def test_ecef_and_local_positions_are_those_of_latitude_and_longitude(tmp_path: Path) -> None:
    ned = (120.0, -50.0, -3.0)
    point = np.array(ecef_from_geodetic(ORIGIN)) + ned_from_ecef(ORIGIN.latitude, ORIGIN.longitude).T @ ned
    velocity = ned_from_ecef(ORIGIN.latitude, ORIGIN.longitude).T @ [5.0, 1.0, 0.2]
    ecef = fix_of(
        tmp_path,
        'position_ecef = { columns = ["x", "y", "z"] }\n'
        'velocity = { columns = ["vx", "vy", "vz"], unit = "m/s", axes = "ecef" }\n',
        "t,x,y,z,vx,vy,vz", [0.5, *point, *velocity],
    )  # fmt: skip
    origin = "origin = { latitude_deg = 48.0, longitude_deg = 9.0, height_m = 300.0 }"
    local = {
        axes: fix_of(
            tmp_path, f'position_local = {{ columns = ["a", "b", "c"], axes = "{axes}", {origin} }}\n', "t,a,b,c",
            [0.5, *values],
        )
        for axes, values in {"ned": ned, "enu": (-50.0, 120.0, 3.0)}.items()
    }  # fmt: skip
    for gnss_fix in (*local.values(), ecef):
        place = Geodetic(math.radians(gnss_fix.latitude_deg or 0), math.radians(gnss_fix.longitude_deg or 0),
                         gnss_fix.height_ellipsoid_m or 0)  # fmt: skip
        assert np.array(ecef_from_geodetic(place)) == pytest.approx(point, abs=1e-4)
    # North at the point is turned by the convergence, 1e-5 rad, against that at the origin.
    assert ecef.velocity_ned_m_s == pytest.approx((5.0, 1.0, 0.2), abs=2e-4)


@pytest.mark.parametrize("direction", ["ned_from_body", "body_from_ned", "enu_from_body", "body_from_enu"])
@pytest.mark.parametrize("body", ["frd", "flu"])
@pytest.mark.parametrize("order", ["wxyz", "xyzw"])
def test_a_quaternion_of_any_order_direction_and_axes_is_roll_pitch_yaw(
    tmp_path: Path, direction: str, body: str, order: str
) -> None:
    roll, pitch, yaw = 0.1, -0.2, 2.5
    rotation = Rotation.from_euler("ZYX", [yaw, pitch, roll])
    if body == "flu":
        rotation = rotation * Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]))
    if "enu" in direction:
        rotation = Rotation.from_matrix(NED_FROM_ENU.T) * rotation
    if direction.startswith("body"):
        rotation = rotation.inv()
    x, y, z, w = rotation.as_quat()
    quaternion = (w, x, y, z) if order == "wxyz" else (x, y, z, w)
    write(tmp_path, "truth.csv", "t,lat,lon,h,a,b,c,d", [(0.5, 48.0, 9.0, 300.0, *quaternion)])
    text = f'quaternion = {{ columns = ["a", "b", "c", "d"], order = "{order}", direction = "{direction}", '
    found = messages(tmp_path, IMU + TRUTH + GEODETIC + text + f'body = "{body}" }}\n')
    (state,) = (m for m in found if isinstance(m, TruthState))
    assert state.attitude_rad == pytest.approx((roll, pitch, yaw), abs=1e-9)
    assert state.velocity_ned_m_s is None


def test_fixes_of_one_quality_are_the_truth_for_those_of_another(tmp_path: Path) -> None:
    write(tmp_path, "fix.csv", "t,lat,lon,h,q", [(0.2 * k, 48.0, 9.0, 300.0, 1 + k % 2) for k in range(6)])
    gnss = GNSS + GEODETIC + 'quality = { column = "q", values = { 2 = "single" } }\n'
    truth = TRUTH.replace("truth.csv", "fix.csv") + GEODETIC
    truth += 'at = "antenna"\nquality = { column = "q", values = { 1 = "fixed" } }\n'
    found = messages(tmp_path, 'truth_is = "recorded"\n' + IMU + gnss + truth)
    fixes = [m for m in found if isinstance(m, GnssFix)]
    states = [m for m in found if isinstance(m, TruthState)]
    assert [f.sampled_ns for f in fixes] == [200_000_000, 600_000_000, 1_000_000_000]
    assert all(f.carrier_solution is CarrierSolution.NONE for f in fixes)
    assert [s.sampled_ns for s in states] == [0, 400_000_000, 800_000_000]
    assert states[0].velocity_ned_m_s is None and states[0].attitude_rad is None
    with Recording(tmp_path / "out.mcap") as recording:
        provenance = recording.metadata["provenance"]
    assert provenance["truth_at"] == "antenna" and provenance["truth_quantities"] == "position"


def test_accelerometer_and_gyroscope_in_two_files_are_joined_at_the_stamps_of_the_gyroscope(tmp_path: Path) -> None:
    write(tmp_path, "acc.csv", "t,ax,ay,az", [(0.02 * k, 0.1 * k, 0.0, 9.8) for k in range(50) if not 20 < k < 30])
    write(tmp_path, "gyr.csv", "t,gx,gy,gz", [(0.005 + 0.01 * k, 0.0, 0.0, 1.0) for k in range(110)])
    mapping = """
    name = "two"
    [imu]
    file = "acc.csv"
    time = { column = "t" }
    specific_force = { columns = ["ax", "ay", "az"], unit = "m/s2" }
    axes = ["forward", "left", "up"]
    [gyroscope]
    file = "gyr.csv"
    time = { column = "t" }
    angular_rate = { columns = ["gx", "gy", "gz"], unit = "deg/s" }
    axes = ["forward", "right", "down"]
    """
    samples = [m for m in messages(tmp_path, mapping) if isinstance(m, ImuSamples)]
    stamps = np.array([s.sampled_ns[0] for s in samples]) * 1e-9
    forces = np.array([s.specific_force_body_m_s2[0] for s in samples])
    np.testing.assert_allclose(forces, np.column_stack([5.0 * stamps, 0.0 * stamps, -9.8 + 0.0 * stamps]), atol=1e-9)
    assert samples[0].angular_rate_body_rad_s[0] == pytest.approx((0.0, 0.0, math.radians(1.0)))
    assert not ((stamps > 0.41) & (stamps < 0.59)).any(), "0.2 s without specific force are not interpolated"
    assert len(samples) == 40 + 38, "until 0.395 s, and from 0.605 to 0.975 s"


def test_a_matlab_file_of_structures_and_row_vectors_is_read(tmp_path: Path) -> None:
    t = np.arange(100) * 0.01
    force = np.tile([[0.0], [0.0], [-9.8]], (1, 100))
    savemat(tmp_path / "log.mat", {"imu": {"t": t, "acc": force, "gyr": np.zeros((100, 3))}, "note": "a text"})
    mapping = IMU.replace("imu.csv", "log.mat").replace('"t"', '"imu.t"')
    for name, column in zip(
        ("ax", "ay", "az", "gx", "gy", "gz"), ("acc", "acc", "acc", "gyr", "gyr", "gyr"), strict=True
    ):
        mapping = mapping.replace(f'"{name}"', f'"imu.{column}[{"xyz".index(name[1])}]"')
    samples = [m for m in messages(tmp_path, mapping) if isinstance(m, ImuSamples)]
    assert len(samples) == 100 and samples[-1].specific_force_body_m_s2[0] == (0.0, 0.0, -9.8)


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        (b"\x89HDF\r\n\x1a\n" + bytes(600), "version 7.3.*save it again in MATLAB: .*'-v7'"),
        (b"MATLAB 7.3 MAT-file" + bytes(493) + b"\x89HDF\r\n\x1a\n" + bytes(50), "version 7.3"),
        (b"not a matrix at all " * 40, "is not a MATLAB file"),
        (b"", "is not a MATLAB file"),
    ],
)
def test_an_unreadable_matlab_file_says_how_to_save_it(tmp_path: Path, data: bytes, sentence: str) -> None:
    (tmp_path / "imu.mat").write_bytes(data)
    with pytest.raises(UserError, match=sentence):
        messages(tmp_path, IMU.replace("imu.csv", "imu.mat"))


def test_dates_are_read_as_unix_time_and_invalid_values_are_unknown(tmp_path: Path) -> None:
    write(tmp_path, "fix.csv", "t,lat,lon,h,v,c,s", [
        ("2023-08-09 16:37:45+00:00", 40, -75, 60, 12.5, 90, 3.0),
        ("2023-08-09T16:37:46.500", 40, -75, 60, -1, -1, 3.0),
        ("2023-08-09 18:37:47+02:00", 40, -75, 60, 1.0, 0, 3.0),
    ])  # fmt: skip
    form = (
        GEODETIC
        + """ground_speed = { column = "v", unit = "m/s", invalid = -1 }
    course = { column = "c", unit = "deg", invalid = -1 }
    position_sd = { columns = ["s", "s", "s"], scale = 0.5 }
    """
    )
    gnss = GNSS.replace('{ column = "t" }', '{ column = "t", unit = "date" }') + form
    fixes = [m for m in messages(tmp_path, IMU + gnss) if isinstance(m, GnssFix)]
    assert [f.sampled_ns for f in fixes] == [1_691_599_065 * 10**9 + ns for ns in (0, 1_500_000_000, 2_000_000_000)]
    assert [f.ground_speed_m_s for f in fixes] == [12.5, None, 1.0]
    assert [f.course_rad for f in fixes] == [pytest.approx(math.pi / 2), None, 0.0]
    assert fixes[0].position_sd_ned_m == (1.5, 1.5, 1.5)


def test_the_axes_of_a_phone_are_estimated_from_gravity_and_changes_of_speed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(4)
    sensor_from_body = Rotation.from_euler("ZYX", [2.0, -0.4, 1.1]).as_matrix()
    time_s = np.arange(0.0, 200.0, 0.1)
    acceleration = 1.5 * np.sin(0.2 * time_s)
    force = np.column_stack([acceleration, rng.normal(0.0, 0.3, len(time_s)), np.full(len(time_s), -9.8)])
    rows = np.column_stack([time_s, force @ sensor_from_body.T, np.zeros((len(time_s), 3))])
    write(tmp_path, "imu.csv", "t,ax,ay,az,gx,gy,gz", rows.tolist())
    speed = 7.5 * (1.0 - np.cos(0.2 * time_s))
    fixes = [(t, 48.0, 9.0, 300.0, v, 0.0) for t, v in zip(time_s[::10].tolist(), speed[::10].tolist(), strict=True)]
    write(tmp_path, "fix.csv", "t,lat,lon,h,v,c", fixes)
    form = GEODETIC + 'ground_speed = { column = "v", unit = "m/s" }\ncourse = { column = "c", unit = "deg" }\n'
    mapping = IMU.replace('axes = ["forward", "right", "down"]', "estimate_axes = true")
    samples = [m for m in messages(tmp_path, mapping + GNSS + form) if isinstance(m, ImuSamples)]
    found = np.array([s.specific_force_body_m_s2[0] for s in samples])
    assert np.abs(found - force).max() < 0.5, "within 3 degrees"
    assert np.corrcoef(found[:, 0], acceleration)[0, 1] > 0.99
    assert "body_from_sensor = [[" in capsys.readouterr().out
    write(tmp_path, "fix.csv", "t,lat,lon,h,v,c", [(*row[:4], rng.random(), 0.0) for row in fixes])
    with pytest.raises(UserError, match=r"correlate by .* was the sensor fixed"):
        messages(tmp_path, mapping + GNSS + form)


def test_a_single_file_is_that_of_all_tables(tmp_path: Path) -> None:
    write(tmp_path, "monday.csv", "t,ax,ay,az,gx,gy,gz,v", [(0.01 * k, 0, 0, -9.8, 0, 0, 0, 5.0) for k in range(100)])
    speed = '\n[speed]\nfile = "drive.csv"\ntime = { column = "t" }\ncolumn = "v"\nunit = "m/s"\n'
    (tmp_path / "m.toml").write_text(IMU + speed)
    import_drive(tmp_path / "m.toml", tmp_path / "monday.csv", tmp_path / "out.mcap")
    with Recording(tmp_path / "out.mcap") as recording:
        kinds = [type(envelope.decode()).__name__ for envelope in recording]
        assert json.loads(recording.metadata["provenance"]["files"]).keys() == {"monday.csv"}
    assert kinds.count("ImuSamples") == kinds.count("VehicleSpeed") == 100


@pytest.mark.parametrize(
    ("wrong", "forms"),
    [
        (GNSS, ("`latitude`, `longitude` and `height`", "`position_ecef`", "`position_local`")),
        (GNSS + GEODETIC + 'position_ecef = { columns = ["x", "y", "z"] }\n', ("one of three forms",)),
        (GNSS + GEODETIC + 'velocity = { columns = ["x", "y", "z"], unit = "m/s", axes = "body" }\n',
         ("ned, enu, neu or ecef",)),
        (TRUTH + GEODETIC + 'velocity = { columns = ["x", "y", "z"], unit = "m/s", axes = "body" }\n',
         ("`attitude` or `quaternion`", "ecef")),
        ('\n[gyroscope]\nfile = "g.csv"\ntime = { column = "t" }\naxes = ["forward", "right", "down"]\n'
         'angular_rate = { columns = ["gx", "gy", "gz"], unit = "rad/s" }\n', ("[imu]", "[gyroscope]")),
        (TRUTH + GEODETIC + "estimate_delay = true\n", ("requires a [gnss]",)),
    ],
)  # fmt: skip
def test_an_error_names_every_accepted_form(wrong: str, forms: tuple[str, ...]) -> None:
    with pytest.raises(UserError) as raised:
        parse_mapping(IMU + wrong, "m.toml")
    assert all(form in str(raised.value) for form in forms), str(raised.value)

import math
from pathlib import Path

import numpy as np
import pytest

from cli.import_drive.mapping.mapping import Mapping, parse_mapping
from shared.errors import UserError
from tests.support.cases import each

ROOT = Path(__file__).parents[5]
IMU = """
[imu]
file = "imu.csv"
time = { column = "t" }
specific_force = { columns = ["ax", "ay", "az"], unit = "g" }
angular_rate = { columns = ["gx", "gy", "gz"], unit = "deg/s" }
axes = ["forward", "left", "up"]
"""


def mapping(text: str) -> Mapping:
    return parse_mapping('name = "drive"\n' + text, "m.toml")


@each("path", sorted((ROOT / "benchmarks" / "recordings" / "mappings").glob("*.toml")))
def test_every_mapping_of_the_repository_is_valid_and_its_vehicle_file_exists(path: Path) -> None:
    found = parse_mapping(path.read_text(encoding="utf-8"), str(path))
    assert found.name == path.stem
    assert found.vehicle_file is not None
    assert (path.parent / found.vehicle_file).is_file()


@each(
    ("wrong", "sentence"),
    [
        ('[imu]\nfile = "a.csv"\ntme = {}', "did you mean 'time'"),
        (IMU.replace("deg/s", "deg/sec"), "did you mean 'deg/s'"),
        (IMU.replace('time = { column = "t" }', ""), "imu.time is missing"),
        (IMU.replace('column = "t"', 'column = "t", period_s = 0.01'), "time is either"),
        (IMU.replace('"left"', '"right"'), "not a right-handed set"),
        (IMU + "body_from_sensor = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]", "either by `axes` (three of forward"),
        ("", "nothing to import"),
        (IMU.replace('"left"', '"leftish"'), "imu.axes.1"),
        ("[imu", "not valid TOML"),
    ],
)
def test_a_fault_of_a_mapping_is_reported_in_one_sentence(wrong: str, sentence: str) -> None:
    with pytest.raises(UserError) as raised:
        mapping(wrong)
    text = str(raised.value)
    assert text.startswith("m.toml") and sentence in text
    assert "\n" not in text.removesuffix("\n")


def test_truth_is_recorded_requires_a_truth_table() -> None:
    with pytest.raises(UserError, match=r"requires a \[truth\] table"):
        mapping('truth_is = "recorded"\n' + IMU)


def test_named_axes_give_the_rotation_to_forward_right_down() -> None:
    imu = mapping(IMU).imu
    assert imu is not None
    np.testing.assert_allclose(imu.matrix() @ [1.0, 2.0, 3.0], [1.0, -2.0, -3.0], atol=1e-12)


def test_a_mounting_angle_rotates_the_sensor_in_the_vehicle() -> None:
    # A sensor that is yawed 10 degrees to the right sees a forward force turned 10 degrees to its left.
    text = IMU.replace('["forward", "left", "up"]', '["forward", "right", "down"]')
    imu = mapping(text + "mounting_rpy_deg = [0.0, 0.0, 10.0]\n").imu
    assert imu is not None
    angle = math.radians(10.0)
    np.testing.assert_allclose(imu.matrix() @ [math.cos(angle), -math.sin(angle), 0.0], [1.0, 0.0, 0.0], atol=1e-12)


def test_a_matrix_of_three_digits_is_orthonormalised() -> None:
    text = IMU.replace('axes = ["forward", "left", "up"]', "")
    matrix = "body_from_sensor = [[0.866, 0.0, 0.5], [0.0, 1.0, 0.0], [-0.5, 0.0, 0.866]]"
    imu = mapping(text + matrix).imu
    assert imu is not None
    np.testing.assert_allclose(imu.matrix() @ imu.matrix().T, np.eye(3), atol=1e-12)
    assert np.linalg.det(imu.matrix()) == pytest.approx(1.0)

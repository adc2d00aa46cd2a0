"""Real drives, imported by the mappings of the repository and solved: errors against their references.

The truth of these drives is their own RTK. A position at a fix that the filter has used says how well it follows, the
innovation how well it predicts one fix ahead, and an outage how far it drifts alone. The measured values are printed
into docs/how-to/solve-a-recorded-drive.md and docs/reference/drives.md by `make drives`.
"""

import json
from math import radians
from pathlib import Path

import pytest

from cli.import_drive.import_drive import import_drive
from cli.solve.solve import solve
from shared.errors import UserError
from tests.support.data import REPOSITORY, recording

MAPPINGS = REPOSITORY / "benchmarks" / "recordings" / "mappings"
Metrics = dict[str, float]
pytestmark = [pytest.mark.recording, pytest.mark.slow]


def imported(mapping: str, folder: Path, out: Path) -> Path:
    path = out / "drive.mcap"
    import_drive(MAPPINGS / f"{mapping}.toml", folder, path)
    return path


def solved(drive: Path, outage: str | None = None) -> Metrics:
    out = drive.parent / f"solution-{bool(outage)}"
    assert solve(drive, outage=outage, out=out) == 0
    found: Metrics = json.loads((out / "metrics.json").read_text())
    return found


@pytest.fixture(scope="module")
def rtk_car(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return imported("rtkexp_drive", recording("rtkexp_drive"), tmp_path_factory.mktemp("rtkexp"))


def test_positions_of_a_car_with_rtk_agree_with_rtk(rtk_car: Path) -> None:
    found = solved(rtk_car)
    assert found["fixes_recorded"] == 2197 and found["distance_m"] == pytest.approx(4050.0, rel=0.02)
    assert found["horizontal_rmse_m"] <= 0.30, "the goal"
    assert found["innovation_horizontal_rms_m"] <= 0.12, "what a 15-state filter reached"
    assert found["fixes_rejected"] < 0.02 * found["fixes_used"] and found["filter_resets"] == 0
    assert found["within_3_sigma_fraction"] > 0.98


def test_the_drift_of_a_car_in_outages_of_ten_seconds_is_a_few_metres(rtk_car: Path) -> None:
    found = solved(rtk_car, "10/30")
    assert found["outage_count"] >= 16
    assert found["outage_end_error_median_m"] <= 2.5, "the goal with wheels that do not slide"
    assert found["outage_end_error_max_m"] < 20.0
    assert found["within_3_sigma_fraction"] > 0.98, "the covariance grows as the error does"


def test_wheel_speeds_limit_the_drift_of_a_car_in_outages_of_fifteen_seconds(rtk_car: Path) -> None:
    found = solved(rtk_car, "15/45")
    assert found["outage_count"] == 11
    assert found["outage_largest_error_rms_m"] <= 3.5, "the goal, and 3.3 m the best peer"


@pytest.mark.parametrize("trial", ["02", "08", "10"])
def test_a_car_with_a_tactical_imu_drifts_by_less_than_1_5_m(trial: str, tmp_path: Path) -> None:
    drive = imported("wid_car", recording(f"wid_car/trial{trial}"), tmp_path)
    whole, cut = solved(drive), solved(drive, "10/30")
    assert whole["horizontal_rmse_m"] <= 0.05 and whole["fixes_rejected"] == 0
    assert cut["outage_count"] >= 2
    assert cut["outage_end_error_median_m"] <= 1.0, "the goal"


@pytest.mark.parametrize("trial", ["03", "07"])
def test_jumps_of_metres_in_a_city_are_rejected_with_at_most_one_reset(trial: str, tmp_path: Path) -> None:
    found = solved(imported("wid_car", recording(f"wid_car/trial{trial}"), tmp_path))
    assert 20 < found["fixes_rejected"] < 0.4 * found["fixes_used"]
    assert found["filter_resets"] <= 1
    # The fixes are used as truth and have jumps of up to 4.9 m.
    assert found["horizontal_rmse_m"] < 1.0


def test_attitude_and_velocity_of_a_truck_agree_with_a_reference_of_higher_grade(tmp_path: Path) -> None:
    found = solved(imported("auburn_truck", recording("auburn_truck/turn"), tmp_path))
    # The IMU is rotated by several degrees against the reference, and the cab moves on its suspension.
    assert found["yaw_sd_rad"] <= radians(1.0), "the goal, another filter reached 1.3"
    assert found["roll_rmse_rad"] < 0.05 and found["pitch_rmse_rad"] < 0.05
    assert found["velocity_rmse_m_s"] < 0.4, "the antenna is several metres from the IMU, and how many is not known"
    assert found["horizontal_rmse_m"] is None, "the reference does not know the position to better than 3 m"


def test_a_parked_truck_has_no_heading(tmp_path: Path) -> None:
    drive = imported("auburn_truck", recording("auburn_truck/static"), tmp_path)
    with pytest.raises(UserError, match="no heading yet"):
        solved(drive)

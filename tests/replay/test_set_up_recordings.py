"""Checks of the set-up on real drives: no finding as recorded, and each injected fault is reported by its check."""

import json
from pathlib import Path

import numpy as np
import pytest

from cli.import_drive.import_drive import import_drive
from cli.recordings.common import open_recording, vehicle_of
from cli.solve.inputs import inputs_of
from cli.solve.solve import solve
from services.core.fusion.set_up.findings import Verdict
from services.core.fusion.settings import Settings
from tests.support.data import REPOSITORY, recording
from tests.support.drives.set_up import Faults, RecordedDrive, recorded

MAPPINGS = REPOSITORY / "benchmarks" / "recordings" / "mappings"
pytestmark = [pytest.mark.recording, pytest.mark.slow]


def messages_of(mapping: str, folder: Path, out: Path, settings: Settings) -> RecordedDrive:
    path = out / "drive.mcap"
    import_drive(MAPPINGS / f"{mapping}.toml", folder, path)
    with open_recording(path) as opened:
        return recorded(list(inputs_of(opened).messages(vehicle_of(opened, None))), settings)


def contradicted(drive: RecordedDrive, faults: Faults, settings: Settings) -> set[str]:
    return {name for name, check in faults.checks(drive, settings).items() if check.verdict is Verdict.CONTRADICTS}


FAULTS = {
    "imu_axes": Faults(axes=("y", "x", "z")),
    "imu_upright": Faults(axes=("x", "-y", "-z")),
    "gyroscope_axes": Faults(gyroscope_axes=("x", "y", "-z")),
    "gnss_height": Faults(height_sign=-1.0),
    "gnss_delay": Faults(late_s=0.5),
}


def test_the_checks_of_a_drive_with_wheel_speeds_and_rtk_report_only_injected_faults(tmp_path: Path) -> None:
    settings = Settings()
    drive = messages_of("wid_car", recording("wid_car/trial02"), tmp_path, settings)
    assert not contradicted(drive, Faults(), settings)
    assert contradicted(drive, Faults(odometer=1.2), settings) == {"odometer_scale"}
    for name, faults in FAULTS.items():
        assert name in contradicted(drive, faults, settings)


@pytest.mark.parametrize("trial", ["01", "03", "04", "07", "08", "10"])
def test_jumps_and_gaps_of_gnss_are_no_findings_of_the_set_up(trial: str, tmp_path: Path) -> None:
    settings = Settings()
    drive = messages_of("wid_car", recording(f"wid_car/trial{trial}"), tmp_path, settings)
    assert not contradicted(drive, Faults(), settings)


def test_a_hilly_drive_shows_signs_of_velocity_and_height(tmp_path: Path) -> None:
    settings = Settings().with_values({"gnss.velocity_delay_s": 0.125})
    drive = messages_of("rtkexp_drive", recording("rtkexp_drive"), tmp_path, settings)
    assert not contradicted(drive, Faults(), settings)
    assert contradicted(drive, Faults(velocity_axes=("x", "y", "-z")), settings) == {"gnss_vertical_velocity"}
    assert contradicted(drive, Faults(velocity_axes=("y", "x", "z")), settings) == {"gnss_velocity_axes"}
    for name, faults in FAULTS.items():
        assert name in contradicted(drive, faults, settings)


def test_a_phone_with_a_gyroscope_bias_of_four_degrees_a_second_aligns_its_heading(tmp_path: Path) -> None:
    """A start in motion with default settings of the gyroscope."""
    path = tmp_path / "comma.mcap"
    import_drive(MAPPINGS / "comma_segment.toml", recording("comma_segment"), path)
    assert solve(path, score_from=8.0, out=tmp_path / "out") == 0
    found = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert np.degrees(found["yaw_rmse_rad"]) < 1.5, "1.0 was measured, and 70 before"
    assert found["horizontal_rmse_m"] < 0.44, "0.42 was measured, GNSS alone has 0.435"

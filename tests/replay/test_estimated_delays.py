"""Recordings with known delays, imported as they were recorded: the delays that the filter estimates.

================  ==============================  =====================================================
drive             by hand                         estimated, with its standard deviation
================  ==============================  =====================================================
balzer82_car      GNSS 1.1 s, velocity 0.35 more  velocity 1.07 ±0.02 s after 90 s, 1.12 ±0.014 s at the end
rtkexp_drive      velocity 0.125 s after it       0.135 ±0.006 s
================  ==============================  =====================================================
"""

from pathlib import Path
from typing import cast

import pytest

from cli.import_drive.import_drive import import_drive
from cli.recordings.common import vehicle_of
from cli.solve.inputs import inputs_of
from services.core.fusion.process import Config, In, Process
from shared.messages.navigation import NavigationState
from shared.recording import Recording
from tests.support.data import REPOSITORY, recording

pytestmark = [pytest.mark.recording, pytest.mark.slow]


def as_recorded(name: str, folder: Path, out: Path) -> Path:
    """Import a drive without the delays of its mapping."""
    folder_of_mappings = REPOSITORY / "benchmarks" / "recordings"
    lines = (
        (folder_of_mappings / "mappings" / f"{name}.toml")
        .read_text()
        .replace("../vehicles", str(folder_of_mappings / "vehicles"))
    )
    kept = [line for line in lines.splitlines() if not line.startswith(("stamps_late_s", "latency_s"))]
    (out / "mapping.toml").write_text("\n".join(kept) + "\n")
    import_drive(out / "mapping.toml", folder, out / "drive.mcap")
    return out / "drive.mcap"


def last_state(drive: Path, until_s: float, **settings: object) -> NavigationState:
    process = Process(Config().with_values({"estimate_delays": True, **settings}))
    with Recording(drive) as recorded:
        messages = list(inputs_of(recorded).messages(vehicle_of(recorded, None)))
    states: list[NavigationState] = []
    for message in messages:
        states += [out for out in process.handle(cast(In, message)) if isinstance(out, NavigationState)]
        if states and (states[-1].sampled_ns - states[0].sampled_ns) * 1e-9 > until_s:
            break
    return states[-1]


def test_a_gnss_delay_of_a_second_is_estimated_and_velocity_is_delayed_more_than_position(tmp_path: Path) -> None:
    drive = as_recorded("balzer82_car", recording("balzer82_car"), tmp_path)
    found = last_state(drive, 110.0, **{"imu.gyroscope_bias_sd_rad_s": 0.05, "non_holonomic.mounting_sd_rad": 0.17})
    assert found.gnss_delay_s is not None and found.gnss_velocity_delay_s is not None
    assert found.gnss_delay_s + found.gnss_velocity_delay_s == pytest.approx(1.1, abs=0.12)
    assert 0.05 < found.gnss_velocity_delay_s < 0.45, "0.16 s were measured after 90 s, 0.39 s at the end"


def test_a_velocity_that_is_the_mean_of_its_epoch_is_half_an_epoch_old(tmp_path: Path) -> None:
    drive = as_recorded("rtkexp_drive", recording("rtkexp_drive"), tmp_path)
    found = last_state(drive, 150.0, **{"vehicle.gnss.lever_arm_body_m": (0.0, -0.05, 0.0)})
    assert found.gnss_velocity_delay_s == pytest.approx(0.125, abs=0.03)
    assert found.gnss_delay_s == pytest.approx(-0.09, abs=0.05), "the clock of the IMU drifts"

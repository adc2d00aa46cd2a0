"""Recordings with known delays, imported as they were recorded: what the check of the set-up and the import find.

================  ================================  ==========================================  ==================
drive             by hand                           check of the set-up                         import
================  ================================  ==========================================  ==================
balzer82_car      GNSS 0.75 s, velocity 0.35 more   0.57 ± 0.05 s, velocity 1.03 ± 0.04 s       1.00 ± 0.01 s
rtkexp_drive      -0.2 s (the clock of the IMU)     -0.15 ± 0.02 s: within what it allows for   -0.18 ± 0.005 s
================  ================================  ==========================================  ==================

The import finds one delay for positions and velocities.
"""

from pathlib import Path
from typing import cast

import pytest

from cli.import_drive.estimates.delay import delay_of_fixes
from cli.import_drive.import_drive import import_drive
from cli.recordings.common import vehicle_of
from cli.solve.inputs import inputs_of
from services.core.fusion.process import Config, In, Process
from shared.messages.base import Message
from shared.messages.navigation import NavigationState, SetUpState, SetUpVerdict
from shared.recording import Recording
from shared.runtime.config import VehicleFile
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


def inputs_as_recorded(name: str, out: Path) -> tuple[list[Message], VehicleFile]:
    with Recording(as_recorded(name, recording(name), out)) as recorded:
        vehicle = vehicle_of(recorded, None)
        return list(inputs_of(recorded).messages(vehicle)), vehicle


def found_by_checks(
    messages: list[Message], vehicle: VehicleFile, until_s: float
) -> tuple[NavigationState, SetUpState]:
    """Last state and last checks of the set-up at a time of the drive."""
    process = Process(vehicle.section("core.fusion", Config))
    state, checks = None, None
    first: NavigationState | None = None
    for message in messages:
        for out in process.handle(cast(In, message)):
            state = out if isinstance(out, NavigationState) else state
            checks = out if isinstance(out, SetUpState) else checks
            first = first or state
        if first and state and (state.sampled_ns - first.sampled_ns) * 1e-9 > until_s:
            break
    assert state is not None and checks is not None
    return state, checks


def test_a_gnss_delay_of_a_second_is_found_and_velocity_is_delayed_more_than_position(tmp_path: Path) -> None:
    messages, vehicle = inputs_as_recorded("balzer82_car", tmp_path)
    found, _ = found_by_checks(messages, vehicle, 152.0)
    assert found.gnss_delay_s is not None and found.gnss_velocity_delay_s is not None
    assert found.gnss_delay_s + found.gnss_velocity_delay_s == pytest.approx(1.1, abs=0.12)
    assert 0.3 < found.gnss_velocity_delay_s < 0.6
    assert delay_of_fixes(messages, vehicle).seconds == pytest.approx(1.0, abs=0.1), "between the two"


def test_the_clock_of_an_imu_that_is_0_2_s_late_is_found_by_the_import_alone(tmp_path: Path) -> None:
    messages, vehicle = inputs_as_recorded("rtkexp_drive", tmp_path)
    found, set_up = found_by_checks(messages, vehicle, 150.0)
    assert found.gnss_delay_s is found.gnss_velocity_delay_s is None
    delays = {check.name: check for check in set_up.checks if check.name in ("gnss_delay", "gnss_velocity_delay")}
    assert {check.verdict for check in delays.values()} == {SetUpVerdict.AGREES}
    assert delays["gnss_delay"].statistic == pytest.approx(-0.15, abs=0.05)
    assert delay_of_fixes(messages, vehicle).seconds == pytest.approx(-0.18, abs=0.04), "it drifts"

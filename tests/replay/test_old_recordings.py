"""Recordings of earlier releases stay solvable; the vehicle's file inside them is translated when it is read."""

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from cli.recordings.common import open_recording, vehicle_of
from cli.recordings.verify import verify
from cli.solve.inputs import inputs_of
from services.core.fusion.process import Config as Fusion
from services.core.trust.process import Config as Trust
from shared.errors import UserError
from shared.evidence.outcome import OTHER_RELEASE
from shared.messages.base import Message
from shared.messages.imu import ImuSamples
from shared.messages.navigation import NavigationSolution
from shared.recording import RecordingWriter
from shared.runtime.offline import OfflineUnit

FloatArray = npt.NDArray[np.float64]
# Written by release 0.1.0, whose core.fusion turned the samples by 90° again; they were published unturned.
TURNED = Path(__file__).parents[1] / "golden" / "releases" / "0_1_0_turned_imu.mcap"


def solutions(messages: list[Message]) -> dict[int, NavigationSolution]:
    return {message.sampled_ns: message for message in messages if isinstance(message, NavigationSolution)}


def forces(messages: Iterable[Message]) -> FloatArray:
    batches = [message.specific_force_body_m_s2 for message in messages if isinstance(message, ImuSamples)]
    return np.concatenate(batches)


@pytest.mark.slow
def test_a_drive_of_release_0_1_0_with_a_turned_imu_has_the_solution_of_that_release() -> None:
    with open_recording(TURNED) as recording:
        recorded = solutions([envelope.decode() for envelope in recording])
        vehicle = vehicle_of(recording, None)
        unit = OfflineUnit(vehicle, ["core.fusion"])
        now = solutions(list(unit.run(inputs_of(recording).messages(vehicle))))
    assert len(recorded) >= 5
    for stamp, navigation_solution in recorded.items():
        assert (now[stamp].latitude_deg, now[stamp].longitude_deg) == pytest.approx(
            (navigation_solution.latitude_deg, navigation_solution.longitude_deg), abs=1e-8
        )
        assert now[stamp].yaw_rad == pytest.approx(navigation_solution.yaw_rad, abs=1e-3)
        assert now[stamp].velocity_ned_m_s == pytest.approx(navigation_solution.velocity_ned_m_s, abs=0.01)


def test_another_mounting_in_the_file_that_is_given_turns_the_samples(tmp_path: Path) -> None:
    file = tmp_path / "level.toml"
    file.write_text("")
    with open_recording(TURNED) as recording:
        inputs = inputs_of(recording)
        right, level = vehicle_of(recording, None), vehicle_of(recording, file)
    turned, as_recorded = (forces(inputs.messages(vehicle)) for vehicle in (right, level))
    correction = np.array(right.facts.imu.body_from_sensor) @ np.array(level.facts.imu.body_from_sensor).T
    assert turned == pytest.approx(as_recorded @ correction.T, abs=1e-9)
    assert np.degrees(np.arctan2(correction[1, 0], correction[0, 0])) == pytest.approx(90.0, abs=0.1)


def test_what_another_release_has_made_is_not_called_different(capsys: pytest.CaptureFixture[str]) -> None:
    assert verify([TURNED], as_json=True) == OTHER_RELEASE
    told = json.loads(capsys.readouterr().out)
    assert told["code"] == OTHER_RELEASE and told["release"] == {"version": None, "is_this": False}
    assert told["files"][0]["outcome"] == "unsigned"


def test_a_given_file_replaces_a_recorded_one_that_cannot_be_read(tmp_path: Path) -> None:
    recorded, given = tmp_path / "drive.mcap", tmp_path / "car.toml"
    RecordingWriter(recorded, vehicle="car", vehicle_toml="[vehicle").close()
    given.write_text('[vehicle]\nname = "car"\n')
    with open_recording(recorded) as recording:
        assert vehicle_of(recording, given).name == "car"
        with pytest.raises(UserError, match="not valid TOML"):
            vehicle_of(recording, None)


def test_facts_of_the_vehicle_in_a_recorded_file_are_those_of_the_sections_of_then(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    then = (
        "[core.fusion.gnss]\nlever_arm_body_m = [0.3, 0.0, -1.2]\ndelay_s = 0.1\n"
        "[core.fusion.integrity]\nalert_limit_horizontal_m = 5.0\n"
    )
    RecordingWriter(path, vehicle="car", vehicle_toml=then).close()
    with open_recording(path) as recording:
        vehicle = vehicle_of(recording, None)
    fusion, trust = vehicle.section("core.fusion", Fusion), vehicle.section("core.trust", Trust)
    assert fusion.vehicle == trust.vehicle == vehicle.facts
    assert fusion.vehicle.gnss.lever_arm_body_m == (0.3, 0.0, -1.2) and fusion.gnss.delay_s == 0.1
    assert trust.vehicle.alert_limits_m == (5.0, 20.0)

"""`obu calibrate spoofing` from end to end: recordings of a simulated unit, the profile, and core.spoofing with it."""

import json
from dataclasses import dataclass
from pathlib import Path

import pytest

from cli.calibrate.spoofing import PROCESSES, calibrate_spoofing
from cli.solve.inputs import inputs_of
from services.core.spoofing.process import Config
from services.core.spoofing.windows.position_step import FALSE_ALARM_RATE
from services.sensors.simulator.world import messages
from shared.errors import ConfigError, UserError
from shared.messages.trust import Outcome, TrustMonitor
from shared.recording import Recording, RecordingWriter
from shared.runtime.config import VehicleFile, load_vehicle
from shared.runtime.live import arrival_ns
from shared.runtime.offline import OfflineUnit
from tests.support.bus.envelopes import sent

pytestmark = pytest.mark.slow  # three drives of a minute or more through fusion

VEHICLE = '[vehicle]\nname = "made"\n\n[vehicle.gnss]\nlever_arm_body_m = [0.3, 0.0, -1.2]\n'
DURATIONS_S = {"monday": 110.0, "tuesday": 110.0, "later": 80.0}


@dataclass(frozen=True)
class CalibratedProfile:
    """A folder with three recordings, and the profile estimated from two of them."""

    folder: Path
    profile: Path

    def vehicle(self, text: str) -> VehicleFile:
        path = self.folder / "vehicle.toml"
        path.write_text(text + f'\n[core.spoofing]\nprofile = "{self.profile.name}"\n')
        return load_vehicle(path)


def record(path: Path, seed: int, duration_s: float) -> Path:
    writer = RecordingWriter(path, vehicle="made", vehicle_toml=VEHICLE)
    for message in messages("urban", seed=seed, duration_s=duration_s):
        writer.write(sent(message, arrival_ns(message) or 0))
    writer.close()
    return path


@pytest.fixture(scope="module")
def learned(tmp_path_factory: pytest.TempPathFactory) -> CalibratedProfile:
    folder = tmp_path_factory.mktemp("calibrate")
    drives = [record(folder / f"{name}.mcap", seed, s) for seed, (name, s) in enumerate(DURATIONS_S.items(), 1)]
    assert calibrate_spoofing(drives[:2], output=folder / "profile.json") == 0
    return CalibratedProfile(folder, folder / "profile.json")


def statements(learned: CalibratedProfile, vehicle: VehicleFile) -> list[TrustMonitor]:
    """Statements of core.spoofing on the 5 s metrics in a drive that is not part of the profile."""
    with Recording(learned.folder / "later.mcap") as opened:
        inputs = inputs_of(opened)
    said = OfflineUnit(vehicle, PROCESSES).run(inputs.messages(vehicle))
    return [message for message in said if isinstance(message, TrustMonitor) and message.monitor == "inertial_short"]


def test_the_profile_names_its_recordings_and_is_read_by_core_spoofing(learned: CalibratedProfile) -> None:
    document = json.loads(learned.profile.read_text())
    assert [drive["file"] for drive in document["origin"]["drives"]] == ["monday.mcap", "tuesday.mcap"]
    assert sum(drive["windows"] for drive in document["origin"]["drives"]) >= 100
    config = learned.vehicle(VEHICLE).section("core.spoofing", Config)
    assert config.profile.model_dump(mode="json") == document
    assert config.profile.origin is not None and config.profile.origin.configuration == config.digest()
    assert all(0.0 < sigma < 2.0 for values in config.profile.sigma.values() for sigma in values)


def test_a_drive_without_attack_is_tested_with_the_profile_and_not_accused(learned: CalibratedProfile) -> None:
    vehicle = learned.vehicle(VEHICLE)
    profile = vehicle.section("core.spoofing", Config).profile
    judged = [s for s in statements(learned, vehicle) if s.outcome is not Outcome.NOT_EVALUATED]
    assert len(judged) > 20
    assert {s.false_alarm_rate for s in judged} <= {profile.false_alarm_rate, FALSE_ALARM_RATE}, "of the deciding test"
    assert not [s for s in judged if s.outcome is Outcome.ACCUSES]
    assert not [s for s in judged if "another unit" in s.model_dump_json()]


def test_a_profile_of_another_configuration_is_used_with_a_warning(learned: CalibratedProfile) -> None:
    other = learned.vehicle(VEHICLE.replace("0.3, 0.0, -1.2", "2.5, 0.0, -1.2"))
    assert [s for s in statements(learned, other) if "the profile was learned for another unit" in s.model_dump_json()]


def test_a_damaged_profile_and_too_short_a_drive_are_errors(learned: CalibratedProfile, tmp_path: Path) -> None:
    short = CalibratedProfile(learned.folder, learned.folder / "cut.json")
    short.profile.write_text(learned.profile.read_text()[:-20])
    with pytest.raises(ConfigError, match=r"cut\.json is no profile"):
        short.vehicle(VEHICLE).section("core.spoofing", Config)
    with pytest.raises(UserError, match=r"windows of 5 s are too few .* give more recordings"):
        calibrate_spoofing([learned.folder / "later.mcap"], output=tmp_path / "profile.json")

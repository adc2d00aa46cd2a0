"""A real drive with a low-cost IMU and RTK: no permanent alarm, and an added drag-off is accused.

The profile is learned from the first half, as `obu calibrate spoofing` does; the IMU's grade is in the settings.
"""

from dataclasses import dataclass
from math import degrees, radians
from pathlib import Path

import numpy as np
import pytest

from cli.import_drive.import_drive import import_drive
from cli.recordings.common import vehicle_of
from cli.solve.inputs import inputs_of
from services.core.fusion.process import Config as FusionConfig
from services.core.fusion.process import Process as Fusion
from services.core.spoofing.grade import Grade
from services.core.spoofing.process import Config, Process
from services.core.spoofing.profile import learn
from shared.maths.earth import Geodetic, geodetic_from_ned_difference
from shared.messages.base import Tick
from shared.messages.gnss import GnssFix
from shared.messages.imu import ImuSamples
from shared.messages.trust import Outcome
from shared.messages.vehicle import VehicleSpeed
from shared.recording import Recording
from shared.runtime.config import VehicleFile, load_vehicle
from tests.support.data import REPOSITORY, recording
from tests.support.drives.spoofing import SECOND_NS, Input, Result, run

RECORDINGS = REPOSITORY / "benchmarks" / "recordings"
ATTACK_S = 300.0
LOW_COST_IMU = {
    "grade": Grade.CONSUMER,
    "vehicle.gnss.lever_arm_body_m": (0.0, -0.05, 0.0),
    "gnss.velocity_delay_s": 0.125,
    "long.accelerometer_bias_sd_m_s2": 0.03,
    "long.gyroscope_bias_sd_rad_s": 5e-4,
    "long.angle_random_walk_rad_sqrt_s": 3e-4,
    "long.velocity_random_walk_m_s_sqrt_s": 0.03,
    "long.scale_sd": 0.01,
    "long.gyroscope_scale_sd": 0.02,
    "long.position_time_sd_s": 0.2,
}
pytestmark = [pytest.mark.recording, pytest.mark.slow]


@dataclass(frozen=True)
class RealDrive:
    """Messages of the recording with a tick a second."""

    vehicle: VehicleFile
    messages: list[Input]
    start_ns: int


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> RealDrive:
    return real_drive("rtkexp_drive", "rtkexp_drive", tmp_path_factory.mktemp("rtkexp"))


def real_drive(name: str, vehicle_name: str, folder: Path) -> RealDrive:
    path = folder / "drive.mcap"
    import_drive(RECORDINGS / "mappings" / f"{name}.toml", recording(name), path)
    with Recording(path) as file:
        given, vehicle = inputs_of(file), vehicle_of(file, None)
    messages: list[Input] = []
    for message in given.messages(vehicle):
        if isinstance(message, ImuSamples | GnssFix):
            second = message.received_ns // SECOND_NS
            last = messages[-1] if messages else message
            if not isinstance(last, Tick) and last.received_ns // SECOND_NS != second:
                messages.append(Tick(now_ns=second * SECOND_NS))
            messages.append(message)
    first = messages[0]
    assert not isinstance(first, Tick)
    vehicle = load_vehicle(RECORDINGS / "vehicles" / f"{vehicle_name}.toml")
    return RealDrive(vehicle, messages, first.received_ns)


def monitored(drive: RealDrive, config: Config, messages: list[Input], **values: float) -> Result:
    fusion = Fusion(drive.vehicle.section("core.fusion", FusionConfig).with_values(values))
    return run(fusion, Process(config), iter(messages))


def dragged(drive: RealDrive, acceleration: float, speed: float) -> list[Input]:
    """Fixes with a velocity to the north-east that grows up to a speed, and the positions that follow from it."""
    changed: list[Input] = []
    moved, last_s = 0.0, ATTACK_S
    for message in drive.messages:
        elapsed_s = 0.0 if isinstance(message, Tick) else (message.received_ns - drive.start_ns) / SECOND_NS
        if isinstance(message, GnssFix) and elapsed_s > ATTACK_S:
            size = min(acceleration * (elapsed_s - ATTACK_S), speed) / np.sqrt(2.0)
            moved, last_s = moved + size * (elapsed_s - last_s), elapsed_s
            changed.append(moved_fix(message, moved, size))
        else:
            changed.append(message)
    return changed


def moved_fix(fix: GnssFix, distance: float, speed: float) -> GnssFix:
    """A fix with a distance [m] and a speed [m/s] added, to the north and to the east each."""
    assert fix.velocity_ned_m_s is not None and fix.latitude_deg is not None and fix.longitude_deg is not None
    north, east, down = fix.velocity_ned_m_s
    place = Geodetic(radians(fix.latitude_deg), radians(fix.longitude_deg), 0.0)
    false = geodetic_from_ned_difference((distance, distance, 0.0), place)
    update = {
        "velocity_ned_m_s": (north + speed, east + speed, down),
        "latitude_deg": degrees(false.latitude),
        "longitude_deg": degrees(false.longitude),
    }
    return fix.model_copy(update=update)


@pytest.fixture(scope="module")
def config(drive: RealDrive) -> Config:
    start = Config().with_values(LOW_COST_IMU)
    windows = monitored(drive, start, drive.messages[: len(drive.messages) // 2]).windows
    return start.model_copy(update={"profile": learn(windows, threshold=6.5, provenance="first half of the drive")})


def test_an_authentic_drive_raises_no_alarm(drive: RealDrive, config: Config) -> None:
    result = monitored(drive, config, drive.messages)
    assert result.episodes("inertial_short") == 0 and result.episodes("inertial_long") == 0
    assert result.share("inertial_short", Outcome.PASS) > 0.85
    assert result.share("inertial_long", Outcome.PASS) > 0.75


def test_a_drag_off_of_0_3_m_s2_on_the_recording_is_accused(drive: RealDrive, config: Config) -> None:
    result = monitored(drive, config, dragged(drive, 0.3, 3.0))
    begin_s = drive.start_ns / SECOND_NS + ATTACK_S
    times = [result.first_s(monitor) for monitor in ("inertial_short", "inertial_long")]
    found = [time_s - begin_s for time_s in times if time_s is not None]
    assert found and 0.0 < min(found) <= 30.0, "17.5 s were measured"


def test_a_minute_of_another_car_raises_no_permanent_alarm(tmp_path: Path) -> None:
    """The age of the fixes is not recorded: for 0.05 to 0.15 s there is no alarm, for 0 s that of the long window."""
    drive = real_drive("comma_segment", "comma_segment", tmp_path)
    delay_s = 0.1
    config = Config().with_values(
        LOW_COST_IMU
        | {"vehicle.gnss.lever_arm_body_m": (0.0, 0.0, 0.0), "gnss.velocity_delay_s": delay_s, "warm_up_s": 0.0}
    )
    result = monitored(drive, config, drive.messages, **{"gnss.delay_s": delay_s, "gnss.velocity_delay_s": delay_s})
    assert result.episodes("inertial_short") <= 1 and result.episodes("inertial_long") == 0
    assert result.share("inertial_short", Outcome.PASS) > 0.8
    assert result.share("inertial_long", Outcome.PASS) > 0.25, "the window of 30 s is first full after 42 of 60 s"


def test_a_receiver_with_a_configured_delay_of_half_a_second_raises_no_permanent_alarm(
    tmp_path: Path,
) -> None:
    """`navmatlab_car_0327`: positions 0.5 s and velocities 0.62 s old by the check of the set-up."""
    drive = real_drive("navmatlab_car_0327", "navmatlab_car", tmp_path)
    config = Config().with_values(
        LOW_COST_IMU | {"vehicle.gnss.lever_arm_body_m": (0.0, 0.0, 0.0), "gnss.velocity_delay_s": 0.62}
    )
    delays = {"gnss.delay_s": 0.5, "gnss.velocity_delay_s": 0.12}
    result = monitored(drive, config, drive.messages, **delays)
    assert result.share("inertial_short", Outcome.ACCUSES) < 0.005
    assert result.episodes("inertial_long") == 0, "5 episodes and 22 % of the time without the delays"
    assert result.share("inertial_long", Outcome.PASS) > 0.85
    part = [m for m in dragged(drive, 0.3, 3.0) if isinstance(m, Tick) or _elapsed_s(drive, m) < 340.0]
    attacked = monitored(drive, config, part, **delays)
    first_s = attacked.first_s("inertial_long")
    assert first_s is not None and 0.0 < first_s - drive.start_ns / SECOND_NS - ATTACK_S < 30.0


def _elapsed_s(drive: RealDrive, message: ImuSamples | GnssFix | VehicleSpeed) -> float:
    return (message.received_ns - drive.start_ns) / SECOND_NS

"""The attack laboratory on a real drive: a jump of the position is detected, and the verdict comes back after it."""

from pathlib import Path

import pytest

from cli.attack_lab.cases import Case
from cli.attack_lab.run import run
from cli.attack_lab.score import VERDICT, detected_after_s
from cli.import_drive.import_drive import import_drive
from services.core.spoofing.profile import UNIT_IMU
from shared.attacks import schedule
from shared.messages.trust import TrustLevel
from tests.support.data import REPOSITORY, recording

RECORDINGS = REPOSITORY / "benchmarks" / "recordings"
# Five times the standard deviations of the unit's IMU in the metrics of 5 s, and those of the long windows.
LOW_COST_IMU = """
[core.spoofing.long]
accelerometer_bias_sd_m_s2 = 0.03
gyroscope_bias_sd_rad_s = 5e-4
angle_random_walk_rad_sqrt_s = 3e-4
velocity_random_walk_m_s_sqrt_s = 0.03
scale_sd = 0.01
[core.spoofing.profile]
threshold = 5.0
false_alarm_rate = 5e-4
provenance = "five times the unit's IMU"
[core.spoofing.profile.sigma]
"""
USABLE = (TrustLevel.SAFE, TrustLevel.CAUTION)
pytestmark = [pytest.mark.recording, pytest.mark.slow]


def test_a_jump_of_the_position_on_a_recording_is_detected_and_the_verdict_comes_back(tmp_path: Path) -> None:
    """For 15 s: without an odometer, 100 m are within the uncertainty of this IMU after half a minute."""
    sigma = [f"{metric} = {[5.0 * value for value in values]}" for metric, values in UNIT_IMU.sigma.items()]
    vehicle = tmp_path / "vehicle.toml"
    text = (RECORDINGS / "vehicles" / "rtkexp_drive.toml").read_text(encoding="utf-8")
    vehicle.write_text(text + LOW_COST_IMU + "\n".join(sigma), encoding="utf-8")
    path = tmp_path / "drive.mcap"
    import_drive(RECORDINGS / "mappings" / "rtkexp_drive.toml", recording("rtkexp_drive"), path, vehicle)
    case = Case(str(path), 0, 0.0, schedule("position_jump@120:15"), recorded=True)
    timeline = run(case)
    after_s = detected_after_s(case, timeline, VERDICT)
    assert after_s is not None and after_s < 5.0
    assert timeline.seconds_in(USABLE, 60.0, 120.0) == pytest.approx(60.0), "no alarm before it"
    assert timeline.seconds_in(USABLE, 125.0, 135.0) == 0.0
    assert timeline.seconds_in(USABLE, 165.0, 540.0) > 0.95 * 375.0, "satellites are not evaluated: CAUTION at best"

"""The profile that `obu calibrate spoofing` writes: learned, named by a vehicle's file, compared with the unit."""

from collections.abc import Sequence
from math import sqrt
from pathlib import Path

import numpy as np
import pytest

from services.core.spoofing.codes import Code
from services.core.spoofing.process import Config, Process
from services.core.spoofing.profile import UNIT_IMU, LearnedDrive, Origin, Profile, ProfileCondition, learn
from services.core.spoofing.settings import UNKNOWN_AXLE_M
from services.core.spoofing.windows.metrics import Metric
from services.core.spoofing.windows.short_window import Window
from shared.errors import ConfigError
from shared.messages.base import Tick
from shared.messages.explanation import explain
from shared.messages.gnss import FixType, GnssFix
from shared.messages.imu import ImuSamples
from shared.messages.trust import TrustMonitor
from shared.runtime.config import load_vehicle

SECOND_NS = 1_000_000_000
DRIVE = LearnedDrive(file="a.mcap", sha256="0" * 64, date="2026-11-01T10:00:00+00:00", duration_s=600.0, windows=500)


def windows(values: Sequence[float]) -> list[Window]:
    return [
        Window(k * SECOND_NS, (k + 5) * SECOND_NS, {Metric.ACCELERATION_EAST: value}, force_m_s2=0.1)
        for k, value in enumerate(values)
    ]


def origin(**changes: object) -> Origin:
    present = Origin(
        imu="imu0", gnss="gnss0", imu_rate_hz=100.0, gnss_rate_hz=1.0, configuration=Config().digest(), code="1",
        drives=(DRIVE,),
    )  # fmt: skip
    return present.model_copy(update=changes)


def profile(learned: Origin) -> Profile:
    found = learn(windows(np.random.default_rng(1).normal(0.0, 0.05, 400).tolist()), provenance="test")
    return found.model_copy(update={"origin": learned})


def test_the_threshold_is_the_least_without_an_alarm_and_a_tolerance_for_the_number_of_windows() -> None:
    calm = np.random.default_rng(2).normal(0.0, 0.05, 1800)
    found = learn(windows(calm.tolist()), provenance="calm")
    assert found.threshold == 5.0 and found.sigma[Metric.ACCELERATION_EAST][0] == pytest.approx(0.05, rel=0.05)
    rough = calm.copy()
    rough[100:102] = rough[500:502] = 0.4
    higher = learn(windows(rough.tolist()), provenance="rough")
    sigma = higher.sigma[Metric.ACCELERATION_EAST][0]
    assert sigma == pytest.approx(0.05, rel=0.05), "robust against outliers"
    tolerance = 1.0 + 3.0 / sqrt(2.0 * 1800 / 5.0)
    assert higher.threshold * sigma == pytest.approx(0.4 * tolerance)


def test_few_windows_take_a_larger_tolerance_and_a_stated_grade_bounds_what_is_learned() -> None:
    rough = np.random.default_rng(2).normal(0.0, 0.05, 300)
    rough[100:102] = 1.0
    free = learn(windows(rough.tolist()), provenance="rough")
    bounded = learn(windows(rough.tolist()), provenance="rough", stated=UNIT_IMU)
    limits = [profile.threshold * profile.sigma[Metric.ACCELERATION_EAST][0] for profile in (free, bounded)]
    most = 3.0 * UNIT_IMU.threshold * UNIT_IMU.sigma[Metric.ACCELERATION_EAST][0]
    assert limits[0] > 1.0 * (1.0 + 3.0 / sqrt(2.0 * 300 / 5.0)) * 0.999 and limits[1] == pytest.approx(most)


def test_the_free_propagations_learn_a_factor_that_leaves_room_above_the_largest_statistic() -> None:
    calm = windows(np.random.default_rng(2).normal(0.0, 0.05, 600).tolist())
    assert learn(calm, provenance="calm", long_statistics=[0.1, 0.2]).long_factor == 1.0
    found = learn(calm, provenance="calm", long_statistics=[0.1, 2.25])
    assert found.long_factor == pytest.approx(1.5 * (1.0 + 3.0 / sqrt(2.0 * 600 / 60.0)))
    bounded = learn(calm, provenance="calm", long_statistics=[0.1, 400.0], stated=UNIT_IMU)
    assert bounded.long_factor == 3.0


def vehicle(folder: Path, text: str) -> Config:
    path = folder / "vehicle.toml"
    path.write_text(text)
    return load_vehicle(path).section("core.spoofing", Config)


def test_a_vehicle_file_names_a_profile_that_lies_beside_it(tmp_path: Path) -> None:
    learned = profile(origin())
    (tmp_path / "p.json").write_text(learned.model_dump_json())
    config = vehicle(tmp_path, '[core.spoofing]\nprofile = "p.json"\n')
    assert config.profile == learned


@pytest.mark.parametrize(("content", "reason"), [(None, "cannot read the profile"), ("{}", "is no profile")])
def test_a_profile_that_cannot_be_read_is_an_error_that_says_what_to_do(
    tmp_path: Path, content: str | None, reason: str
) -> None:
    if content is not None:
        (tmp_path / "p.json").write_text(content)
    with pytest.raises(ConfigError, match=f"{reason}.*obu calibrate spoofing"):
        vehicle(tmp_path, '[core.spoofing]\nprofile = "p.json"\n')


def test_delay_and_noise_are_those_of_fusion_where_the_section_has_none(tmp_path: Path) -> None:
    fusion = (
        "[core.fusion.gnss]\ndelay_s = 0.05\nvelocity_delay_s = 0.1\n"
        "[core.fusion.imu]\nvelocity_random_walk_m_s_sqrt_s = 0.03\nangle_random_walk_rad_sqrt_s = 1e-6\n"
    )
    config = vehicle(tmp_path, fusion)
    assert config.gnss.velocity_delay_s == pytest.approx(0.15)
    assert config.long.velocity_random_walk_m_s_sqrt_s == 0.03
    assert config.long.angle_random_walk_rad_sqrt_s == Config().long.angle_random_walk_rad_sqrt_s, "not below"
    own = vehicle(tmp_path, fusion + "[core.spoofing.gnss]\nvelocity_delay_s = 0.2\n")
    assert own.gnss.velocity_delay_s == 0.2 and own.gnss.position_delay_s == 0.05


def test_lever_arm_and_rear_axle_are_those_of_the_vehicle(tmp_path: Path) -> None:
    assert vehicle(tmp_path, "").rear_axle_distance_m == UNKNOWN_AXLE_M
    facts = "[vehicle]\nrear_axle_body_m = [-0.9, 1.2, 0.4]\n[vehicle.gnss]\nlever_arm_body_m = [0.3, 0.1, -1.2]\n"
    config = vehicle(tmp_path, facts)
    assert config.vehicle.gnss.lever_arm_body_m == (0.3, 0.1, -1.2)
    assert config.rear_axle_distance_m == pytest.approx(1.5), "on the ground"


def test_a_profile_that_was_learned_with_the_lever_arm_in_another_section_stays_that_of_this_unit(
    tmp_path: Path,
) -> None:
    delays = "[core.fusion.gnss]\ndelay_s = 0.05\nvelocity_delay_s = 0.1\n"
    config = vehicle(tmp_path, f"[vehicle.gnss]\nlever_arm_body_m = [0.3, 0.1, -1.2]\n{delays}")
    assert config.digest() == "8dbec4fab48c7b31", "of the release whose [core.spoofing.gnss] held the lever arm"
    assert vehicle(tmp_path, delays).digest() != config.digest()


def stated_after(config: Config, seconds: int = 15) -> TrustMonitor:
    """Give the last statement `inertial_short` of a unit with imu0 at 100 Hz and gnss0 at 1 Hz."""
    process, last = Process(config), list[TrustMonitor]()
    for k in range(1, seconds * 10):
        now_ns = k * SECOND_NS // 10
        stamps = tuple(now_ns - (9 - i) * 10_000_000 for i in range(10))
        list(process.handle(ImuSamples(
            received_ns=now_ns, source="imu0", sampled_ns=stamps, specific_force_body_m_s2=((0.0, 0.0, -9.8),) * 10,
            angular_rate_body_rad_s=((0.0, 0.0, 0.0),) * 10,
        )))  # fmt: skip
        if k % 10 == 0:
            fix = GnssFix(sampled_ns=now_ns, received_ns=now_ns, source="gnss0", fix_type=FixType.THREE_D,
                          velocity_ned_m_s=(0.0, 0.0, 0.0))  # fmt: skip
            list(process.handle(fix))
            last = [s for s in process.handle(Tick(now_ns=now_ns)) if isinstance(s, TrustMonitor)]
    return last[0]


def test_a_profile_of_the_same_unit_gives_no_warning() -> None:
    stated = stated_after(Config(profile=profile(origin())))
    assert stated.reason_code is not None and stated.reason_code.code == Code.NO_INPUT


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"imu": "mti-3"}, {ProfileCondition.IMU: "IMU mti-3, now imu0"}),
        ({"gnss": "neo-m8"}, {ProfileCondition.GNSS: "GNSS receiver neo-m8, now gnss0"}),
        ({"imu_rate_hz": 50.0}, {ProfileCondition.IMU_RATE: "IMU rate 50 Hz, now 100 Hz"}),
        ({"gnss_rate_hz": 4.0}, {ProfileCondition.GNSS_RATE: "GNSS rate 4 Hz, now 1 Hz"}),
        (
            {"configuration": "f" * 16},
            {ProfileCondition.CONFIGURATION: f"configuration {'f' * 16}, now {Config().digest()}"},
        ),
        (
            {"imu": "mti-3", "gnss": "neo-m8"},
            {ProfileCondition.IMU: "IMU mti-3, now imu0", ProfileCondition.GNSS: "GNSS receiver neo-m8, now gnss0"},
        ),
    ],
)
def test_a_profile_of_another_unit_is_warned_of_in_the_statement_and_how_it_differs_in_the_log(
    changes: dict[str, object], named: dict[ProfileCondition, str], caplog: pytest.LogCaptureFixture
) -> None:
    stated = stated_after(Config(profile=profile(origin(**changes))))
    assert stated.reason_code == explain(Code.PROFILE_OF_ANOTHER_UNIT, differences=tuple(named))
    (logged,) = [record.getMessage() for record in caplog.records if "another unit" in record.getMessage()]
    assert "; ".join(named.values()) in logged

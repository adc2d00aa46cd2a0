"""Checks of the set-up: each fault is reported by its check, and a correct set-up is not reported."""

import tomllib
from dataclasses import replace
from functools import cache
from math import radians
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from cli.solve.overrides import with_settings
from services.core.fusion.aids.gnss.fix import GnssVelocity
from services.core.fusion.set_up.axes import AxesFit, fit_axes
from services.core.fusion.set_up.delay import _fit, lag_of
from services.core.fusion.set_up.findings import Check, Verdict
from services.core.fusion.set_up.monitor import ArmError, SetUpMonitor, check_arm
from services.core.fusion.set_up.motion import MAX_WAITING, Changes, Intervals, Motion, MotionLog, Velocities
from services.core.fusion.set_up.receiver import _covered, _mean_velocity
from services.core.fusion.set_up.regression import least_squares, nearest_permutation
from services.core.fusion.settings import Settings
from services.sensors.simulator.drive import simulate
from shared.maths.rotation import Vector, ned_from_body
from shared.runtime.config import LEVEL_MOUNTING, GnssAntenna, ImuMounting, Vehicle, parse_vehicle
from tests.support.cases import each
from tests.support.drives.set_up import Faults, RecordedDrive, matrix_of, simulated

SECONDS = 180.0


@cache
def town() -> RecordedDrive:
    """Three minutes of stop and go in a town with hills."""
    return simulated(simulate("urban", seed=3, duration_s=SECONDS), exact_heights=True)


def contradicted(checks: dict[str, Check]) -> set[str]:
    return {name for name, check in checks.items() if check.verdict is Verdict.CONTRADICTS}


FAULTS = {
    "axes swapped and mirrored": (Faults(axes=("y", "x", "z")), {"imu_axes"}),
    "axis mirrored": (Faults(axes=("x", "-y", "z")), {"imu_axes"}),
    "turned by 90 degrees": (Faults(axes=("y", "-x", "z")), {"imu_axes"}),
    "backwards": (Faults(axes=("-x", "-y", "z")), {"imu_axes"}),
    "upside down": (Faults(axes=("x", "-y", "-z")), {"imu_axes", "imu_upright"}),
    "on its side": (Faults(axes=("x", "z", "-y")), {"imu_axes", "imu_upright"}),
    "gyroscope of the wrong sense": (Faults(gyroscope_axes=("x", "y", "-z")), {"gyroscope_axes"}),
    "gyroscope in other axes": (Faults(gyroscope_axes=("z", "y", "-x")), {"gyroscope_axes"}),
    "forces in g": (Faults(accelerometer=1.0 / 9.80665), {"accelerometer_scale"}),
    "mounted at 20 degrees": (Faults(yaw_rad=radians(20.0)), {"imu_mounting"}),
    "biased gyroscope": (Faults(bias_rad_s=(0.06, -0.17, 0.04)), {"gyroscope_bias"}),
    "heights downwards": (Faults(height_sign=-1.0), {"gnss_height"}),
    "vertical velocity upwards": (Faults(velocity_axes=("x", "y", "-z")), {"gnss_vertical_velocity"}),
    "east before north": (Faults(velocity_axes=("y", "x", "z")), {"gnss_velocity_axes"}),
    "stamps late": (Faults(late_s=0.4), {"gnss_velocity_delay"}),
    "stamps early": (Faults(late_s=-0.3), {"gnss_velocity_delay"}),
    "odometer of other tyres": (Faults(odometer=1.15), {"odometer_scale"}),
    "lever arm": (Faults(arm=ArmError((2.0, 0.1), 12.0, wrong=True)), {"lever_arm"}),
}


def correction_of(setting: dict[str, Any]) -> npt.NDArray[np.float64]:
    """What a proposed mounting changes of the present one, which was the level one; it must be a valid setting."""
    proposed = ImuMounting.model_validate(setting["vehicle"]["imu"]).body_from_sensor
    change: npt.NDArray[np.float64] = np.array(proposed) @ np.array(LEVEL_MOUNTING).T
    return change


@each("what", FAULTS)
def test_each_wrong_setting_is_reported_by_the_check_of_its_name_alone(what: str) -> None:
    faults, expected = FAULTS[what]
    found = contradicted(faults.checks(town()))
    assert expected <= found
    assert found <= expected | {"gnss_delay"}, "no other check"


def test_the_setting_that_a_check_proposes_corrects_the_fault() -> None:
    """The proposed axes undo the swapped ones; delay and scale are the injected ones."""
    axes = ("y", "-x", "z")
    setting = tomllib.loads(Faults(axes=axes).checks(town())["imu_axes"].setting or "")
    correction = correction_of(setting)
    assert correction @ matrix_of(axes) == pytest.approx(np.eye(3))
    late = Faults(late_s=0.4).checks(town())["gnss_velocity_delay"]
    assert late.statistic == pytest.approx(0.4, abs=0.06) and "delay_s = 0.4" in (late.setting or "")
    scale = tomllib.loads(Faults(odometer=1.15).checks(town())["odometer_scale"].setting or "")
    assert scale["core"]["fusion"]["odometer"]["scale"] == pytest.approx(1.0 / 1.15, rel=0.01)
    skewed = tomllib.loads(Faults(yaw_rad=radians(20.0)).checks(town())["imu_mounting"].setting or "")
    turned = correction_of(skewed)
    assert np.degrees(np.arctan2(-turned[0, 1], turned[0, 0])) == pytest.approx(20.0, abs=2.0)


@each("what", FAULTS)
def test_a_proposed_setting_can_be_given_to_obu_solve_as_it_is_printed(what: str) -> None:
    faults, _ = FAULTS[what]
    proposed = [check.setting for check in faults.checks(town()).values() if check.setting]
    for setting in proposed:
        parse_vehicle(setting)
        assert with_settings(parse_vehicle(""), [setting]).section("core.fusion", Settings) != Settings()


def test_the_proposed_lever_arm_is_that_of_the_vehicle_plus_what_was_found() -> None:
    settings = Settings(vehicle=Vehicle(gnss=GnssAntenna(lever_arm_body_m=(0.3, 0.0, -1.2))))
    check = check_arm(settings, ArmError((2.0, 0.1), 12.0, wrong=True))
    assert parse_vehicle(check.setting or "").facts.gnss.lever_arm_body_m == (2.3, 0.1, -1.2)


@pytest.mark.parametrize(
    ("scenario", "seed"), [("urban", 1), ("parking_lot", 1), ("parking_lot", 2), ("degraded", 4), ("highway", 1)]
)
def test_a_correct_set_up_is_not_reported(scenario: str, seed: int) -> None:
    checks = Faults(arm=ArmError((0.05, 0.05), 1.0, wrong=False)).checks(
        simulated(simulate(scenario, seed, duration_s=SECONDS))
    )
    assert not contradicted(checks)
    assert checks["accelerometer_scale"].verdict is checks["imu_upright"].verdict is Verdict.AGREES


@each("of", ["roll", "pitch"])
@each("degrees_", [15.0, -15.0])
@each("moving", [True, False])
def test_a_tilt_of_15_degrees_is_a_finding_with_the_setting_that_corrects_it(
    of: str, degrees_: float, moving: bool
) -> None:
    """Without fixes gravity tells it alone."""
    mount = ned_from_body(*((radians(degrees_), 0.0) if of == "roll" else (0.0, radians(degrees_))), 0.0)
    drive = replace(town(), force=town().force @ mount, rate=town().rate @ mount)
    checks = Faults().checks(drive if moving else replace(drive, fixes=[]))
    assert contradicted(checks) == {"imu_mounting"}
    size_deg = checks["imu_mounting"].statistic
    assert size_deg == pytest.approx(abs(degrees_), abs=1.5)
    setting = tomllib.loads(checks["imu_mounting"].setting or "")
    correction = correction_of(setting)
    assert correction @ mount.T == pytest.approx(np.eye(3), abs=radians(2.0))
    assert checks["imu_mounting"].turn is None, "the heading is right"


@pytest.mark.parametrize(("late_s", "verdict"), [(0.0, Verdict.AGREES), (0.5, Verdict.CONTRADICTS)])
def test_positions_of_a_metre_tell_the_delay_of_a_receiver_without_velocity(late_s: float, verdict: Verdict) -> None:
    drive = simulated(simulate("urban", 2, duration_s=280.0))
    drive = replace(drive, fixes=[fix._replace(velocity=None) for fix in drive.fixes])
    checks = Faults(late_s=late_s, arm=ArmError((2.0, 0.1), 12.0, wrong=True)).checks(drive)
    assert checks["gnss_delay"].verdict is verdict
    assert checks["gnss_delay"].statistic == pytest.approx(late_s, abs=0.1)
    assert checks["lever_arm"].verdict is (Verdict.CONTRADICTS if verdict is Verdict.AGREES else Verdict.UNKNOWN)


def test_without_a_known_delay_there_is_no_finding_of_the_lever_arm() -> None:
    drive = simulated(simulate("degraded", 1, duration_s=SECONDS))
    drive = replace(drive, fixes=[fix._replace(velocity=None) for fix in drive.fixes])
    checks = Faults(arm=ArmError((2.0, 0.1), 12.0, wrong=True)).checks(drive)
    assert checks["gnss_delay"].verdict is checks["lever_arm"].verdict is Verdict.UNKNOWN


def test_after_three_minutes_only_delay_and_lever_arm_may_be_unknown() -> None:
    checks = Faults().checks(town())
    unknown = {name for name, check in checks.items() if check.verdict is Verdict.UNKNOWN}
    assert unknown <= {"gnss_delay", "lever_arm"}


def test_at_standstill_only_the_checks_of_gravity_are_decided() -> None:
    n = 3000
    still = RecordedDrive(
        np.arange(1, n + 1) * 10_000_000, np.tile([0.0, 0.0, -9.81], (n, 1)), np.zeros((n, 3)), fixes=[]
    )
    known = {name for name, check in Faults().checks(still).items() if check.verdict is not Verdict.UNKNOWN}
    assert known == {"accelerometer_scale", "imu_upright"}


def test_a_finding_needs_two_evaluations_and_stays_when_later_ones_are_unknown() -> None:
    monitor = SetUpMonitor(Settings())
    wrong, right = Check("imu_axes", Verdict.CONTRADICTS), Check("imu_axes", Verdict.AGREES)
    monitor._adopt(wrong, 10)
    assert monitor.checks["imu_axes"][0].verdict is Verdict.UNKNOWN
    monitor._adopt(wrong, 20)
    monitor._adopt(Check("imu_axes"), 30)
    assert monitor.checks["imu_axes"] == (wrong, 20)
    monitor._adopt(right, 40)
    assert monitor.checks["imu_axes"] == (right, 40)


def test_delays_in_use_are_those_that_contradict_the_settings() -> None:
    monitor = SetUpMonitor(Settings())
    assert monitor.delays == (0.0, 0.0)
    for _ in range(2):
        monitor._adopt(Check("gnss_velocity_delay", Verdict.CONTRADICTS, statistic=0.6), 10)
    assert monitor.delays == (0.6, 0.6), "of positions nothing is known, and they come from the same receiver"
    monitor._adopt(Check("gnss_delay", Verdict.AGREES, statistic=0.03), 20)
    assert monitor.delays == (0.0, 0.6), "only the velocity is smoothed"
    monitor._adopt(Check("gnss_velocity_delay", Verdict.AGREES, statistic=0.1), 30)
    assert monitor.delays == (0.0, 0.0)


def test_regression_has_consistent_standard_deviations_and_excludes_outliers() -> None:
    rng = np.random.default_rng(1)
    truth = np.array([[1.0, -2.0], [0.5, 3.0]])
    pulls = []
    for _ in range(200):
        x = rng.standard_normal((60, 2))
        y = x @ truth + 0.1 * rng.standard_normal((60, 2))
        y[7] += 100.0
        fit = least_squares(x, y)
        assert fit is not None
        pulls.append((fit.coefficients - truth) / fit.sd)
    assert 0.5 < np.sqrt(np.mean(np.square(pulls))) < 0.9, "rows have half weight, as they may be correlated"
    assert least_squares(np.ones((20, 2)), np.ones((20, 1))) is None


def test_the_nearest_permutation_of_a_disturbed_permutation_is_that_permutation() -> None:
    rng = np.random.default_rng(2)
    true = matrix_of(("-z", "x", "y"))
    found, gap = nearest_permutation(true + 0.2 * rng.standard_normal((3, 3)))
    assert np.array_equal(found, true) and gap > 2.0


def test_the_log_holds_300_s_of_one_device() -> None:
    log = MotionLog()
    for k in range(40_000):
        log.samples((k * 10_000_000,), ((0.0, 0.0, -9.81),), ((0.0, 0.0, 0.0),))
    motion = log.motion()
    assert motion is not None
    assert motion.nodes[-1] - motion.nodes[0] == pytest.approx(300.0, abs=0.2)


def wobbling(seconds: float, seed: int = 4) -> tuple[list[int], list[Vector], list[Vector]]:
    """Stamps at 100 Hz with one gap, forces and rates of a car that wobbles."""
    rng = np.random.default_rng(seed)
    count = round(100 * seconds)
    stamps = np.cumsum(np.full(count, 10_000_000)) + np.where(np.arange(count) > count // 2, 3_000_000_000, 0)
    gravity = np.array([0.0, 0.0, -9.81])
    forces, rates = gravity + rng.standard_normal((count, 3)), 0.1 * rng.standard_normal((count, 3))
    return stamps.tolist(), [(x, y, z) for x, y, z in forces.tolist()], [(x, y, z) for x, y, z in rates.tolist()]


@pytest.mark.parametrize("size", [1, 7, 1000])
def test_integrals_are_the_sums_of_the_samples_however_they_are_batched(size: int) -> None:
    stamps, forces, rates = wobbling(60.0)
    log = MotionLog()
    for first in range(0, len(stamps), size):
        batch = slice(first, first + size)
        log.samples(stamps[batch], forces[batch], rates[batch])
    motion = log.motion()
    assert motion is not None
    steps_s = np.diff(stamps) * 1e-9
    sums = np.cumsum(np.hstack([forces, rates])[1:] * steps_s[:, np.newaxis], axis=0).T
    ends_s = (np.array(stamps[1:]) - stamps[0]) * 1e-9
    places = np.searchsorted(ends_s, motion.nodes[1:] - 1e-6)
    assert motion.nodes[1:] == pytest.approx(ends_s[places])
    assert motion.integrals[:, 1:] == pytest.approx(sums[:, places], rel=1e-12, abs=1e-12)
    assert motion.gaps[-1] == pytest.approx(3.01) and motion.gaps[0] == 0.0
    assert np.diff(motion.nodes).min() > 0.0499


def test_samples_out_of_order_are_left_out_of_the_integrals() -> None:
    stamps, forces, rates = wobbling(20.0)
    straight, disturbed = MotionLog(), MotionLog()
    straight.samples(stamps, forces, rates)
    for k, stamp in enumerate(stamps):
        disturbed.samples((stamp, stamp, stamp - 50_000_000), [forces[k]] + [(99.0, 0.0, 0.0)] * 2, [rates[k]] * 3)
    one, other = straight.motion(), disturbed.motion()
    assert one is not None and other is not None
    assert np.array_equal(one.nodes, other.nodes) and np.array_equal(one.integrals, other.integrals)


def test_a_clock_that_stands_still_does_not_let_the_log_grow() -> None:
    log = MotionLog()
    for _ in range(2 * MAX_WAITING + 10):
        log.samples((1_000_000_000,), ((0.0, 0.0, -9.81),), ((0.0, 0.0, 0.0),))
    assert len(log._waiting) < MAX_WAITING
    assert log.motion() is None


def turning(lag_s: float) -> tuple[Motion, Velocities]:
    """Two minutes of a car whose velocities are older than their stamps by a lag."""
    stamps, forces, rates = wobbling(120.0)
    time = (np.array(stamps) - stamps[0]) * 1e-9
    pull, turn = 2.0 * np.sin(0.7 * time), 0.2 * np.sin(0.45 * time + 1.0)
    log = MotionLog()
    log.samples(
        stamps,
        [(a + f[0] * 0.01, f[1], f[2]) for a, f in zip(pull.tolist(), forces, strict=True)],
        [(w[0], w[1], r + w[2] * 0.01) for r, w in zip(turn.tolist(), rates, strict=True)],
    )
    motion = log.motion()
    assert motion is not None
    at = np.arange(3.0, time[-1] - 3.0)
    past = at - lag_s
    speed = 12.0 - 2.0 / 0.7 * np.cos(0.7 * past)
    course = -0.2 / 0.45 * np.cos(0.45 * past + 1.0)
    ned = np.column_stack([speed * np.cos(course), speed * np.sin(course), np.zeros_like(at)])
    return motion, Velocities(at, at, ned)


@pytest.mark.parametrize("lag_s", [-0.4, 0.0, 0.55])
def test_the_lag_is_found(lag_s: float) -> None:
    motion, velocities = turning(lag_s)
    found = lag_of(motion, velocities)
    assert found is not None and found[0] == pytest.approx(lag_s, abs=0.05)
    assert lag_of(motion, velocities._replace(ned=np.zeros_like(velocities.ned))) is None, "at rest nothing tells it"


def test_means_at_several_lags_are_those_at_each_lag() -> None:
    motion, velocities = turning(0.2)
    changes = Changes.of(velocities).within(motion, 1.0)
    lags = np.array([-0.8, 0.0, 0.35])
    together = changes.inertial(motion, lags)
    assert together.shape == (6, 3, len(changes.rows))
    for place, lag in enumerate(lags):
        assert np.array_equal(together[:, place], changes.inertial(motion, np.array([lag]))[:, 0])
        begin, end = (motion.integrals_at(times[:, 0] - lag) for times in (changes.begin, changes.end))
        assert together[:, place] == pytest.approx((end - begin) / (changes.end - changes.begin)[:, 0], abs=1e-12)


def test_a_regressor_that_follows_from_another_one_changes_no_likelihood() -> None:
    rng = np.random.default_rng(5)
    x, y = rng.standard_normal((2, 4, 200)), rng.standard_normal(200)
    y = y + 3.0 * x[0, 1]
    alone, share = _fit(x, y)
    doubled, same = _fit(np.concatenate([x, 2.0 * x[:1]]), y)
    assert doubled == pytest.approx(alone) and same == pytest.approx(share)
    solved = np.linalg.lstsq(np.column_stack([x[0, 1], x[1, 1], np.ones(200)]), y, rcond=None)[0]
    size = np.abs(y - np.column_stack([x[0, 1], x[1, 1], np.ones(200)]) @ solved)
    left = np.minimum(size, 4.0 * np.median(size))
    assert share[1] == pytest.approx(1.0 - left @ left / ((y - y.mean()) ** 2).sum())


def test_a_window_is_covered_where_measurements_surround_it_without_a_gap() -> None:
    time = np.array([0.0, 1.0, 2.0, 6.0, 7.0, 8.0])
    begin, end = np.array([-0.5, 0.5, 0.5, 6.5, 6.5]), np.array([1.5, 1.5, 3.0, 7.5, 8.5])
    assert _covered(time, begin, end).tolist() == [False, True, False, True, False]


def test_the_mean_velocity_of_a_receiver_needs_two_velocities() -> None:
    """It grows evenly by 2 m/s to the north in a second: 2 m/s over that second, 1.5 m/s over its first half."""
    velocities = np.array([[0.0, 1.0, 0.0, 0.0], [1.0, 3.0, 0.0, 0.0]])
    second = Velocities(np.array([0.0]), np.array([1.0]), np.zeros((1, 3)))
    assert _mean_velocity(velocities, second) == pytest.approx(np.array([[2.0, 0.0]]))
    assert np.isnan(_mean_velocity(velocities[:1], second)).all()


def test_rates_that_the_course_does_not_explain_tell_no_axis() -> None:
    """Of a gyroscope that measures noise; the forces tell the axes of the accelerometer all the same."""
    rng = np.random.default_rng(4)
    time = np.arange(0.0, 200.0)
    course_rate, ahead, still = 0.2 * np.sin(time), np.cos(0.3 * time), np.zeros(len(time))
    force = np.column_stack([ahead, 10.0 * course_rate, still - 9.8])
    integrals = np.vstack([[still, still, -9.8 * time], np.zeros((3, len(time)))])
    motion = Motion(time, integrals, still, np.zeros((0, 4)), np.zeros((0, 4)), np.zeros((0, 2)))
    turning = np.column_stack([still, still, course_rate])

    def axes(rate: npt.NDArray[np.float64]) -> AxesFit:
        seen = Intervals(
            time, np.ones(len(time)), np.full(len(time), 10.0), np.cos(0.3 * time), course_rate, force, rate
        )
        found = fit_axes(motion, seen, LEVEL_MOUNTING)
        assert found is not None and found.columns is not None
        return found

    noise = 0.01 * rng.standard_normal((len(time), 3))
    turn = axes(turning + 0.1 * noise).turn
    assert turn is not None and turn == pytest.approx([0.0, 0.0, 1.0], abs=0.01)
    assert axes(noise).turn is None


def test_what_a_delay_may_be_off_by_is_what_the_filter_does_not_correct_of_the_one_that_is_found() -> None:
    monitor = SetUpMonitor(Settings())
    assert monitor.spread(0.3) == monitor.spread()
    monitor.checks["gnss_delay"] = Check("gnss_delay", Verdict.CONTRADICTS, statistic=0.3, sd=0.03), 0
    assert monitor.spread(0.3).delay_s == pytest.approx(0.03)
    assert monitor.spread(0.26).delay_s == pytest.approx(0.05)
    assert monitor.spread().delay_s == SetUpMonitor(Settings()).spread().delay_s


def test_a_measurement_whose_stamp_does_not_advance_is_not_taken_twice() -> None:
    log = MotionLog()
    log.samples((0, 50_000_000, 100_000_000), ((0.0, 0.0, -9.81),) * 3, ((0.0, 0.0, 0.0),) * 3)
    for stamp, north in ((10_000_000, 1.0), (10_000_000, 2.0), (5_000_000, 3.0), (90_000_000, 4.0)):
        log.see(GnssVelocity(stamp, stamp, "gnss", (north, 0.0, 0.0), np.eye(3), 3, (0.0, 0.0, 0.0)))
    motion = log.motion()
    assert motion is not None and len(motion.nodes) >= 2
    assert motion.velocities[:, 1].tolist() == [1.0, 4.0]

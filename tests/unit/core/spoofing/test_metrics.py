"""The 5 s window, the paper's metrics on arrays, and profiles that are learned."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from cli.papers.spoofing.method import (
    Rates,
    gnss_rates,
    metrics,
    mounting_of,
    paper_rates,
    paper_sigma,
    sensor_rates,
    turned_by_course,
)
from services.core.spoofing.codes import Code
from services.core.spoofing.inertial import propagation
from services.core.spoofing.inertial.anchors import Anchor
from services.core.spoofing.inertial.compass import barometric_pressure
from services.core.spoofing.inertial.tracks import Heights, Series, VelocityFix
from services.core.spoofing.profile import UNIT_IMU, Profile, exceeding, learn
from services.core.spoofing.windows.metrics import Metric, acceleration_differences, consecutive
from services.core.spoofing.windows.short_window import Window, _attitude_part, window_of_fixes
from shared.inertial.increments import SECOND_NS
from shared.maths.earth import STANDARD_GRAVITY
from shared.messages.explanation import explain
from shared.trust.inputs import Input

FloatArray = npt.NDArray[np.float64]
RATE_HZ = 10
DIP = np.radians(66.0)


def phone(seconds: int, seed: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Velocity at 1 Hz [ENU], and force, field and height at 10 Hz of a level phone whose y axis is forward."""
    rng = np.random.default_rng(seed)
    n = seconds * RATE_HZ
    t = np.arange(n + 1) / RATE_HZ
    speed = 12.0 + 5.0 * np.sin(2.0 * np.pi * t / 47.0)
    heading = 1.2 * np.sin(2.0 * np.pi * t / 60.0)
    velocity = np.column_stack([speed * np.sin(heading), speed * np.cos(heading), 0.5 * np.sin(t / 20.0)])
    force_enu = np.diff(velocity, axis=0) * RATE_HZ + [0.0, 0.0, 9.81]
    right = np.column_stack([np.cos(heading), -np.sin(heading), 0.0 * t])[:-1]
    forward = np.column_stack([np.sin(heading), np.cos(heading), 0.0 * t])[:-1]
    axes = np.stack([right, forward, np.tile([0.0, 0.0, 1.0], (n, 1))], axis=1)
    force = np.einsum("nij,nj->ni", axes, force_enu) + rng.normal(0.0, 0.12, (n, 3))
    field = 52.0 * axes @ np.array([0.0, np.cos(DIP), -np.sin(DIP)]) + rng.normal(0.0, 0.5, (n, 3))
    height = np.cumsum(velocity[:-1, 2]) / RATE_HZ + rng.normal(0.0, 0.12, n)
    fixes = velocity[:-1:RATE_HZ] + rng.normal(0.0, [0.03, 0.03, 0.08], (seconds, 3))
    return fixes, force, field, height


VEHICLE_FROM_PHONE = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # forward, right, down


def papers_rates(force: FloatArray, field: FloatArray, height: FloatArray, fixes: FloatArray) -> Rates:
    return turned_by_course(paper_rates(force, field, height, RATE_HZ, VEHICLE_FROM_PHONE), fixes)


def differences(*, improved: bool) -> dict[Metric, FloatArray]:
    fixes, force, field, height = phone(600, 1)
    gnss = gnss_rates(fixes, filtered=improved)
    read = force, field, height
    sensors = sensor_rates(*read, RATE_HZ) if improved else papers_rates(*read, fixes)
    found = metrics(gnss, sensors, np.hypot(fixes[:, 0], fixes[:, 1]))
    return {metric: values[20:] for metric, values in found.items()}


def test_the_papers_acceleration_metric_is_the_acceleration_of_the_vehicle_and_equal_filters_remove_it() -> None:
    papers, improved = differences(improved=False), differences(improved=True)
    assert len(papers[Metric.HEADING_RATE]) == 600 - 1 - 4 - 20
    for metric in (Metric.ACCELERATION_EAST, Metric.ACCELERATION_NORTH):
        assert papers[metric].std() > 0.3 and improved[metric].std() < 0.5 * papers[metric].std()
    assert papers[Metric.ALTITUDE_RATE].std() == pytest.approx(0.05, abs=0.02), "0.04 to 0.05 m/s by the reference"


@pytest.mark.parametrize(("frequency_hz", "gain"), [(0.03, 0.0624), (0.06, 0.2425), (0.12, 0.7071), (0.24, 0.970)])
def test_the_papers_accelerations_are_those_of_the_vehicle_times_the_gain_of_the_high_pass(
    frequency_hz: float, gain: float
) -> None:
    """A car that drives east and oscillates along and across: f^2 / sqrt(f^4 + fc^4), and the mean over a second."""
    n = 2000 * RATE_HZ
    t = (np.arange(n) + 0.5) / RATE_HZ
    along, across = np.sin(2.0 * np.pi * frequency_hz * t), 0.5 * np.cos(2.0 * np.pi * frequency_hz * t)
    force = np.column_stack([across, along, np.full(n, 9.81)])  # the phone's y axis is forward
    field, fixes = np.tile([0.0, 20.0, -47.0], (n, 1)), np.tile([12.0, 0.0, 0.0], (2000, 1))
    east, north, up = papers_rates(force, field, np.zeros(n), fixes).acceleration[300:].T
    mean = np.sinc(frequency_hz)  # of a second
    assert np.sqrt(2.0) * east.std() == pytest.approx(gain * mean, rel=0.02)
    assert np.sqrt(2.0) * north.std() == pytest.approx(0.5 * gain * mean, rel=0.02), "right is south"
    assert np.abs(up).max() < 1e-9


def test_accelerations_are_turned_by_the_course_which_stays_below_1_m_s() -> None:
    rates = Rates(np.zeros(4), np.tile([2.0, 1.0, -3.0], (4, 1)), np.zeros(4))
    velocity = np.array([[0.0, 9.0, 0.0], [0.0, 9.0, 0.0], [9.0, -9.0, 0.0], [0.3, 0.2, 0.0], [-0.2, 0.3, 0.0]])
    turned = turned_by_course(rates, velocity).acceleration
    assert turned[0] == pytest.approx([1.0, 2.0, 3.0]), "north"
    assert turned[1] == pytest.approx([2.0, -1.0, 3.0]), "east"
    assert turned[3] == pytest.approx(turned[2]), "standing"


@given(st.integers(0, 2**32))
@settings(max_examples=20, deadline=None)
def test_a_mounting_is_found_by_gravity_and_the_accelerations_of_gnss(seed: int) -> None:
    fixes, force, _, _ = phone(300, 3)
    turn = Rotation.random(rng=seed).as_matrix()
    seconds = force.reshape(-1, RATE_HZ, 3).mean(axis=1) @ turn.T
    shifted = np.vstack([seconds[:1], seconds[:-1]])  # second k is [k - 1, k)
    found = mounting_of(shifted, np.tile(turn @ [0.0, 0.0, 9.81], (300, 1)), fixes)
    assert np.linalg.det(found) == pytest.approx(1.0)
    assert found == pytest.approx(VEHICLE_FROM_PHONE @ turn.T, abs=0.03)


def test_the_papers_sigma_of_1_hz_errors_is_too_wide_for_the_mean_of_a_differenced_series() -> None:
    rng = np.random.default_rng(3)
    heading, height = rng.normal(0.0, 0.1, 2000), rng.normal(0.0, 0.1, 2000)
    windowed = np.std((heading[5:] - heading[:-5]) / 5.0)
    assert paper_sigma(np.diff(heading), np.diff(height)) / windowed > 2.0


def test_the_heading_rate_is_not_defined_below_1_m_s() -> None:
    fixes, force, field, height = phone(60, 2)
    fixes[30] = 0.0
    speed = np.hypot(fixes[:, 0], fixes[:, 1])
    found = metrics(gnss_rates(fixes), papers_rates(force, field, height, fixes), speed)
    missing = np.flatnonzero(np.isnan(found[Metric.HEADING_RATE]))
    assert missing.tolist() == list(range(25, 31)), "the six windows that hold the epoch"
    assert np.isfinite(found[Metric.ACCELERATION_EAST]).all()


def test_accelerations_are_compared_as_vectors_and_by_magnitude() -> None:
    found = acceleration_differences(np.array([3.0, 4.0, -0.5]), np.array([3.0, 3.0, 0.0]))
    assert found[Metric.ACCELERATION_EAST] == 1.0 and found[Metric.ACCELERATION_NORTH] == 0.0
    assert found[Metric.ACCELERATION_UP] == 0.5
    assert found[Metric.ACCELERATION] == pytest.approx(np.sqrt(25.25) - np.sqrt(18.0))


def test_an_alarm_takes_two_successive_evaluations() -> None:
    exceeded = np.array([True, False, True, True, True, False, True])
    assert consecutive(exceeded).tolist() == [False, False, False, True, True, False, False]


def fix(time_s: float) -> VelocityFix:
    return VelocityFix(round(time_s * SECOND_NS), np.array([5.0, 0.0, 0.0]), np.full(3, 0.05))


def test_a_window_holds_5_s_of_fixes_or_says_why_there_is_none() -> None:
    assert window_of_fixes([]) == explain(Code.NO_INPUT, input=Input.GNSS_VELOCITY)
    assert window_of_fixes([fix(t) for t in range(5)]) == explain(Code.FEW_VELOCITIES)
    whole = window_of_fixes([fix(t) for t in range(9)])
    assert isinstance(whole, list) and [f.time_ns // SECOND_NS for f in whole] == [3, 4, 5, 6, 7, 8]
    assert window_of_fixes([fix(t) for t in (0, 1, 3, 4, 5)]) == explain(Code.VELOCITY_GAP, limit_s=1.6)
    dense = window_of_fixes([fix(t / 4) for t in range(60)])
    assert isinstance(dense, list) and dense[-1].time_ns - dense[0].time_ns == 5 * SECOND_NS


def test_a_series_interpolates_between_neighbours_only() -> None:
    series = Series(10, 2.0)
    for time_s, value in ((0, 1.0), (1, 3.0), (5, 4.0)):
        series.add(time_s * SECOND_NS, value)
    assert series.at(SECOND_NS // 2) == 2.0 and series.at(5 * SECOND_NS) == 4.0
    assert series.at(3 * SECOND_NS) is None, "a gap of 4 s"
    assert series.at(-1) is None and series.at(6 * SECOND_NS) is None


def test_barometric_heights_give_a_rate_and_bad_pressures_are_counted() -> None:
    heights = Heights()
    for k in range(100):
        heights.pressure(k * SECOND_NS // 10, barometric_pressure(300.0 + 0.1 * k))
    assert heights.rate(2 * SECOND_NS, 7 * SECOND_NS) == pytest.approx(1.0, rel=1e-6)
    assert heights.rate(2 * SECOND_NS, 20 * SECOND_NS) is None
    for pressure in (0.0, 1e9, float("nan")):
        heights.pressure(20 * SECOND_NS, pressure)
    assert heights.rejected.total() == 3


def windows(count: int, seed: int, sigma: float) -> list[Window]:
    rng = np.random.default_rng(seed)
    return [
        Window(
            k, k + 5, {Metric.ACCELERATION_EAST: float(rng.normal(0.0, np.hypot(sigma * (1 + (k % 2)), 0.02)))},
            {Metric.ACCELERATION_EAST: 0.02}, (6.0, 8.0), 0.5 if k % 2 else 0.1,
        )
        for k in range(count)
    ]  # fmt: skip


def test_a_profile_is_learned_by_dynamics_class_without_the_noise_of_gnss() -> None:
    profile = learn(windows(8000, 1, 0.05), threshold=4.0, provenance="seeded windows")
    calm, lively, *others = profile.sigma[Metric.ACCELERATION_EAST]
    assert calm == pytest.approx(0.05, rel=0.05) and lively == pytest.approx(0.10, rel=0.05)
    assert others == [lively, lively], "classes without windows take the largest"
    assert profile.false_alarm_rate == pytest.approx(1.0 / 8001.0)
    assert Metric.ALTITUDE_RATE not in profile.sigma
    assert Profile.model_validate_json(profile.model_dump_json()) == profile


def test_a_threshold_of_three_sigma_is_exceeded_as_often_as_normal_noise_exceeds_it() -> None:
    profile = learn(windows(8000, 2, 0.05), threshold=3.0, provenance="seeded windows")
    exceeded = sum(bool(exceeding(window, profile)) for window in windows(8000, 3, 0.05))
    assert 8 <= exceeded <= 37, "0.27 % of 8000 is 21.6, within 3 standard deviations"


def test_a_stated_inaccuracy_of_gnss_widens_the_threshold() -> None:
    window = windows(1, 1, 0.05)[0]
    wide = replace(window, noise={Metric.ACCELERATION_EAST: 1.0})
    narrow_sigma = UNIT_IMU.sigma_of(Metric.ACCELERATION_EAST, window)
    wide_sigma = UNIT_IMU.sigma_of(Metric.ACCELERATION_EAST, wide)
    assert narrow_sigma is not None and wide_sigma is not None and wide_sigma > 1.0 > narrow_sigma


def test_too_few_windows_and_incomplete_profiles_are_errors() -> None:
    with pytest.raises(ValueError, match="drive for ten minutes"):
        learn(windows(99, 1, 0.05), threshold=3.0, provenance="short")
    with pytest.raises(ValidationError, match="needs 4 positive"):
        Profile(sigma={Metric.ACCELERATION: (0.1,)}, threshold=3.0, false_alarm_rate=0.0, provenance="")


def test_a_bias_of_the_gyroscope_tilts_gravity_in_proportion_to_time() -> None:
    anchor = Anchor(0, np.zeros(propagation.STATE), np.zeros((3, 3)), np.array([1e-3, 2e-3, 0.0]))
    for middle_s in (1.0, 4.0):
        sd = _attitude_part(anchor, np.eye(3), np.zeros(3), middle_s)
        np.testing.assert_allclose(sd, STANDARD_GRAVITY * middle_s * np.array([2e-3, 1e-3, 0.0]), rtol=1e-12)

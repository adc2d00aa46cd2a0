from copy import copy
from math import degrees, radians, sqrt

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from services.core.fusion.settings import Settings
from services.core.fusion.start.levelling import Levelling, level, standstill_gyroscope_bias
from shared.maths.earth import STANDARD_GRAVITY, earth_rate_n
from shared.maths.rotation import Vector, matrix_from_quaternion, ned_from_body

STEP_S = 0.01
UP: Vector = (0.0, 0.0, -STANDARD_GRAVITY)
NOTHING: Vector = (0.0, 0.0, 0.0)


def feed(levelling: Levelling, seconds: float, force: Vector, rate: Vector = NOTHING, *, shake: float = 0.0) -> None:
    rng = np.random.default_rng(5)
    for _ in range(round(seconds / STEP_S)):
        x, y, z = (np.array(force) + shake * rng.standard_normal(3)).tolist()
        a, b, c = (np.array(rate) + 0.02 * shake * rng.standard_normal(3)).tolist()
        levelling.advance((x, y, z), (a, b, c), STEP_S)


@pytest.mark.parametrize("roll_pitch", [(0.0, 0.0), (0.3, -0.2), (-3.0, 1.2)])
def test_roll_and_pitch_follow_from_the_specific_force_at_standstill(roll_pitch: tuple[float, float]) -> None:
    force = ned_from_body(*roll_pitch, 1.0).T @ np.array(UP)
    x, y, z = force.tolist()
    assert level((x, y, z)) == pytest.approx(roll_pitch, abs=1e-12)


def test_a_bias_of_two_thousandths_of_gravity_tilts_by_a_tenth_of_a_degree() -> None:
    bias = 2e-3 * STANDARD_GRAVITY
    assert degrees(level((bias, 0.0, -STANDARD_GRAVITY))[1]) == pytest.approx(0.115, abs=0.001)
    assert abs(degrees(level((0.0, bias, -STANDARD_GRAVITY))[0])) == pytest.approx(0.115, abs=0.001)


def test_the_gyroscope_bias_at_standstill_is_the_mean_rate_minus_the_earth_rate() -> None:
    attitude, bias = ned_from_body(0.1, 0.2, 2.0), np.array([1e-3, -2e-3, 5e-4])
    earth = earth_rate_n(radians(42.0))
    x, y, z = (attitude.T @ np.array(earth) + bias).tolist()
    assert standstill_gyroscope_bias((x, y, z), attitude, earth) == pytest.approx(bias, abs=1e-15)


def test_a_standstill_of_fifteen_seconds_completes_the_levelling() -> None:
    levelling = Levelling(Settings())
    feed(levelling, 14.9, UP, (0.002, 0.0, -0.001))
    assert levelling.is_stationary and not levelling.ready
    feed(levelling, 0.2, UP, (0.002, 0.0, -0.001))
    assert levelling.ready
    assert levelling.rate_bias == pytest.approx((0.002, 0.0, -0.001), abs=1e-12)


def test_moving_off_completes_the_levelling() -> None:
    levelling = Levelling(Settings())
    feed(levelling, 3.0, UP)
    feed(levelling, 1.0, (1.5, 0.0, -STANDARD_GRAVITY))
    assert levelling.ready and not levelling.is_stationary


def test_levelling_in_motion_has_tilt_errors_below_2_5_degrees_and_the_stated_deviation() -> None:
    """Twenty seconds of turns, braking and accelerating."""
    levelling = Levelling(Settings())
    for forward, right in ((1.5, 0.5), (0.0, 2.0), (-1.5, -0.5), (0.0, -2.0)) * 5:
        feed(levelling, 1.0, (forward, right, -STANDARD_GRAVITY))
    assert levelling.ready
    assert levelling.standstill_quaternion is None
    roll, pitch, _ = Rotation.from_matrix(matrix_from_quaternion(levelling.quaternion)).as_euler("ZYX")[::-1]
    assert max(abs(degrees(roll)), abs(degrees(pitch))) < min(2.5, degrees(levelling.tilt_sd))
    assert levelling.tilt_sd > radians(2.0)


def test_levelling_in_motion_estimates_a_gyroscope_bias_of_4_degrees_a_second() -> None:
    """A minute of driving with a bias of 4 degrees a second about a horizontal axis."""
    levelling, bias = Levelling(Settings()), radians(4.0)
    for forward, right in ((1.5, 0.5), (0.0, 1.0), (-1.5, -0.5), (0.0, -1.0)) * 15:
        for _ in range(100):
            levelling.advance((forward, right, -STANDARD_GRAVITY), (bias, 0.0, 0.0), 0.01)
    assert levelling.rate_bias[0] == pytest.approx(bias, abs=3.0 * sqrt(levelling.covariance.bias))
    assert sqrt(levelling.covariance.bias) < radians(0.7)
    roll, pitch, _ = Rotation.from_matrix(matrix_from_quaternion(levelling.quaternion)).as_euler("ZYX")[::-1]
    assert max(abs(degrees(roll)), abs(degrees(pitch))) < 3.0 * degrees(levelling.tilt_sd)


def test_a_standstill_is_detected_with_an_idling_engine() -> None:
    """Vibration of 0.7 m/s² and 0.014 rad/s in single samples, as recorded in a car at standstill."""
    levelling = Levelling(Settings())
    feed(levelling, 15.0, UP, (0.001, 0.0, 0.0), shake=0.7)
    assert levelling.is_stationary
    assert levelling.rate_bias == pytest.approx((0.001, 0.0, 0.0), abs=2e-3)


def test_slow_even_motion_after_a_standstill_is_not_a_standstill() -> None:
    """Constant speed for two seconds with a yaw rate of 0.2 degrees a second does not change the bias."""
    levelling = Levelling(Settings())
    feed(levelling, 10.0, UP)
    feed(levelling, 0.5, (1.0, 0.0, -STANDARD_GRAVITY))
    feed(levelling, 3.0, UP, (0.0, 0.0, radians(0.2)))
    assert not levelling.is_stationary
    assert levelling.rate_bias == pytest.approx(NOTHING, abs=1e-12)


def test_a_motion_measured_by_gnss_ends_a_standstill() -> None:
    levelling = Levelling(Settings())
    for _ in range(10):
        levelling.use_speed(30.0)
        feed(levelling, 1.0, UP)
    assert not levelling.is_stationary


def test_bias_and_attitude_of_a_false_standstill_are_discarded_when_gnss_measures_motion() -> None:
    """Motion at constant speed is detected as a standstill until positions change."""
    levelling = Levelling(Settings())
    feed(levelling, 4.0, UP, (0.0, 0.0, 0.01))
    assert levelling.is_stationary and levelling.rate_bias[2] == pytest.approx(0.01)
    levelling.discard_standstill()
    assert not levelling.is_stationary and levelling.standstill_quaternion is None and levelling.yaw_at_start is None
    assert levelling.rate_bias == NOTHING
    feed(levelling, 0.5, UP)
    assert levelling.ready, "after three seconds of motion"


def test_acceleration_is_integrated_from_the_end_of_a_standstill() -> None:
    levelling = Levelling(Settings())
    feed(levelling, 5.0, UP)
    feed(levelling, 3.0, (1.0, 0.0, -STANDARD_GRAVITY))
    assert levelling.velocity == pytest.approx((3.0, 0.0), abs=0.01)
    assert levelling.moving_s == pytest.approx(3.0, abs=0.01)


def test_an_hour_of_earth_rotation_at_standstill_does_not_tilt_the_level_frame() -> None:
    """The rotation of the Earth in an hour, 15 degrees, applied within 36 s of half-second blocks."""
    levelling = Levelling(Settings())
    for hour in range(72):
        feed(levelling, 0.5, UP, (radians(0.01 * hour / 72), 0.0, 0.0))
    roll, pitch, _ = Rotation.from_matrix(matrix_from_quaternion(levelling.quaternion)).as_euler("ZYX")[::-1]
    assert (roll, pitch) == pytest.approx((0.0, 0.0), abs=1e-6)


def test_a_copy_of_the_levelling_is_independent() -> None:
    levelling = Levelling(Settings())
    feed(levelling, 5.0, UP)
    twin = copy(levelling)
    feed(levelling, 5.0, (2.0, 0.0, -STANDARD_GRAVITY))
    assert twin.is_stationary and not levelling.is_stationary
    assert twin.velocity == (0.0, 0.0)

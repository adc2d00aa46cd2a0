"""Levelling by gyroscope from standstill: closed forms, a tilted IMU, a road with a bank, a biased gyroscope."""

from math import cos, radians, sin

import numpy as np
import numpy.typing as npt
import pytest

from services.core.motion_conflict.inertial_speed.levelling import LevelIncrement, Levelling
from shared.inertial.increments import SECOND_NS, Increment
from shared.maths.earth import STANDARD_GRAVITY
from shared.maths.rotation import ned_from_body

FloatArray = npt.NDArray[np.float64]
STEP_NS = SECOND_NS // 10


class LevellingDrive:
    """Feeds increments of a known motion to a levelling; `mounting` turns the IMU in the vehicle."""

    def __init__(
        self, *, mounting: FloatArray | None = None, bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ) -> None:
        self.levelling = Levelling()
        self._turn = np.eye(3) if mounting is None else mounting
        self._bias, self._time_ns = np.array(bias), 0

    def step(
        self, speed: float | None, force_b: FloatArray, rate_b: FloatArray, acceleration: float | None = 0.0
    ) -> LevelIncrement | None:
        row = [*(self._turn.T @ force_b), *(self._turn.T @ rate_b + self._bias), 0.1]
        self._time_ns += STEP_NS
        increment = Increment(self._time_ns - STEP_NS, self._time_ns, row, 0.0, False)
        return self.levelling.step(increment, speed, acceleration)

    def stand(self, seconds: float = 3.0, *, roll: float = 0.0) -> None:
        gravity = ned_from_body(roll, 0.0, 0.0).T @ np.array([0.0, 0.0, -STANDARD_GRAVITY])
        for _ in range(round(10 * seconds)):
            self.step(0.0, gravity, np.zeros(3))


LEVEL = np.array([0.0, 0.0, -STANDARD_GRAVITY])


def test_nothing_is_given_before_a_standstill() -> None:
    driven = LevellingDrive()
    assert driven.step(10.0, LEVEL, np.zeros(3)) is None
    assert not driven.levelling.ready
    driven.stand()
    assert driven.levelling.ready


def test_a_standing_vehicle_whose_speed_is_not_zero_or_whose_readings_change_teaches_nothing() -> None:
    driven = LevellingDrive()
    for k in range(40):
        driven.step(0.0, LEVEL, np.array([0.0, 0.0, 0.05 * (-1) ** k]))
        driven.step(5.0, LEVEL, np.zeros(3))
    assert not driven.levelling.ready


@pytest.mark.parametrize("pitch", [0.0, 11.0])
def test_a_steady_turn_has_the_centripetal_acceleration_however_the_imu_is_mounted(pitch: float) -> None:
    """At 10 m/s and 0.3 rad/s; an IMU pitched by 11 degrees sees 2 % less about its own z axis."""
    driven = LevellingDrive(mounting=ned_from_body(0.0, radians(pitch), 0.0), bias=(0.01, -0.02, 0.03))
    driven.stand()
    for _ in range(30):
        levelled = driven.step(10.0, LEVEL + np.array([0.0, 3.0, 0.0]), np.array([0.0, 0.0, 0.3]))
    assert levelled is not None
    assert levelled.yaw_rate == pytest.approx(0.3, abs=1e-6)
    assert levelled.lateral == pytest.approx(3.0, abs=1e-3)
    assert levelled.forward == pytest.approx(0.0, abs=1e-3)


def test_a_bank_that_the_gyroscope_sees_is_removed() -> None:
    """The body rolls by 4 degrees within 1 s: without the gyroscope's roll 0.7 m/s² would be taken for lateral."""
    driven, roll = LevellingDrive(), 0.0
    driven.stand()
    for _ in range(10):
        roll += radians(0.4)
        force = np.array([0.0, -STANDARD_GRAVITY * sin(roll), -STANDARD_GRAVITY * cos(roll)])
        levelled = driven.step(0.5, force, np.array([radians(4.0), 0.0, 0.0]))
    assert levelled is not None and levelled.lateral == pytest.approx(0.0, abs=0.01)


def test_tilt_is_corrected_on_straights_and_not_in_bends() -> None:
    driven = LevellingDrive()
    driven.stand(roll=radians(2.0))  # parked on a bank, then driven on a level road without its turn being seen
    for _ in range(300):
        straight = driven.step(10.0, LEVEL, np.zeros(3))
    assert straight is not None and abs(straight.lateral) < 0.01
    for _ in range(100):
        bend = driven.step(10.0, LEVEL + np.array([0.0, 3.0, 0.0]), np.array([0.0, 0.0, 0.3]))
    assert bend is not None and bend.lateral == pytest.approx(3.0, abs=0.02)


def test_a_vehicle_on_its_side_is_no_vehicle() -> None:
    driven = LevellingDrive(mounting=ned_from_body(0.0, radians(80.0), 0.0))
    driven.stand()
    assert driven.step(5.0, LEVEL, np.zeros(3)) is None

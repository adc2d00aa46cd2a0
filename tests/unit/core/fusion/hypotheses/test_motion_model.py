"""The model of motion without inertial sensors: truth on an arc, consistency, start, gaps and wrong positions."""

from math import cos, hypot, radians, sin

import numpy as np
import pytest

from services.core.fusion.aids.gnss.fix import GnssPosition, GnssVelocity
from services.core.fusion.aids.odometer.aid import WheelSpeed
from services.core.fusion.hypotheses.motion_model import MAX_GAP_S, REJECTIONS, MotionModel, State
from services.core.fusion.settings import Settings
from shared.maths.earth import Geodetic, geodetic_from_ned_difference, ned_from_geodetic_difference

SECOND_NS = 1_000_000_000
PLACE = Geodetic(radians(45.0), radians(9.0), 100.0)
SPEED, TURN, SD_M = 10.0, 0.05, 1.0
ARM = (1.2, 0.3, -1.5)
SETTINGS = Settings().with_values({"vehicle.gnss.lever_arm_body_m": ARM})


def truth(time_s: float) -> tuple[np.ndarray, float]:
    """Position [m, NED] and heading on a circle."""
    heading, radius = TURN * time_s, SPEED / TURN
    return np.array([radius * sin(heading), radius * (1.0 - cos(heading)), 0.0]), heading


def fix(time_s: float, noise: np.ndarray, *, aside_m: float = 0.0) -> tuple[GnssVelocity, GnssPosition]:
    """Velocity and position of the antenna."""
    position, heading = truth(time_s)
    c, s = cos(heading), sin(heading)
    arm = np.array([c * ARM[0] - s * ARM[1], s * ARM[0] + c * ARM[1], ARM[2]])
    velocity = np.array([SPEED * c, SPEED * s, 0.0]) + TURN * np.array([-arm[1], arm[0], 0.0])
    stamp = round(time_s * SECOND_NS)
    north, east, down = (position + arm + SD_M * noise[:3] + np.array([aside_m, 0.0, 0.0])).tolist()
    vn, ve, vd = (velocity + 0.05 * noise[3:]).tolist()
    return (
        GnssVelocity(stamp, stamp, "gnss", (vn, ve, vd), 0.05**2 * np.eye(3), 3, ARM),
        GnssPosition(stamp, stamp, "gnss", geodetic_from_ned_difference((north, east, down), PLACE),
                     SD_M**2 * np.eye(3), 3, ARM, 0.0),
    )  # fmt: skip


def driven(seed: int, until_s: float = 60.0, *, aside_from_s: float = 1e9, aside_m: float = 0.0) -> MotionModel:
    """A model after a drive with ten fixes and speeds a second."""
    rng, model = np.random.default_rng(seed), MotionModel(SETTINGS)
    for k in range(round(10 * until_s)):
        time_s = 0.1 * k
        for item in fix(time_s, rng.normal(size=6), aside_m=aside_m if time_s >= aside_from_s else 0.0):
            model.use(item)
        stamp = round(time_s * SECOND_NS)
        model.use(WheelSpeed(stamp, stamp, "wheels", SPEED, 0.0, of_wheels=True, exact=True, settings=SETTINGS))
    return model


def state(model: MotionModel, time_s: float) -> State:
    found = model.state(round(time_s * SECOND_NS))
    assert found is not None
    return found


def errors(found: State, time_s: float) -> tuple[np.ndarray, float]:
    position, heading = truth(time_s)
    return np.array(ned_from_geodetic_difference(found.position, PLACE)) - position, found.heading - heading


def test_position_heading_and_velocity_are_those_of_the_vehicle_on_an_arc() -> None:
    found = state(driven(1), 59.9)
    error, turned = errors(found, 59.9)
    assert hypot(*error[:2]) < 1.5 and abs(np.angle(np.exp(1j * turned))) < radians(3.0)
    assert hypot(*found.velocity[:2]) == pytest.approx(SPEED, abs=0.3)


def test_errors_of_position_are_within_the_stated_covariance() -> None:
    """Positions with the receiver's own error, which no average removes: the covariance is an upper bound."""
    squares = []
    for seed in range(12):
        found = state(driven(seed, 20.0), 19.9)
        error, _ = errors(found, 19.9)
        squares.append(error[:2] @ np.linalg.solve(found.position_cov[:2, :2], error[:2]))
    assert np.mean(squares) < 2.0 and max(squares) < 13.8


def test_innovations_have_their_expected_value() -> None:
    assert driven(3).innovations == pytest.approx(3.0, abs=1.5)


def test_it_starts_only_in_motion_and_ends_long_after_the_last_position() -> None:
    model = MotionModel(SETTINGS)
    velocity, position = fix(0.0, np.zeros(6))
    model.use(position)
    slow = GnssVelocity(0, 0, "gnss", (0.5, 0.0, 0.0), 0.05**2 * np.eye(3), 3, ARM)
    model.use(slow)
    assert model.state(SECOND_NS) is None
    model.use(velocity)
    early, late = model.state(SECOND_NS), model.state(round((MAX_GAP_S + 0.5) * SECOND_NS))
    assert early is not None and late is None
    nine = state(model, 9.0)
    assert nine.position_cov[0, 0] > 10.0 * early.position_cov[0, 0], "it soon knows nothing"


def test_asking_for_a_state_changes_nothing() -> None:
    model = driven(4, 10.0)
    first = state(model, 12.0)
    state(model, 15.0)
    again = state(model, 12.0)
    assert first.position == again.position and np.array_equal(first.position_cov, again.position_cov)


def test_positions_that_stay_far_off_start_it_again_there() -> None:
    model = driven(5, 20.0, aside_from_s=15.0, aside_m=200.0)
    error, _ = errors(state(model, 19.9), 19.9)
    assert error[0] == pytest.approx(200.0, abs=3.0) and REJECTIONS < 50


def test_an_old_measurement_is_left_out() -> None:
    model = driven(6, 10.0)
    before = state(model, 10.0)
    for item in fix(3.0, np.zeros(6), aside_m=50.0):
        model.use(item)
    assert state(model, 10.0).position == before.position

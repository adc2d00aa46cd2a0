from math import cos, pi, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from services.sensors.simulator.drive import Drive, simulate
from shared.inertial import strapdown
from shared.inertial.strapdown import InertialState
from shared.maths.earth import (
    EARTH_RATE,
    Geodetic,
    earth_rate_n,
    gravity,
    ned_from_geodetic_difference,
)
from shared.maths.ellipsoid import curvature_radii
from shared.maths.rotation import (
    Vector,
    matrix_from_quaternion,
    ned_from_body,
    quaternion_from_matrix,
    quaternion_from_rotation_vector,
    skew,
)
from tests.support.drives.rotations import mean_rotation

STEP_NS = 10_000_000
COMPONENT = st.floats(-2.0, 2.0)
VECTORS = st.tuples(COMPONENT, COMPONENT, COMPONENT)


def propagated(state: InertialState, force: Vector, rate: Vector, time_ns: int) -> tuple[InertialState, Vector]:
    earth, step = strapdown.local_earth(state.position.latitude), (time_ns - state.time_ns) * 1e-9
    q, v, (latitude, longitude, height), _, force_n, _ = strapdown.mechanise(*state[1:], earth, force, rate, step)
    return InertialState(time_ns, q, v, Geodetic(latitude, longitude, height)), force_n


@given(VECTORS, VECTORS)
def test_rotation_by_a_quaternion_agrees_with_scipy(
    turn: tuple[float, ...], vector: tuple[float, float, float]
) -> None:
    matrix = Rotation.from_rotvec(turn).as_matrix()
    turned = strapdown.rotate(quaternion_from_matrix(matrix), vector)
    assert turned == pytest.approx(matrix @ np.array(vector), abs=1e-13)


@given(st.one_of(VECTORS, st.tuples(*[st.floats(-1e-4, 1e-4)] * 3)))
def test_the_factors_of_a_rotation_give_its_quaternion_and_its_mean_rotation(turn: tuple[float, float, float]) -> None:
    half_cosine, scale, first, second = strapdown.rotation_series(sum(component * component for component in turn))
    quaternion = (half_cosine, *(scale * component for component in turn))
    assert quaternion == pytest.approx(quaternion_from_rotation_vector(turn), abs=1e-15)
    average = np.eye(3) + first * skew(turn) + second * skew(turn) @ skew(turn)
    assert average == pytest.approx(mean_rotation(turn), abs=1e-12)


@given(st.floats(-1.57, 1.57), st.floats(-500.0, 9000.0))
def test_terms_computed_once_a_latitude_equal_radii_and_gravity_of_wgs84(latitude: float, height: float) -> None:
    sine, cosine, meridian, transverse, surface, slope = strapdown.local_earth(latitude)
    assert (sine, cosine) == (sin(latitude), cos(latitude))
    assert (meridian, transverse) == pytest.approx(curvature_radii(latitude), rel=1e-15)
    expected = gravity(latitude, height)
    assert surface * (1.0 - height * (slope - strapdown.SLOPE_CHANGE * height)) == pytest.approx(expected, rel=1e-14)


@pytest.fixture(scope="module")
def drive() -> Drive:
    return simulate("parking_lot", seed=3)


def test_ideal_samples_of_four_minutes_reproduce_velocity_and_attitude(drive: Drive) -> None:
    """Ideal samples of a drive of 240 s: velocity to 2e-9 m/s, attitude to 2e-12."""
    start = ned_from_body(*drive.attitude[0])
    state = InertialState(0, quaternion_from_matrix(start), (0.0, 0.0, 0.0), Geodetic(*drive.position[0].tolist()))
    forces, rates = drive.ideal_force_b.tolist(), drive.ideal_rate_b.tolist()
    worst_velocity = worst_attitude = 0.0
    for i, time_ns in enumerate(drive.t_ns.tolist()):
        state, _ = propagated(state, tuple(forces[i]), tuple(rates[i]), time_ns)
        if i % 100 == 99:
            true = ned_from_body(*drive.attitude[i])
            turned = Rotation.from_matrix(matrix_from_quaternion(state.quaternion) @ true.T).as_rotvec()
            worst_attitude = max(worst_attitude, float(np.abs(turned).max()))
            worst_velocity = max(worst_velocity, float(np.abs(np.subtract(state.velocity, drive.velocity_n[i])).max()))
    assert len(drive.t_ns) == 24_000
    assert worst_velocity < 2e-9
    assert worst_attitude < 2e-12
    ten_micrometres = 1e-5
    end = Geodetic(*drive.position[-1].tolist())
    assert ned_from_geodetic_difference(state.position, end) == pytest.approx((0.0, 0.0, 0.0), abs=ten_micrometres)


@pytest.mark.parametrize("latitude", [-1.2, 0.0, 0.74])
def test_at_standstill_velocity_and_attitude_stay_constant(latitude: float) -> None:
    attitude = ned_from_body(0.1, -0.05, 2.0)
    force = attitude.T @ np.array([0.0, 0.0, -gravity(latitude, 100.0)])
    rate = attitude.T @ np.array(earth_rate_n(latitude))
    state = InertialState(0, quaternion_from_matrix(attitude), (0.0, 0.0, 0.0), Geodetic(latitude, 1.0, 100.0))
    for k in range(1, 1001):
        state, force_n = propagated(state, tuple(force.tolist()), tuple(rate.tolist()), k * STEP_NS)
    assert state.velocity == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    assert matrix_from_quaternion(state.quaternion) == pytest.approx(attitude, abs=1e-12)
    assert force_n == pytest.approx((0.0, 0.0, -gravity(latitude, 100.0)), abs=1e-9)


def test_a_zero_rate_gyroscope_rotates_against_the_earth_at_earth_rate() -> None:
    """A body fixed in inertial space rotates by -15 degrees an hour relative to the Earth."""
    state = InertialState(0, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), Geodetic(pi / 4, 0.0, 0.0))
    for k in range(1, 101):
        state, _ = propagated(state, (0.0, 0.0, -9.8), (0.0, 0.0, 0.0), k * STEP_NS)
    turned = Rotation.from_matrix(matrix_from_quaternion(state.quaternion)).as_rotvec()
    assert turned == pytest.approx(-EARTH_RATE * np.array([0.5**0.5, 0.0, -(0.5**0.5)]), abs=1e-9)


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_driving_over_the_antimeridian_wraps_the_longitude_at_once(sense: float) -> None:
    state = InertialState(0, (1.0, 0.0, 0.0, 0.0), (0.0, sense * 30.0, 0.0), Geodetic(0.3, sense * (pi - 1e-6), 0.0))
    for k in range(1, 101):
        state, _ = propagated(state, (0.0, 0.0, -gravity(0.3, 0.0)), (0.0, 0.0, 0.0), k * STEP_NS)
        assert -pi < state.position.longitude <= pi
    assert pi - 1e-5 < abs(state.position.longitude) and sense * state.position.longitude < 0.0


@settings(max_examples=30)
@given(st.integers(1, 9))
def test_two_part_steps_agree_with_one_step_to_second_order(tenths: int) -> None:
    """The difference is of second order in the step: less than 1e-6 m/s."""
    attitude = quaternion_from_matrix(ned_from_body(0.02, 0.01, 1.0))
    start = InertialState(0, attitude, (10.0, 5.0, 0.0), Geodetic(0.74, 0.2, 100.0))
    force, rate = (1.0, 2.0, -9.8), (0.0, 0.0, 0.3)
    whole, _ = propagated(start, force, rate, STEP_NS)
    half, _ = propagated(start, force, rate, STEP_NS * tenths // 10)
    both, _ = propagated(half, force, rate, STEP_NS)
    assert both.velocity == pytest.approx(whole.velocity, abs=1e-6)
    assert both.quaternion == pytest.approx(whole.quaternion, abs=1e-12)

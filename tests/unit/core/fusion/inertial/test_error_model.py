"""The error model against finite differences of the mechanisation, and against matrix products."""

from collections.abc import Sequence
from math import cos, hypot, inf, sin, tan

import numpy as np
import numpy.typing as npt
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from services.core.fusion.aids.gnss.antenna import antenna_velocity
from services.core.fusion.aids.gnss.fix import GnssPosition, GnssVelocity
from services.core.fusion.aids.non_holonomic.aid import NonHolonomic
from services.core.fusion.aids.odometer.aid import WheelSpeed
from services.core.fusion.inertial import error_model as em
from services.core.fusion.inertial.filter import ErrorStateFilter
from services.core.fusion.settings import Settings
from services.core.fusion.states import LAYOUT
from shared.inertial import strapdown
from shared.inertial.strapdown import InertialState
from shared.maths.earth import (
    EARTH_RATE,
    Geodetic,
    earth_rate_n,
    geodetic_from_ned_difference,
    gravity,
    ned_from_geodetic_difference,
    transport_rate_n,
)
from shared.maths.ellipsoid import ECCENTRICITY_SQUARED, curvature_radii
from shared.maths.kalman import predict
from shared.maths.rotation import (
    Vector,
    matrix_from_quaternion,
    ned_from_body,
    quaternion_from_matrix,
    skew,
)
from shared.runtime.config import Vehicle

FloatArray = npt.NDArray[np.float64]

LATITUDE, HEIGHT = 0.74, 1500.0
VELOCITY = (120.0, -180.0, 15.0)
FORCE_N = (1.2, -0.7, -9.6)
ATTITUDE = ned_from_body(0.1, -0.2, 0.7)
RATE: Vector = (0.05, -0.02, 0.3)
STATE = InertialState(0, quaternion_from_matrix(ATTITUDE), VELOCITY, Geodetic(LATITUDE, 0.2, HEIGHT))
EARTH = strapdown.local_earth(LATITUDE)
STEP_NS = 1_000_000
PERTURBATION = np.repeat([1e-3, 1.0, 1000.0, 1.0, 1e-3, 0.01, 1e-3], 3)
NEGLECTED = {0: 1e-9, 3: 0.01, 6: 0.01}  # by first row: what the length of the step leaves where the model has nought


def vector(array: FloatArray) -> Vector:
    x, y, z = array.tolist()
    return x, y, z


def disturbed(state: InertialState, error: FloatArray) -> InertialState:
    """State with a given error, estimated minus true."""
    matrix = Rotation.from_rotvec(error[em.ATTITUDE]).as_matrix() @ matrix_from_quaternion(state.quaternion)
    return InertialState(
        state.time_ns,
        quaternion_from_matrix(matrix),
        vector(np.add(state.velocity, error[em.VELOCITY])),
        geodetic_from_ned_difference(vector(error[em.POSITION]), state.position),
    )


def error_of(estimate: InertialState, truth: InertialState) -> FloatArray:
    """Estimated minus true, in the order of the first nine states."""
    turned = matrix_from_quaternion(estimate.quaternion) @ matrix_from_quaternion(truth.quaternion).T
    return np.concatenate(
        [
            Rotation.from_matrix(turned).as_rotvec(),
            np.subtract(estimate.velocity, truth.velocity),
            ned_from_geodetic_difference(estimate.position, truth.position),
        ]
    )


@pytest.fixture
def differences() -> FloatArray:
    """Derivatives of the first nine errors with respect to the driving states, with gravity of one latitude."""
    force, rate = vector(ATTITUDE.T @ np.array(FORCE_N)), RATE

    def propagated(state: InertialState, force: Vector, rate: Vector) -> InertialState:
        earth = strapdown.local_earth(state.position.latitude)
        earth = earth._replace(gravity=EARTH.gravity, gravity_slope=EARTH.gravity_slope)
        q, v, (latitude, longitude, height), *_ = strapdown.mechanise(*state[1:], earth, force, rate, STEP_NS * 1e-9)
        return InertialState(STEP_NS, q, v, Geodetic(latitude, longitude, height))

    def after(error: FloatArray) -> FloatArray:
        wrong_force = vector(np.array(force) * (1.0 - error[em.ACCELEROMETER_SCALE]) - error[em.ACCELEROMETER_BIAS])
        wrong_rate = vector(np.array(rate) * (1.0 - error[em.GYROSCOPE_SCALE]) - error[em.GYROSCOPE_BIAS])
        estimate, truth = propagated(disturbed(STATE, error), wrong_force, wrong_rate), propagated(STATE, force, rate)
        return (error_of(estimate, truth) - error[:9]) / (STEP_NS * 1e-9)

    columns = []
    for j, size in enumerate(PERTURBATION):
        step = np.zeros(em.DRIVING)
        step[j] = size
        columns.append((after(step) - after(-step)) / (2.0 * size))
    return np.array(columns).T


BLOCKS = [
    (row, column)
    for row in (em.ATTITUDE, em.VELOCITY, em.POSITION)
    for column in (
        em.ATTITUDE,
        em.VELOCITY,
        em.POSITION,
        em.ACCELEROMETER_BIAS,
        em.GYROSCOPE_BIAS,
        em.ACCELEROMETER_SCALE,
        em.GYROSCOPE_SCALE,
    )
]


def test_every_block_of_the_system_matrix_agrees_with_finite_differences(differences: FloatArray) -> None:
    F = em.system_matrix(*STATE[1:], EARTH, FORCE_N, RATE)
    one_percent = 0.01
    for row, column in BLOCKS:
        size = np.linalg.norm(F[row, column])
        limit = one_percent * size if size else NEGLECTED[row.start]
        assert np.linalg.norm(differences[row, column] - F[row, column]) <= limit, (row, column)


def test_the_transition_is_that_of_the_matrix_exponential_to_first_order() -> None:
    step_s = 1e-4
    F = em.system_matrix(*STATE[1:], EARTH, FORCE_N, RATE)
    Phi, whole = em.transition_matrix(step_s * F, np.ones(em.SIZE)), np.zeros((em.SIZE, em.SIZE))
    whole[: em.MOVING, : em.DRIVING] = F
    assert Phi == pytest.approx(expm(whole * step_s), abs=1e-6)
    assert Phi == pytest.approx(np.eye(em.SIZE) + whole * step_s, abs=1e-15)


def test_the_covariance_step_by_blocks_equals_the_product_of_whole_matrices() -> None:
    rng = np.random.default_rng(5)
    root, Q = rng.standard_normal((em.SIZE, em.SIZE)), rng.random(em.SIZE)
    P, Ft = root @ root.T, rng.standard_normal((em.MOVING, em.DRIVING))
    decay = np.where(np.arange(em.SIZE) < em.DRIVING, 1.0, rng.uniform(0.3, 1.0, em.SIZE))
    after = em.predicted(P, Ft, decay, Q)
    assert after == pytest.approx(predict(P, em.transition_matrix(Ft, decay), np.diag(Q)), rel=1e-12, abs=1e-12)
    assert (after == after.T).all()


def test_time_correlated_errors_decay_exactly_at_any_step() -> None:
    """Two half steps equal one step, other states are unchanged, and the limit has variance one."""
    root = np.random.default_rng(4).standard_normal((em.SIZE, em.SIZE))
    still, place = np.zeros((em.MOVING, em.DRIVING)), LAYOUT.place("gnss_error")
    noise = em.ProcessNoise(np.zeros(em.SIZE), np.full(em.SIZE, inf), np.zeros(em.SIZE), 1.0)
    noise.correlation_s[place], noise.variance[place] = 20.0, 1.0

    def decayed(P: FloatArray, step_s: float) -> FloatArray:
        Q, decay = em.process_noise(noise, 0.0, 0.0, step_s)
        return em.predicted(P, still, decay, Q)

    P = root @ root.T
    whole = decayed(P, 20.0)
    assert decayed(decayed(P, 10.0), 10.0) == pytest.approx(whole, abs=1e-12)
    assert (whole[: em.DRIVING, : em.DRIVING] == P[: em.DRIVING, : em.DRIVING]).all()
    assert decayed(P, 1e4)[place, place] == pytest.approx(np.eye(3))


def test_vibration_increases_the_process_noise_to_the_measured_psd() -> None:
    psd = em.process_noise_psd((em.ATTITUDE, 2.0), (em.VELOCITY, 3.0))
    noise = em.ProcessNoise(psd, np.full(em.SIZE, inf), np.zeros(em.SIZE), 1.0)
    Q, decay = em.process_noise(noise, attitude_psd=0.5, velocity_psd=5.0, step_s=0.1)
    assert Q[em.ATTITUDE] == pytest.approx(np.full(3, 0.2))
    assert Q[em.VELOCITY] == pytest.approx(np.full(3, 0.5))
    assert not Q[em.POSITION.start :].any() and (decay == 1.0).all()


def test_the_system_matrix_equals_the_matrix_products_of_its_docstring() -> None:
    F = em.system_matrix(*STATE[1:], EARTH, FORCE_N, RATE)
    latitude_scale, east_scale = curvature_radii(LATITUDE)
    m, t, tangent = latitude_scale + HEIGHT, east_scale + HEIGHT, tan(LATITUDE)
    north, east, _ = VELOCITY
    earth = np.array(earth_rate_n(LATITUDE))
    transport = np.array(transport_rate_n(LATITUDE, HEIGHT, VELOCITY))
    by_velocity = np.array([[0.0, 1.0 / t, 0.0], [-1.0 / m, 0.0, 0.0], [0.0, -tangent / t, 0.0]])
    earth_by_position = np.zeros((3, 3))
    earth_by_position[:, 0] = np.array([-sin(LATITUDE), 0.0, -cos(LATITUDE)]) * EARTH_RATE / m
    transport_by_position = np.array(
        [
            [0.0, 0.0, east / t**2],
            [0.0, 0.0, -north / m**2],
            [-east / cos(LATITUDE) ** 2 / (t * m), 0.0, -east * tangent / t**2],
        ]
    )
    geocentric_radius = east_scale * hypot(cos(LATITUDE), (1.0 - ECCENTRICITY_SQUARED) * sin(LATITUDE))
    free_air = np.zeros((3, 3))
    free_air[2, 2] = 2.0 * gravity(LATITUDE, 0.0) / geocentric_radius
    expected = {
        (em.ATTITUDE.start, em.ATTITUDE.start): -skew(earth + transport),
        (em.ATTITUDE.start, em.VELOCITY.start): -by_velocity,
        (em.ATTITUDE.start, em.POSITION.start): -(earth_by_position + transport_by_position),
        (em.ATTITUDE.start, em.GYROSCOPE_BIAS.start): -ATTITUDE,
        (em.VELOCITY.start, em.ATTITUDE.start): -skew(FORCE_N),
        (em.VELOCITY.start, em.VELOCITY.start): skew(VELOCITY) @ by_velocity - skew(transport + 2.0 * earth),
        (em.VELOCITY.start, em.POSITION.start): skew(VELOCITY) @ (transport_by_position + 2.0 * earth_by_position)
        + free_air,
        (em.VELOCITY.start, em.ACCELEROMETER_BIAS.start): -ATTITUDE,
        (em.POSITION.start, em.VELOCITY.start): np.eye(3),
        (em.VELOCITY.start, em.ACCELEROMETER_SCALE.start): -ATTITUDE @ np.diag(ATTITUDE.T @ np.array(FORCE_N)),
        (em.ATTITUDE.start, em.GYROSCOPE_SCALE.start): -ATTITUDE @ np.diag(RATE),
    }
    for (row, column), block in expected.items():
        assert F[row : row + 3, column : column + 3] == pytest.approx(block, rel=1e-12, abs=1e-19), (row, column)
    assert not F[em.POSITION, em.ATTITUDE].any() and not F[em.POSITION, em.ACCELEROMETER_BIAS.start :].any()


def navigation(error: FloatArray) -> ErrorStateFilter:
    """Filter with a given error, estimated minus true, in every state."""
    wrong = ErrorStateFilter(Settings(), disturbed(STATE, error), np.eye(em.SIZE))
    rate = vector(np.array(RATE) - error[em.GYROSCOPE_BIAS])
    wrong.state = wrong.state._replace(rate_b=rate)
    vehicle = slice(LAYOUT.index("odometer_scale"), LAYOUT.place("mounting").stop)
    wrong.parameters = (*(np.array(VEHICLE) + error[vehicle]).tolist(), *error[vehicle.stop :].tolist())
    return wrong


ACCELERATION: Vector = (1.2, -0.7, 0.3)  # [m/s²]
VEHICLE: Vector = (0.03, 0.1, -0.07)  # scale error of the odometer, pitch and yaw of the mounting
ARM: Vector = (0.3, -0.5, -1.2)
ANTENNA = geodetic_from_ned_difference(vector(ATTITUDE @ np.array(ARM)), STATE.position)
PERFECT = navigation(np.zeros(em.SIZE))


@pytest.mark.parametrize(
    "measurement",
    [
        GnssPosition(0, 0, "", ANTENNA, np.eye(3), 3, ARM, 0.0),
        GnssPosition(0, 0, "", ANTENNA, np.diag([1.0, 4.0, 9.0]) + 0.5, 3, ARM, 0.0, time_correlated=True),
        GnssVelocity(
            0,
            0,
            "",
            vector(np.array(VELOCITY) + antenna_velocity(PERFECT, ARM)),
            np.eye(3),
            3,
            ARM,
            time_correlated=True,
        ),
    ],
    ids=["position", "position with a time-correlated error", "velocity"],
)
def test_the_measurement_matrices_agree_with_finite_differences(measurement: GnssPosition | GnssVelocity) -> None:
    seen = measurement.observe(PERFECT)
    assert seen.z == pytest.approx(np.zeros(3), abs=1e-8)
    for j in range(em.SIZE):
        step = np.zeros(em.SIZE)
        step[j] = 1e-4
        ahead, behind = measurement.observe(navigation(step)).z, measurement.observe(navigation(-step)).z
        earth_rate_term = 1e-4  # of the lever arm, which H neglects
        assert (ahead - behind) / 2e-4 == pytest.approx(seen.H[:, j], abs=earth_rate_term)


AXLE = vector(
    ned_from_body(0.0, *VEHICLE[1:]) @ (ATTITUDE.T @ np.array(VELOCITY) + np.cross(RATE, ARM))  # [m/s, vehicle]
)


@pytest.mark.parametrize(
    ("measurement", "predicted"),
    [
        (
            WheelSpeed(0, 0, "", 0.0, 0.0, True, True, Settings(vehicle=Vehicle(rear_axle_body_m=ARM))),
            [1.03 * AXLE[0], *AXLE[1:]],
        ),
        (NonHolonomic(0, Settings(vehicle=Vehicle(rear_axle_body_m=ARM))), AXLE[1:]),
    ],
    ids=["odometer", "non-holonomic"],
)
def test_odometer_and_nhc_matrices_agree_with_finite_differences(
    measurement: WheelSpeed | NonHolonomic, predicted: Sequence[float]
) -> None:
    seen = measurement.observe(PERFECT)
    assert -seen.z == pytest.approx(np.array(predicted)), "zero wheel speed and zero lateral velocity"
    for j in range(em.SIZE):
        step = np.zeros(em.SIZE)
        step[j] = 1e-5
        ahead, behind = measurement.observe(navigation(step)).z, measurement.observe(navigation(-step)).z
        assert (ahead - behind) / 2e-5 == pytest.approx(seen.H[:, j], rel=1e-6, abs=1e-6)


def test_each_noise_setting_is_on_the_diagonal_of_its_states() -> None:
    noise = em.process_noise_psd((em.ATTITUDE, 1.0), (em.GYROSCOPE_BIAS, 4.0), (LAYOUT.index("odometer_scale"), 5.0))
    assert noise[em.ATTITUDE].tolist() == [1.0] * 3 and noise[em.GYROSCOPE_BIAS].tolist() == [4.0] * 3
    assert noise[LAYOUT.index("odometer_scale")] == 5.0 and noise.sum() == 20.0


def test_the_noise_of_an_mti_630_is_that_of_its_data_sheet() -> None:
    defaults = Settings()
    assert defaults.imu.angle_random_walk_rad_sqrt_s**2 == pytest.approx(1.493e-8, rel=1e-3)
    assert defaults.imu.velocity_random_walk_m_s_sqrt_s**2 == pytest.approx(3.462e-7, rel=1e-3)


@pytest.mark.parametrize(
    "measurement",
    [
        GnssPosition(0, 0, "", ANTENNA, np.eye(3), 3, ARM, 0.0),
        GnssVelocity(0, 0, "", VELOCITY, np.eye(3), 3, ARM),
        WheelSpeed(0, 0, "", 0.0, 0.0, True, True, Settings(vehicle=Vehicle(rear_axle_body_m=ARM))),
    ],
    ids=["position", "velocity", "odometer"],
)
def test_all_columns_of_measurements_agree_with_finite_differences(
    measurement: GnssPosition | GnssVelocity | WheelSpeed,
) -> None:
    seen = measurement.observe(PERFECT)
    for j in range(em.SIZE):
        step = np.zeros(em.SIZE)
        step[j] = 1e-4
        ahead, behind = measurement.observe(navigation(step)).z, measurement.observe(navigation(-step)).z
        assert (ahead - behind) / 2e-4 == pytest.approx(seen.H[:, j], abs=1e-3), j

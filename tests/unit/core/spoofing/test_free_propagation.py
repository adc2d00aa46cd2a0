"""Strapdown and free propagation: closed forms, the simulator's exact inversion, and consistency of the covariance."""

from dataclasses import replace
from math import radians

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation

from services.core.spoofing.inertial.strapdown import SECOND_NS, Decimator, FilterAnchor, Increment, Strapdown
from services.core.spoofing.settings import LongSettings
from services.core.spoofing.windows.free_propagation import ATTITUDE, SIZE, VELOCITY, FreePropagation
from services.sensors.simulator.drive import Drive, simulate
from shared.maths.rotation import ned_from_body

FloatArray = npt.NDArray[np.float64]
START_S, LENGTH_S = 30, 60
ANCHOR_SIZE = 15  # states of fusion that a propagation starts with


@pytest.fixture(scope="module")
def drive() -> Drive:
    return simulate("urban", 4, 100.0)


def increments_of(drive: Drive, *, ideal: bool) -> list[Increment]:
    decimator, found = Decimator(), []
    force, rate = (drive.ideal_force_b, drive.ideal_rate_b) if ideal else (drive.force_b, drive.rate_b)
    for time_ns, f, w in zip(drive.t_ns.tolist(), force.tolist(), rate.tolist(), strict=True):
        increment = decimator.add(time_ns, tuple(f), tuple(w))
        if increment is not None:
            found.append(increment)
    return found


def anchor_at(drive: Drive, time_s: float) -> FilterAnchor:
    k = int(np.searchsorted(drive.t_ns, round(time_s * SECOND_NS)))
    latitude, _, height = drive.position[k].tolist()
    return FilterAnchor(
        time_ns=int(drive.t_ns[k]),
        ned_from_body=ned_from_body(*drive.attitude[k].tolist()),
        velocity_n=drive.velocity_n[k],
        accelerometer_bias=np.zeros(3),
        gyroscope_bias=np.zeros(3),
        latitude=latitude,
        height=height,
        stationary=False,
        gnss_age_s=None,
        attitude_cov=np.zeros((3, 3)),
        gyroscope_bias_sd=np.zeros(3),
        scale=1.0,
        yaw=0.0,
        pitch=0.0,
        covariance=np.zeros((ANCHOR_SIZE, ANCHOR_SIZE)),
    )


def test_ideal_increments_lead_to_the_true_velocity_and_attitude_after_a_minute(drive: Drive) -> None:
    free = Strapdown(anchor_at(drive, START_S))
    for increment in increments_of(drive, ideal=True):
        if START_S * SECOND_NS <= increment.start_ns < (START_S + LENGTH_S) * SECOND_NS:
            free.advance(increment)
    k = int(np.searchsorted(drive.t_ns, free.time_ns))
    assert free.time_ns == (START_S + LENGTH_S) * SECOND_NS
    np.testing.assert_allclose(free.velocity, drive.velocity_n[k], atol=0.02)
    attitude = ned_from_body(*drive.attitude[k].tolist())
    assert Rotation.from_matrix(free.ned_from_body @ attitude.T).magnitude() < radians(0.01)


def test_increments_end_at_multiples_of_100_ms_and_a_gap_starts_a_new_run(drive: Drive) -> None:
    assert {increment.end_ns % 100_000_000 for increment in increments_of(drive, ideal=True)} == {0}
    decimator = Decimator()
    times = [*range(10_000_000, 320_000_000, 10_000_000), *range(900_000_000, 1_120_000_000, 10_000_000)]
    found = [decimator.add(time_ns, (0.0, 0.0, -9.8), (0.0, 0.0, 0.0)) for time_ns in times]
    kept = [increment for increment in found if increment is not None]
    assert [increment.after_gap for increment in kept] == [True, False, False, True, False]
    assert all(increment.duration <= 0.1 for increment in kept)
    assert decimator.add(times[-1], (0.0, 0.0, -9.8), (0.0, 0.0, 0.0)) is None
    assert decimator.rejected == {"imu: stamp is not after the one before": 1}


def test_derivatives_of_the_body_velocity_agree_with_finite_differences(drive: Drive) -> None:
    free = FreePropagation(anchor_at(drive, 50.0), LongSettings())
    step = 1e-6
    for axis in range(3):
        value, H = free.body_row(axis)
        assert value == pytest.approx(float(free.nominal.ned_from_body[:, axis] @ free.nominal.velocity))
        for element in range(6):
            psi, dv = np.zeros(3), np.zeros(3)
            (dv if element < 3 else psi)[element % 3] = step
            C = Rotation.from_rotvec(psi).as_matrix() @ free.nominal.ned_from_body
            changed = float(C[:, axis] @ (free.nominal.velocity + dv))
            assert (changed - value) / step == pytest.approx(H[element], abs=1e-4)
    assert len(H) == SIZE and not H[6:].any()


def test_covariance_of_an_unaided_run_grows_by_the_closed_form() -> None:
    settings = LongSettings(non_holonomic=False, velocity_sd_m_s=0.0, scale_sd=0.0)
    P = np.zeros((ANCHOR_SIZE, ANCHOR_SIZE))
    P[0, 0], P[4, 4], P[6, 6], P[4, 6] = 0.05**2, 1e-3**2, 0.01**2, -0.8 * 1e-3 * 0.01
    P[6, 4] = P[4, 6]
    level = FilterAnchor(
        0, np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3), 0.8, 300.0, False, None,
        np.zeros((3, 3)), np.zeros(3), 1.0, 0.0, 0.0, P
    )  # fmt: skip
    free = FreePropagation(level, settings)
    still = Increment(0, 100_000_000, np.array([0.0, 0.0, -0.98]), np.eye(3), np.zeros(3), 0.0, False)
    for k in range(300):
        free.advance(replace(still, start_ns=k * 100_000_000, end_ns=(k + 1) * 100_000_000))
        if k % 10 == 9:
            free.predict()
    T, g, s = 30.0, 9.8, settings
    expected = (
        (g * s.attitude_sd_rad * T) ** 2
        + 0.05**2
        + ((g * 1e-3) ** 2 + 0.01**2 + 2.0 * g * P[4, 6]) * T**2  # tilt and bias that compensate each other
        + (s.accelerometer_bias_sd_m_s2 * T) ** 2
        + (g * s.gyroscope_bias_sd_rad_s * T**2 / 2.0) ** 2
        + s.velocity_random_walk_m_s_sqrt_s**2 * T
        + (g * s.angle_random_walk_rad_sqrt_s) ** 2 * T**3 / 3.0
    )
    assert free.P[0, 0] == pytest.approx(expected, rel=0.02)


def test_errors_of_aided_runs_are_within_their_covariance() -> None:
    squares = []
    for seed in range(4):
        drive = simulate("urban", 20 + seed, 100.0)
        truth = anchor_at(drive, START_S)
        rng, s = np.random.default_rng(seed), LongSettings()
        tilt = rng.normal(0.0, s.attitude_sd_rad, 3)
        anchor = replace(
            truth,
            ned_from_body=Rotation.from_rotvec(tilt).as_matrix() @ truth.ned_from_body,
            velocity_n=truth.velocity_n + rng.normal(0.0, s.velocity_sd_m_s, 3),
            accelerometer_bias=np.mean(drive.force_b - drive.ideal_force_b, axis=0),
            gyroscope_bias=np.mean(drive.rate_b - drive.ideal_rate_b, axis=0),
        )
        free = FreePropagation(anchor, s)
        for increment in increments_of(drive, ideal=False):
            if not START_S * SECOND_NS <= increment.start_ns < (START_S + LENGTH_S) * SECOND_NS:
                continue
            free.advance(increment)
            if increment.end_ns % SECOND_NS == 0:
                free.predict()
                speed = float(np.interp(increment.end_ns, drive.odometer_ns, drive.odometer))
                free.aid(speed, s.odometer_sd_m_s, float(increment.rate_b[2]))
        k = int(np.searchsorted(drive.t_ns, free.nominal.time_ns))
        error = drive.velocity_n[k] - free.nominal.velocity
        squares.append(float(error @ np.linalg.solve(free.P[VELOCITY, VELOCITY], error)))
        np.testing.assert_allclose(free.P, free.P.T, atol=1e-9)
        assert np.linalg.eigvalsh(free.P[ATTITUDE, ATTITUDE]).min() > 0.0
    assert max(squares) < 16.3, "chi-square with 3 degrees of freedom: exceeded once in 1000"
    assert np.mean(squares) > 0.05, "not absurdly wide"


def test_an_odometer_that_freezes_is_rejected_and_then_left_out(drive: Drive) -> None:
    free = FreePropagation(anchor_at(drive, START_S), LongSettings())
    free.nominal.velocity = free.nominal.velocity + 5.0 * free.nominal.ned_from_body[:, 0]
    before = free.nominal.velocity.copy()
    for _ in range(3):
        free.aid(0.0, 0.1, 0.0)
    assert free.odometer_rejections == 3
    free.aid(float(before @ free.nominal.ned_from_body[:, 0]), 0.1, 0.0)
    assert free.odometer_rejections == 3, "no longer used"


@pytest.mark.parametrize(("speed_sd", "left"), [(1.9, 0.5 * 0.03 / (1.9**2 + 0.03)), (2.1, 0.5)])
def test_the_non_holonomic_constraint_is_used_while_the_forward_speed_is_known(
    drive: Drive, speed_sd: float, left: float
) -> None:
    anchor = anchor_at(drive, START_S)
    covariance = np.zeros((ANCHOR_SIZE, ANCHOR_SIZE))
    covariance[VELOCITY, VELOCITY] = np.eye(3) * speed_sd**2
    sideways = anchor.velocity_n + 0.5 * anchor.ned_from_body[:, 1]
    free = FreePropagation(replace(anchor, velocity_n=sideways, covariance=covariance), LongSettings())
    free.aid(None, 0.1, 0.0)
    lateral = free.nominal.ned_from_body[:, 1] @ free.nominal.velocity
    assert lateral == pytest.approx(left, abs=1e-3), "lateral noise of 0.1 m/s that lasts 3 s"

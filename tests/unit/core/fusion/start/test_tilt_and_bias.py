"""Correlation of tilt and accelerometer bias in the initial covariance after levelling."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from services.core.fusion.inertial import error_model as em
from services.core.fusion.inertial.filter import ErrorStateFilter
from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import ImuSettings, Settings
from services.core.fusion.start.heading import Prior
from shared.maths.earth import STANDARD_GRAVITY, Geodetic
from shared.maths.rotation import Vector, ned_from_body
from shared.runtime.config import GnssAntenna, Vehicle

BIAS_SD = 0.03
TILTED = ned_from_body(0.05, -0.08, 0.7)


def started(bias: Vector, arm: Vector = (0.0, 0.0, 0.0)) -> ErrorStateFilter:
    """Filter after 16 s of standstill on a slope, with a saved heading."""
    vehicle = Vehicle(gnss=GnssAntenna(lever_arm_body_m=arm))
    imu = ImuSettings(accelerometer_bias_sd_m_s2=BIAS_SD)
    navigator = Navigator(Settings(merge_delay_s=0.0, imu=imu, vehicle=vehicle))
    x, y, z = (TILTED.T @ np.array([0.0, 0.0, -STANDARD_GRAVITY]) + bias).tolist()
    here = Geodetic(0.74, 0.23, 700.0)
    navigator.use_prior(Prior(here, (1.0, 1.0, 1.0), 0.7, 0.01))
    for k in range(1, 1700):
        if k % 100 == 0:
            navigator.fix(k * 10**7, position=here, velocity=(0.0, 0.0, 0.0))
        navigator.imu(k * 10**7, (x, y, z), (0.0, 0.0, 0.0))
        if navigator.engine.filter is not None:
            return navigator.engine.filter
    raise AssertionError("no start")


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_initial_covariance_of_tilt_and_bias_agrees_with_finite_differences(axis: int) -> None:
    """Finite differences of the whole start against P: E[psi x] = (d psi / d x) var(x), x being minus the bias."""
    size = 1e-3
    bias = [0.0, 0.0, 0.0]
    bias[axis] = size
    ideal, biased = started((0.0, 0.0, 0.0)), started((bias[0], bias[1], bias[2]))
    tilt = Rotation.from_matrix(biased.ned_from_body @ ideal.ned_from_body.T).as_rotvec() / -size
    both = ideal.P[em.ATTITUDE, em.ACCELEROMETER_BIAS][:, axis] / BIAS_SD**2
    assert tilt[:2] == pytest.approx(both[:2], abs=2e-3 / STANDARD_GRAVITY + 0.01 * np.abs(both).max())
    assert np.linalg.eigvalsh(ideal.P[: em.DRIVING, : em.DRIVING])[0] >= 0.0


def test_a_long_lever_arm_adds_the_error_of_its_swing_to_the_initial_velocity() -> None:
    """0.05 rad/s times 4 m are 0.2 m/s in each direction."""
    alone, swung = (started((0.0, 0.0, 0.0), (x, 0.0, 0.0)).P[em.VELOCITY, em.VELOCITY] for x in (0.0, 4.0))
    assert swung - alone == pytest.approx(0.2**2 * np.eye(3), abs=1e-3)

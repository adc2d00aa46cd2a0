"""Scale errors of the IMU as states: estimated where observable, and absent by default."""

import numpy as np
import pytest

from services.core.fusion.inertial import error_model as em
from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import Settings
from services.sensors.simulator.drive import Drive, simulate
from shared.maths.earth import Geodetic

SCALE = np.array([0.004, -0.003, 0.01])  # measured over true, of the gyroscope's axes


@pytest.fixture(scope="module")
def drive() -> Drive:
    return simulate("parking_lot", seed=2, duration_s=200.0)


def navigated(drive: Drive, **settings: float) -> Navigator:
    """Navigator after a drive with a gyroscope scale error and velocities of RTK accuracy."""
    made = Navigator(Settings().with_values({"vehicle.gnss.lever_arm_body_m": drive.lever_arm_b, **settings}))
    rate_b = drive.rate_b * (1.0 + SCALE)
    for i, time_ns in enumerate(drive.t_ns.tolist()):
        if i % 100 == 99:
            k = i // 100
            north, east, down = drive.fix_velocity_n[k].tolist()
            position = Geodetic(*drive.fix_position[k].tolist())
            made.fix(time_ns, position=position, velocity=(north, east, down), position_sd=(0.3, 0.3, 0.4))
        made.imu(time_ns, drive.force_b[i].tolist(), rate_b[i].tolist())
    return made


def test_the_gyroscope_scale_about_the_vertical_is_estimated_within_3_5_sigma(drive: Drive) -> None:
    navigation = navigated(drive, **{"imu.gyroscope_scale_sd": 0.01}).engine.filter
    assert navigation is not None
    sd = np.sqrt(np.diag(navigation.P)[em.GYROSCOPE_SCALE])
    truth = 1.0 - 1.0 / (1.0 + SCALE)  # correction of a reading as a share of it
    error = np.array(navigation.imu.gyroscope_scale) - truth
    assert (np.abs(error) < 3.5 * sd).all()
    assert sd[2] < 0.003, "rotations about the vertical"
    assert sd[0] > 0.005 and sd[1] > 0.005, "small rotations about the other axes"


def test_scales_are_not_estimated_by_default(drive: Drive) -> None:
    navigation = navigated(drive).engine.filter
    assert navigation is not None
    assert navigation.imu.gyroscope_scale == navigation.imu.accelerometer_scale == (0.0, 0.0, 0.0)
    assert not navigation.P[em.SCALES].any()

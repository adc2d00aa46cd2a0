"""A simulated drive with a V2X radio: what another station reads in the frames that the unit sends."""

import math
from bisect import bisect_left
from itertools import pairwise

import numpy as np
import pytest

from services.parsers.v2x.process import Config, Process
from services.sensors.simulator.world import messages
from shared.maths.earth import Geodetic, geodetic_from_ned_difference, ned_from_geodetic_difference
from shared.maths.rotation import cross, ned_from_body
from shared.messages.navigation import NavigationPhase, NavigationSolution, TruthState
from shared.messages.v2x import Cam, CamList, V2xSend
from shared.runtime.config import parse_vehicle
from shared.runtime.offline import OfflineUnit
from tests.support.drives.golden import VEHICLE
from tests.support.v2x import cams

FRONT_BODY_M = (2.0, 0.0, 0.6)
SECTIONS = f"""
[controller.cam]
station_id = 99
reference_point_body_m = {list(FRONT_BODY_M)}

[parsers.v2x]
"""
DURATION_S = 60.0
NS = 1_000_000_000


@pytest.fixture(scope="module")
def drive() -> tuple[list[Cam], list[TruthState]]:
    """CAM as another station decodes them, and the truth."""
    unit = OfflineUnit(parse_vehicle(VEHICLE.read_text() + SECTIONS))
    other = Process(Config())
    received: list[Cam] = []
    truth: list[TruthState] = []
    first_ns = None
    for message in unit.run(messages("parking_lot", 3, DURATION_S)):
        match message:
            case TruthState():
                truth.append(message)
            case NavigationSolution(phase=NavigationPhase.NAVIGATING) if first_ns is None:
                first_ns = message.sampled_ns
            case V2xSend():
                for cam_list in other.handle(cams.batch([message.data], message.received_ns + 20_000_000)):
                    assert isinstance(cam_list, CamList)
                    received += cam_list.cams
    assert first_ns is not None
    assert not other.rejects
    return [cam for cam in received if cam.sampled_ns > first_ns + 20 * NS], truth


def truth_at(time_ns: int, truth: list[TruthState]) -> TruthState:
    """Find the state of that time; the truth is published ten times a second, and CAM are stamped with them."""
    stamps = [state.sampled_ns for state in truth]
    at = bisect_left(stamps, time_ns)
    return min(truth[max(0, at - 1) : at + 1], key=lambda state: abs(state.sampled_ns - time_ns))


def front(state: TruthState, time_ns: int) -> tuple[Geodetic, tuple[float, float]]:
    """Position and horizontal velocity of the reference point, extrapolated over less than one interval."""
    assert state.roll_rad is not None and state.pitch_rad is not None and state.yaw_rad is not None
    rotation = ned_from_body(state.roll_rad, state.pitch_rad, state.yaw_rad)
    rate = state.angular_rate_body_rad_s
    assert rate is not None
    velocity = np.array(state.velocity_ned_m_s) + rotation @ np.array(cross(rate, FRONT_BODY_M))
    offset = rotation @ np.array(FRONT_BODY_M) + velocity * (time_ns - state.sampled_ns) / NS
    imu = Geodetic(math.radians(state.latitude_deg), math.radians(state.longitude_deg), state.height_ellipsoid_m)
    point = geodetic_from_ned_difference((float(offset[0]), float(offset[1]), float(offset[2])), imu)
    return point, (float(velocity[0]), float(velocity[1]))


def test_cams_follow_one_another_by_0_1_to_1_second(drive: tuple[list[Cam], list[TruthState]]) -> None:
    received, _ = drive
    intervals_s = [(later.sampled_ns - earlier.sampled_ns) / NS for earlier, later in pairwise(received)]
    assert min(intervals_s) >= 0.09
    assert max(intervals_s) <= 1.01
    assert any(interval < 0.5 for interval in intervals_s)  # it turns and brakes
    low = [cam.sampled_ns / NS for cam in received if cam.low_frequency is not None]
    assert max(later - earlier for earlier, later in pairwise(low)) <= 1.5


def test_the_stated_ellipses_hold_the_true_position_of_the_front(drive: tuple[list[Cam], list[TruthState]]) -> None:
    """95 % by design; the errors of a drive are correlated, so that fewer CAM are independent than sent."""
    received, truth = drive
    inside = []
    for cam in received:
        assert cam.latitude_deg is not None
        assert cam.longitude_deg is not None
        assert cam.height_ellipsoid_m is not None
        assert cam.position_semi_major_m and cam.position_semi_minor_m
        assert cam.position_semi_major_orientation_rad is not None
        point, _ = front(truth_at(cam.sampled_ns, truth), cam.sampled_ns)
        stated = Geodetic(math.radians(cam.latitude_deg), math.radians(cam.longitude_deg), cam.height_ellipsoid_m)
        north, east, _ = ned_from_geodetic_difference(stated, point)
        angle = cam.position_semi_major_orientation_rad
        along = north * math.cos(angle) + east * math.sin(angle)
        across = -north * math.sin(angle) + east * math.cos(angle)
        inside.append((along / cam.position_semi_major_m) ** 2 + (across / cam.position_semi_minor_m) ** 2 <= 1.0)
    assert len(inside) > 50
    assert np.mean(inside) > 0.9


def test_speed_heading_and_yaw_rate_are_those_of_the_front(drive: tuple[list[Cam], list[TruthState]]) -> None:
    received, truth = drive
    speed_errors, heading_errors, rate_errors, rates = [], [], [], []
    for cam in received:
        state = truth_at(cam.sampled_ns, truth)
        _, (north, east) = front(state, cam.sampled_ns)
        assert cam.speed_m_s is not None
        assert state.angular_rate_body_rad_s is not None
        speed_errors.append(cam.speed_m_s - math.hypot(north, east))
        if cam.speed_m_s > 2.0:
            assert cam.heading_rad is not None
            assert cam.yaw_rate_rad_s is not None
            heading_errors.append(math.degrees(math.remainder(cam.heading_rad - math.atan2(east, north), 2 * math.pi)))
            rates.append(-state.angular_rate_body_rad_s[2])
            rate_errors.append(cam.yaw_rate_rad_s - rates[-1])
    half_a_tenth_of_2_m_s2 = 0.2  # between the solution and the nearest truth
    assert np.sqrt(np.mean(np.square(speed_errors))) < half_a_tenth_of_2_m_s2
    assert np.median(np.abs(heading_errors)) < 1.5
    assert min(rates) < -0.4  # right turns around the car park
    assert np.corrcoef(rates, np.add(rates, rate_errors))[0, 1] > 0.9

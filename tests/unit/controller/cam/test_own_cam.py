import math
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from services.controller.cam.content import PATH_POINTS, PathHistory, confidence_ellipse
from services.controller.cam.process import Config, Process
from services.parsers.v2x.process import Config as ParserConfig
from services.parsers.v2x.process import Process as Parser
from shared.maths.earth import Geodetic, ned_from_geodetic_difference
from shared.messages.base import Message, Symmetric3, Vector3
from shared.messages.gnss import FixType, GnssFix
from shared.messages.navigation import NavigationPhase, NavigationSolution
from shared.messages.trust import TrustLevel, TrustState
from shared.messages.v2x import CamList, DriveDirection, OwnCam, StationType, V2xSend, VehicleRole
from shared.v2x import its_time
from tests.support.gnss.captures import dissect
from tests.support.v2x import cams

START_NS = 1_795_000_000 * 10**9
UTC_OFFSET_NS = -250_000_000  # of the receiver's UTC to the time line of the unit
MS = 1_000_000
IMU = Geodetic(math.radians(49.4), math.radians(-1.1), 120.0)
CONFIG = Config(station_id=77, reference_point_body_m=(2.0, 0.1, 0.7), length_m=4.5, width_m=1.8)


def solution(
    time_ns: int = START_NS,
    *,
    velocity_ned_m_s: Vector3 = (0.0, 0.0, 0.0),
    yaw_rad: float = 0.0,
    roll_rad: float = 0.0,
    pitch_rad: float = 0.0,
    position_cov_ned_m2: Symmetric3 = (4.0, 0.0, 0.0, 1.0, 0.0, 9.0),
    velocity_cov_ned_m2_s2: Symmetric3 = (0.01, 0.0, 0.0, 0.04, 0.0, 0.09),
    angular_rate_body_rad_s: Vector3 = (0.0, 0.0, 0.0),
) -> NavigationSolution:
    return NavigationSolution(
        sampled_ns=time_ns,
        phase=NavigationPhase.NAVIGATING,
        latitude_deg=math.degrees(IMU.latitude),
        longitude_deg=math.degrees(IMU.longitude),
        height_ellipsoid_m=IMU.height,
        velocity_ned_m_s=velocity_ned_m_s,
        roll_rad=roll_rad,
        pitch_rad=pitch_rad,
        yaw_rad=yaw_rad,
        position_cov_ned_m2=position_cov_ned_m2,
        velocity_cov_ned_m2_s2=velocity_cov_ned_m2_s2,
        attitude_cov_ned_rad2=(1e-6, 0.0, 0.0, 1e-6, 0.0, math.radians(0.5) ** 2),
        angular_rate_body_rad_s=angular_rate_body_rad_s,
        accelerometer_bias_m_s2=(0.0, 0.0, 0.0),
        gyroscope_bias_rad_s=(0.0, 0.0, 0.0),
        stationary=False,
    )


def verdict(state: TrustLevel, time_ns: int = START_NS) -> TrustState:
    return TrustState(
        sampled_ns=time_ns,
        state=state,
        since_ns=time_ns,
        row=1,
        reasons=("test",),
        alert_limit_horizontal_m=10.0,
        alert_limit_vertical_m=15.0,
    )


FIX = GnssFix(
    sampled_ns=START_NS,
    received_ns=START_NS,
    source="gnss0",
    utc_ns=START_NS + UTC_OFFSET_NS,
    fix_type=FixType.THREE_D,
)


def sent(messages: Iterable[Message], config: Config = CONFIG) -> list[OwnCam]:
    process = Process(config)
    return [cam for message in messages for cam in process.handle(message)]


def one(given: NavigationSolution, state: TrustLevel = TrustLevel.SAFE, *, verdict_ns: int = START_NS) -> OwnCam:
    (found,) = sent([FIX, verdict(state, verdict_ns), given])
    return found


def test_no_cam_is_sent_before_the_time_is_known() -> None:
    assert sent([verdict(TrustLevel.SAFE), solution()]) == []
    assert len(sent([verdict(TrustLevel.SAFE), FIX, solution()])) == 1


def test_the_generation_time_is_that_of_the_solution_in_its_time() -> None:
    assert one(solution()).its_time_ms == its_time.its_time_ms(START_NS + UTC_OFFSET_NS)


@pytest.mark.parametrize("yaw_deg", [0.0, 90.0, 200.0])
def test_the_reference_point_is_the_ground_below_the_front(yaw_deg: float) -> None:
    found = one(solution(yaw_rad=math.radians(yaw_deg)))
    assert found.latitude_deg is not None
    assert found.longitude_deg is not None
    assert found.height_ellipsoid_m == pytest.approx(120.0 - 0.7)
    point = Geodetic(math.radians(found.latitude_deg), math.radians(found.longitude_deg), 119.3)
    north, east, down = ned_from_geodetic_difference(point, IMU)
    yaw = math.radians(yaw_deg)
    assert north == pytest.approx(2.0 * math.cos(yaw) - 0.1 * math.sin(yaw), abs=1e-4)
    assert east == pytest.approx(2.0 * math.sin(yaw) + 0.1 * math.cos(yaw), abs=1e-4)
    assert down == pytest.approx(0.7)


def test_speed_and_heading_are_those_of_the_front_in_a_turn() -> None:
    """A right turn with 0.5 rad/s about the IMU: the front, 2 m ahead, moves to the right with 1 m/s."""
    found = one(solution(velocity_ned_m_s=(10.0, 0.0, 0.0), angular_rate_body_rad_s=(0.0, 0.0, 0.5)))
    assert found.speed_m_s == pytest.approx(math.hypot(10.0 - 0.1 * 0.5, 1.0))
    assert found.heading_rad == pytest.approx(math.atan2(1.0, 9.95))


def test_a_left_turn_has_a_positive_yaw_rate_and_curvature() -> None:
    left = one(solution(velocity_ned_m_s=(10.0, 0.0, 0.0), angular_rate_body_rad_s=(0.0, 0.0, -0.2)))
    assert left.yaw_rate_rad_s == pytest.approx(0.2)
    assert left.curvature == pytest.approx(0.2 / left.speed_m_s)  # type: ignore[operator]
    assert one(solution(angular_rate_body_rad_s=(0.0, 0.0, -0.2))).curvature is None


def test_the_yaw_rate_of_an_inclined_vehicle_is_that_of_its_heading() -> None:
    """On a bank of 60 degrees the heading turns with half the rate about the vertical axis of the body."""
    found = one(solution(roll_rad=math.radians(60.0), angular_rate_body_rad_s=(0.0, 0.0, 0.2)))
    assert found.yaw_rate_rad_s == pytest.approx(-0.2 * math.cos(math.radians(60.0)))


def test_the_heading_is_that_of_the_motion_and_at_standstill_that_of_the_body() -> None:
    forward = one(solution(velocity_ned_m_s=(0.0, 5.0, 0.0), yaw_rad=math.pi / 2))
    backward = one(solution(velocity_ned_m_s=(0.0, -5.0, 0.0), yaw_rad=math.pi / 2))
    resting = one(solution(velocity_ned_m_s=(0.0, -0.05, 0.0), yaw_rad=math.pi / 2))
    assert forward.heading_rad == pytest.approx(math.pi / 2)
    assert backward.heading_rad == pytest.approx(3 * math.pi / 2)
    assert resting.heading_rad == pytest.approx(math.pi / 2)
    assert (forward.drive_direction, backward.drive_direction, resting.drive_direction) == (
        DriveDirection.FORWARD,
        DriveDirection.BACKWARD,
        None,
    )


def test_confidences_are_those_of_95_percent_along_and_across_the_movement() -> None:
    found = one(solution(velocity_ned_m_s=(10.0, 0.0, 0.0)))
    assert found.speed_confidence_m_s == pytest.approx(1.96 * 0.1, rel=1e-4)
    assert found.heading_confidence_rad == pytest.approx(1.96 * 0.2 / 10.0, rel=1e-4)
    assert found.height_confidence_m == pytest.approx(1.96 * 3.0, rel=1e-4)
    assert found.position_semi_major_m == pytest.approx(2.4477 * 2.0, rel=1e-4)
    assert found.position_semi_minor_m == pytest.approx(2.4477 * 1.0, rel=1e-4)
    assert found.position_semi_major_orientation_rad == pytest.approx(0.0)
    assert one(solution()).heading_confidence_rad == pytest.approx(1.96 * math.radians(0.5), rel=1e-4)


@pytest.mark.parametrize("orientation_deg", [0.0, 30.0, 90.0, 150.0])
def test_the_ellipse_holds_95_percent_of_the_errors_and_points_along_its_axis(orientation_deg: float) -> None:
    angle = math.radians(orientation_deg)
    rotation = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    cov = rotation @ np.diag([9.0, 1.0]) @ rotation.T
    major, minor, orientation = confidence_ellipse(cov)
    assert (major / 3.0, minor / 1.0) == pytest.approx((2.44775, 2.44775), rel=1e-5)
    assert math.remainder(orientation - angle, math.pi) == pytest.approx(0.0, abs=1e-9)
    errors = np.random.default_rng(3).multivariate_normal([0.0, 0.0], cov, 100_000)
    along = errors @ [math.cos(orientation), math.sin(orientation)]
    across = errors @ [-math.sin(orientation), math.cos(orientation)]
    share = np.mean((along / major) ** 2 + (across / minor) ** 2 <= 1.0)
    assert share == pytest.approx(0.95, abs=4 * math.sqrt(0.95 * 0.05 / 100_000))


@pytest.mark.parametrize("state", TrustLevel)
def test_the_position_cannot_be_trusted_exactly_when_trust_is_unsafe(state: TrustLevel) -> None:
    found = one(solution(), state)
    assert found.position_out_of_range is (state is TrustLevel.UNSAFE)


def test_without_a_recent_verdict_the_position_confidence_is_unavailable() -> None:
    late = one(solution(START_NS + 6_000 * MS))
    (never,) = sent([FIX, solution()])
    for own_cam in (late, never):
        assert own_cam.position_semi_major_m is own_cam.position_semi_minor_m is own_cam.height_confidence_m is None
        assert own_cam.latitude_deg is not None
        assert not own_cam.position_out_of_range


def test_an_unsafe_unit_sends_cams_with_an_untrusted_position() -> None:
    own = one(solution(velocity_ned_m_s=(10.0, 0.0, 0.0)), TrustLevel.UNSAFE)
    (frame,) = Parser(ParserConfig()).handle(own)
    assert isinstance(frame, V2xSend)
    other = Parser(ParserConfig())
    (found,) = other.handle(cams.batch([frame.data], START_NS + UTC_OFFSET_NS))
    assert isinstance(found, CamList)
    assert found.cams[0].position_out_of_range
    assert found.cams[0].position_semi_major_m is None
    assert found.cams[0].latitude_deg is not None


def test_the_vehicle_is_described_by_its_settings() -> None:
    config = CONFIG.with_values({"station_type": StationType.HEAVY_TRUCK, "role": VehicleRole.DANGEROUS_GOODS})
    (found,) = sent([FIX, solution()], config)
    assert (found.station_id, found.station_type) == (77, StationType.HEAVY_TRUCK)
    assert (found.vehicle_length_m, found.vehicle_width_m) == (4.5, 1.8)
    assert found.low_frequency is not None
    assert found.low_frequency.vehicle_role is VehicleRole.DANGEROUS_GOODS


def test_the_longitudinal_acceleration_is_that_of_the_last_half_second() -> None:
    braking = [
        solution(START_NS + step * 100 * MS, velocity_ned_m_s=(0.0, 20.0 - 0.3 * step, 0.0), yaw_rad=math.pi / 2)
        for step in range(20)
    ]
    found = sent([FIX, *braking])
    assert found[0].longitudinal_acceleration_m_s2 is None
    assert found[-1].longitudinal_acceleration_m_s2 == pytest.approx(-3.0)


def test_a_drive_is_sent_by_the_generation_rules() -> None:
    """10 s at standstill at 1 Hz, then 10 s with 1.5 m/s² with a CAM for each 0.5 m/s or 4 m."""
    drive = [
        solution(START_NS + step * 100 * MS, velocity_ned_m_s=(max(0.0, 0.15 * (step - 100)), 0.0, 0.0))
        for step in range(200)
    ]
    times_ms = [(cam.sampled_ns - START_NS) // MS for cam in sent([FIX, *drive])]
    resting = [time for time in times_ms if time <= 10_000]
    assert resting == list(range(0, 10_001, 1000))
    moving = [later - earlier for earlier, later in pairwise(times_ms) if earlier > 10_400]
    assert set(moving) == {400}


def test_the_path_behind_the_vehicle_is_in_every_low_frequency_container() -> None:
    """40 s at 10 m/s to the north: a point every 10 m or the first one behind it, of 23 points."""
    step_deg = math.degrees(1.0 / 6_373_000.0)
    given = [
        solution(START_NS + k * 100 * MS, velocity_ned_m_s=(10.0, 0.0, 0.0)).model_copy(
            update={"latitude_deg": math.degrees(IMU.latitude) + k * step_deg}
        )
        for k in range(400)
    ]
    found = [cam for cam in sent([FIX, *given]) if cam.low_frequency]
    assert found[0].low_frequency is not None and found[0].low_frequency.path == ()
    last = found[-1]
    assert last.low_frequency is not None and last.latitude_deg is not None
    path = last.low_frequency.path
    assert len(path) in (PATH_POINTS - 1, PATH_POINTS)
    for point in path[1:]:
        assert point.delta_latitude_deg == pytest.approx(-10.0 * step_deg, rel=0.12)
        assert point.delta_longitude_deg == pytest.approx(0.0, abs=1e-9)
        assert point.delta_time_s == pytest.approx(1.0, abs=0.11)
    assert 0.0 <= -(path[0].delta_latitude_deg or 0.0) / step_deg <= 11.0


def test_the_path_ends_where_it_is_old_or_not_continuous() -> None:
    here, history = Geodetic(0.8, 0.1, 0.0), PathHistory()
    history.add(0, Geodetic(0.8, 0.1 - 1e-3, 0.0))
    assert history.points(10**9, here) == (), "further than a point of the path can be"
    history.add(1, Geodetic(0.8, 0.1 - 1e-5, 0.0))
    assert len(history.points(10**9, here)) == 1
    assert history.points(700 * 10**9, here) == ()
    history.add(0, here)
    assert history.points(10**9, here)[0].delta_longitude_deg == 0.0, "the time went back"


def test_tshark_dissects_a_sent_frame_to_the_values_of_the_solution(tmp_path: Path) -> None:
    """To the north-east with 10 m/s in a right turn of 0.1 rad/s, worked out by hand in the units of TS 102 894-2.

    The front is 2 m ahead of the IMU, 0.1 m to the right and 0.7 m below: v = (9.99, 0.2) m/s forward and right,
    that is 9.992 m/s with a course 1.147 degrees to the right of the yaw of 53.130 degrees. Of its covariance
    diag(0.01, 0.04) m²/s² remain 0.1726 m/s along that course and 0.1422 m/s across it.
    """
    turning = solution(
        velocity_ned_m_s=(6.0, 8.0, 0.0),
        yaw_rad=math.atan2(8.0, 6.0),
        angular_rate_body_rad_s=(0.0, 0.0, 0.1),
        position_cov_ned_m2=(2.5, 1.5, 0.0, 2.5, 0.0, 9.0),  # variances of 4 and 1 m², the larger to the north-east
    )
    messages = {
        "safe": [FIX, verdict(TrustLevel.SAFE), turning],
        "unsafe": [FIX, verdict(TrustLevel.UNSAFE), turning],
        "no verdict": [FIX, turning],
    }
    frames = [cam_frame(sent(given)[0]) for given in messages.values()]
    seen = dict(zip(messages, dissect(frames, tmp_path), strict=True))
    assert not any(frame.malformed for frame in seen.values())

    metres_of_latitude, metres_of_longitude = 111_211.4, 72_571.9  # of a degree at 49.4 degrees on WGS84
    north, east = 2.0 * 0.6 - 0.1 * 0.8, 2.0 * 0.8 + 0.1 * 0.6
    expected = {
        "its.stationID": 77,
        "cam.generationDeltaTime": ((1_795_000_000 - 1_072_915_200 + 5) * 1000 - 250) % 65536,
        "cam.stationType": 5,
        "its.latitude": round((49.4 + north / metres_of_latitude) * 1e7),
        "its.longitude": round((-1.1 + east / metres_of_longitude) * 1e7),
        "its.altitudeValue": 11_930,
        "its.headingValue": 543,
        "its.headingConfidence": 16,  # 1.96 · 0.1422 / 9.992 rad = 1.598 degrees, rounded up
        "its.speedValue": 999,
        "its.speedConfidence": 34,  # 1.96 · 0.1726 m/s = 0.338 m/s, rounded up
        "cam.driveDirection": 0,
        "its.vehicleLengthValue": 45,
        "cam.vehicleWidth": 18,
        "its.yawRateValue": -573,  # a turn to the right is negative
        "its.curvatureValue": -100,
        "its.longitudinalAccelerationValue": 161,  # unavailable: one solution has no acceleration
        "btpb.dstport": 2001,
        "geonw.src_pos.lat": round((49.4 + north / metres_of_latitude) * 1e7),
        "geonw.src_pos.speed": 999,
        "geonw.src_pos.hdg": 543,
    }
    for frame in seen.values():
        assert {name: frame.number(name) for name in expected} == expected
    confidence = {
        name: (
            frame.number("its.semiMajorConfidence"),
            frame.number("its.semiMinorConfidence"),
            frame.number("its.semiMajorOrientation"),
            frame.number("its.altitudeConfidence"),
            frame.number("geonw.src_pos.pai"),
        )
        for name, frame in seen.items()
    }
    assert confidence["safe"] == (490, 245, 450, 9, 1)  # 2.4477 · 2 m and 1 m, 45 degrees, at most 10 m
    assert confidence["unsafe"] == (4094, 4094, 450, 9, 0), "the position cannot be trusted"
    assert confidence["no verdict"] == (4095, 4095, 3601, 15, 0), "unavailable"


def cam_frame(own: OwnCam) -> bytes:
    """Encode a CAM as this unit sends it."""
    (frame,) = Parser(ParserConfig()).handle(own)
    assert isinstance(frame, V2xSend)
    return frame.data

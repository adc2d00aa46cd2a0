from itertools import pairwise
from math import cos, radians

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from services.sensors.simulator.drive import simulate
from services.sensors.simulator.imu.ideal_imu import attitude_matrices, integrate_position
from services.sensors.simulator.motion.roads import Course, Road, RoadSegment, bend
from services.sensors.simulator.motion.speed import SpeedProfile, plan_lap
from services.sensors.simulator.motion.trajectory import Trajectory
from services.sensors.simulator.scenarios import BY_NAME, SCENARIOS, Scenario
from services.sensors.simulator.vehicle import antenna_at
from shared.maths.earth import Geodetic, earth_rate_n, gravity, ned_track, transport_rate_n
from shared.maths.rotation import skew
from tests.support.cases import each
from tests.support.drives.rotations import mean_rotation

STEP = 0.01


def trajectory(scenario: Scenario, seed: int = 0) -> Trajectory:
    return Trajectory(
        scenario.course, scenario.start, standstill=16.0, acceleration=1.2, step=STEP, rng=np.random.default_rng(seed)
    )


@each("row", SCENARIOS)
def test_a_lap_of_every_course_ends_where_it_began(row: Scenario) -> None:
    road = Road(row.course)
    s = np.linspace(0.0, road.length, 200_001)
    heading, slope, _ = road.at(s)
    end = np.exp(1j * heading) * np.cos(slope)
    closure = abs(np.trapezoid(end, s))
    climb = np.trapezoid(np.sin(slope), s)
    assert closure < 1e-3
    assert abs(climb) < 1e-3
    assert cos(heading[-1] - heading[0]) == pytest.approx(1.0, abs=1e-12)


def test_heading_is_the_integral_of_a_continuous_curvature() -> None:
    road = Road(BY_NAME["urban"].course)
    s = np.linspace(0.0, 2.0 * road.length, 100_001)
    heading, _, curvature = road.at(s)
    integral = np.concatenate([[0.0], np.cumsum(0.5 * (curvature[1:] + curvature[:-1]) * np.diff(s))])
    assert np.abs(heading - heading[0] - integral).max() < 1e-4
    assert np.abs(np.diff(curvature)).max() < 4e-3


def test_the_maximum_curvature_of_a_bend_is_that_of_its_radius() -> None:
    course = Course((RoadSegment(20.0, (5.0, 5.0)), bend(90.0, 6.0, (4.0, 4.0), (5.0, 5.0))))
    _, _, curvature = Road(course).at(np.linspace(0.0, Road(course).length, 10_001))
    assert curvature.max() == pytest.approx(1.0 / 6.0)


@each("row", SCENARIOS)
def test_a_planned_lap_has_the_length_of_its_course_and_respects_its_speed_limits(row: Scenario) -> None:
    for seed in range(5):
        moves = plan_lap(row.course, row.acceleration_m_s2, np.random.default_rng(seed))
        assert sum(move.distance for move in moves) == pytest.approx(Road(row.course).length, rel=1e-12)
        assert all(a.end == pytest.approx(b.begin, abs=1e-9) for a, b in pairwise(moves))
        assert max(move.begin for move in moves) <= max(s.speed_m_s[1] for s in row.course.segments)
        assert moves[-1].end == 0.0


def test_distance_is_the_integral_of_speed_and_acceleration_is_continuous() -> None:
    profile = SpeedProfile(BY_NAME["urban"].course, 2.0, 1.2, np.random.default_rng(3))
    t = np.arange(0.0, 300.0, 0.001)
    distance, speed = profile.at(t)
    integral = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * 0.001)])
    assert np.abs(distance - integral).max() < 1e-3
    jerk = np.diff(speed, 2) / 0.001**2
    assert np.abs(jerk).max() < 20.0, "a step in acceleration would show as a jerk of 1000 m/s³ and more"


def test_the_speed_before_a_segment_too_short_for_braking_is_reduced() -> None:
    course = Course((RoadSegment(500.0, (30.0, 30.0)), RoadSegment(5.0, (30.0, 30.0), stop_s=(1.0, 1.0))))
    moves = plan_lap(course, 1.0, np.random.default_rng(0))
    assert sum(move.distance for move in moves) == pytest.approx(505.0)
    assert all(abs(move.end - move.begin) <= move.duration * 1.0 + 1e-9 for move in moves)


def test_a_course_must_end_in_a_stop() -> None:
    with pytest.raises(ValueError, match="must end in a stop"):
        Course((RoadSegment(100.0, (5.0, 6.0)),))


def test_the_motion_is_independent_of_the_block_lengths() -> None:
    whole = trajectory(BY_NAME["parking_lot"]).advance(6000)
    parts = trajectory(BY_NAME["parking_lot"])
    blocks = [parts.advance(n) for n in (1, 99, 400, 5500)]
    assert np.abs(np.concatenate([b.force_b for b in blocks]) - whole.force_b).max() < 1e-9
    assert np.abs(np.concatenate([b.rate_b for b in blocks]) - whole.rate_b).max() < 1e-12
    assert blocks[-1].position[-1] == pytest.approx(whole.position[-1], abs=1e-11)


@pytest.mark.parametrize("name", ["parking_lot", "highway"])
def test_integrating_the_ideal_measurements_reproduces_the_trajectory(name: str) -> None:
    """Mechanisation by eq. 12 to 19 of the paper (corrected), with rotation matrices: independent of the simulator."""
    drive = simulate(name, seed=1, duration_s=40.0)
    C, v, (lat, lon, h) = attitude_matrices(drive.attitude[:1])[0], drive.velocity_n[0], drive.position[0]
    worst = 0.0
    turns = drive.ideal_rate_b * STEP
    means, matrices = mean_rotation(turns), Rotation.from_rotvec(turns).as_matrix()
    for k in range(1, len(drive.t_ns)):
        earth, transport = np.array(earth_rate_n(lat)), np.array(transport_rate_n(lat, h, tuple(v)))
        mean = C @ means[k] - 0.5 * STEP * skew(earth + transport) @ C
        g = np.array([0.0, 0.0, gravity(lat, h)])
        new_v = v + STEP * (mean @ drive.ideal_force_b[k] + g - np.cross(transport + 2.0 * earth, v))
        lat, lon, h = integrate_position(Geodetic(lat, lon, h), np.array([v, new_v]), STEP).position[1]
        new_transport = np.array(transport_rate_n(lat, h, tuple(new_v)))
        C = (np.eye(3) - STEP * skew(earth + 0.5 * (transport + new_transport))) @ C @ matrices[k]
        C = C @ (1.5 * np.eye(3) - 0.5 * C.T @ C)
        v = new_v
        worst = max(worst, float(np.abs(v - drive.velocity_n[k]).max()))
    assert worst < 2e-9
    assert np.abs(attitude_matrices(drive.attitude[-1:])[0].T @ C - np.eye(3)).max() < 2e-12
    assert [lat, lon] == pytest.approx(drive.position[-1, :2], abs=1e-14)
    assert h == pytest.approx(drive.position[-1, 2], abs=1e-7)


def test_position_is_the_integral_of_velocity() -> None:
    drive = simulate("highway", seed=2, duration_s=60.0)
    track = ned_track(drive.position, Geodetic(*drive.position[0]))
    sums = np.cumsum(0.5 * STEP * (drive.velocity_n[1:] + drive.velocity_n[:-1]), axis=0)
    # Over 1 km the axes of the start differ from those of the end by 0.2 mrad.
    assert np.abs(track[1:] - sums).max() < 0.5
    assert np.abs(track[1:, :2] - sums[:, :2]).max() < 0.1


def test_at_standstill_the_ideal_measurements_are_gravity_and_earth_rate() -> None:
    drive = simulate("parking_lot", seed=0, duration_s=10.0)
    place = drive.position[0]
    assert np.linalg.norm(drive.ideal_force_b[5]) == pytest.approx(gravity(place[0], place[2]), rel=1e-9)
    assert np.linalg.norm(drive.ideal_rate_b[5]) == pytest.approx(7.292115e-5, rel=1e-7)
    assert drive.ideal_force_b[5, 0] > 0.1, "the car park slopes by one degree, nose up"


def test_the_velocity_is_along_the_body_x_axis() -> None:
    drive = simulate("urban", seed=4, duration_s=120.0)
    body = np.einsum("nij,ni->nj", attitude_matrices(drive.attitude), drive.velocity_n)
    assert np.abs(body[:, 1:]).max() < 1e-12


def test_the_antenna_is_at_its_lever_arm_and_its_velocity_is_the_derivative_of_its_position() -> None:
    motion = trajectory(BY_NAME["parking_lot"]).advance(6000)
    nodes = np.arange(1, 6000)
    states = [antenna_at(motion, float(node)) for node in nodes]
    origin = Geodetic(*motion.position[0])
    track = ned_track(np.array([state.position for state in states]), origin)
    lever_n = track - ned_track(motion.position[1:6000], origin)
    assert np.abs(np.linalg.norm(lever_n, axis=1) - np.hypot(0.3, 1.2)).max() < 1e-4
    derivative = (track[2:] - track[:-2]) / (2.0 * STEP)
    velocity = np.array([state.velocity_n for state in states])[1:-1]
    assert np.abs(velocity - derivative).max() < 0.02, "the rate is the mean of the step before: half a step old"


def test_pitch_equals_the_slope_of_the_road() -> None:
    drive = simulate("highway", seed=0, duration_s=300.0)
    assert np.ptp(drive.attitude[:, 1]) > radians(3.0)
    climb = -drive.velocity_n[:, 2] / np.maximum(np.linalg.norm(drive.velocity_n, axis=1), 1e-9)
    moving = np.linalg.norm(drive.velocity_n, axis=1) > 1.0
    assert np.abs(climb - np.sin(drive.attitude[:, 1]))[moving].max() < 1e-9

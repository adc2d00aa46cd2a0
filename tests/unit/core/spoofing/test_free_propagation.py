"""Strapdown and free propagation: closed forms, the simulator's exact inversion, and consistency of the covariance."""

from collections import Counter
from dataclasses import replace
from itertools import pairwise
from math import inf, nan, radians

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation

from services.core.spoofing.inertial import propagation
from services.core.spoofing.inertial.anchors import FilterAnchor
from services.core.spoofing.inertial.tracks import OdometerSpeed, VelocityFix
from services.core.spoofing.settings import LongSettings, Settings
from services.core.spoofing.windows.free_propagation import ATTITUDE, SIZE, VELOCITY, FreePropagations
from services.core.spoofing.windows.long_window import LongWindow
from services.sensors.simulator.drive import Drive, simulate
from shared.inertial.increments import SECOND_NS, Decimator, Increment
from shared.maths.earth import Geodetic
from shared.maths.rotation import ned_from_body, quaternion_from_matrix

FloatArray = npt.NDArray[np.float64]
START_S, LENGTH_S = 30, 60
ANCHOR_SIZE = 15  # states of fusion that a propagation starts with


@pytest.fixture(scope="module")
def drive() -> Drive:
    return simulate("urban", 4, 100.0)


def increments_of(
    drive: Drive, *, ideal: bool, start_s: float = START_S, length_s: float = LENGTH_S, batch: int = 100
) -> list[Increment]:
    decimator, found = Decimator(80.0, 20.0, Counter()), []
    force, rate = (drive.ideal_force_b, drive.ideal_rate_b) if ideal else (drive.force_b, drive.rate_b)
    times, forces, rates = drive.t_ns.tolist(), list(map(tuple, force.tolist())), list(map(tuple, rate.tolist()))
    for k in range(0, len(times), batch):
        decimator.add(times[k : k + batch], forces[k : k + batch], rates[k : k + batch])
        found += decimator.take()
    return [
        increment for increment in found if start_s * SECOND_NS <= increment.start_ns < (start_s + length_s) * SECOND_NS
    ]


def anchor_at(drive: Drive, time_s: float) -> FilterAnchor:
    k = int(np.searchsorted(drive.t_ns, round(time_s * SECOND_NS)))
    state = np.zeros(propagation.STATE)
    state[propagation.QUATERNION] = quaternion_from_matrix(ned_from_body(*drive.attitude[k].tolist()))
    state[propagation.VELOCITY], state[propagation.POSITION] = drive.velocity_n[k], drive.position[k]
    return FilterAnchor(
        int(drive.t_ns[k]), state, np.array([1.0, 0.0, 0.0]), np.zeros((ANCHOR_SIZE, ANCHOR_SIZE))
    )  # fmt: skip


def started(settings: LongSettings, *anchors: FilterAnchor) -> FreePropagations:
    free = FreePropagations(Settings(long=settings))
    for anchor in anchors:
        free.start(anchor)
    return free


def velocities(free: FreePropagations) -> FloatArray:
    """Velocities [m/s, NED], shape (n, 3), a view."""
    found: FloatArray = free.runs["state"][:, propagation.VELOCITY]
    return found


def test_ideal_increments_lead_to_the_true_velocity_and_attitude_after_a_minute(drive: Drive) -> None:
    increments = increments_of(drive, ideal=True)
    steps = propagation.carried(anchor_at(drive, START_S).state[None], propagation.table_of(increments))
    k = int(np.searchsorted(drive.t_ns, increments[-1].end_ns))
    assert increments[-1].end_ns == (START_S + LENGTH_S) * SECOND_NS
    np.testing.assert_allclose(steps[0, -1, propagation.VELOCITY], drive.velocity_n[k], atol=0.01)
    attitude = propagation.matrices(steps[0, -1, propagation.QUATERNION])
    turn = attitude @ ned_from_body(*drive.attitude[k].tolist()).T
    assert Rotation.from_matrix(turn).magnitude() < radians(0.01)


def test_a_bias_and_a_scale_of_the_sensors_are_removed_from_each_increment(drive: Drive) -> None:
    table = propagation.table_of(increments_of(drive, ideal=True, length_s=10.0))
    state = anchor_at(drive, START_S).state
    bias_f, bias_w, scale = np.array([0.3, -0.2, 0.1]), np.array([0.02, -0.01, 0.03]), np.array([0.01, -0.02, 0.015])
    wrong = table.copy()
    wrong[:, :3] += bias_f
    wrong[:, propagation.RATE] = (table[:, propagation.RATE] + bias_w) / (1.0 - scale)
    told = state.copy()
    told[propagation.ACCELEROMETER_BIAS], told[propagation.GYROSCOPE_BIAS] = bias_f, bias_w
    told[propagation.GYROSCOPE_SCALE] = scale
    np.testing.assert_allclose(
        propagation.carried(told[None], wrong), propagation.carried(state[None], table), rtol=1e-9, atol=1e-9
    )


def test_a_stack_of_propagations_is_each_of_them_alone_in_parts_of_any_length(drive: Drive) -> None:
    """Second by second with aiding, three that start at different times against each alone, increment by increment."""
    anchors, increments = [anchor_at(drive, START_S + k) for k in (0.0, 1.0, 3.0)], increments_of(drive, ideal=True)
    anchors[1].mounting[0] = 1.3  # its odometer is rejected
    anchors[2].state[propagation.VELOCITY] += 3.0

    def run(*anchors: FilterAnchor, parts: int) -> FreePropagations:
        free, waiting = started(LongSettings()), list(anchors)
        for k in range(0, 200, 10):
            if waiting and increments[k].start_ns >= waiting[0].time_ns:
                free.start(waiting.pop(0))
            if not len(free.runs):
                continue
            for part in range(k, k + 10, parts):
                free.advance(increments[part : part + parts])
            free.predict()
            end_ns = increments[k + 9].end_ns
            true = drive.velocity_n[int(np.searchsorted(drive.t_ns, end_ns))]
            speed = OdometerSpeed(end_ns, float(np.linalg.norm(true)), 0.0)
            if k == 190:
                free.stand()
            else:
                free.aid(speed, increments[k + 9].row[5])
        return free

    together = run(*anchors, parts=10)
    assert together.runs["odometer_rejections"].tolist()[:2] == [0, 3]
    for row, anchor in enumerate(anchors):
        alone = run(anchor, parts=1).runs[0]
        for name in together.runs.dtype.names or ():
            np.testing.assert_allclose(together.runs[name][row], alone[name], rtol=1e-9, atol=1e-12, err_msg=name)


def test_velocity_and_way_are_known_between_the_first_and_the_newest_increment_of_a_run(drive: Drive) -> None:
    free, increments = started(LongSettings(), anchor_at(drive, START_S)), increments_of(drive, ideal=True)
    free.advance(increments[:1])
    assert np.isnan(free.nodes_at(increments[0].end_ns, free.end_ns)).all(), "one increment"
    free.advance(increments[1:10])
    free.start(anchor_at(drive, START_S + 1))
    free.advance(increments[10:20])
    first, second = increments[0].end_ns, increments[10].end_ns
    k = int(np.searchsorted(drive.t_ns, second))
    np.testing.assert_allclose(free.nodes_at(second, free.end_ns)[:, :3], [drive.velocity_n[k]] * 2, atol=0.01)
    between = free.nodes_at(second + 30_000_000, free.end_ns)
    low, high = free.nodes_at(second, free.end_ns), free.nodes_at(second + 100_000_000, free.end_ns)
    np.testing.assert_allclose(between, 0.7 * low + 0.3 * high, rtol=1e-9)
    assert np.isnan(free.nodes_at(second - 1, free.end_ns)[:, 0]).tolist() == [False, True]
    assert (
        np.isnan(free.nodes_at(first - 1, free.end_ns)).all()
        and np.isnan(free.nodes_at(increments[19].end_ns + 1, free.end_ns)).all()
    )


def test_increments_end_at_multiples_of_100_ms_and_a_gap_starts_a_new_run(drive: Drive) -> None:
    assert {increment.end_ns % 100_000_000 for increment in increments_of(drive, ideal=True)} == {0}
    rejected: Counter[str] = Counter()
    decimator = Decimator(80.0, 20.0, rejected)
    times = [*range(10_000_000, 320_000_000, 10_000_000), *range(900_000_000, 1_120_000_000, 10_000_000)]
    kept = []
    for time_ns in times:
        decimator.add([time_ns], [(0.0, 0.0, -9.8)], [(0.0, 0.0, 0.0)])
        kept += decimator.take()
    assert [increment.after_gap for increment in kept] == [True, False, False, True, False]
    assert all(increment.row[propagation.DURATION] <= 0.1 for increment in kept)
    assert not decimator.take()
    decimator.add([times[-1]], [(0.0, 0.0, -9.8)], [(0.0, 0.0, 0.0)])
    assert not decimator.take()
    assert rejected == {"imu: stamp is not after the one before": 1}


def test_a_short_gap_is_bridged_by_the_mean_of_its_ends_and_a_longer_one_is_not() -> None:
    decimator = Decimator(80.0, 20.0, Counter(), bridged_ns=1_000_000_000)
    times = [*range(0, 310_000_000, 10_000_000), *range(900_000_000, 1_110_000_000, 10_000_000), 2_200_000_000]
    forces = [(0.0 if time_ns < 500_000_000 else 2.0, 0.0, -9.8) for time_ns in times]
    decimator.add(times, forces, [(0.0, 0.0, 0.1)] * len(times))
    found = decimator.take()
    assert [increment.bridges for increment in found] == [False, False, False, True, False, False]
    assert [increment.after_gap for increment in found] == [True, False, False, False, False, False]
    assert all(increment.end_ns == other.start_ns for increment, other in pairwise(found)), "nothing is missing"
    np.testing.assert_allclose(found[3].row, [1.0, 0.0, -9.8, 0.0, 0.0, 0.1, 0.6], rtol=1e-12)


def test_the_error_over_a_bridged_gap_is_within_what_it_adds_to_the_spread(drive: Drive) -> None:
    kept = (drive.t_ns <= 52.3 * 1e9) | (drive.t_ns >= 53.1 * 1e9)
    whole, bridged = (Decimator(80.0, 20.0, Counter(), bridged_ns=1_000_000_000) for _ in range(2))
    whole.add(drive.t_ns.tolist(), drive.force_b.tolist(), drive.rate_b.tolist())
    bridged.add(drive.t_ns[kept].tolist(), drive.force_b[kept].tolist(), drive.rate_b[kept].tolist())
    runs = []
    for decimator in (whole, bridged):
        free = started(LongSettings(), anchor_at(drive, 50.0))
        free.advance([increment for increment in decimator.take() if 50.0e9 <= increment.start_ns < 53.4e9][:30])
        runs.append(free.runs[0])
    difference = (runs[1]["state"] - runs[0]["state"])[propagation.VELOCITY]
    added = np.sqrt((runs[1]["P"] - runs[0]["P"]).diagonal()[:3])
    assert (added > 0.1).all() and (np.abs(difference) < 3.0 * added).all()


def test_increments_are_the_means_of_their_samples_however_these_are_batched(drive: Drive) -> None:
    one, many = (increments_of(drive, ideal=False, batch=batch) for batch in (7, 5000))
    assert one == many and len(one) == 10 * LENGTH_S
    first, last = np.searchsorted(drive.t_ns, [one[20].start_ns, one[20].end_ns])
    means = [values[first + 1 : last + 1].mean(axis=0) for values in (drive.force_b, drive.rate_b)]
    np.testing.assert_allclose(one[20].row, [*means[0], *means[1], 0.1], rtol=1e-12)


def test_a_sample_that_cannot_be_is_counted_and_costs_nothing_but_itself() -> None:
    rejected: Counter[str] = Counter()
    decimator = Decimator(80.0, 20.0, rejected)
    times = list(range(0, 410_000_000, 10_000_000))
    forces, rates = [(0.0, 0.0, -9.8)] * len(times), [(0.0, 0.1, 0.0)] * len(times)
    forces[5], forces[6], rates[7] = (0.0, nan, -9.8), (81.0, 0.0, 0.0), (0.0, inf, 0.0)
    times[8] = times[3]
    decimator.add(times, forces, rates)
    found = decimator.take()
    assert [(increment.start_ns, increment.end_ns) for increment in found] == [
        (k * 10**8, (k + 1) * 10**8) for k in range(4)
    ]
    np.testing.assert_allclose([increment.row[3:6] for increment in found], [(0.0, 0.1, 0.0)] * 4, rtol=1e-12)
    assert rejected == {
        "imu: value is not a number": 1,
        "imu: value is beyond every sensor's range": 2,
        "imu: stamp is not after the one before": 1,
    }


def test_derivatives_of_the_body_velocity_agree_with_finite_differences(drive: Drive) -> None:
    free = started(LongSettings(), anchor_at(drive, 50.0), anchor_at(drive, 60.0))
    values, H, attitudes = free.body_velocities()
    step = 1e-6
    for row, (C, v) in enumerate(zip(attitudes, velocities(free), strict=True)):
        np.testing.assert_allclose(values[row], C.T @ v, atol=1e-12)
        for element in range(6):
            psi, dv = np.zeros(3), np.zeros(3)
            (dv if element < 3 else psi)[element % 3] = step
            changed = (Rotation.from_rotvec(psi).as_matrix() @ C).T @ (v + dv)
            np.testing.assert_allclose((changed - values[row]) / step, H[row, :, element], atol=1e-4)
    assert H.shape == (2, 3, SIZE) and not H[..., 6:].any()


def test_covariance_of_an_unaided_run_grows_by_the_closed_form() -> None:
    settings = LongSettings(non_holonomic=False, velocity_sd_m_s=0.0, scale_sd=0.0)
    P = np.zeros((ANCHOR_SIZE, ANCHOR_SIZE))
    P[0, 0], P[4, 4], P[6, 6], P[4, 6] = 0.05**2, 1e-3**2, 0.01**2, -0.8 * 1e-3 * 0.01
    P[6, 4] = P[4, 6]
    state = np.zeros(propagation.STATE)
    state[0], state[propagation.POSITION] = 1.0, (0.8, 0.0, 300.0)
    free = started(settings, FilterAnchor(0, state, np.array([1.0, 0.0, 0.0]), P))
    for k in range(30):
        free.advance([
            Increment(n * 10**8, (n + 1) * 10**8, (0.0, 0.0, -9.8, 0.0, 0.0, 0.0, 0.1), 0.0, False)
            for n in range(10 * k, 10 * k + 10)
        ])  # fmt: skip
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
    assert free.runs["P"][0, 0, 0] == pytest.approx(expected, rel=0.02)


def test_errors_of_aided_runs_are_within_their_covariance() -> None:
    squares = []
    for seed in range(4):
        drive = simulate("urban", 20 + seed, 100.0)
        truth = anchor_at(drive, START_S)
        rng, s = np.random.default_rng(seed), LongSettings()
        tilt = rng.normal(0.0, s.attitude_sd_rad, 3)
        state = truth.state.copy()
        matrix = Rotation.from_rotvec(tilt).as_matrix() @ propagation.matrices(state[propagation.QUATERNION])
        state[propagation.QUATERNION] = quaternion_from_matrix(matrix)
        state[propagation.VELOCITY] += rng.normal(0.0, s.velocity_sd_m_s, 3)
        state[propagation.ACCELEROMETER_BIAS] = np.mean(drive.force_b - drive.ideal_force_b, axis=0)
        state[propagation.GYROSCOPE_BIAS] = np.mean(drive.rate_b - drive.ideal_rate_b, axis=0)
        free = started(s, replace(truth, state=state))
        increments = increments_of(drive, ideal=False)
        for k in range(0, len(increments), 10):
            free.advance(increments[k : k + 10])
            free.predict()
            speed = float(np.interp(free.end_ns, drive.odometer_ns, drive.odometer))
            free.aid(OdometerSpeed(free.end_ns, speed, 0.0), increments[k + 9].row[5])
        assert free.end_ns == (START_S + LENGTH_S) * SECOND_NS
        P = free.runs["P"][0]
        error = drive.velocity_n[int(np.searchsorted(drive.t_ns, free.end_ns))] - velocities(free)[0]
        squares.append(float(error @ np.linalg.solve(P[VELOCITY, VELOCITY], error)))
        np.testing.assert_allclose(P, P.T, atol=1e-9)
        assert np.linalg.eigvalsh(P[ATTITUDE, ATTITUDE]).min() > 0.0
    assert max(squares) < 16.3, "chi-square with 3 degrees of freedom: exceeded once in 1000"
    assert np.mean(squares) > 0.05, "not absurdly wide"


def test_an_odometer_that_freezes_is_rejected_and_then_left_out(drive: Drive) -> None:
    free = started(LongSettings(), anchor_at(drive, START_S))
    forward = free.body_velocities()[2][0, :, 0]
    velocities(free)[0] += 5.0 * forward
    before = float(velocities(free)[0] @ forward)
    for _ in range(3):
        free.aid(OdometerSpeed(0, 0.0, 0.0), 0.0)
    assert free.runs["odometer_rejections"].tolist() == [3]
    free.aid(OdometerSpeed(0, before, 0.0), 0.0)
    assert free.runs["odometer_rejections"].tolist() == [3], "no longer used"
    assert not free.odometer_agrees(0)


@pytest.mark.parametrize(("speed_sd", "left"), [(1.9, 0.5 * 0.03 / (1.9**2 + 0.03)), (2.1, 0.5)])
def test_the_non_holonomic_constraint_is_used_while_the_forward_speed_is_known(
    drive: Drive, speed_sd: float, left: float
) -> None:
    anchor = anchor_at(drive, START_S)
    covariance = np.zeros((ANCHOR_SIZE, ANCHOR_SIZE))
    covariance[VELOCITY, VELOCITY] = np.eye(3) * speed_sd**2
    C = propagation.matrices(anchor.state[propagation.QUATERNION])
    anchor.state[propagation.VELOCITY] += 0.5 * C[:, 1]
    free = started(LongSettings(), replace(anchor, covariance=covariance))
    free.aid(None, 0.0)
    lateral = free.body_velocities()[0][0, 1]
    assert lateral == pytest.approx(left, abs=1e-3), "lateral noise of 0.1 m/s that lasts 3 s"


@pytest.mark.parametrize(("ahead_ns", "known"), [(0, True), (90_000_000, True), (150_000_000, False)])
def test_a_fix_is_compared_with_the_increments_until_the_one_that_passes_it(
    drive: Drive, ahead_ns: int, known: bool
) -> None:
    """Whatever is propagated at once; a position that is true later than these is not compared.

    A second propagation begins 5 s later: the test is made of two.
    """
    increments, found = increments_of(drive, ideal=True), []
    for parts in (1, 10):
        long = LongWindow(Settings())
        long.start(anchor_at(drive, START_S))
        for k in range(0, len(increments), parts):
            part = increments[k : k + parts]
            if k == 50:
                long.start(anchor_at(drive, START_S + 5))
            long.advance(part)
            for increment in part:
                at = int(np.searchsorted(drive.t_ns, increment.end_ns - 90_000_000))
                place = Geodetic(*drive.position[at + ahead_ns // 10_000_000].tolist())
                velocity, sd, at_ns = drive.velocity_n[at], np.full(3, 0.05), int(drive.t_ns[at])
                fix = VelocityFix(at_ns, velocity, sd, place, 1.0, position_ns=at_ns + ahead_ns)
                long.compare(fix, increment.end_ns)
            if part[-1].end_ns % SECOND_NS == 0:
                long.predict()
        way, velocities_60 = long.way(60), long.result(60)
        assert velocities_60 is not None and (way is not None) == known
        found.append([*velocities_60.difference_n, *([] if way is None else way.difference_n)])
    np.testing.assert_allclose(found[0], found[1], atol=1e-9)
    np.testing.assert_allclose(found[0], 0.0, atol=0.5)

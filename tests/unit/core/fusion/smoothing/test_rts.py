"""The smoother against batch least squares, the textbook form, and simulated truth."""

from copy import copy, deepcopy
from dataclasses import dataclass
from functools import cache
from math import radians

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from cli.papers.navigation import saved_heading
from services.core.fusion.aids.gnss.antenna import antenna_position_matrix
from services.core.fusion.aids.gnss.settings import GnssSettings
from services.core.fusion.inertial import error_model as em
from services.core.fusion.inertial.filter import ErrorStateFilter, rescaled
from services.core.fusion.inertial.propagation import Intervals, samples_of
from services.core.fusion.inertial.standstill import CERTAIN_LIMITS
from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import Settings
from services.core.fusion.smoothing.history import CorrectionRecord, HistoryRecorder, Knot, Start, Step
from services.core.fusion.smoothing.rts import BackwardRecursion, smoothed_filters
from services.core.fusion.states import LAYOUT
from services.sensors.simulator.drive import Drive, simulate
from services.sensors.simulator.gnss.gnss_errors import ErrorKind, InjectedError
from services.sensors.simulator.scenarios import scenario_of, with_error
from shared.inertial.strapdown import InertialState
from shared.maths.earth import Geodetic, ned_from_geodetic_difference
from shared.maths.kalman import correct, predict
from shared.maths.rotation import ned_from_body, quaternion_from_matrix
from shared.runtime.config import GnssAntenna, Vehicle
from tests.support.cases import each
from tests.support.drives.histories import Records

FloatArray = npt.NDArray[np.float64]
PERIOD_NS = 500_000_000


@dataclass
class LinearRun:
    """A linear filter with closed loop, and its history for the smoother."""

    Ps: list[FloatArray]  # after each measurement
    states: list[FloatArray]
    steps: list[FloatArray]  # Phi
    corrections: list[CorrectionRecord]
    predicted: list[FloatArray]  # covariance before each measurement


def filtered(measured: FloatArray, P0: FloatArray, F: FloatArray, noise: FloatArray, R: FloatArray) -> LinearRun:
    """Measure the first state, and its second every third time, after each step of 0.1 s."""
    way = LinearRun([P0], [np.zeros(len(P0))], [], [], [])
    P, state = P0, np.zeros(len(P0))
    for k, value in enumerate(measured):
        m, n = F.shape
        Phi = np.eye(len(P0))
        Phi[:m, :n] += 0.1 * F
        P, state = predict(P, Phi, np.diag(0.1 * noise)), Phi @ state
        H = np.zeros((1, len(P0)))
        H[0, 1 if k % 3 == 2 else 0] = 1.0
        way.predicted.append(P)
        correction = correct(P, value - H @ state, H, R)
        P, state = correction.P, state + correction.x
        way.steps.append(Phi)
        way.corrections.append(CorrectionRecord(0, correction.z, H, correction.K, correction.S_inverse))
        way.Ps.append(P)
        way.states.append(state)
    return way


def smoothed(way: LinearRun) -> tuple[list[FloatArray], list[FloatArray]]:
    back = BackwardRecursion(len(way.Ps[0]))
    states, covs = [], []
    for k in reversed(range(len(way.Ps))):
        errors, cov = back.smoothed(way.Ps[k])
        states.append(way.states[k] + errors)
        covs.append(cov)
        if k > 0:
            correction = way.corrections[k - 1]
            back.correction(correction.z, correction.H, correction.K, correction.S_inverse)
            back.step(way.steps[k - 1])
    return states[::-1], covs[::-1]


@pytest.fixture(scope="module")
def moving() -> tuple[FloatArray, LinearRun]:
    """Position, velocity and a state that is known to be zero; 30 measurements."""
    rng = np.random.default_rng(4)
    measured = rng.standard_normal((30, 1)) * 3.0 + np.linspace(0.0, 9.0, 30)[:, None]
    F, noise = np.array([[0.0, 1.0]]), np.array([0.02, 0.3, 0.0])
    return measured, filtered(measured, np.diag([4.0, 9.0, 0.0]), F, noise, np.array([[0.5]]))


def test_smoothed_states_equal_batch_least_squares(moving: tuple[FloatArray, LinearRun]) -> None:
    measured, way = moving
    count = len(measured) + 1
    Phi, Q = np.array([[1.0, 0.1], [0.0, 1.0]]), np.diag([0.002, 0.03])
    rows, values = [np.eye(2, 2 * count) / np.array([[2.0], [3.0]])], [np.zeros(2)]
    for k, value in enumerate(measured):
        step = np.zeros((2, 2 * count))
        step[:, 2 * k : 2 * k + 2], step[:, 2 * k + 2 : 2 * k + 4] = -Phi, np.eye(2)
        rows.append(step / np.sqrt(Q.diagonal())[:, None])
        values.append(np.zeros(2))
        seen = np.zeros((1, 2 * count))
        seen[0, 2 * k + 2 + (k % 3 == 2)] = 1.0
        rows.append(seen / np.sqrt(0.5))
        values.append(value / np.sqrt(0.5))
    A = np.vstack(rows)
    cov = np.linalg.inv(A.T @ A)
    best = (cov @ A.T @ np.concatenate(values)).reshape(count, 2)
    states, covs = smoothed(way)
    assert np.array(states)[:, :2] == pytest.approx(best, abs=1e-9)
    for k, P in enumerate(covs):
        assert P[:2, :2] == pytest.approx(cov[2 * k : 2 * k + 2, 2 * k : 2 * k + 2], abs=1e-9)
        assert not P[2].any() and not P[:, 2].any() and states[k][2] == 0.0, "without variance: unchanged"


def test_smoothed_states_equal_the_textbook_form_with_the_inverse_covariance(
    moving: tuple[FloatArray, LinearRun],
) -> None:
    """x_s = x + A (x_s+ - Phi x), P_s = P + A (P_s+ - P_predicted) A^T, A = P Phi^T P_predicted^-1."""
    _, way = moving
    Phi = np.array([[1.0, 0.1], [0.0, 1.0]])
    states, covs = smoothed(way)
    state, cov = way.states[-1][:2], way.Ps[-1][:2, :2]
    for k in reversed(range(len(way.Ps) - 1)):
        P, predicted = way.Ps[k][:2, :2], way.predicted[k][:2, :2]
        A = P @ Phi.T @ np.linalg.inv(predicted)
        state = way.states[k][:2] + A @ (state - Phi @ way.states[k][:2])
        cov = P + A @ (cov - predicted) @ A.T
        assert states[k][:2] == pytest.approx(state, abs=1e-9)
        assert covs[k][:2, :2] == pytest.approx(cov, abs=1e-9)


def test_a_decaying_error_is_smoothed_to_the_batch_least_squares() -> None:
    """x0 known to 2, x1 = 0.5 x0 + noise of variance 3, z = x1 + noise of variance 1."""
    P1 = np.array([[0.25 * 4.0 + 3.0]])
    seen = correct(P1, np.array([2.0]), np.eye(1), np.eye(1))
    back = BackwardRecursion(1)
    back.correction(seen.z, seen.H, seen.K, seen.S_inverse)
    back.step(np.array([[0.5]]))
    errors, cov = back.smoothed(np.array([[4.0]]))
    batch = np.linalg.inv(np.array([[1 / 4 + 0.25 / 3, -0.5 / 3], [-0.5 / 3, 1 / 3 + 1.0]]))
    assert cov[0, 0] == pytest.approx(batch[0, 0], abs=1e-12)
    assert errors[0] == pytest.approx((batch @ [0.0, 2.0])[0], abs=1e-12)


def test_measurements_after_a_parameter_reset_do_not_change_the_parameter_before_it() -> None:
    seen = correct(np.eye(2), np.array([1.0]), np.array([[0.0, 1.0]]), np.eye(1))
    back = BackwardRecursion(2)
    back.correction(seen.z, seen.H, seen.K, seen.S_inverse)
    back.reset_parameter(1)
    errors, cov = back.smoothed(np.eye(2))
    assert not errors.any() and (cov == np.eye(2)).all()


@cache
def drive_of(seed: int, duration_s: float = 80.0) -> Drive:
    white = InjectedError(ErrorKind.WHITE, (3.07, 1.99, 1.56), exact=True)
    return simulate(with_error(scenario_of("parking_lot"), white), seed, duration_s=duration_s)


Times = tuple[float, float]


def history_of(
    drive: Drive,
    *,
    late_ns: int = 0,
    gap_s: Times = (0.0, 0.0),
    imu_gap_s: Times = (0.0, 0.0),
    correlated: bool = True,
) -> Records:
    """History of a drive, with late fixes, a GNSS outage or a gap of the IMU."""
    records = Records()
    settings = Settings(
        merge_delay_s=0.0,
        vehicle=Vehicle(gnss=GnssAntenna(lever_arm_body_m=drive.lever_arm_b)),
        gnss=GnssSettings(time_correlated_errors=correlated),
    )
    navigator = Navigator(settings)
    navigator.record_history(HistoryRecorder(records, PERIOD_NS))
    navigator.use_prior(saved_heading(drive, radians(1.5)))
    times, forces, rates = drive.t_ns.tolist(), drive.force_b.tolist(), drive.rate_b.tolist()
    fix = 0
    for i, time_ns in enumerate(times):
        while fix < len(drive.fix_ns) and drive.fix_ns[fix] + late_ns <= time_ns:
            velocity, place = drive.fix_velocity_n[fix].tolist(), Geodetic(*drive.fix_position[fix].tolist())
            sd, speed_sd = drive.fix_position_sd_n[fix].tolist(), drive.fix_velocity_sd_n[fix].tolist()
            if not gap_s[0] <= drive.fix_ns[fix] * 1e-9 < gap_s[1]:
                navigator.fix(int(drive.fix_ns[fix]), position=place, velocity=velocity, position_sd=sd,
                              velocity_sd=speed_sd, received_ns=time_ns)  # fmt: skip
            fix += 1
        if not imu_gap_s[0] < time_ns * 1e-9 < imu_gap_s[1]:
            navigator.imu(time_ns, forces[i], rates[i])
    navigator.finish()
    return records


def of_filter(records: Records) -> dict[int, ErrorStateFilter]:
    """Give the filter at each knot, with its whole covariance."""
    found = {}
    for record in records.all:
        if isinstance(record, Knot):
            twin = copy(record.filter)
            twin.P = np.zeros((record.filter.size, record.filter.size))
            twin.P[np.ix_(record.known, record.known)] = record.filter.P
            found[record.time_ns] = twin
    return found


def of_smoother(records: Records) -> dict[int, ErrorStateFilter]:
    return {state.inertial.time_ns: state for state in smoothed_filters(records.newest_first())}


def errors(drive: Drive, state: ErrorStateFilter) -> FloatArray:
    """Estimated minus true attitude, velocity and position, shape (9,)."""
    i = round(state.inertial.time_ns / 1e7) - 1
    truth = Geodetic(*drive.position[i].tolist())
    return np.concatenate([
        Rotation.from_matrix(state.ned_from_body @ ned_from_body(*drive.attitude[i]).T).as_rotvec(),
        np.array(state.inertial.velocity) - drive.velocity_n[i],
        np.array(ned_from_geodetic_difference(state.inertial.position, truth)),
    ])  # fmt: skip


@pytest.fixture(scope="module")
def one() -> tuple[Drive, Records]:
    drive = drive_of(3)
    return drive, history_of(drive)


def test_the_smoothed_covariance_is_never_above_that_of_the_filter() -> None:
    """Without estimation of the GNSS error model: later data may increase the estimated size of the errors."""
    records = history_of(drive_of(3), correlated=False)
    before, after = of_filter(records), of_smoother(records)
    assert before.keys() == after.keys() and len(before) > 100
    for time_ns, state in after.items():
        scale = np.sqrt(np.maximum(before[time_ns].P.diagonal(), 1e-30))
        less = (before[time_ns].P - state.P) / np.outer(scale, scale)
        assert np.linalg.eigvalsh(less).min() > -1e-9
        assert np.linalg.eigvalsh(state.P / np.outer(scale, scale)).min() > -1e-9


def test_at_the_last_knot_the_smoothed_state_is_that_of_the_filter(one: tuple[Drive, Records]) -> None:
    records = Records()
    records.all = one[1].all[: max(k for k, record in enumerate(one[1].all) if isinstance(record, Knot)) + 1]
    last = max(of_filter(records))
    before, after = of_filter(records)[last], of_smoother(records)[last]
    assert (before.P == after.P).all() and before.imu == after.imu
    assert after.inertial.velocity == before.inertial.velocity
    assert after.inertial.position == pytest.approx(before.inertial.position, abs=1e-15)


def test_smoothed_gyroscope_biases_vary_by_less_than_a_third_of_their_initial_uncertainty(
    one: tuple[Drive, Records],
) -> None:
    found = of_smoother(one[1])
    course = np.array([found[time_ns].imu.gyroscope_bias for time_ns in sorted(found)])
    at_first = of_filter(one[1])[min(found)]
    assert np.ptp(course, axis=0).max() < 0.3 * np.sqrt(at_first.P.diagonal()[em.GYROSCOPE_BIAS].max())


def test_filtering_is_the_same_with_and_without_a_history() -> None:
    drive = drive_of(1, 60.0)
    states = []
    for store in (Records(), None):
        navigator = Navigator(Settings(vehicle=Vehicle(gnss=GnssAntenna(lever_arm_body_m=drive.lever_arm_b))))
        if store is not None:
            navigator.record_history(HistoryRecorder(store, PERIOD_NS))
        navigator.use_prior(saved_heading(drive, radians(1.5)))
        for i, time_ns in enumerate(drive.t_ns.tolist()):
            if time_ns % 10**9 == 0:
                navigator.fix(time_ns, position=Geodetic(*drive.position[i].tolist()), position_sd=(1.0, 1.0, 1.0))
            navigator.imu(time_ns, drive.force_b[i].tolist(), drive.rate_b[i].tolist())
        states.append(navigator.solution())
    assert states[0] is not None and states[1] is not None
    assert states[0].position == states[1].position and (states[0].position_cov == states[1].position_cov).all()


def test_late_fixes_are_smoothed_as_fixes_in_time() -> None:
    drive = drive_of(2, 60.0)
    none_at_the_end = (59.0, 61.0)  # late ones would not be received
    in_time = of_smoother(history_of(drive, gap_s=none_at_the_end))
    late = of_smoother(history_of(drive, gap_s=none_at_the_end, late_ns=230_000_000))
    both = in_time.keys() & late.keys()
    assert len(both) > 60
    for time_ns in both:
        a, b = in_time[time_ns], late[time_ns]
        assert np.abs(ned_from_geodetic_difference(a.inertial.position, b.inertial.position)).max() < 1e-9
        assert np.abs(a.P - b.P).max() < 1e-12


def test_a_history_with_late_fixes_has_increasing_stamps_and_no_step_twice() -> None:
    records = history_of(drive_of(2, 60.0), late_ns=230_000_000)
    stamps = [record.time_ns for record in records.all]
    assert stamps == sorted(stamps)
    assert sum(isinstance(record, Start) for record in records.all) == 1
    steps = [record for record in records.all if isinstance(record, Step)]
    assert len({record.time_ns for record in steps}) == len(steps)


@cache
def recorded_until(end: int) -> tuple[Navigator, Records]:
    """A navigator with true fixes at 1 Hz until a sample, and its history."""
    drive, records = drive_of(2, 60.0), Records()
    navigator = Navigator(
        Settings(merge_delay_s=0.0, vehicle=Vehicle(gnss=GnssAntenna(lever_arm_body_m=drive.lever_arm_b)))
    )
    navigator.record_history(HistoryRecorder(records, PERIOD_NS))
    navigator.use_prior(saved_heading(drive, radians(1.5)))
    for i in range(end):
        time_ns = int(drive.t_ns[i])
        if time_ns % 10**9 == 0:
            navigator.fix(time_ns, position=Geodetic(*drive.position[i].tolist()), position_sd=(1.0, 1.0, 1.0))
        navigator.imu(time_ns, drive.force_b[i].tolist(), drive.rate_b[i].tolist())
    return navigator, records


@each("begin", range(3000, 3016, 3))
def test_a_roll_back_over_a_gap_records_no_step_twice(begin: int) -> None:
    """The step before a gap is made when it is bridged, and has the stamp of the sample before it."""
    drive, (navigator, records) = drive_of(2, 60.0), deepcopy(recorded_until(2995))
    for i in (*range(2995, begin), *range(begin + 30, begin + 80)):
        time_ns = int(drive.t_ns[i])
        if i == begin + 40:  # late, with a stamp within the gap
            time_ns = int(drive.t_ns[begin + 10])
        if time_ns % 10**9 == 0 or i == begin + 40:
            position = Geodetic(*drive.position[i].tolist())
            navigator.fix(time_ns, position=position, position_sd=(1.0, 1.0, 1.0), received_ns=int(drive.t_ns[i]))
        navigator.imu(int(drive.t_ns[i]), drive.force_b[i].tolist(), drive.rate_b[i].tolist())
    steps = [record.time_ns for record in records.all if isinstance(record, Step)]
    assert len(set(steps)) == len(steps) > 200


RUNS = 8


@pytest.fixture(scope="module")
def drives() -> list[tuple[FloatArray, FloatArray, FloatArray]]:
    """Drives with 10 s without GNSS: errors of filter and smoother at all knots, and the smoother's variances."""
    found = []
    for seed in range(RUNS):
        drive = drive_of(seed + 100)
        records = history_of(drive, gap_s=(45.0, 55.0))
        before, after = of_filter(records), of_smoother(records)
        stamps = sorted(after)
        variances = np.array([after[k].P.diagonal()[:9] for k in stamps])
        of_both = [np.array([errors(drive, states[k]) for k in stamps]) for states in (before, after)]
        found.append((of_both[0], of_both[1], variances))
    return found


@pytest.mark.parametrize("part", [em.ATTITUDE, em.VELOCITY, em.POSITION], ids=["attitude", "velocity", "position"])
def test_smoothed_errors_are_smaller_than_filtered_ones_on_every_drive(
    drives: list[tuple[FloatArray, FloatArray, FloatArray]], part: slice
) -> None:
    ratios = [np.linalg.norm(after[:, part]) / np.linalg.norm(before[:, part]) for before, after, _ in drives]
    assert max(ratios) < 1.0, ratios
    assert np.median(ratios) < 0.7, "0.35, 0.6 and 0.4 were measured"


def test_at_least_98_5_percent_of_smoothed_errors_are_within_three_sigma(
    drives: list[tuple[FloatArray, FloatArray, FloatArray]],
) -> None:
    inside = [np.abs(after) <= 3.0 * np.sqrt(variances) for _, after, variances in drives]
    # The stated accuracy holds for the mean over drives, not in each of them; the filter has the same share.
    assert np.concatenate(inside).mean() > 0.985


def test_smoothed_errors_do_not_depend_on_a_change_of_scale_of_some_states() -> None:
    """Estimates and covariance in the units before the change, to rounding."""
    rng = np.random.default_rng(7)
    root, n, place, ratios = rng.standard_normal((6, 6)), 6, slice(3, 6), np.array([0.3, 0.3, 2.0])
    P = root @ root.T + np.eye(n)
    units = np.ones(n)
    units[place] = ratios
    behind = rescaled(P, place, ratios)
    back = BackwardRecursion(n)
    H = rng.standard_normal((2, n))
    S_inverse: FloatArray = np.asarray(np.linalg.inv(H @ behind @ H.T + np.eye(2)), dtype=np.float64)
    back.correction(np.array([1.0, -2.0]), H, behind @ H.T @ S_inverse, S_inverse)
    errors_behind, cov_behind = back.smoothed(behind)
    back.rescale(place, ratios, P[place])
    errors_before, cov_before = back.smoothed(P)
    assert errors_before == pytest.approx(units * errors_behind, abs=1e-12)
    assert cov_before == pytest.approx(cov_behind * np.outer(units, units), abs=1e-12)


def test_smoothed_errors_are_smaller_than_filtered_ones_after_a_short_gap_of_the_imu() -> None:
    drive = drive_of(3)
    records = history_of(drive, imu_gap_s=(45.0, 45.5))
    before, after = of_filter(records), of_smoother(records)
    assert sum(isinstance(record, Start) for record in records.all) == 1
    stamps = [k for k in sorted(after) if 45.0e9 <= k <= 50.0e9]
    of_both = [np.array([errors(drive, states[k])[em.POSITION] for k in stamps]) for states in (before, after)]
    assert len(stamps) > 8 and np.linalg.norm(of_both[1]) < np.linalg.norm(of_both[0])


def test_a_long_gap_of_the_imu_divides_the_drive_and_each_part_is_smoothed_by_itself() -> None:
    drive = drive_of(3)
    records = history_of(drive, imu_gap_s=(45.0, 47.0))
    before, after = of_filter(records), of_smoother(records)
    starts = [record.time_ns for record in records.all if isinstance(record, Start)]
    assert len(starts) == 2 and starts[1] > 45.0e9
    assert not [k for k in after if 45.2e9 < k < starts[1]], "no state within the gap"
    end = max(k for k in after if k < starts[1])
    variances = [states[end].P[em.POSITION, em.POSITION].diagonal() for states in (before, after)]
    assert (variances[1] > 0.5 * variances[0]).all(), "data after the gap do not change states before it"
    for first in starts:
        assert (after[first].P.diagonal()[:9] < before[first].P.diagonal()[:9]).all()
        error, P = errors(drive, after[first]), after[first].P[:9, :9]
        assert error @ np.linalg.solve(P, error) < chi2.isf(1e-4, 9)


@dataclass
class World:
    """The history of a filter, and the true errors in the middle of an outage."""

    drive: Drive
    records: Records
    middle_ns: int
    accelerometer_bias: FloatArray
    gyroscope_bias: FloatArray


@cache
def noise_free_drive() -> Drive:
    return simulate("parking_lot", seed=7, duration_s=65.0)


def matched(seed: int) -> World:
    """Drive for 40 s with the noise of the filter's model, from a state drawn from its initial covariance."""
    rng, first = np.random.default_rng(seed), 2499
    drive = noise_free_drive()
    settings = Settings().with_values({"imu.vibration_factor": 0.0})
    sd = np.zeros(em.SIZE)
    sd[:15] = np.repeat([0.005, 0.1, 1.0, 0.03, 1e-3], 3)
    attitude = quaternion_from_matrix(ned_from_body(*drive.attitude[first]))
    position, velocity = Geodetic(*drive.position[first].tolist()), drive.velocity_n[first].tolist()
    inertial = InertialState(int(drive.t_ns[first]), attitude, (velocity[0], velocity[1], velocity[2]), position)
    navigation = ErrorStateFilter(settings, inertial, np.diag(sd**2))
    start = np.zeros(em.SIZE)  # GNSS velocities are not used, and their errors not drawn
    start[: LAYOUT.place("gnss_velocity_error").start] = rng.standard_normal(LAYOUT.place("gnss_velocity_error").start)
    start *= sd
    navigation.subtract_errors(start, np.diag(sd**2))
    force_bias, rate_bias = np.zeros(3), np.zeros(3)
    records = Records()
    HistoryRecorder(records, PERIOD_NS).start(navigation)
    noise = np.array([settings.imu.velocity_random_walk_m_s_sqrt_s, settings.imu.angle_random_walk_rad_sqrt_s]) * 10.0
    walk = np.sqrt(
        np.array([settings.imu.accelerometer_bias_psd_m2_s5, settings.imu.gyroscope_bias_psd_rad2_s3]) * 0.01
    )
    sd_of_fix, H = np.array([0.5, 0.5, 1.0]), antenna_position_matrix((0.0, 0.0, 0.0))
    biases = force_bias, rate_bias
    for k in range(1, 4001):
        i = first + k
        force_bias, rate_bias = (
            force_bias + walk[0] * rng.standard_normal(3),
            rate_bias + walk[1] * rng.standard_normal(3),
        )
        fx, fy, fz = (drive.ideal_force_b[i] + force_bias + noise[0] * rng.standard_normal(3)).tolist()
        wx, wy, wz = (drive.ideal_rate_b[i] + rate_bias + noise[1] * rng.standard_normal(3)).tolist()
        one = samples_of([int(drive.t_ns[i])], [[fx, fy, fz, wx, wy, wz]], {})
        navigation.propagate(one, 0, 1, CERTAIN_LIMITS, Intervals(np.inf))
        if k % 5 == 0:
            navigation.propagate_covariance()
        if k == 2000:
            biases = force_bias, rate_bias
        if k % 100 == 0 and not 1500 <= k < 2500:
            place = Geodetic(*drive.position[i].tolist())
            z = np.array(ned_from_geodetic_difference(place, navigation.inertial.position))
            z += sd_of_fix * rng.standard_normal(3)
            navigation.apply(navigation.innovate(z, H, np.diag(sd_of_fix**2)))
    return World(drive, records, int(drive.t_ns[first + 2000]), *biases)


@pytest.mark.slow
def test_normalised_smoothed_errors_squared_lie_in_the_95_percent_band_of_chi_square() -> None:
    """In the middle of an outage, over 50 runs; sums are chi-square with as many degrees as errors a run."""
    runs, parts = 50, {"all": slice(0, 15), "attitude": em.ATTITUDE, "velocity": em.VELOCITY, "position": em.POSITION}
    sizes = dict.fromkeys(parts, 0.0)
    for seed in range(runs):
        world = matched(seed)
        state = of_smoother(world.records)[world.middle_ns]
        e = np.concatenate([
            errors(world.drive, state),
            state.imu.accelerometer_bias - world.accelerometer_bias,
            state.imu.gyroscope_bias - world.gyroscope_bias,
        ])  # fmt: skip
        for name, part in parts.items():
            sizes[name] += float(e[part] @ np.linalg.solve(state.P[part, part], e[part]))
    for name, part in parts.items():
        count = runs * (part.stop - part.start)
        assert chi2.ppf(0.025, count) < sizes[name] < chi2.isf(0.025, count), (name, sizes[name] / count)

"""Monte Carlo of the scenario: false alarms, missed steps and missed ramps of the paper's test and of the bank."""

from dataclasses import dataclass

import numpy as np

from ..measurements import FloatArray
from ..v2x.bank import LeaveOneOutBank, Pseudoranges
from ..v2x.forward import (
    CLOCK,
    DRIFT,
    POSITION,
    BoolArray,
    Estimate,
    ForwardSettings,
    Neighbours,
    correct,
    correct_range_rates,
    correct_road,
    predict,
)
from ..v2x.virtual import prediction_matrix, residual_cov, residual_test, snooping_test
from . import scenario

RATIOS = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1)
# The published table: false alarms, missed steps and missed ramps [%], one column for each ratio.
PUBLISHED_FALSE_ALARM = (2.53, 3.39, 2.92, 1.23, 1.55, 1.61, 3.46, 2.29, 2.29, 7.03)
PUBLISHED_MISSED_STEP = (1.08, 1.10, 0.27, 0.76, 0.61, 0.51, 0.10, 0.09, 0.04, 0.01)
PUBLISHED_MISSED_RAMP = (50.16, 44.97, 45.50, 52.79, 50.05, 48.59, 44.54, 48.10, 46.79, 41.21)
CLOCK_SD = 1.0  # [m] of the calibration of the receiver's clock, constant during a run
DRIFT_SD = 0.03  # [m/s] of the calibration of the receiver's clock drift
START_SD = (1.0, 0.5)  # [m], [m/s] of the first position and velocity


@dataclass(frozen=True)
class Rates:
    """Rates of one setting, in percent."""

    false_alarm: float  # (epoch, run) with a healthy satellite excluded
    missed_step: float  # (epoch with the step, run) with its satellite in use
    missed_ramp: float


def rates_of(excluded: BoolArray, accused_while_healthy: BoolArray) -> Rates:
    """Count exclusions, shape (90, runs, 4), against the faults of the scenario."""
    faulty = scenario.faults() != 0.0
    missed = ~excluded
    return Rates(
        100.0 * float(accused_while_healthy.any(axis=-1).mean()),
        100.0 * float(missed[faulty[:, scenario.STEP], :, scenario.STEP].mean()),
        100.0 * float(missed[faulty[:, scenario.RAMP], :, scenario.RAMP].mean()),
    )


@dataclass(frozen=True)
class Drive:
    """Measurements of all runs: what is drawn once and scaled by the ratio."""

    pseudorange_noise: FloatArray  # [m] shape (90, runs, 4)
    rate_noise: FloatArray  # [-] shape (90, runs, 6)
    neighbour_noise: FloatArray  # [m] shape (90, runs, 6, 3)
    map_noise: FloatArray  # [m, m, m/s] shape (90, runs, 3)
    start: FloatArray  # [-] shape (runs, 6)
    clock: FloatArray  # [m] shape (runs,)


def draw(runs: int, seed: int) -> Drive:
    """Draw the random numbers of a number of runs."""
    rng = np.random.default_rng(seed)
    n, m = len(scenario.SATELLITES), len(scenario.neighbours(0.0)[0])
    return Drive(
        scenario.PSEUDORANGE_SD * rng.standard_normal((scenario.EPOCHS, runs, n)),
        rng.standard_normal((scenario.EPOCHS, runs, m)),
        scenario.NEIGHBOUR_SD * rng.standard_normal((scenario.EPOCHS, runs, m, 3)),
        rng.standard_normal((scenario.EPOCHS, runs, 3)),
        rng.standard_normal((runs, 6)),
        CLOCK_SD * rng.standard_normal(runs),
    )


def forward_settings() -> ForwardSettings:
    """Calibrated oscillators, as the paper assumes: no error of the radio's own, and a receiver clock that is quiet."""
    return ForwardSettings(oscillator_sd=0.0, clock_sd=0.05, clock_drift_sd=0.005)


def start_estimate(drive: Drive) -> Estimate:
    """First estimate of each run: the truth at t = 0 with the errors that were drawn."""
    runs = len(drive.start)
    position, velocity = scenario.vehicle(0.0)
    sd = np.repeat(START_SD, 3)
    x, P = np.zeros((runs, CLOCK + 1)), np.zeros((runs, CLOCK + 1, CLOCK + 1))
    x[:, :6] = np.concatenate([position, velocity]) + sd * drive.start
    P[:, range(6), range(6)] = sd**2
    P[:, CLOCK, CLOCK], P[:, DRIFT, DRIFT] = CLOCK_SD**2, DRIFT_SD**2
    return Estimate(x, P)


@dataclass(frozen=True)
class Reception:
    """What is received of the neighbours."""

    count: int = 6  # of them, the nearest lanes first
    position_sd: float = scenario.NEIGHBOUR_SD  # [m] of their published positions
    latency_s: float = 0.0  # age of a published position and velocity; the frequency is measured on arrival
    penetration: float = 1.0  # probability that a neighbour has a radio, for each run


EVERYTHING = Reception()
NOT_RECEIVED_SD = 1e6  # [m/s] of the range-rate of a neighbour that is not received


def received(drive: Drive, reception: Reception) -> BoolArray:
    """Which neighbours each run receives, shape (runs, 6); a run keeps its own when the penetration grows."""
    m = drive.rate_noise.shape[-1]
    draws = np.random.default_rng(7).random((len(drive.start), m))
    found: BoolArray = (draws < reception.penetration) & (np.arange(m) < reception.count)
    return found


def with_neighbours_and_map(
    estimate: Estimate, drive: Drive, k: int, ratio: float, reception: Reception = EVERYTHING
) -> Estimate:
    """Predict to epoch k (1 to 90) and correct by range-rates and map; leading axes (runs, ...)."""
    settings, t = forward_settings(), float(k)
    estimate = predict(estimate, 1.0, settings)
    position, velocity = scenario.vehicle(t)
    others, velocities = scenario.neighbours(t)
    away, relative = position - others, velocity - velocities
    true_rate = (away * relative).sum(axis=1) / np.linalg.norm(away, axis=1)
    sd = scenario.RATE_SD * ratio
    runs = len(drive.start)
    axes = (runs, *[1] * (estimate.x.ndim - 2))
    m, stated = (
        len(others),
        scenario.neighbours(t - reception.latency_s) if reception.latency_s else (others, velocities),
    )
    noise = reception.position_sd / scenario.NEIGHBOUR_SD * drive.neighbour_noise[k - 1]
    seen = received(drive, reception).reshape(*axes, m)
    reports = Neighbours(
        (stated[0] + noise).reshape(*axes, m, 3),
        stated[1],
        (true_rate + sd * drive.rate_noise[k - 1]).reshape(*axes, m),
        np.full(m, reception.position_sd),
        np.where(seen, sd, NOT_RECEIVED_SD) if reception is not EVERYTHING else np.full(m, sd),
    )
    estimate = correct_range_rates(estimate, reports)
    sds = np.array([settings.cross_track_sd, settings.height_sd, settings.lateral_speed_sd])
    return correct_road(estimate, scenario.road(), settings, (sds * drive.map_noise[k - 1]).reshape(*axes, 3))


def open_loop(
    drive: Drive, ratio: float, false_alarm_rate: float = 1e-5, reception: Reception = EVERYTHING
) -> tuple[Rates, FloatArray]:
    """The paper's test against an estimate from neighbours and map alone, clock calibrated.

    Returns
    -------
    Rates, ndarray, shape (90, runs, 3)
        And the error of the forward estimate [m, NED].
    """
    estimate = start_estimate(drive)
    errors = []
    for k in range(1, scenario.EPOCHS + 1):
        estimate = with_neighbours_and_map(estimate, drive, k, ratio, reception)
        errors.append(estimate.x[:, POSITION] - scenario.vehicle(float(k))[0])
    error = np.array(errors)
    return structure_test(drive, error, np.broadcast_to(drive.clock, error.shape[:2]), false_alarm_rate), error


def snooping(drive: Drive, error: FloatArray) -> Rates:
    """Baarda's iterative test against a forward estimate with given errors [m, NED], shape (90, runs, 3)."""
    q = residuals(drive, error, np.broadcast_to(drive.clock, error.shape[:2]))
    excluded = snooping_test(q, residual_covariance(), 1e-5).excluded
    return rates_of(excluded, excluded & (scenario.faults() == 0.0)[:, np.newaxis])


def structure_test(drive: Drive, error: FloatArray, clock_error: FloatArray, false_alarm_rate: float = 1e-5) -> Rates:
    """The paper's test against a reference with given errors [m, NED], shape (90, runs, 3), and [m], (90, runs)."""
    excluded = residual_test(residuals(drive, error, clock_error), residual_covariance(), false_alarm_rate).excluded
    healthy = (scenario.faults() == 0.0)[:, np.newaxis]
    return rates_of(excluded, excluded & healthy)


def residual_covariance() -> FloatArray:
    """W of the scenario [m²], shape (4, 4)."""
    H_real = scenario.real_rows()
    sd = np.full(len(H_real), scenario.PSEUDORANGE_SD)
    return residual_cov(prediction_matrix(H_real, scenario.virtual_rows()), sd, sd)


def residuals(drive: Drive, error: FloatArray, clock_error: FloatArray) -> FloatArray:
    """Residuals q [m], shape (90, runs, 4), against a reference with given errors, as in `structure_test`."""
    reference = error @ scenario.real_rows()[:, :3].T + clock_error[..., np.newaxis]
    q: FloatArray = scenario.faults()[:, np.newaxis] + drive.pseudorange_noise - reference
    return q


def combined_error(error: FloatArray, q: FloatArray, excluded: BoolArray) -> FloatArray:
    """Position error [m, NED], shape (90, runs, 3), of the paper's least squares over virtual and real pseudoranges.

    Parameters
    ----------
    error : ndarray, shape (90, runs, 3)
        [m, NED] Error of the forward estimate, at which it is linearised: the virtual residuals are zero.
    q : ndarray, shape (90, runs, 4)
        [m] Residuals of the real satellites.
    excluded : ndarray, shape (90, runs, 4)
        Real satellites that are left out.
    """
    H_real, H_virtual = scenario.real_rows(), scenario.virtual_rows()
    used = (~excluded).astype(np.float64)
    normal = H_virtual.T @ H_virtual + np.einsum("...i,ij,ik->...jk", used, H_real, H_real)
    step = np.linalg.solve(normal, ((used * q) @ H_real)[..., np.newaxis])[..., 0]
    found: FloatArray = error + step[..., :3]
    return found


def plain_error(drive: Drive) -> FloatArray:
    """Position error [m, NED], shape (90, runs, 3), of least squares over the four real satellites alone.

    Four satellites have no redundancy: nothing can be tested.
    """
    measured = scenario.faults()[:, np.newaxis] + drive.pseudorange_noise
    found: FloatArray = (measured @ np.linalg.inv(scenario.real_rows()).T)[..., :3]
    return found


def closed_loop(drive: Drive, ratio: float, variance_factor: float = 1.0) -> tuple[Rates, FloatArray]:
    """The paper's test against an estimate that the satellites under test correct: a slow ramp is absorbed.

    Parameters
    ----------
    drive : Drive
        Measurements.
    ratio : float
        [-] Of the range-rate deviation.
    variance_factor : float
        [-] On the pseudorange variance in the filter; 100 keeps the estimate nearly independent.

    Returns
    -------
    Rates, ndarray, shape (90, runs, 3)
        And the error of the estimate before the satellites' correction [m, NED].
    """
    H, estimate = scenario.real_rows(), start_estimate(drive)
    n, runs = len(H), len(drive.start)
    sd, W = np.full(n, scenario.PSEUDORANGE_SD), residual_covariance()
    visible = np.ones(n, dtype=np.bool_)
    excluded, errors = [], []
    for k in range(1, scenario.EPOCHS + 1):
        estimate = with_neighbours_and_map(estimate, drive, k, ratio)
        position = scenario.vehicle(float(k))[0]
        y = H[:, :3] @ position + scenario.faults()[k - 1] + drive.pseudorange_noise[k - 1]
        rows = Pseudoranges(-H[:, :3], (0,) * n, y, sd, np.zeros(n), visible).rows(CLOCK + 1)
        q = y - estimate.x @ rows.T
        test = residual_test(q, W, 1e-5)
        excluded.append(test.excluded)
        errors.append(estimate.x[:, POSITION] - position)
        estimate = correct(
            estimate, np.broadcast_to(rows, (runs, *rows.shape)), q, variance_factor * sd**2, ~test.excluded
        )
    found = np.array(excluded)
    return rates_of(found, found & (scenario.faults() == 0.0)[:, np.newaxis]), np.array(errors)


def leave_one_out(drive: Drive, ratio: float) -> tuple[Rates, FloatArray]:
    """The leave-one-out bank on the same measurements; a satellite that waits for re-admission is no false alarm.

    Returns
    -------
    Rates, ndarray, shape (90, runs, 3)
        And the error of the estimate from the satellites in use [m, NED].
    """
    H = scenario.real_rows()
    n, runs = len(H), len(drive.start)
    bank = LeaveOneOutBank(start_estimate(drive), n)
    excluded, false, errors = [], [], []
    accused_while_healthy = np.zeros((runs, n), dtype=np.bool_)
    sd, correlated, visible = np.full(n, scenario.PSEUDORANGE_SD), np.zeros(n), np.ones(n, dtype=np.bool_)
    for k in range(1, scenario.EPOCHS + 1):
        fault = scenario.faults()[k - 1]
        predicted = with_neighbours_and_map(bank.estimate, drive, k, ratio)
        position = scenario.vehicle(float(k))[0]
        y = H[:, :3] @ position + fault + drive.pseudorange_noise[k - 1]
        test = bank.advance(predicted, Pseudoranges(-H[:, :3], (0,) * n, y, sd, correlated, visible))
        accused_while_healthy = (accused_while_healthy | test.newly_excluded & (fault == 0.0)) & test.excluded
        excluded.append(test.excluded)
        false.append(accused_while_healthy & (fault == 0.0))
        errors.append(bank.fault_free.x[:, POSITION] - position)
    return rates_of(np.array(excluded), np.array(false)), np.array(errors)


def horizontal_rms(error: FloatArray) -> FloatArray:
    """Horizontal root mean square [m] over the runs of errors, shape (90, runs, 3)."""
    rms: FloatArray = np.sqrt((error[..., :2] ** 2).sum(axis=-1).mean(axis=-1))
    return rms


def phase_rms(error: FloatArray) -> dict[str, float]:
    """Horizontal root mean square [m] in each of `scenario.PHASES` of errors, shape (90, runs, 3)."""
    squares = horizontal_rms(error) ** 2
    return {name: float(np.sqrt(squares[epochs].mean())) for name, epochs in scenario.PHASES.items()}


@dataclass(frozen=True)
class Row:
    """One column of the published table beside ours, and horizontal position errors [m] by method and phase."""

    ratio: float
    published: Rates
    open_loop: Rates
    snooping: Rates  # Baarda's test, open loop
    closed_loop: Rates
    leave_one_out: Rates
    position_m: dict[str, dict[str, float]]


def row(index: int, runs: int = 500, seed: int = 1) -> Row:
    """Compute one ratio of the table; all ratios use the same random numbers, so that rows may be made in parallel."""
    drive, ratio = draw(runs, seed), RATIOS[index]
    published = Rates(PUBLISHED_FALSE_ALARM[index], PUBLISHED_MISSED_STEP[index], PUBLISHED_MISSED_RAMP[index])
    opened, forward = open_loop(drive, ratio)
    q = residuals(drive, forward, np.broadcast_to(drive.clock, forward.shape[:2]))
    excluded = residual_test(q, residual_covariance(), 1e-5).excluded
    bank, fault_free = leave_one_out(drive, ratio)
    errors = {
        "four satellites alone": plain_error(drive),
        "neighbours and map alone": forward,
        "paper, without exclusion": combined_error(forward, q, np.zeros_like(excluded)),
        "paper, with exclusion": combined_error(forward, q, excluded),
        "leave-one-out bank": fault_free,
    }
    position = {name: phase_rms(error) for name, error in errors.items()}
    return Row(ratio, published, opened, snooping(drive, forward), closed_loop(drive, ratio)[0], bank, position)

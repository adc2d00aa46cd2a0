"""The leave-one-out bank on a vehicle at rest with eight satellites: false alarms, ramps, steps, re-admission."""

import numpy as np
import pytest
from scipy.stats import binom

from services.core.cooperative.paper.scenario import real_rows, virtual_rows
from services.core.cooperative.v2x.bank import BankSettings, BankTest, LeaveOneOutBank, Pseudoranges
from services.core.cooperative.v2x.forward import CLOCK, DRIFT, OSCILLATOR, Estimate, ForwardSettings, predict

ROWS = np.vstack([real_rows(), virtual_rows()])
N = len(ROWS)
FORWARD = ForwardSettings(acceleration_sd=0.05, vertical_acceleration_sd=0.05, clock_sd=0.1, clock_drift_sd=0.01)
VISIBLE = np.ones(N, dtype=np.bool_)


def start(runs: int) -> Estimate:
    x, P = np.zeros((runs, CLOCK + 1)), np.zeros((runs, CLOCK + 1, CLOCK + 1))
    P[:, range(3), range(3)], P[:, range(3, 6), range(3, 6)] = 4.0, 0.01
    P[:, CLOCK, CLOCK], P[:, DRIFT, DRIFT], P[:, OSCILLATOR, OSCILLATOR] = 4.0, 0.01, 0.0
    return Estimate(x, P)


def drive(faults: np.ndarray, runs: int, settings: BankSettings, seed: int) -> tuple[LeaveOneOutBank, list[BankTest]]:
    """A vehicle that drifts about the origin as the filters expect it; `faults` [m], shape (epochs, N)."""
    rng = np.random.default_rng(seed)
    bank, tests = LeaveOneOutBank(start(runs), N, settings), []
    size = CLOCK + 1
    Q = predict(Estimate(np.zeros(size), np.zeros((size, size))), 1.0, FORWARD).P
    step = np.linalg.cholesky(Q + 1e-15 * np.eye(size))
    truth = rng.standard_normal((runs, size)) * np.sqrt(np.diagonal(start(runs).P, axis1=1, axis2=2))
    for fault in faults:
        predicted = predict(bank.estimate, 1.0, FORWARD)
        truth = predict(Estimate(truth, np.zeros((size, size))), 1.0, FORWARD).x
        truth += rng.standard_normal((runs, size)) @ step.T
        y = truth[:, :3] @ ROWS[:, :3].T + truth[:, CLOCK, np.newaxis] + fault + 3.0 * rng.standard_normal((runs, N))
        ranges = Pseudoranges(-ROWS[:, :3], (0,) * N, y, np.full(N, 3.0), np.zeros(N), VISIBLE)
        tests.append(bank.advance(predicted, ranges))
    return bank, tests


@pytest.mark.slow
@pytest.mark.parametrize("rate", [1e-2, 1e-3])
def test_false_alarms_begin_at_the_design_rate(rate: float) -> None:
    """100,000 epochs; windows overlap, so that alarms are counted as episodes."""
    runs, epochs = 2000, 50
    _, tests = drive(np.zeros((epochs, N)), runs, BankSettings(false_alarm_rate=rate), 1)
    episodes = sum(int(test.newly_excluded.any(axis=-1).sum()) for test in tests)
    assert binom.ppf(0.001, runs * epochs, rate) <= episodes <= binom.ppf(0.999, runs * epochs, rate)


def test_single_innovations_are_standard_normal() -> None:
    _, tests = drive(np.zeros((30, N)), 500, BankSettings(false_alarm_rate=1e-9), 2)
    squares = np.array([test.single**2 for test in tests[10:]])
    assert squares.mean() == pytest.approx(1.0, abs=0.02)


def test_a_ramp_of_1_m_s_is_not_absorbed() -> None:
    faults = np.zeros((70, N))
    faults[20:, 0] = np.arange(1.0, 51.0)
    _, tests = drive(faults, 200, BankSettings(), 3)
    excluded = np.array([test.excluded for test in tests])
    assert excluded[45:, :, 0].mean() > 0.99, "25 m are excluded"
    assert excluded[:, :, 1:].mean() < 0.002


def test_a_step_is_excluded_at_once_and_readmitted_eight_epochs_after_its_end() -> None:
    faults = np.zeros((60, N))
    faults[20:30, 3] = 50.0
    _, tests = drive(faults, 100, BankSettings(), 4)
    excluded = np.array([test.excluded[:, 3] for test in tests])
    assert excluded[20:30].mean() > 0.99 and excluded[:20].mean() < 0.01
    assert excluded[30:37].all(), "not before eight healthy epochs"
    assert excluded[-5:].mean() < 0.05


def test_a_filter_never_uses_its_own_satellite() -> None:
    faults = np.zeros((1, N))
    (clean, _), (faulty, _) = (drive(item, 1, BankSettings(), 5) for item in (faults, faults + 14.0 * np.eye(N)[2]))
    assert (clean.estimate.x[0, 2] == faulty.estimate.x[0, 2]).all()
    assert (clean.estimate.x[0, 3] != faulty.estimate.x[0, 3]).any()


def test_new_satellites_start_from_the_filter_that_has_not_seen_them() -> None:
    bank, _ = drive(np.zeros((5, N)), 1, BankSettings(), 6)
    before = bank.estimate
    bank.rearrange([4, None, 0])
    assert bank.satellites == 3
    for row, source in enumerate((4, N, 0, N)):
        assert (bank.estimate.x[0, row] == before.x[0, source]).all()
    bank.rearrange([])
    assert bank.satellites == 0 and (bank.fault_free.x[0] == before.x[0, N]).all()


def test_what_is_not_visible_is_neither_tested_nor_used() -> None:
    bank = LeaveOneOutBank(start(1), N)
    y = np.zeros((1, N))
    y[0, 1] = 1e6
    seen = VISIBLE.copy()
    seen[1] = False
    test = bank.advance(bank.estimate, Pseudoranges(-ROWS[:, :3], (0,) * N, y, np.full(N, 3.0), np.zeros(N), seen))
    assert test.t[0, 1] == 0.0 and not test.excluded.any() and np.abs(bank.estimate.x).max() < 1.0


def test_errors_that_are_correlated_in_time_are_no_fault() -> None:
    """A constant 4 m of the atmosphere, declared as such, does not alarm; declared as white noise it does."""
    rng = np.random.default_rng(7)
    offsets = 4.0 * rng.standard_normal((200, N))
    found = []
    for white, correlated in ((1.0, 4.0), (np.sqrt(17.0), 0.0)):
        bank = LeaveOneOutBank(start(200), N, BankSettings(false_alarm_rate=1e-4))
        for _ in range(30):
            y = offsets + rng.standard_normal((200, N))
            ranges = Pseudoranges(-ROWS[:, :3], (0,) * N, y, np.full(N, white), np.full(N, correlated), VISIBLE)
            test = bank.advance(predict(bank.estimate, 1.0, FORWARD), ranges)
        found.append(float(test.excluded.any(axis=-1).mean()))
    assert found[0] < 0.01 < found[1]


def test_means_of_innovations_are_less_than_standard_normal_by_what_the_filter_shares() -> None:
    """Measurement noise averages out over m innovations, R/m, the error of the prediction does not."""
    _, tests = drive(np.zeros((40, N)), 500, BankSettings(false_alarm_rate=1e-9), 2)
    squares = np.array([test.mean**2 for test in tests[20:]])
    assert 0.3 < squares.mean() < 1.05

"""The Monte Carlo of the scenario against the reference numbers, with fewer runs than the published table has."""

import numpy as np
import pytest

from services.core.cooperative.paper import scenario
from services.core.cooperative.paper.monte_carlo import (
    closed_loop,
    combined_error,
    draw,
    horizontal_rms,
    leave_one_out,
    open_loop,
    plain_error,
    row,
    structure_test,
)

RUNS = 120
DRIVE = draw(RUNS, 3)
POINTS = 1.5  # [%] tolerance of the reference for the ramp
SAMPLING = 1.0  # [%] what 120 runs instead of 500 add
EPOCHS = 0.1  # [%] ten of 10,800 epochs, which rounding may turn


def test_the_drive_is_1027_m_long() -> None:
    assert scenario.distance(90.0) == pytest.approx(1027.0, abs=0.5)
    assert scenario.speed(0.0) == 5.0 and scenario.speed(46.0) == 8.0


def test_velocities_are_the_derivatives_of_positions() -> None:
    for t in (4.0, 20.0, 40.0, 47.0, 70.0, 85.0):
        (before, _), (after, _), (_, velocity) = (scenario.vehicle(t + dt) for dt in (-0.01, 0.01, 0.0))
        assert (after - before) / 0.02 == pytest.approx(velocity, abs=2e-3)
    (before, _), (after, _), (_, velocities) = (scenario.neighbours(20.0 + dt) for dt in (-0.01, 0.01, 0.0))
    assert (after - before) / 0.02 == pytest.approx(velocities, abs=2e-3)


def test_the_vehicle_is_on_the_centre_line() -> None:
    points = np.array([scenario.vehicle(t)[0] for t in np.arange(0.0, 90.0, 0.7)])
    assert scenario.road().foot(points).distance.max() < 0.05


def test_against_a_perfect_reference_the_structure_test_is_the_reference() -> None:
    runs = draw(500, 1)
    found = structure_test(runs, np.zeros((90, 500, 3)), np.zeros((90, 500)))
    assert found.missed_ramp == pytest.approx(45.9, abs=1.0)
    assert found.missed_step < 0.1 and found.false_alarm < 0.05


@pytest.mark.parametrize(("rate", "missed"), [(1e-3, 35.1), (1e-5, 44.8), (1e-7, 53.4)], ids=["1e-3", "1e-5", "1e-7"])
def test_missed_ramps_depend_on_the_design_rate_as_in_the_reference(rate: float, missed: float) -> None:
    found, _ = open_loop(DRIVE, 0.5, rate)
    assert found.missed_ramp == pytest.approx(missed, abs=POINTS + SAMPLING)


@pytest.mark.parametrize(
    ("ratio", "rates", "ramp"),
    [(1.0, (4.59, 2.78, 44.43), 42.6), (0.7, (0.40, 1.17, 43.42), 43.1), (0.5, (0.03, 0.28, 44.46), 44.3),
     (0.1, (0.0, 0.0, 45.99), 45.0)]
)  # fmt: skip
def test_the_open_loop_has_its_rates_and_the_ramp_of_the_reference(
    ratio: float, rates: tuple[float, float, float], ramp: float
) -> None:
    """The rates of these 120 runs, to some epochs; the reference's false alarms and steps at 1.0 are 3.2 and 1.8 %."""
    found, _ = open_loop(DRIVE, ratio)
    assert (found.false_alarm, found.missed_step, found.missed_ramp) == pytest.approx(rates, abs=EPOCHS)
    assert found.missed_ramp == pytest.approx(ramp, abs=POINTS + SAMPLING)
    if ratio == 0.5:
        assert found.false_alarm < 1.0 and found.missed_step < 0.5 and found.missed_ramp < 50.0


@pytest.mark.parametrize(("ratio", "ramp"), [(1.0, 22.0), (0.5, 21.5), (0.1, 16.8)])
def test_the_bank_sees_the_ramp_twice_as_early(ratio: float, ramp: float) -> None:
    """Where the reference gives no tolerance, a quarter of the number is allowed; the stretch goals hold at 1.0."""
    found, error = leave_one_out(DRIVE, ratio)
    assert found.missed_ramp == pytest.approx(ramp, rel=0.25)
    assert found.false_alarm < 1.0 and found.missed_step < 0.5
    if ratio == 1.0:
        assert found.missed_ramp <= 25.0 and found.false_alarm <= 0.3
    assert np.sqrt((horizontal_rms(error)[50:80] ** 2).mean()) < 5.5


@pytest.mark.parametrize("ratio", [1.0, 0.1])
def test_a_closed_loop_absorbs_the_ramp(ratio: float) -> None:
    """Reference: 99.96 and 98.6 % missed, 36 and 14 m horizontal RMS from 51 to 80 s; the latter is not reproduced."""
    found, error = closed_loop(DRIVE, ratio)
    assert found.missed_ramp > 97.0 and found.missed_step < 0.5
    assert np.sqrt((horizontal_rms(error)[50:80] ** 2).mean()) == pytest.approx(
        {1.0: 37.31, 0.1: 18.61}[ratio], rel=0.01
    )


def test_a_row_holds_one_ratio_of_all_methods() -> None:
    found = row(5, runs=20)
    assert found.ratio == 0.5 and found.published.missed_ramp == 48.59
    assert found.leave_one_out.missed_ramp < found.open_loop.missed_ramp < found.closed_loop.missed_ramp


def test_exclusion_keeps_the_position_error_of_a_step_small() -> None:
    """A step of 50 m on one of four satellites: without redundancy it is in the position."""
    position = row(5, runs=60).position_m
    assert position["four satellites alone"]["51-80 s"] > 50.0
    assert position["paper, with exclusion"]["51-80 s"] < position["paper, without exclusion"]["51-80 s"]
    assert position["paper, with exclusion"]["81-90 s"] < 0.4 * position["paper, without exclusion"]["81-90 s"]
    assert position["leave-one-out bank"]["51-80 s"] < position["paper, with exclusion"]["51-80 s"]
    assert position["paper, with exclusion"]["1-30 s"] == pytest.approx(
        position["paper, without exclusion"]["1-30 s"], rel=0.02
    )


def test_the_combined_position_is_the_least_squares_of_all_eight_pseudoranges() -> None:
    rng = np.random.default_rng(4)
    H = np.vstack([scenario.virtual_rows(), scenario.real_rows()])
    error, q = rng.normal(size=(1, 1, 3)), rng.normal(size=(1, 1, 4))
    step = np.linalg.lstsq(H, np.r_[np.zeros(4), q[0, 0]], rcond=None)[0]
    found = combined_error(error, q, np.zeros((1, 1, 4), dtype=np.bool_))
    assert found[0, 0] == pytest.approx(error[0, 0] + step[:3], abs=1e-12)


def test_plain_positions_have_the_error_of_the_geometry() -> None:
    expected = scenario.PSEUDORANGE_SD * np.sqrt(np.diag(np.linalg.inv(scenario.real_rows().T @ scenario.real_rows())))
    assert plain_error(draw(500, 5))[:30].std(axis=(0, 1)) == pytest.approx(expected[:3], rel=0.03)

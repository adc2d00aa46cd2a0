"""One run of the cooperative scenario over time, and sweeps of what is received of the neighbours."""

import numpy as np
import pytest

from cli.papers.cooperative_over_time import (
    SWEEPS,
    OneRun,
    one_run,
    over_time_document,
    over_time_figures,
    sweep_point,
    sweep_table,
)
from services.core.cooperative.paper import scenario
from services.core.cooperative.paper.monte_carlo import Reception, draw, open_loop, received


@pytest.fixture(scope="module")
def run() -> OneRun:
    return one_run(1)


def test_one_run_over_time_has_its_faults_where_the_scenario_has_them(run: OneRun) -> None:
    assert run.residual_m.shape == run.excluded.shape == (scenario.EPOCHS, 4)
    step = slice(scenario.STEP_FROM - 1, scenario.STEP_TO)
    assert run.residual_m[step, scenario.STEP].mean() == pytest.approx(scenario.STEP_M, abs=10.0)
    assert abs(run.residual_m[:30, scenario.STEP].mean()) < 10.0
    assert run.excluded[step, scenario.STEP].mean() > 0.9
    assert run.residual_m[-1, scenario.RAMP] > 40.0, "1 m/s for a minute"
    assert run.excluded[-5:, scenario.RAMP].all() and not run.excluded[:30, scenario.RAMP].any()
    alone, paper = run.position_m["four satellites alone"], run.position_m["paper, with exclusion"]
    assert paper[step].mean() < 0.5 * alone[step].mean()


def test_all_neighbours_at_once_are_those_of_the_table() -> None:
    drive = draw(5, 1)
    plain, error = open_loop(drive, 0.5)
    same, again = open_loop(drive, 0.5, reception=Reception(latency_s=0.0, penetration=1.0))
    assert plain == same and np.array_equal(error, again)


def test_fewer_neighbours_and_late_ones_are_worse() -> None:
    few, all_six = (sweep_point("neighbours", Reception(count=count), 20, 1) for count in (2, 6))
    assert few.forward_m > all_six.forward_m and few.rates.false_alarm > all_six.rates.false_alarm
    late = sweep_point("latency [s]", Reception(latency_s=3.0), 20, 1)
    assert late.forward_m > all_six.forward_m and (late.sweep, late.value) == ("latency [s]", 3.0)


def test_a_higher_penetration_keeps_the_neighbours_of_a_lower_one() -> None:
    drive = draw(200, 1)
    some, more = (received(drive, Reception(penetration=share)) for share in (0.3, 0.7))
    assert not (some & ~more).any()
    assert some.mean() == pytest.approx(0.3, abs=0.05) and more.mean() == pytest.approx(0.7, abs=0.05)
    assert not received(drive, Reception(count=2))[:, 2:].any()


def test_figures_table_and_document_hold_every_point(run: OneRun) -> None:
    points = [sweep_point(sweep, one, 2, 1) for sweep, receptions in SWEEPS.items() for one in receptions[:2]]
    document = over_time_document(run, points)
    sweeps = document["sweeps"]
    assert isinstance(sweeps, list) and len(sweeps) == len(points) == len(sweep_table(points).rows)
    assert len(over_time_figures(run, points)) == 2

"""V2X-assisted fault detection over the time of one run, and by what is received of the neighbours."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from services.core.cooperative.measurements import FloatArray
from services.core.cooperative.paper import scenario
from services.core.cooperative.paper.monte_carlo import (
    Drive,
    Rates,
    Reception,
    combined_error,
    draw,
    leave_one_out,
    open_loop,
    phase_rms,
    plain_error,
    residual_covariance,
    residuals,
)
from services.core.cooperative.v2x.virtual import residual_test

from .report import Figure, Table, figure

RATIO = 0.5
SWEEPS = {
    "neighbours": tuple(Reception(count=count) for count in (0, 1, 2, 3, 4, 5, 6)),
    "position error [m]": tuple(Reception(position_sd=sd) for sd in (0.5, 1.0, 3.0, 10.0, 30.0)),
    "latency [s]": tuple(Reception(latency_s=late) for late in (0.0, 0.1, 0.3, 1.0, 3.0)),
    "penetration": tuple(Reception(penetration=share) for share in (0.2, 0.4, 0.6, 0.8, 1.0)),
}
VALUES: dict[str, Callable[[Reception], float]] = {
    "neighbours": lambda one: float(one.count), "position error [m]": lambda one: one.position_sd,
    "latency [s]": lambda one: one.latency_s, "penetration": lambda one: one.penetration,
}  # fmt: skip


@dataclass(frozen=True)
class SweepPoint:
    """Rates of the paper's test in open loop, and the error of neighbours and map alone."""

    sweep: str
    value: float
    rates: Rates
    forward_m: float  # horizontal root mean square, worst phase


@dataclass(frozen=True)
class OneRun:
    """What one run is made of, over 90 epochs."""

    residual_m: FloatArray  # shape (90, 4) of each real satellite against the forward estimate
    excluded: FloatArray  # shape (90, 4) share
    position_m: dict[str, FloatArray]  # horizontal error by method, shape (90,)
    forward_ned_m: FloatArray  # shape (90, 3)


def sweep_point(sweep: str, reception: Reception, runs: int, seed: int) -> SweepPoint:
    """Run the paper's test with another reception of neighbours."""
    rates, error = open_loop(draw(runs, seed), RATIO, reception=reception)
    return SweepPoint(sweep, VALUES[sweep](reception), rates, max(phase_rms(error).values()))


def one_run(seed: int) -> OneRun:
    """One run at a ratio of 0.5: the first of those of the table."""
    drive = draw(1, seed)
    _, forward = open_loop(drive, RATIO)
    q = residuals(drive, forward, np.broadcast_to(drive.clock, forward.shape[:2]))
    excluded = residual_test(q, residual_covariance(), 1e-5).excluded
    errors = {
        "four satellites alone": plain_error(drive),
        "paper, with exclusion": combined_error(forward, q, excluded),
        "leave-one-out bank": _bank(drive),
        "neighbours and map alone": forward,
    }
    position = {name: np.hypot(error[:, 0, 0], error[:, 0, 1]) for name, error in errors.items()}
    return OneRun(q[:, 0], excluded[:, 0].astype(np.float64), position, forward[:, 0])


def _bank(drive: Drive) -> FloatArray:
    return leave_one_out(drive, RATIO)[1]


def sweep_table(points: list[SweepPoint]) -> Table:
    """Rates by what is received."""
    rows = [
        (f"{point.sweep}: {point.value:g}", f"{point.rates.false_alarm:.2f}", f"{point.rates.missed_step:.2f}",
         f"{point.rates.missed_ramp:.1f}", f"{point.forward_m:.1f}")
        for point in points
    ]  # fmt: skip
    columns = ("ratio 0.5, open loop", "false [%]", "step [%]", "ramp [%]", "forward [m]")
    return Table("By what is received of the neighbours; six of them, 1 m, no latency, all equipped", columns, rows)


def over_time_document(run: OneRun, points: list[SweepPoint]) -> dict[str, object]:
    """Numbers of the one run and of the sweeps."""
    return {
        "one_run": {
            "horizontal_error_m": {name: float(np.sqrt(np.mean(error**2))) for name, error in run.position_m.items()},
            "excluded_epochs": {
                name: int(run.excluded[:, k].sum()) for k, name in enumerate(scenario.SATELLITES)
            },
            "faulty_epochs": {
                name: int((scenario.faults()[:, k] != 0.0).sum()) for k, name in enumerate(scenario.SATELLITES)
            },
        },
        "sweeps": [
            {
                "sweep": point.sweep, "value": point.value, "false_alarm_percent": point.rates.false_alarm,
                "missed_step_percent": point.rates.missed_step, "missed_ramp_percent": point.rates.missed_ramp,
                "forward_error_m": point.forward_m,
            }
            for point in points
        ],
    }  # fmt: skip


def over_time_figures(run: OneRun, points: list[SweepPoint]) -> list[Figure]:
    """Draw the run over time, and the sweeps."""
    drawn: list[Figure] = []
    time_s = np.arange(1, scenario.EPOCHS + 1)
    with figure("One run over time", drawn.append, columns=4) as panels:
        for k, name in enumerate(scenario.SATELLITES):
            panels[0].plot(time_s, run.residual_m[:, k], label=name)
            panels[1].plot(time_s, run.excluded[:, k] + 0.05 * k, label=name)
        for axis, component in zip(("north", "east", "down"), run.forward_ned_m.T, strict=True):
            panels[2].plot(time_s, component, label=axis)
        for name, error in run.position_m.items():
            panels[3].semilogy(time_s, error, label=name)
        titles = "residual of a satellite [m]", "excluded", "error of neighbours and map [m]", "horizontal error [m]"
        for axes, title in zip(panels, titles, strict=True):
            axes.set(xlabel="time [s]", title=title)
            axes.legend(fontsize="x-small")
    with figure("By what is received of the neighbours", drawn.append, columns=len(SWEEPS)) as panels:
        for axes, sweep in zip(panels, SWEEPS, strict=True):
            chosen = [point for point in points if point.sweep == sweep]
            values = [point.value for point in chosen]
            axes.plot(values, [point.rates.false_alarm for point in chosen], marker=".", label="false alarms")
            axes.plot(values, [point.rates.missed_step for point in chosen], marker=".", label="missed step")
            axes.plot(values, [point.rates.missed_ramp for point in chosen], marker=".", label="missed ramp")
            axes.set(xlabel=sweep, ylabel="[%]")
        panels[0].legend(fontsize="small")
    return drawn

"""Horizontal position error after GNSS outages in the simulated car park of the OBU paper."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from services.core.fusion.navigator import Navigator
from services.sensors.simulator.drive import simulate
from services.sensors.simulator.gnss.gnss_errors import ErrorKind, InjectedError
from services.sensors.simulator.scenarios import scenario_of, with_error

from .navigation import YAW_SD, in_parallel, navigate, position_errors, saved_heading, settings_for

FloatArray = npt.NDArray[np.float64]

LENGTHS_S = (10, 30, 60)
STARTS_S = (90, 160)  # start of the outage, alternating between runs
GNSS = InjectedError(ErrorKind.WHITE, (1.0, 1.0, 1.0), exact=True)
FIRST_SEED = 20_000
GOALS_M = (0.35, 0.35, 0.5)  # median errors with NHC and odometer


@dataclass(frozen=True)
class Aids:
    """Aiding during the outage: a row of the table."""

    name: str
    zero_velocity: bool = False
    wheels: bool = False


AIDS = (Aids("inertial alone"), Aids("standstill", True), Aids("standstill, wheels", True, True))


@dataclass(frozen=True)
class Outages:
    """Horizontal errors [m] of a row, shape (runs, lengths), after each of `LENGTHS_S`."""

    aids: Aids
    errors: FloatArray

    @property
    def median(self) -> list[float]:
        """Medians [m]."""
        found: list[float] = np.median(self.errors, axis=0).tolist()
        return found

    @property
    def p95(self) -> list[float]:
        """95th percentiles [m]."""
        found: list[float] = np.percentile(self.errors, 95.0, axis=0).tolist()
        return found


def measure(job: tuple[Aids, int]) -> tuple[str, list[float]]:
    """Horizontal errors [m] after each of `LENGTHS_S` in one outage of the longest duration."""
    aids, run = job
    start_s = STARTS_S[run % len(STARTS_S)]
    scenario = with_error(scenario_of("parking_lot"), GNSS)
    drive = simulate(scenario, FIRST_SEED + run, duration_s=start_s + LENGTHS_S[-1] + 1.0)
    drive.fix_valid[drive.fix_ns > start_s * 1e9] = False
    settings = settings_for(drive, wheels=aids.wheels)
    switches = {"standstill.enabled": aids.zero_velocity, "non_holonomic.enabled": aids.wheels}
    navigator = Navigator(settings.with_values(switches))
    navigator.use_prior(saved_heading(drive, YAW_SD))
    track = navigate(drive, navigator, wheels=aids.wheels)
    errors, times_s = position_errors(drive, track), drive.t_ns[track.index] * 1e-9
    ends = [int(np.argmin(np.abs(times_s - start_s - length))) for length in LENGTHS_S]
    return aids.name, np.hypot(errors[ends, 0], errors[ends, 1]).tolist()


def measure_all(rows: Sequence[Aids], runs: int, workers: int, progress: bool) -> list[Outages]:
    """Run every row with the same drives, in parallel."""
    collected: dict[str, list[list[float]]] = {aids.name: [] for aids in rows}
    for name, errors in in_parallel(measure, [(aids, run) for aids in rows for run in range(runs)], workers, progress):
        collected[name].append(errors)
    return [Outages(aids, np.array(collected[aids.name])) for aids in rows]


def shortcomings(rows: Sequence[Outages]) -> list[str]:
    """Limits with NHC and odometer that were exceeded; empty if none."""
    return [
        f"after {length} s without GNSS the median position error is {median:.2f} m, above {goal} m"
        for row in rows
        if row.aids.wheels
        for length, median, goal in zip(LENGTHS_S, row.median, GOALS_M, strict=True)
        if median > goal
    ]


def document(rows: Sequence[Outages]) -> list[dict[str, object]]:
    """Rows of the table for JSON."""
    return [{"aids": row.aids.name, "length_s": LENGTHS_S, "median_m": row.median, "p95_m": row.p95} for row in rows]


def print_table(rows: Sequence[Outages], runs: int, console: Console) -> None:
    """Print median and 95th percentile of the errors after each outage length."""
    each = f"{runs} simulated run{'s' if runs > 1 else ''} per row"
    title = f"Horizontal error in metres at the end of an outage, median and 95th percentile; {each}"
    table = Table(title=title, box=SIMPLE_HEAD)
    table.add_column("")
    for length in LENGTHS_S:
        table.add_column(f"{length} s", justify="right", overflow="fold")
    for row in rows:
        table.add_row(row.aids.name, *(f"{m:.2f} {p:.2f}" for m, p in zip(row.median, row.p95, strict=True)))
    console.print(table)

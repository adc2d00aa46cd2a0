"""`obu papers navigation`: the five degraded drives of the OBU paper, simulated, beside what it printed.

The simulated error is scaled to exactly the paper's GNSS error, axis by axis, but its correlation time of 5 s was
chosen so that the ratio fits; agreement is therefore no independent evidence. It shows that the filter does what a
correct filter does with such data.
"""

import json as json_module
import multiprocessing
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from math import radians

import numpy as np
import numpy.typing as npt
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import track
from rich.table import Table

from services.core.fusion.heading import Prior
from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import Settings
from services.sensors.simulator.drive import Drive, simulate
from services.sensors.simulator.gnss_errors import ErrorKind, InjectedError
from services.sensors.simulator.scenarios import DEGRADED_RMSE, scenario_of, with_error
from shared.errors import UserError
from shared.maths.earth import Geodetic, ned_track

FloatArray = npt.NDArray[np.float64]
Vector = tuple[float, float, float]

# RMSE [m, NED] of the paper's sensor fusion in its five drives: Appl. Sci. 2024, 14, 4401, table 2.
PAPER_FUSED: tuple[Vector, ...] = (
    (0.87, 0.83, 0.86),
    (0.91, 0.58, 1.03),
    (1.15, 0.70, 0.83),
    (0.69, 0.49, 0.80),
    (0.84, 0.83, 1.44),
)
SETTLED_NS = 15_000_000_000  # levelling at rest, of which no error is counted
OUTPUT_STRIDE = 10  # of 100 Hz
YAW_SD = radians(1.5)  # of the heading that was saved
RATIO_LIMIT = 0.40  # fused over GNSS, 3-D, all drives together
WHITE_LIMIT_M = 0.45  # mean of the three axes with white errors
WORKERS = 2
SEEDS_PER_CASE = 1000
WHITE = "white"


@dataclass(frozen=True)
class Case:
    """One kind of drive: a row of the table."""

    name: str
    error: InjectedError
    paper_fused: Vector | None


@dataclass(frozen=True)
class Track:
    """What a navigator made of a drive, ten times a second."""

    index: npt.NDArray[np.intp]  # shape (n,) of the inertial sample
    position: FloatArray  # shape (n, 3) [rad, rad, m]
    velocity: FloatArray  # shape (n, 3) [m/s, NED]


@dataclass(frozen=True)
class Result:
    """Mean square errors [m², NED] of all runs of a case."""

    case: Case
    gnss: Vector
    fused: Vector

    @property
    def ratio(self) -> float:
        """3-D RMSE of the fusion over that of GNSS."""
        return float(np.sqrt(sum(self.fused) / sum(self.gnss)))


CASES = (
    *(
        Case(f"drive {i}", InjectedError(ErrorKind.GAUSS_MARKOV, rmse, correlation_s=5.0, exact=True), fused)
        for i, (rmse, fused) in enumerate(zip(DEGRADED_RMSE, PAPER_FUSED, strict=True), 1)
    ),
    Case(WHITE, InjectedError(ErrorKind.WHITE, DEGRADED_RMSE[0], exact=True), None),
)


def saved_heading(drive: Drive, yaw_sd: float) -> Prior:
    """Heading of the start as a unit may have saved it, with a random error of its standard deviation."""
    error = yaw_sd * np.random.default_rng((drive.seed, 4)).standard_normal()
    return Prior(Geodetic(*drive.position[0].tolist()), (3.0, 3.0, 5.0), float(drive.attitude[0, 2] + error), yaw_sd)


def navigate(drive: Drive, navigator: Navigator) -> Track:
    """Lead a navigator through a drive in the order of the stamps."""
    times, forces, rates = drive.t_ns.tolist(), drive.force_b.tolist(), drive.rate_b.tolist()
    fixes = [k for k in range(len(drive.fix_ns)) if drive.fix_valid[k]]
    index, positions, velocities = [], [], []
    for i, time_ns in enumerate(times):
        while fixes and drive.fix_ns[fixes[0]] <= time_ns:
            give_fix(drive, fixes.pop(0), navigator)
        navigator.imu(time_ns, forces[i], rates[i])
        solution = navigator.solution() if i % OUTPUT_STRIDE == OUTPUT_STRIDE - 1 else None
        if solution:
            index.append(i)
            positions.append(solution.position)
            velocities.append(solution.velocity)
    return Track(np.array(index), np.array(positions), np.array(velocities))


def give_fix(drive: Drive, k: int, navigator: Navigator) -> None:
    """Give one fix of a drive to a navigator."""
    north, east, down = drive.fix_velocity_n[k].tolist()
    navigator.fix(
        int(drive.fix_ns[k]),
        position=Geodetic(*drive.fix_position[k].tolist()),
        velocity=(north, east, down),
        position_sd=drive.fix_position_sd_n[k].tolist(),
        velocity_sd=drive.fix_velocity_sd_n[k].tolist(),
    )


def position_errors(drive: Drive, track: Track) -> FloatArray:
    """Estimated minus true position of the IMU [m, NED], shape (n, 3)."""
    origin = Geodetic(*drive.position[0].tolist())
    errors: FloatArray = ned_track(track.position, origin) - ned_track(drive.position[track.index], origin)
    return errors


def measure(job: tuple[Case, int]) -> tuple[str, FloatArray, FloatArray]:
    """Mean square errors of GNSS and of the fusion [m², NED] in one run."""
    case, seed = job
    drive = simulate(with_error(scenario_of("parking_lot"), case.error), seed)
    navigator = Navigator(Settings(lever_arm_body_m=drive.lever_arm_b))
    navigator.remember(saved_heading(drive, YAW_SD))
    fused = (position_errors(drive, navigate(drive, navigator)) ** 2).mean(axis=0)
    return case.name, (drive.fix_error_n[drive.fix_ns >= SETTLED_NS] ** 2).mean(axis=0), fused


def measure_all(cases: Sequence[Case], runs: int, workers: int, progress: bool) -> list[Result]:
    """Run every case with seeds of its own, in parallel, and take the mean of each case."""
    jobs = [(case, SEEDS_PER_CASE * i + run) for i, case in enumerate(cases) for run in range(runs)]
    collected: dict[str, list[tuple[FloatArray, FloatArray]]] = {case.name: [] for case in cases}
    with multiprocessing.get_context("spawn").Pool(min(workers, len(jobs))) as pool:
        done = pool.imap(measure, jobs)
        console = Console(stderr=True)
        for name, gnss, fused in track(done, "simulating", len(jobs), console=console, disable=not progress):
            collected[name].append((gnss, fused))
    results = []
    for case in cases:
        (gn, ge, gd), (fn, fe, fd) = np.mean(collected[case.name], axis=0).tolist()
        results.append(Result(case, (gn, ge, gd), (fn, fe, fd)))
    return results


def shortcomings(results: Sequence[Result]) -> list[str]:
    """What a correct filter would reach and this one did not; empty if all is well."""
    found = []
    degraded = [result for result in results if result.case.name != WHITE]
    if degraded:
        ratio = float(np.sqrt(sum(sum(r.fused) for r in degraded) / sum(sum(r.gnss) for r in degraded)))
        if ratio > RATIO_LIMIT:
            found.append(f"the fused 3-D RMSE is {ratio:.3f} of that of GNSS, above {RATIO_LIMIT}")
    for result in results:
        if any(fused >= gnss for fused, gnss in zip(result.fused, result.gnss, strict=True)):
            found.append(f"{result.case.name}: the fusion is no better than GNSS on some axis")
        mean = float(np.mean(np.sqrt(result.fused)))
        if result.case.name == WHITE and mean > WHITE_LIMIT_M:
            found.append(f"white errors leave {mean:.2f} m, above {WHITE_LIMIT_M} m")
    return found


def run(runs: int, json: bool) -> int:
    """Print GNSS and fused errors of every drive beside the paper's; 0 if they are as small as they must be."""
    if runs < 1:
        raise UserError(f"{runs} runs measure nothing: try `obu papers navigation --runs 10`")
    results = measure_all(CASES, runs, WORKERS, progress=sys.stderr.isatty())
    faults = shortcomings(results)
    if json:
        print(json_module.dumps(_document(results, runs, faults), indent=2))
    else:
        _print_table(results, runs, faults)
    return 1 if faults else 0


def _document(results: Sequence[Result], runs: int, faults: Sequence[str]) -> dict[str, object]:
    rows = [
        {
            "drive": result.case.name,
            "gnss_rmse_ned_m": np.sqrt(result.gnss).tolist(),
            "fused_rmse_ned_m": np.sqrt(result.fused).tolist(),
            "ratio_3d": result.ratio,
            "paper_fused_rmse_ned_m": result.case.paper_fused,
        }
        for result in results
    ]
    return {"runs": runs, "drives": rows, "shortcomings": list(faults)}


def _print_table(results: Sequence[Result], runs: int, faults: Sequence[str]) -> None:
    title = f"Position RMSE in metres north, east, down; {runs} simulated runs each"
    table = Table(title=title, box=SIMPLE_HEAD)
    for heading in ("", "GNSS", "fused", "paper", "ratio", "paper"):
        table.add_column(heading, justify="right" if heading else "left", no_wrap=True)
    for result in results:
        paper = result.case.paper_fused
        paper_ratio = float(np.sqrt(np.square(paper).sum() / sum(result.gnss))) if paper else None
        table.add_row(
            result.case.name,
            _metres(np.sqrt(result.gnss)),
            _metres(np.sqrt(result.fused)),
            _metres(paper) if paper else "-",
            f"{result.ratio:.2f}",
            f"{paper_ratio:.2f}" if paper_ratio else "-",
        )
    console = Console()
    console.print(table)
    console.print("Simulated: the errors' correlation time of 5 s was chosen to fit the paper.")
    for fault in faults:
        console.print(f"[red]not reached:[/] {fault}")
    if not faults:
        console.print("[green]all as small as they must be[/]")


def _metres(values: Sequence[float] | FloatArray) -> str:
    return " ".join(f"{value:.2f}" for value in values)

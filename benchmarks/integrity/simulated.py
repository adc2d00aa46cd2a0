"""Simulated drives with outages, under errors that the filter knows of and errors that it does not."""

import multiprocessing
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from services.commands.papers_navigation import YAW_SD, give_fix, saved_heading
from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import Settings
from services.sensors.simulator.drive import Drive, simulate
from services.sensors.simulator.gnss_errors import ErrorKind, InjectedError
from services.sensors.simulator.scenarios import DEGRADED_RMSE, scenario_of, with_error
from shared.maths.earth import FloatArray, Geodetic, ned_track

DURATION_S = 180.0
OUTAGE_S, PERIOD_S, FIRST_NS = 15, 60, 45_000_000_000
EVERY = 50  # inertial samples of 10 ms between two solutions that are judged: neighbours tell the same
STREAM = 11  # of random numbers that no other part of the simulator draws


@dataclass(frozen=True)
class Case:
    """A kind of drive; half of its runs have an odometer."""

    name: str
    scenario: str
    error: InjectedError | None = None  # None: that of the scenario


@dataclass(frozen=True)
class Judged:
    """Errors beside protection levels [m] in one run."""

    case: str
    seed: int
    error_m: FloatArray  # horizontal, vertical, shape (n, 2)
    level_m: FloatArray  # shape (n, 2)


def _lasting(rmse: tuple[float, float, float], correlation_s: float) -> InjectedError:
    return InjectedError(ErrorKind.GAUSS_MARKOV, rmse, correlation_s=correlation_s)


CASES = (
    Case("car park, open sky", "parking_lot"),
    Case("car park, white 3 m", "parking_lot", InjectedError(ErrorKind.WHITE, DEGRADED_RMSE[0], exact=True)),
    Case("car park, 3 m over 5 s", "degraded"),
    Case("car park, 2 m over 60 s", "parking_lot", _lasting((2.0, 2.0, 3.0), 60.0)),
    Case("town, 1 m over 5 s", "urban"),
    Case("town, 1.5 m over 60 s", "urban", _lasting((1.5, 1.5, 3.0), 60.0)),
    Case("motorway, RTK", "highway"),
    Case("country road with tunnels", "tunnel"),
)


def judge_run(job: tuple[Case, int]) -> Judged:
    """Drive once, with GNSS away for 15 s of every minute and stamps off by as much as the settings say."""
    case, seed = job
    scenario = scenario_of(case.scenario, seed)
    drive = simulate(with_error(scenario, case.error) if case.error else scenario, seed, DURATION_S)
    drive.fix_valid[_hidden(drive.fix_ns)] = False
    settings = Settings(lever_arm_body_m=drive.lever_arm_b, merge_delay_s=0.0)
    rng = np.random.default_rng((seed, STREAM))
    late_ns = round(abs(settings.gnss_time_sd_s * rng.standard_normal()) * 1e9)
    return _judged(case, drive, settings, late_ns)


def _hidden(stamps_ns: "np.typing.NDArray[np.int64]") -> "np.typing.NDArray[np.bool_]":
    phase_s = (stamps_ns - FIRST_NS) // 10**9 % PERIOD_S
    found: np.typing.NDArray[np.bool_] = (stamps_ns >= FIRST_NS) & (phase_s >= PERIOD_S - OUTAGE_S)
    return found


def _judged(case: Case, drive: Drive, settings: Settings, late_ns: int) -> Judged:
    navigator = Navigator(settings)
    navigator.remember(saved_heading(drive, YAW_SD))
    fixes = [k for k in range(len(drive.fix_ns)) if drive.fix_valid[k]]
    speeds = list(range(len(drive.odometer_ns))) if drive.seed % 2 else []
    drive.fix_ns[:] += late_ns
    rows, positions, levels = [], [], []
    times, forces, rates = drive.t_ns.tolist(), drive.force_b.tolist(), drive.rate_b.tolist()
    for i, time_ns in enumerate(times):
        while fixes and drive.fix_ns[fixes[0]] <= time_ns:
            give_fix(drive, fixes.pop(0), navigator)
        while speeds and drive.odometer_ns[speeds[0]] <= time_ns:
            k = speeds.pop(0)
            navigator.speed(int(drive.odometer_ns[k]), float(drive.odometer[k]))
        navigator.imu(time_ns, forces[i], rates[i])
        solution = navigator.solution() if i % EVERY == EVERY - 1 else None
        if solution:
            rows.append(i)
            positions.append(solution.position)
            levels.append((solution.protection_level_horizontal, solution.protection_level_vertical))
    origin = Geodetic(*drive.position[0].tolist())
    off = ned_track(np.array(positions), origin) - ned_track(drive.position[rows], origin)
    return Judged(
        case.name, drive.seed, np.column_stack([np.hypot(off[:, 0], off[:, 1]), abs(off[:, 2])]), np.array(levels)
    )


def judge_all(runs: int, workers: int, first_seed: int = 0) -> Iterator[Judged]:
    """Judge a number of runs, the cases in turn, each with a seed of its own."""
    jobs = [(CASES[i % len(CASES)], first_seed + i // len(CASES)) for i in range(runs)]
    if workers == 1:
        yield from map(judge_run, jobs)
        return
    with multiprocessing.get_context("spawn").Pool(min(workers, len(jobs))) as pool:
        yield from pool.imap_unordered(judge_run, jobs)

"""Simulated drives with outages, under errors that the filter knows of and errors that it does not."""

from dataclasses import dataclass

import numpy as np

from benchmarks.given import fixes_of, speeds_of
from cli.campaign import Job, Kept
from cli.papers.navigation import YAW_SD, saved_heading
from services.core.fusion.aids.gnss.settings import GnssSettings
from services.core.fusion.batch import solve
from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import Settings
from services.sensors.simulator.drive import Drive, simulate
from services.sensors.simulator.gnss.gnss_errors import ErrorKind, InjectedError
from services.sensors.simulator.scenarios import DEGRADED_RMSE, scenario_of, with_error
from shared.maths.earth import FloatArray, Geodetic, geodetic_from_ned_difference, ned_track
from shared.runtime.config import GnssAntenna, Vehicle

DURATION_S = 180.0
OUTAGE_S, PERIOD_S, FIRST_NS = 15, 60, 45_000_000_000
PERIOD_NS = 500_000_000  # between two solutions that are judged: neighbours tell the same
WHITE_RMSE = (3.0, 2.0, 1.6)  # [m, NED]
STREAM = 11  # of random numbers that no other part of the simulator draws


@dataclass(frozen=True)
class Case:
    """A kind of drive; half of its runs have an odometer."""

    name: str
    scenario: str
    error: InjectedError | None = None  # None: that of the scenario
    base_share: float = 0.0  # standard deviation of an error that never changes, over that of the others


@dataclass(frozen=True)
class ErrorsAndLevels:
    """Errors beside protection levels [m] in one run."""

    case: str
    seed: int
    error_m: Kept  # horizontal, vertical, shape (n, 2)
    level_m: Kept  # shape (n, 2)


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
    Case("car park, white 3 m and a fifth for ever", "parking_lot", InjectedError(ErrorKind.WHITE, WHITE_RMSE), 0.2),
    Case("country road, 1 m over 30 min", "tunnel", _lasting((1.0, 1.0, 1.5), 1800.0)),
)


def judge_run(case: Case, seed: int) -> ErrorsAndLevels:
    """Drive once, with GNSS away for 15 s of every minute and stamps off by as much as the settings say.

    Lever arm and delay are stated to be exact, as they are: what is judged is the filter, not what is assumed of them.
    """
    scenario = scenario_of(case.scenario, seed)
    drive = simulate(with_error(scenario, case.error) if case.error else scenario, seed, DURATION_S)
    drive.fix_valid[_hidden(drive.fix_ns)] = False
    settings = Settings(
        vehicle=Vehicle(gnss=GnssAntenna(lever_arm_body_m=drive.lever_arm_b, lever_arm_sd_m=0.0)),
        gnss=GnssSettings(delay_sd_s=0.0),
    )
    rng = np.random.default_rng((seed, STREAM))
    drive.fix_ns[:] += round(abs(settings.gnss.time_sd_s * rng.standard_normal()) * 1e9)
    base_sd = case.base_share * drive.fix_position_sd_n[0]
    _shift(drive, base_sd * rng.standard_normal(3))
    drive.fix_position_sd_n[:] = np.hypot(drive.fix_position_sd_n, base_sd)
    return _judged(case, drive, settings)


def _shift(drive: Drive, base: FloatArray) -> None:
    """Move all fixes [m, NED]."""
    north, east, down = base.tolist()
    for k in range(len(drive.fix_ns)):
        drive.fix_position[k] = geodetic_from_ned_difference((north, east, down), Geodetic(*drive.fix_position[k]))


def _hidden(stamps_ns: "np.typing.NDArray[np.int64]") -> "np.typing.NDArray[np.bool_]":
    phase_s = (stamps_ns - FIRST_NS) // 10**9 % PERIOD_S
    found: np.typing.NDArray[np.bool_] = (stamps_ns >= FIRST_NS) & (phase_s >= PERIOD_S - OUTAGE_S)
    return found


def _judged(case: Case, drive: Drive, settings: Settings) -> ErrorsAndLevels:
    navigator = Navigator(settings)
    navigator.use_prior(saved_heading(drive, YAW_SD))
    measured = fixes_of(drive, settings) + (speeds_of(drive, settings) if drive.seed % 2 else [])
    readings = np.hstack([drive.force_b, drive.rate_b])
    found = list(solve(navigator, drive.t_ns, readings, measured, every_ns=PERIOD_NS))
    rows = np.searchsorted(drive.t_ns, [solution.time_ns for solution in found])
    origin = Geodetic(*drive.position[0].tolist())
    places = np.array([solution.position for solution in found])
    off = ned_track(places, origin) - ned_track(drive.position[rows], origin)
    levels = np.array(
        [(solution.protection_level_horizontal, solution.protection_level_vertical) for solution in found]
    )
    return ErrorsAndLevels(
        case.name, drive.seed, np.column_stack([np.hypot(off[:, 0], off[:, 1]), abs(off[:, 2])]), levels
    )


def jobs_of(runs: int, first_seed: int = 0) -> list[Job[ErrorsAndLevels]]:
    """List a number of runs, the cases in turn, each with a seed of its own."""
    chosen = [(CASES[i % len(CASES)], first_seed + i // len(CASES)) for i in range(runs)]
    return [Job(f"{case.name}, seed {seed}", judge_run, (case, seed)) for case, seed in chosen]

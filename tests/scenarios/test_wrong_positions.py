"""Positions that freeze or drift: rejections and protection levels of the filter alone."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from benchmarks.given import fixes_of
from cli.papers.navigation import YAW_SD, saved_heading
from services.core.fusion.aids.base import Counts
from services.core.fusion.batch import solve
from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import Settings
from services.sensors.simulator.drive import Drive, simulate
from shared.maths.earth import FloatArray, Geodetic, geodetic_from_ned_difference, ned_track
from shared.runtime.config import GnssAntenna, Vehicle

BEGIN_S, END_S, DURATION_S = 60, 90, 100.0
Wrong = Callable[[Drive, int], None]  # falsifies a fix


@dataclass(frozen=True)
class FaultRun:
    """Horizontal errors and levels [m] since the begin of the fault, twice a second, and the counters."""

    error: FloatArray
    level: FloatArray
    before: Counts  # of the same drive until the fault began
    counts: Counts


def drive_with(wrong: Wrong, scenario: str = "urban", seed: int = 3) -> FaultRun:
    drive = simulate(scenario, seed, DURATION_S)
    for k in np.flatnonzero((drive.fix_ns > BEGIN_S * 10**9) & (drive.fix_ns <= END_S * 10**9)).tolist():
        wrong(drive, k)
    settings = Settings(vehicle=Vehicle(gnss=GnssAntenna(lever_arm_body_m=drive.lever_arm_b)))
    navigator = Navigator(settings)
    navigator.use_prior(saved_heading(drive, YAW_SD))
    readings, before, rows = np.hstack([drive.force_b, drive.rate_b]), Counts(), []
    for solution in solve(navigator, drive.t_ns, readings, fixes_of(drive, settings), every_ns=500_000_000):
        if solution.time_ns <= BEGIN_S * 10**9:
            before = navigator.counts
            continue
        true = Geodetic(*drive.position[np.searchsorted(drive.t_ns, solution.time_ns)].tolist())
        north, east, _ = ned_track(np.array([solution.position]), true)[0]
        rows.append((np.hypot(north, east), solution.protection_level_horizontal))
    error, level = np.array(rows).T
    return FaultRun(error, level, before, navigator.counts)


def frozen(drive: Drive, k: int) -> None:
    """Repeat the last position, with the true velocity."""
    drive.fix_position[k] = drive.fix_position[k - 1]


def held(drive: Drive, k: int) -> None:
    """Repeat the last position and the last velocity."""
    frozen(drive, k)
    drive.fix_velocity_n[k] = drive.fix_velocity_n[k - 1]


def drifting(rate: float) -> Wrong:
    """Let positions drift to the east [m/s], with the true velocity."""

    def drift(drive: Drive, k: int) -> None:
        east = rate * (drive.fix_ns[k] * 1e-9 - BEGIN_S)
        place = Geodetic(*drive.fix_position[k].tolist())
        drive.fix_position[k] = geodetic_from_ned_difference((0.0, east, 0.0), place)

    return drift


@pytest.mark.parametrize("scenario", ["urban", pytest.param("highway", marks=pytest.mark.slow)])
def test_frozen_positions_are_rejected_and_the_level_stays_above_the_error(scenario: str) -> None:
    """Also after the filter was reset to the frozen position."""
    seen = drive_with(frozen, scenario)
    assert seen.counts.fixes_rejected - seen.before.fixes_rejected >= 10 and seen.counts.resets > 0
    assert seen.error.max() > 50.0
    assert (seen.error <= seen.level).all()


def test_repeated_epochs_are_not_used_for_ten_seconds_and_then_rejected() -> None:
    seen = drive_with(held, "highway")
    assert seen.counts.epochs_repeated >= 10 and seen.counts.fixes_rejected >= 10
    assert (seen.error > seen.level).mean() < 0.1
    assert seen.error[:20].max() < 3.0, "[m] ten seconds without GNSS; the frozen position is 300 m off"


def test_positions_drifting_at_1_m_s_are_rejected_and_the_largest_level_is_above_the_error() -> None:
    seen = drive_with(drifting(1.0))
    assert seen.counts.fixes_rejected - seen.before.fixes_rejected >= 10
    assert seen.level.max() > seen.error.max()


def test_a_drift_of_0_1_m_s_causes_no_larger_error_than_its_offset() -> None:
    """0.1 m/s passes every gate, and the level need not cover it: see docs/explanation/protection-levels.md."""
    seen = drive_with(drifting(0.1))
    assert 1.0 < seen.error.max() < 0.1 * (END_S - BEGIN_S) + 1.5, "at most the offset of the fixes"


def test_after_frozen_positions_the_step_back_closes_what_the_reset_had_left() -> None:
    """The level was above the error of more than 50 m, and comes down when the position does."""
    seen = drive_with(frozen)
    assert seen.level.max() > 50.0 and seen.error[-1] < seen.level[-1] < 15.0

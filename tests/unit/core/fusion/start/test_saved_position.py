"""The first fix of a parked vehicle against its saved position."""

from math import radians

import numpy as np
import pytest

from benchmarks.given import fixes_of
from services.core.fusion.batch import solve
from services.core.fusion.codes import Code
from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import Settings
from services.core.fusion.start.heading import Prior, better_prior
from services.sensors.simulator.drive import Drive, simulate
from shared.maths.earth import Geodetic, geodetic_from_ned_difference
from shared.runtime.config import GnssAntenna, Vehicle

END_S = 60.0


@pytest.fixture(scope="module")
def drive() -> Drive:
    return simulate("urban", 3, END_S)


def started(drive: Drive, aside_m: float, *, parked: bool = True) -> Navigator:
    """A navigator that was switched off where the drive begins, or aside of it, at standstill or in motion."""
    settings = Settings(vehicle=Vehicle(gnss=GnssAntenna(lever_arm_body_m=drive.lever_arm_b)))
    navigator = Navigator(settings)
    saved = geodetic_from_ned_difference((0.0, -aside_m, 0.0), Geodetic(*drive.position[0].tolist()))
    navigator.use_prior(Prior(saved, (1.0, 1.0, 2.0), float(drive.attitude[0, 2]), radians(1.0), parked))
    readings = np.hstack([drive.force_b, drive.rate_b])
    for _ in solve(navigator, drive.t_ns, readings, fixes_of(drive, settings), every_ns=10**9):
        pass
    return navigator


def test_a_first_fix_50_m_aside_is_held_by_the_level_and_both_are_stated(drive: Drive) -> None:
    navigator = started(drive, 50.0)
    held, solution = navigator.engine.aids.error_monitor.held, navigator.solution()
    assert held.at_start and held.bound[0] == pytest.approx(50.0, abs=6.0)
    assert held.why is not None and held.why.code == Code.HELD_AT_START
    assert [end.values.get("needed_m") for end in held.ends(None) if end.code == Code.ENDS_BY_DRIVE] == [2000.0]
    assert solution is not None and solution.protection_level_horizontal > 44.0


def test_a_first_fix_aside_of_the_last_position_of_a_vehicle_in_motion_holds_nothing(drive: Drive) -> None:
    assert not started(drive, 50.0, parked=False).engine.aids.error_monitor.held.is_open


def test_a_first_fix_where_the_vehicle_was_parked_holds_nothing(drive: Drive) -> None:
    navigator = started(drive, 2.0)
    assert not navigator.engine.aids.error_monitor.held.is_open


def test_the_first_prior_is_used_unless_only_a_later_one_is_of_a_parked_vehicle() -> None:
    first, second, parked = (
        Prior(Geodetic(0.8, 0.1, height), (1.0, 1.0, 2.0), 0.0, 0.1, height > 2.0) for height in (1.0, 2.0, 3.0)
    )
    assert better_prior(None, first) is first and better_prior(first, second) is first
    assert better_prior(first, parked) is parked and better_prior(parked, second) is parked

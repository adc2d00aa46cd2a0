"""Set-ups that are wrong by as much as happens, under a receiver of two centimetres: the levels hold what they do."""

from functools import cache

import numpy as np
import pytest

from services.core.fusion.codes import Code
from services.sensors.simulator.drive import Drive, simulate
from shared.messages.navigation import SetUpVerdict
from tests.support.drives.set_up import matrix_of
from tests.support.drives.set_up_runs import SetUpRun, run

KNOWING: dict[str, object] = {"vehicle.gnss.lever_arm_sd_m": 0.0, "gnss.delay_sd_s": 0.0}


@cache
def drive(scenario: str, seed: int = 3) -> Drive:
    return simulate(scenario, seed, 120.0)


@cache
def late(scenario: str, *, with_velocity: bool = True) -> SetUpRun:
    return run(drive(scenario), late_s=0.3, with_velocity=with_velocity)


@pytest.mark.parametrize(
    ("scenario", "error"),
    [("parking_lot", (1.0, 0.0, 0.0)), pytest.param("urban", (0.0, -1.0, 0.0), marks=pytest.mark.slow)],
)
def test_a_lever_arm_that_is_a_metre_off_is_held_by_the_levels(
    scenario: str, error: tuple[float, float, float]
) -> None:
    solved = run(drive(scenario), arm_error=error)
    assert np.sqrt((solved.horizontal**2).mean()) > 0.9
    assert max(solved.above()) <= 0.01, "78 to 99 % without the spread"


@pytest.mark.parametrize("scenario", [pytest.param("parking_lot", marks=pytest.mark.slow), "urban"])
def test_fixes_that_are_0_3_s_late_are_held_by_the_levels_until_the_delay_is_found(scenario: str) -> None:
    assert max(late(scenario).above()) <= 0.01, "37 to 44 % without the spread"


def test_a_delay_that_is_found_is_corrected_and_the_levels_keep_what_is_left_of_it() -> None:
    solved = late("urban")
    after = solved.time_s > 100.0
    assert np.sqrt((solved.horizontal[after] ** 2).mean()) < 0.15, "2.5 m before"
    assert np.median(solved.level_h[after]) < 1.5 and (solved.horizontal < solved.level_h)[after].all()
    assert solved.checks["lever_arm"].verdict is not SetUpVerdict.CONTRADICTS


@pytest.mark.slow
def test_levels_of_metres_hardly_grow_where_the_vehicle_file_says_how_well_the_set_up_is_known() -> None:
    """As that of the simulated vehicle does; what an unknown delay makes at the speed of the town is no small thing."""
    stated: dict[str, object] = {"vehicle.gnss.lever_arm_sd_m": 0.02, "gnss.delay_sd_s": 0.02}
    town = drive("urban")
    before, after = run(town, KNOWING, rtk=False), run(town, stated, rtk=False)
    assert np.median(after.level_h) < 1.05 * np.median(before.level_h)
    assert np.median(after.level_v) < 1.05 * np.median(before.level_v)


def test_the_levels_of_a_right_set_up_come_down_when_the_checks_agree() -> None:
    solved = run(drive("urban"))
    assert max(solved.above()) == 0.0
    assert solved.level_h[-1] < 0.7 * np.median(solved.level_h[:300])


@pytest.mark.parametrize("late_s", [0.3, 0.5])
def test_a_late_receiver_is_no_finding_of_the_lever_arm(late_s: float) -> None:
    """Positions alone; a delay of 0.3 s looks in turns like an antenna that is 1.5 m elsewhere."""
    solved = run(drive("urban", 5), late_s=late_s, with_velocity=False)
    assert solved.checks["gnss_delay"].verdict is SetUpVerdict.CONTRADICTS, "positions alone tell the delay"
    assert solved.checks["gnss_delay"].statistic == pytest.approx(late_s, abs=0.06)
    assert solved.lever_arm_found == [] and all(state.lever_arm_error_body_m is None for state in solved.states)


@pytest.mark.slow
def test_a_lever_arm_is_found_when_the_delay_is_known() -> None:
    solved = run(drive("parking_lot"), arm_error=(0.0, -2.0, 0.0))
    assert solved.lever_arm_found and solved.states[-1].lever_arm_error_body_m is not None
    assert solved.lever_arm_found[0] >= solved.checks["gnss_velocity_delay"].since_ns * 1e-9


@pytest.mark.slow
def test_heights_of_the_wrong_sign_are_used_no_more_once_they_are_found() -> None:
    """700 m above the ellipsoid: the height is wrong by 1.4 km, and nothing tells the right one."""
    solved = run(simulate("urban", 3, 180.0), height_sign=-1.0)
    found = solved.checks["gnss_height"]
    assert found.verdict is SetUpVerdict.CONTRADICTS
    assert found.code is not None and found.code.code == Code.HEIGHT_SIGN_WRONG
    after = solved.time_s > found.since_ns * 1e-9 + 0.5
    assert after.sum() > 300 and (solved.vertical < solved.level_v)[after].all(), "all of them before"
    assert np.sqrt((solved.horizontal[after] ** 2).mean()) < 0.1 and solved.states[-1].resets == 0
    before = solved.time_s < found.since_ns * 1e-9
    changed = np.abs(solved.vertical - solved.vertical[0])[before]
    assert changed.max() > 1.0 and (changed < solved.level_v[before]).all(), "twice the change since the start is held"


@pytest.mark.parametrize("axes", [("y", "-x", "z"), pytest.param(("-x", "-y", "z"), marks=pytest.mark.slow)])
def test_after_a_finding_of_turned_axes_the_heading_is_that_of_the_vehicle(axes: tuple[str, str, str]) -> None:
    solved = run(drive("urban"), imu=matrix_of(axes))
    since_s = solved.checks["imu_axes"].since_ns * 1e-9 + 0.5
    before, after = solved.time_s < since_s - 1.0, solved.time_s > since_s
    assert np.degrees(np.abs(solved.yaw_error[before]).min()) > 80.0
    assert np.degrees(np.abs(solved.yaw_error[after]).max()) < 2.0
    assert (np.abs(solved.yaw_error) < 3.0 * solved.yaw_sd)[after].all()


@pytest.mark.slow
def test_after_a_finding_of_a_skewed_mount_the_heading_is_that_of_the_vehicle() -> None:
    c, s = np.cos(0.35), np.sin(0.35)
    solved = run(drive("urban"), imu=np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]))
    after = solved.time_s > solved.checks["imu_mounting"].since_ns * 1e-9 + 0.5
    assert after.sum() > 200 and (np.abs(solved.yaw_error) < 3.0 * solved.yaw_sd)[after].all()
    assert np.degrees(np.abs(solved.yaw_error[after]).max()) < 3.0, "20 before"

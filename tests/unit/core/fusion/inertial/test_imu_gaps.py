"""Gaps of seconds in which the vehicle turns, so that the heading before the gap is no longer valid."""

from functools import cache
from math import hypot

import pytest

from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import Settings
from services.sensors.simulator.drive import Drive, simulate
from shared.maths.earth import Geodetic, ned_from_geodetic_difference

SETTLED_S = 2.0  # from the end of the gap, in which the next fix is due


@cache
def drive(seed: int) -> Drive:
    return simulate("urban", seed=seed, duration_s=100.0)


@pytest.mark.parametrize(("seed", "begin_s"), [(3, 70.0), (5, 70.0)])
@pytest.mark.parametrize("gap_s", [3.0, 5.5])
def test_after_a_gap_in_a_bend_the_position_error_stays_below_3_m_without_a_reset(
    seed: int, begin_s: float, gap_s: float
) -> None:
    d = drive(seed)
    made = Navigator(
        Settings().with_values({"vehicle.gnss.lever_arm_body_m": d.lever_arm_b, "alignment.levelling_s": 2.0})
    )
    k, worst_m, solutions = 0, 0.0, 0
    for i, time_ns in enumerate(d.t_ns.tolist()):
        while k < len(d.fix_ns) and d.fix_ns[k] <= time_ns:
            if d.fix_valid[k]:
                made.fix(
                    int(d.fix_ns[k]),
                    position=Geodetic(*d.fix_position[k].tolist()),
                    velocity=tuple(d.fix_velocity_n[k].tolist()),
                    position_sd=tuple(d.fix_position_sd_n[k].tolist()),
                    velocity_sd=tuple(d.fix_velocity_sd_n[k].tolist()),
                )
            k += 1
        if begin_s <= time_ns * 1e-9 < begin_s + gap_s:
            continue
        made.imu(time_ns, tuple(d.force_b[i].tolist()), tuple(d.rate_b[i].tolist()))
        solution = made.solution() if time_ns * 1e-9 > begin_s + gap_s + SETTLED_S and i % 10 == 0 else None
        if solution is not None:
            north, east, _ = ned_from_geodetic_difference(solution.position, Geodetic(*d.position[i].tolist()))
            worst_m, solutions = max(worst_m, hypot(north, east)), solutions + 1
    assert solutions > 150 and worst_m < 3.0
    assert made.counts.resets == 0

"""Injected delays: found by the search, estimated by the filter, and removed from the stamps."""

from functools import cache
from math import hypot, radians, sqrt

import numpy as np
import pytest
from scipy.stats import chi2

from cli.papers.navigation import saved_heading
from services.core.fusion.filter import error_model as em
from services.core.fusion.measurements.gnss import GnssVelocity
from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import Settings
from services.core.fusion.timing.delay_compensation import known_delays
from services.core.fusion.timing.delay_search import DelaySearch
from services.sensors.simulator.drive import Drive, simulate
from shared.maths.earth import Geodetic, ned_from_geodetic_difference

ODOMETER_S = 0.06


@cache
def town(seed: int = 4, duration_s: float = 45.0) -> Drive:
    """A town with a receiver without fixed ambiguities, five fixes a second."""
    return simulate("urban", seed, duration_s, epoch_s=0.2)


def processed(d: Drive, delay_s: float, *, late_s: float = 0.0, quiet_s: float = 0.0, **changes: object) -> Navigator:
    """Process a drive whose GNSS and odometer are older than their stamps.

    A fix is received `late_s` after its stamp; the last `quiet_s` of the drive have none.
    """
    settings = {
        "vehicle.gnss.lever_arm_body_m": d.lever_arm_b,
        "alignment.levelling_s": 2.0,
        "estimate_delays": True,
        **changes,
    }
    made = Navigator(Settings().with_values(settings))
    made.use_prior(saved_heading(d, radians(1.5)))
    fixes = [k for k in range(len(d.fix_ns)) if d.fix_valid[k] and d.fix_ns[k] < d.t_ns[-1] - quiet_s * 1e9]
    speeds = list(range(len(d.odometer_ns)))
    for i, now in enumerate(d.t_ns.tolist()):
        while fixes and (arrival := int(d.fix_ns[fixes[0]]) + round((delay_s + late_s) * 1e9)) <= now:
            k = fixes.pop(0)
            north, east, down = d.fix_velocity_n[k].tolist()
            made.fix(
                arrival - round(late_s * 1e9),
                position=Geodetic(*d.fix_position[k].tolist()),
                velocity=(north, east, down),
                position_sd=d.fix_position_sd_n[k].tolist(),
                velocity_sd=d.fix_velocity_sd_n[k].tolist(),
                received_ns=now,
            )
        while speeds and (stamp := int(d.odometer_ns[speeds[0]]) + round(ODOMETER_S * 1e9)) <= now:
            made.speed(stamp, float(d.odometer[speeds.pop(0)]), received_ns=now)
        made.imu(now, d.force_b[i].tolist(), d.rate_b[i].tolist(), now)
    return made


def age(made: Navigator) -> tuple[float, float]:
    """Delay of GNSS velocities, and its standard deviation."""
    running = made.engine.filter
    assert running is not None
    places = [em.GNSS_DELAY, em.GNSS_VELOCITY_DELAY]
    variance = float(running.P[np.ix_(places, places)].sum())
    return sum(running.parameter(place) for place in places), sqrt(variance)


def error_m(d: Drive, made: Navigator) -> float:
    solution = made.solution()
    assert solution is not None
    return hypot(*ned_from_geodetic_difference(solution.position, Geodetic(*d.position[-1].tolist()))[:2])


def searched(d: Drive, delay_s: float) -> DelaySearch:
    search, fixes = DelaySearch(2.5), np.flatnonzero(d.fix_valid).tolist()
    for i, now in enumerate(d.t_ns.tolist()):
        (fx, fy, fz), (wx, wy, wz) = d.force_b[i].tolist(), d.rate_b[i].tolist()
        search.sample(now, (fx, fy, fz), (wx, wy, wz))
        while fixes and d.fix_ns[fixes[0]] <= now:
            k = fixes.pop(0)
            stamp, (north, east, down) = int(d.fix_ns[k]) + round(delay_s * 1e9), d.fix_velocity_n[k].tolist()
            search.see(GnssVelocity(stamp, stamp, "gnss", (north, east, down), np.eye(3), 3, d.lever_arm_b))
    return search


@pytest.mark.parametrize("delay_s", [-0.4, 0.2, 0.5, 1.1])
def test_the_delay_search_estimates_a_delay_within_three_sigma(delay_s: float) -> None:
    found = searched(town(duration_s=120.0), delay_s).result()
    assert abs(found.delay_s - delay_s) < min(0.1, 3.0 * found.sd_s)


def test_the_deviation_is_infinite_for_an_assumed_delay_or_at_standstill() -> None:
    assert searched(town(duration_s=120.0), 0.5).result(assumed_s=0.5).sd_s == np.inf
    assert searched(town(duration_s=15.0), 0.5).result().sd_s == np.inf


@pytest.mark.parametrize("epoch_s", [0.1, 1.0])
def test_the_delay_search_works_at_1_and_10_hz(epoch_s: float) -> None:
    found = searched(simulate("urban", 4, 150.0, epoch_s=epoch_s), 0.5).result()
    assert abs(found.delay_s - 0.5) < 0.15


def test_delays_of_gnss_and_odometer_are_estimated_and_removed() -> None:
    d = town()
    made = processed(d, 0.2)
    delay_s, sd_s = age(made)
    assert abs(delay_s - 0.2) < min(0.02, 3.5 * sd_s), "velocity against acceleration"
    delays = known_delays(made.engine.filter)
    assert delays is not None
    gnss, odometer, _ = delays
    assert abs(gnss[0] - 0.2) < 3.0 * gnss[1] < 0.2, "less accurate from positions, whose errors are time-correlated"
    assert abs(odometer[0] - ODOMETER_S) < 0.025
    removed = made._oosm._timing
    assert removed._at(GnssVelocity, int(d.t_ns[-1])) == pytest.approx(0.2, abs=0.03), "[s] by which stamps are shifted"
    assert made.counts.resets == 0 and made.counts.fixes_rejected == 0
    assert error_m(d, made) < 1.0


@pytest.mark.slow
def test_late_fixes_with_estimated_delays_change_nothing_to_the_last_bit() -> None:
    """The last second has no fix, so that all late ones were received."""
    d = town()
    in_time, late = processed(d, 0.1, quiet_s=1.0), processed(d, 0.1, late_s=0.2, quiet_s=1.0)
    first, second = in_time.solution(), late.solution()
    assert first is not None and second is not None
    assert age(in_time) == age(late)
    assert (first.position, first.velocity, first.yaw) == (second.position, second.velocity, second.yaw)


def test_delays_are_not_estimated_by_default() -> None:
    made = processed(town(duration_s=40.0), 0.1, estimate_delays=False)
    running = made.engine.filter
    assert running is not None and not made.settings.estimate_delays
    assert not running.P[em.DELAYS].any()
    assert [running.parameter(place) for place in em.DELAYS.tolist()] == [0.0, 0.0, 0.0]


@pytest.mark.slow
@pytest.mark.parametrize("delay_s", [-0.4, 0.08, 0.2, 0.5, 1.1])
def test_delays_up_to_1_1_s_are_estimated_to_0_02_s(delay_s: float) -> None:
    d = town(duration_s=160.0)
    made = processed(d, delay_s)
    assert abs(age(made)[0] - delay_s) < 0.02
    assert made.counts.resets == 0
    assert error_m(d, made) < 1.5


@pytest.mark.slow
def test_normalised_delay_errors_squared_lie_in_the_99_percent_band() -> None:
    """NEES of the delays of velocity and odometer over eight drives, 99 % band of chi-square."""
    runs, nees = 8, np.zeros(2)
    for seed in range(runs):
        delay_s = 0.02 * (seed - 4)
        made = processed(town(seed + 10, 90.0), delay_s)
        estimated, sd_s = age(made)
        delays = known_delays(made.engine.filter)
        assert delays is not None
        odometer = delays[1]
        nees += ((estimated - delay_s) / sd_s) ** 2, ((odometer[0] - ODOMETER_S) / odometer[1]) ** 2
    assert (chi2.ppf(0.005, runs) < nees).all() and (nees < chi2.isf(0.005, runs)).all(), nees

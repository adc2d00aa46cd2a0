"""GNSS that is half a second older than its stamps, which the check of the set-up has found and no setting corrects."""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.given import fixes_of
from cli.papers.navigation import YAW_SD, saved_heading
from services.core.fusion.aids.base import Measurement
from services.core.fusion.aids.gnss.fix import GnssPosition, GnssVelocity
from services.core.fusion.aids.gnss.settings import GnssSettings
from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import Settings
from services.sensors.simulator.drive import simulate
from shared.maths.earth import Geodetic, ned_track
from shared.runtime.config import GnssAntenna, Vehicle

LATE_S = 0.5
LATE_NS = round(LATE_S * 1e9)
FOUND_S, FROM_S, GONE_S, END_S = 25.0, 30.0, 65.0, 90.0


def late(seen: Measurement) -> Measurement:
    assert isinstance(seen, GnssPosition | GnssVelocity)
    return replace(seen, time_ns=seen.time_ns + LATE_NS, received_ns=seen.received_ns + LATE_NS)


@pytest.mark.parametrize("stamps_exact", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_positions_of_a_late_receiver_are_of_the_time_that_the_settings_say(stamps_exact: bool) -> None:
    """Without the finding the velocity errs by 0.52 m/s (RMS), and the error reaches 1.4 times its level."""
    drive = simulate("urban", 5, END_S)
    settings = Settings(
        vehicle=Vehicle(gnss=GnssAntenna(lever_arm_body_m=drive.lever_arm_b)),
        gnss=GnssSettings(stamps_exact=stamps_exact),
    )
    navigator = Navigator(settings)
    navigator.use_prior(saved_heading(drive, YAW_SD))
    seen = [late(fix) for fix in fixes_of(drive, settings) if fix.time_ns + LATE_NS < GONE_S * 1e9]
    rows, k = [], 0
    for i, time_ns in enumerate(drive.t_ns.tolist()):
        while k < len(seen) and seen[k].received_ns <= time_ns:
            navigator.measure(seen[k])
            k += 1
        navigator.imu(time_ns, drive.force_b[i].tolist(), drive.rate_b[i].tolist())
        if time_ns >= FOUND_S * 1e9:
            navigator.correct_delay(LATE_S, LATE_S)
        if time_ns % 500_000_000 or (solution := navigator.solution()) is None:
            continue
        now, then = (
            min(int(np.searchsorted(drive.t_ns, solution.time_ns - age_ns)), len(drive.t_ns) - 1)
            for age_ns in (0, LATE_NS)
        )
        error, from_late = (
            ned_track(np.array([solution.position]), Geodetic(*drive.position[k].tolist()))[0] for k in (now, then)
        )
        levels = solution.protection_level_horizontal, solution.protection_level_vertical
        velocity_error = solution.velocity - drive.velocity_n[now]
        variance = float(np.trace(solution.position_cov[:2, :2]))
        rows.append((solution.time_ns * 1e-9, *error, *from_late[:2], *levels, *velocity_error[:2], variance))
    time, n, e, d, late_n, late_e, level, upright, vn, ve, variance = np.array(rows).T
    known, driven = time > FROM_S, (time > FROM_S) & (time < GONE_S)
    if stamps_exact:  # it is the inertial samples that are early
        n, e = late_n, late_e
    assert (np.hypot(n, e) < level)[known].all() and (np.abs(d) < upright)[known].all()
    assert np.sqrt((vn**2 + ve**2)[driven].mean()) < 0.15
    assert np.sqrt((n**2 + e**2)[driven].mean()) < 0.8
    assert (n**2 + e**2)[driven].mean() < variance[driven].mean(), "and the covariance holds what is left"
    assert level[driven].mean() < 8.0 and navigator.counts.resets == 0, "15 m with the way in the delay"


def test_a_delay_in_use_follows_the_check_and_outlives_a_filter() -> None:
    drive = simulate("urban", 3, 40.0)
    navigator = Navigator()
    navigator.use_prior(saved_heading(drive, YAW_SD))
    fixes = [late(fix) for fix in fixes_of(drive, navigator.settings)]
    k = 0
    for time_ns, force, rate in zip(drive.t_ns.tolist(), drive.force_b.tolist(), drive.rate_b.tolist(), strict=True):
        while k < len(fixes) and fixes[k].received_ns <= time_ns:
            navigator.measure(fixes[k])
            k += 1
        navigator.imu(time_ns, force, rate)
        if navigator.engine.filter is not None and time_ns > 35e9:
            break
    steps = [((0.5, 0.6), (0.5, 0.6)), ((0.54, 0.6), (0.5, 0.6)), ((0.0, 0.4), (0.0, 0.4)), ((0.6, 0.0), None)]
    for (position_s, velocity_s), expected in steps:
        navigator.correct_delay(position_s, velocity_s)
        time_ns += 100_000_000
        navigator.imu(time_ns, force, rate)
        filter_ = navigator.engine.filter
        assert filter_ is not None
        assert (None if filter_.late is None else filter_.late[:2]) == expected
        assert navigator.engine.aids.error_monitor.delay_s == (0.0 if expected else 0.6), "only that is not corrected"
        assert navigator.corrected_delay_s == (expected[0] if expected else None)
    navigator.correct_delay(0.5, 0.5)
    time_ns += 100_000_000
    navigator.imu(time_ns, force, rate)
    engine = navigator.engine
    assert engine.filter is not None
    again = copy(engine.filter)
    again.late, place = None, again.position
    engine.aids.begin(time_ns, again, engine.aids.gnss.comparison)
    assert again.late is not None and again.late.position_s == 0.5
    assert again.position == place, "a fix of the right time has given it"
    assert engine.aids.error_monitor.delay_s == 0.0

"""Spread of lever arm and delay: assumed, stated or measured, and what it adds to the levels."""

from dataclasses import replace
from math import hypot

import pytest

from services.core.fusion.aids.gnss.settings import GnssSettings
from services.core.fusion.integrity.error_monitor import ErrorMonitor
from services.core.fusion.integrity.protection_levels import Levels, protection_levels
from services.core.fusion.integrity.set_up_spread import NO_SPREAD, CheckDifference, SetUpSpread
from services.core.fusion.set_up.findings import Check, Verdict
from services.core.fusion.set_up.monitor import SetUpMonitor
from services.core.fusion.settings import Settings
from shared.runtime.config import GnssAntenna, Vehicle

GIVEN = Settings(vehicle=Vehicle(gnss=GnssAntenna(lever_arm_body_m=(0.3, 0.0, -1.2))))


def levels(sd: float, velocity: tuple[float, float, float], spread: SetUpSpread) -> Levels:
    monitor = ErrorMonitor(used_ns=1, unestimated=(1e-9, 1e-9))
    monitor = replace(monitor, position=replace(monitor.position, time_ns=1))
    cov = ((sd**2, 0.0, 0.0), (0.0, sd**2, 0.0), (0.0, 0.0, sd**2))
    return protection_levels(cov, velocity, 1, monitor, risk=1e-3, time_sd_s=0.0, spread=spread)


def test_a_lever_arm_that_is_not_given_is_known_less_than_one_that_is_and_a_stated_spread_is_that() -> None:
    assert SetUpSpread.of(GIVEN) == SetUpSpread(0.35, 0.35, 0.12)
    assert SetUpSpread.of(Settings()) == SetUpSpread(0.5, 0.5, 0.12)
    assert SetUpSpread.of(Settings(gnss=GnssSettings(delay_s=0.4))).delay_s == 0.05
    stated = GIVEN.with_values({"vehicle.gnss.lever_arm_sd_m": 0.02, "gnss.delay_sd_s": 0.0})
    assert SetUpSpread.of(stated) == SetUpSpread(0.02, 0.02, 0.0)


def test_a_check_replaces_what_was_assumed_by_what_it_has_seen_and_never_by_more() -> None:
    found = SetUpSpread.of(GIVEN, arm=CheckDifference(0.03, 0.04), delay=CheckDifference(0.4, 0.02))
    assert found.arm_horizontal_m == pytest.approx(0.05)
    assert found.arm_vertical_m == 0.35, "turns do not show the height"
    assert found.delay_s == 0.12


def test_only_checks_that_agree_replace_it() -> None:
    monitor = SetUpMonitor(GIVEN)
    assert monitor.spread() == SetUpSpread.of(GIVEN)
    monitor._adopt(Check("lever_arm", Verdict.AGREES, statistic=0.03, sd=0.04), 10)
    monitor._adopt(Check("gnss_velocity_delay", Verdict.AGREES, statistic=0.0, sd=0.02), 10)
    assert monitor.spread() == SetUpSpread(hypot(0.03, 0.04), 0.35, 0.02)
    for _ in range(2):
        monitor._adopt(Check("lever_arm", Verdict.CONTRADICTS, statistic=0.9, sd=0.04), 20)
    assert monitor.spread().arm_horizontal_m == 0.35


def test_the_levels_hold_an_arm_of_a_metre_and_a_delay_of_0_3_s_and_hardly_grow_above_5_m() -> None:
    fast = (6.0, 8.0, 0.5)
    assumed = SetUpSpread.of(GIVEN)
    assert levels(0.02, (0.0, 0.0, 0.0), assumed).horizontal > 1.1
    assert levels(0.02, fast, assumed).horizontal > 0.36 * 10.0
    several = levels(1.6, (3.0, 0.0, 0.0), NO_SPREAD)
    grown = levels(1.6, (3.0, 0.0, 0.0), assumed)
    assert 5.5 < several.horizontal < grown.horizontal < 1.05 * several.horizontal
    assert several.vertical < grown.vertical < 1.05 * several.vertical


def test_without_a_spread_the_level_is_that_of_the_covariance() -> None:
    assert levels(1.0, (9.0, 0.0, 0.0), NO_SPREAD) == levels(1.0, (0.0, 9.0, 0.0), SetUpSpread(0.0, 0.0, 0.0))

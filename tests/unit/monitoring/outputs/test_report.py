"""Whether a fix is given, and with what errors."""

from math import cos, radians, sin

import numpy as np
import pytest

from services.monitoring.outputs.report import (
    STALE_AFTER_NS,
    LatestMessages,
    Quality,
    Report,
    horizontal_ellipse,
)
from shared.maths.confidence import ELLIPSE_95
from shared.messages.gnss import CarrierSolution
from shared.messages.navigation import NavigationPhase
from shared.messages.operation import OriginKind
from shared.messages.trust import TrustLevel
from tests.support.outputs import fix, origin, satellites, solution, verdict

NS = 1_000_000_000
T = 1_700_000_000 * NS
UTC_OFFSET_NS = 37 * NS


def newest(
    state: TrustLevel = TrustLevel.SAFE, kind: OriginKind = OriginKind.LIVE, **changes: object
) -> LatestMessages:
    made = LatestMessages()
    made.add_origin(origin(T, kind), "sensors.gnss", T, retained=False)
    made.add_trust(verdict(T, state))
    made.add_fix(fix(T, T + UTC_OFFSET_NS))
    made.add_satellites(satellites(T))
    made.add_solution(solution(T, **changes), T, recorded_ns=None)
    return made


def test_a_solution_that_is_safe_is_given_with_its_utc_and_heights() -> None:
    report = newest().report(T)
    assert report.quality is Quality.AUTONOMOUS and report.place is not None
    assert report.utc_ns == T + UTC_OFFSET_NS
    assert report.place.height_msl_m == pytest.approx(513.5)


@pytest.mark.parametrize(
    ("state", "quality"),
    [
        (TrustLevel.SAFE, Quality.AUTONOMOUS),
        (TrustLevel.CAUTION, Quality.AUTONOMOUS),
        (TrustLevel.DEAD_RECKONING, Quality.ESTIMATED),
        (TrustLevel.UNSAFE, Quality.INVALID),
        (TrustLevel.NO_FIX, Quality.INVALID),
        (TrustLevel.INITIALISING, Quality.INVALID),
    ],
)
def test_the_verdict_decides_whether_a_position_is_given(state: TrustLevel, quality: Quality) -> None:
    report = newest(state).report(T)
    assert report.quality is quality
    assert (report.place is None) is (quality is Quality.INVALID)
    assert report.verdict is state


def test_a_solution_older_than_two_seconds_is_no_fix_and_time_goes_on() -> None:
    unit = newest()
    assert unit.report(T + STALE_AFTER_NS).place is not None
    stale = unit.report(T + STALE_AFTER_NS + 1)
    assert stale.place is None
    assert stale.utc_ns == T + UTC_OFFSET_NS + STALE_AFTER_NS + 1


def test_a_solution_that_comes_late_is_as_old_as_its_stamp() -> None:
    unit = newest()
    unit.add_solution(solution(T), T + STALE_AFTER_NS + 1, recorded_ns=None)
    assert unit.report(T + STALE_AFTER_NS + 1).place is None


def test_without_a_recent_verdict_or_origin_there_is_no_fix() -> None:
    unit = newest()
    unit.add_solution(solution(T + 6 * NS), T + 6 * NS, recorded_ns=None)
    assert unit.report(T + 6 * NS).place is None
    unit.add_trust(verdict(T + 6 * NS))
    assert unit.report(T + 6 * NS).place is not None
    unit.add_trust(verdict(T + 11 * NS))
    unit.add_solution(solution(T + 11 * NS), T + 11 * NS, recorded_ns=None)
    assert unit.report(T + 11 * NS).place is None, "the origin was told 11 s ago"


def test_a_retained_origin_of_an_earlier_run_says_nothing() -> None:
    unit = newest(kind=OriginKind.LIVE)
    unit.add_origin(origin(T - 11 * NS, OriginKind.SIMULATED), "sensors.simulator", T, retained=True)
    assert unit.report(T).quality is Quality.AUTONOMOUS
    unit.add_origin(origin(T - 1 * NS, OriginKind.SIMULATED), "sensors.simulator", T, retained=True)
    assert unit.report(T).quality is Quality.SIMULATOR


def test_simulated_and_replayed_data_are_those_of_a_simulator() -> None:
    assert newest(kind=OriginKind.SIMULATED).report(T).quality is Quality.SIMULATOR
    unit = newest()
    unit.add_solution(solution(T), T + 10**6 * NS, recorded_ns=T)
    replayed = unit.report(T + 10**6 * NS)
    assert replayed.quality is Quality.SIMULATOR and replayed.utc_ns == T + UTC_OFFSET_NS
    assert unit.report(T + 10**6 * NS + STALE_AFTER_NS + 1).place is None


def test_coasting_is_dead_reckoning_also_while_gnss_is_excluded() -> None:
    assert newest(phase=NavigationPhase.COASTING).report(T).quality is Quality.ESTIMATED
    assert newest(gnss_excluded_since_ns=T).report(T).quality is Quality.ESTIMATED
    assert newest(phase=NavigationPhase.LEVELLING).report(T).quality is Quality.INVALID


def test_an_excluded_receiver_does_not_change_utc() -> None:
    unit = newest()
    unit.add_trust(verdict(T, gnss_excluded=True))
    unit.add_fix(fix(T, T + 3600 * NS))
    assert unit.report(T).utc_ns == T + UTC_OFFSET_NS


@pytest.mark.parametrize(
    ("changes", "quality"),
    [
        ({"carrier_solution": CarrierSolution.FIXED}, Quality.RTK_FIXED),
        ({"carrier_solution": CarrierSolution.FLOAT}, Quality.RTK_FLOAT),
        ({"differential": True}, Quality.DIFFERENTIAL),
    ],
)
def test_the_quality_of_the_receiver_is_that_of_the_fused_solution(
    changes: dict[str, object], quality: Quality
) -> None:
    unit = newest()
    unit.add_fix(fix(T, T, **changes))
    assert unit.report(T).quality is quality


def test_below_the_lowest_speed_there_is_no_course() -> None:
    place = newest(velocity_ned_m_s=(0.6, 0.7, 0.0)).report(T).place
    assert place is not None and place.course_deg is None and place.course_sd_deg is None
    moving = newest().report(T).place
    assert moving is not None and moving.course_deg == pytest.approx(53.130102)
    assert moving.course_sd_deg == pytest.approx(np.degrees(0.1 / 5.0))


@pytest.mark.parametrize("turn_deg", [0.0, 30.0, 90.0, 120.0, 179.0])
def test_the_ellipse_has_the_axes_of_the_covariance(turn_deg: float) -> None:
    turn = radians(turn_deg)
    axes = np.array([[cos(turn), -sin(turn)], [sin(turn), cos(turn)]])
    cov = axes @ np.diag([9.0, 4.0]) @ axes.T
    major, minor, orientation = horizontal_ellipse((cov[0, 0], cov[0, 1], 0.0, cov[1, 1], 0.0, 1.0))
    assert (major, minor) == pytest.approx((3.0, 2.0))
    assert np.sin(orientation - turn) == pytest.approx(0.0, abs=1e-9)


def test_the_95_percent_ellipse_holds_95_percent() -> None:
    """Monte Carlo, 100,000 errors: the standard error of the share is 0.07 %."""
    errors = np.random.default_rng(1).normal(size=(100_000, 2))
    assert np.mean(np.hypot(*errors.T) <= ELLIPSE_95) == pytest.approx(0.95, abs=0.0025)


def test_of_many_producers_of_origins_the_newest_are_remembered() -> None:
    unit = newest()
    for number in range(1000):
        unit.add_origin(origin(T), f"sensors.{number}", T, retained=False)
    assert len(unit._origins) <= 16


def test_without_anything_there_is_a_report_without_fix() -> None:
    assert LatestMessages().report(T) == Report(None)

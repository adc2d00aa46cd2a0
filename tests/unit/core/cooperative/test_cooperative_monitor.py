"""The bank on raw epochs: start, neighbours and road, exclusion, what is refused, and satellites that come and go."""

from dataclasses import replace
from math import inf

import numpy as np
import pytest

from services.core.cooperative.broadcast.store import EphemerisStore
from services.core.cooperative.codes import Code
from services.core.cooperative.measurements import Constellation, RawEpoch, SatelliteSolution, SatelliteVerdict
from services.core.cooperative.satellites.monitor import SatelliteMonitor
from services.core.cooperative.v2x.forward import Estimate, Neighbours, range_rates
from services.core.cooperative.v2x.monitor import MAX_NEIGHBOURS, CooperativeMonitor, CooperativeSettings
from services.core.cooperative.v2x.neighbours import NeighbourReport, NeighbourTest
from shared.maths.earth import Geodetic, ecef_from_geodetic, ned_from_ecef
from shared.maths.frequency_offset import cfo_from_range_rate
from shared.messages.explanation import explain
from shared.messages.trust import Outcome
from tests.support.cases import each
from tests.support.gnss.constellation import NOW_NS, constellation, filled_store, pushed, raw_epoch

STORE = filled_store()
ORIGIN = np.array(ecef_from_geodetic(Geodetic(0.83, 0.16, 300.0)))
TO_NED = ned_from_ecef(0.83, 0.16)
SPEED_N = np.array([12.0, 5.0, 0.0])
ROAD_E = ORIGIN + np.outer([-100.0, 200.0, 500.0], TO_NED.T @ (SPEED_N / 13.0))
RECEIVER = -3e-7  # [-] of the vehicle's radio


def truth(k: float) -> np.ndarray:
    position: np.ndarray = ORIGIN + TO_NED.T @ (k * SPEED_N)
    return position


def neighbours(k: int, rng: np.random.Generator | None = None, lag_s: float = 0.0) -> tuple[NeighbourReport, ...]:
    reports = []
    cars = (
        ((30.0, 10.0, 0.0), (1.0, 0.5, 0.0)),
        ((-25.0, -12.0, 0.0), (0.0, 0.0, 0.0)),
        ((60.0, -50.0, 0.0), (-12.0, -5.0, 0.0)),
    )
    for number, (away, relative) in enumerate(cars):
        offset = 1e-7 * number
        rate = float(np.dot(relative, away) / np.linalg.norm(away))
        cfo = cfo_from_range_rate(rate, offset, RECEIVER) + (20.0 * rng.standard_normal() if rng else 0.0)
        position = truth(k - lag_s) + TO_NED.T @ np.array(away)
        velocity = TO_NED.T @ (SPEED_N + np.array(relative))
        x, y, z = position.tolist()
        vx, vy, vz = velocity.tolist()
        reports.append(NeighbourReport(f"car-{number}", (x, y, z), (vx, vy, vz), 1.0, 0.2, cfo, offset))
    return tuple(reports)


def epoch(k: int, rng: np.random.Generator | None = None, **options: object) -> RawEpoch:
    time_ns = NOW_NS + k * 10**9
    return raw_epoch(truth(k), velocity_e=TO_NED.T @ SPEED_N, gps_time_ns=time_ns, rng=rng, drift=0.0, **options)  # type: ignore[arg-type]


def start(k: int = 0) -> SatelliteSolution | None:
    return SatelliteMonitor().evaluate(epoch(k), STORE).solution


def judged(
    monitor: CooperativeMonitor, one: RawEpoch, k: int, rng: np.random.Generator | None = None
) -> SatelliteVerdict:
    return monitor.evaluate(one, STORE, neighbours(k, rng), road_e=ROAD_E, start=start(k) if k == 0 else None)


def test_a_clean_drive_passes_and_is_where_the_vehicle_is() -> None:
    rng, monitor = np.random.default_rng(1), CooperativeMonitor()
    for k in range(40):
        verdict = judged(monitor, epoch(k, rng), k, rng)
        assert verdict.outcome == Outcome.PASS, f"epoch {k}: {verdict.why}"
    assert verdict.solution is not None and verdict.solution.velocity_e is not None and verdict.hpl_m is not None
    error = float(np.linalg.norm(np.array(verdict.solution.position_e) - truth(39)))
    assert error < 5.0 and error < verdict.hpl_m < 60.0
    assert np.linalg.norm(np.array(verdict.solution.velocity_e) - TO_NED.T @ SPEED_N) < 2.0
    assert verdict.statistic is not None and verdict.threshold is not None and verdict.statistic < verdict.threshold
    assert not verdict.rejected


def test_a_ramp_of_1_m_s_is_excluded_before_it_is_40_m_and_nothing_else_is() -> None:
    rng, monitor = np.random.default_rng(2), CooperativeMonitor()
    satellite = epoch(0).measurements[3].satellite
    excluded_at = None
    for k in range(70):
        one = pushed(epoch(k, rng), satellite, max(0.0, k - 15.0))
        verdict = judged(monitor, one, k, rng)
        assert set(verdict.excluded) <= {satellite}
        if verdict.excluded and excluded_at is None:
            excluded_at = k
            assert verdict.outcome == Outcome.ACCUSES and verdict.why.values["satellites"] == (satellite.reference,)
    assert excluded_at is not None and excluded_at - 15 < 40
    assert verdict.solution is not None and np.linalg.norm(np.array(verdict.solution.position_e) - truth(69)) < 8.0


def test_with_four_satellites_a_fault_is_still_attributed() -> None:
    """Plain RAIM has no redundancy here: neighbours and map make it."""
    rng, monitor = np.random.default_rng(3), CooperativeMonitor()
    satellite = epoch(0, systems=(Constellation.GPS,)).measurements[1].satellite
    for k in range(25):
        full = epoch(k, rng, systems=(Constellation.GPS,))
        four = replace(full, measurements=full.measurements[:4])
        assert SatelliteMonitor().evaluate(four, STORE).outcome == Outcome.NOT_EVALUATED
        verdict = judged(monitor, pushed(four, satellite, 100.0 if k >= 15 else 0.0), k, rng)
        assert verdict.excluded == ((satellite,) if k >= 15 else ()), f"epoch {k}"


def test_a_jump_of_the_receivers_clock_is_no_fault() -> None:
    monitor = CooperativeMonitor()
    for k in range(20):
        clock = 45.0 if k < 10 else 45.0 + 299_792.458
        one = epoch(k, clock_m=clock, galileo_clock_m=clock + 6.0)
        verdict = judged(monitor, one, k)
        assert verdict.outcome == Outcome.PASS, f"epoch {k}: {verdict.why}"


def test_without_a_start_nothing_is_evaluated() -> None:
    verdict = CooperativeMonitor().evaluate(epoch(0), STORE, neighbours(0), road_e=ROAD_E, start=None)
    assert verdict.outcome == Outcome.NOT_EVALUATED and verdict.why == explain(Code.NO_START)


def test_without_neighbours_and_road_nothing_is_evaluated() -> None:
    verdict = CooperativeMonitor().evaluate(epoch(0), STORE, (), road_e=None, start=start())
    assert verdict.outcome == Outcome.NOT_EVALUATED and verdict.why == explain(Code.NO_NEIGHBOUR)
    assert verdict.solution is not None


def test_a_gap_or_a_step_back_in_time_starts_again() -> None:
    monitor = CooperativeMonitor()
    assert judged(monitor, epoch(0), 0).outcome == Outcome.PASS
    for k in (9, 8):
        verdict = monitor.evaluate(epoch(k), STORE, neighbours(k), road_e=ROAD_E, start=None)
        assert verdict.outcome == Outcome.NOT_EVALUATED and verdict.why == explain(Code.NO_START)
        assert monitor.evaluate(epoch(9), STORE, neighbours(9), road_e=ROAD_E, start=start(9)).outcome == Outcome.PASS


NAN = float("nan")
BAD = (
    ("neighbour_without_cfo", {"cfo_hz": None}),
    ("neighbour_without_cfo", {"cfo_hz": NAN}),
    ("neighbour_without_oscillator_offset", {"oscillator_offset": None}),
    ("neighbour_without_oscillator_offset", {"oscillator_offset": 0.3}),
    ("implausible_cfo", {"cfo_hz": 9e9}),
    ("implausible_neighbour", {"position_e": (0.0, 0.0, 0.0)}),
    ("implausible_neighbour", {"position_e": (NAN, 0.0, 0.0)}),
    ("implausible_neighbour", {"velocity_e": (4000.0, 0.0, 0.0)}),
    ("neighbour_without_accuracy", {"position_sd_m": 0.0}),
    ("neighbour_without_accuracy", {"cfo_sd_hz": NAN}),
    ("neighbour_without_accuracy", {"position_sd_m": None}),
    ("neighbour_without_accuracy", {"velocity_sd_m_s": float("inf")}),
    ("inaccurate_neighbour", {"position_sd_m": 500.0}),
    ("inaccurate_neighbour", {"velocity_sd_m_s": 40.0}),
    ("implausible_neighbour", {"position_e": tuple((truth(1) + TO_NED.T @ np.array([5000.0, 0.0, 0.0])).tolist())}),
    ("neighbour_too_near", {"position_e": tuple(truth(1).tolist())}),
)


def started() -> CooperativeMonitor:
    """A monitor that has used one epoch."""
    monitor = CooperativeMonitor()
    judged(monitor, epoch(0), 0)
    return monitor


@each(("reason", "change"), BAD)
def test_bad_neighbours_are_refused_with_a_counted_reason(reason: str, change: dict[str, object]) -> None:
    first, *rest = neighbours(1)
    reports = (replace(first, **change), *rest)  # type: ignore[arg-type]
    verdict = started().evaluate(epoch(1), STORE, reports, road_e=None, start=None)
    assert verdict.outcome == Outcome.PASS and verdict.rejected == {reason: 1}
    assert [finding.name for finding in verdict.neighbours] == [report.name for report in rest]


def test_a_crowd_of_neighbours_is_bounded() -> None:
    crowd = tuple(replace(neighbours(1)[0], name=f"car-{k}") for k in range(500))
    verdict = started().evaluate(epoch(1), STORE, crowd, road_e=None, start=None)
    assert verdict.rejected == {"too_many_neighbours": 500 - MAX_NEIGHBOURS}
    assert len(verdict.neighbours) == MAX_NEIGHBOURS


@pytest.mark.parametrize("late_s", [-1.5, 0.3])
def test_reports_from_before_the_last_epoch_or_after_this_one_are_refused(late_s: float) -> None:
    stamped = replace(neighbours(1)[0], gps_time_ns=epoch(1).gps_time_ns + round(late_s * 1e9))
    verdict = started().evaluate(epoch(1), STORE, (stamped,), road_e=None, start=None)
    assert verdict.rejected == {"late_neighbour": 1} and verdict.outcome == Outcome.NOT_EVALUATED


def test_reports_between_two_epochs_are_used_at_their_own_time() -> None:
    """Range-rates half a second before the epoch, of cars that pass: used a half second late they would contradict."""
    rng, monitor = np.random.default_rng(8), CooperativeMonitor()
    for k in range(60):
        between = tuple(
            replace(report, gps_time_ns=epoch(k).gps_time_ns - 500_000_000) for report in neighbours(k, rng, lag_s=0.5)
        )
        verdict = monitor.evaluate(epoch(k, rng), STORE, between, road_e=None, start=start(k) if k == 0 else None)
        assert not any(finding.excluded for finding in verdict.neighbours), f"epoch {k}"


def lying(k: int, rng: np.random.Generator, liars: int, speed: float) -> tuple[NeighbourReport, ...]:
    """Reports of which the first ones add the same speed, along the road, to their velocity."""
    added = speed * (TO_NED.T @ (SPEED_N / 13.0))
    reported = []
    for number, report in enumerate(neighbours(k, rng)):
        vx, vy, vz = (np.array(report.velocity_e) + (added if number < liars else 0.0)).tolist()
        reported.append(replace(report, velocity_e=(vx, vy, vz)))
    return tuple(reported)


@pytest.mark.parametrize("liars", [1, 2])
def test_neighbours_that_lie_are_excluded_and_come_back_eight_reports_after_they_tell_the_truth(liars: int) -> None:
    """Two of three lie alike: a majority, but the oscillator of the own radio is known from before."""
    rng, monitor = np.random.default_rng(9), CooperativeMonitor()
    for k in range(50):
        reports = lying(k, rng, liars, 16.0 if 20 <= k < 30 else 0.0)
        verdict = monitor.evaluate(epoch(k, rng), STORE, reports, road_e=None, start=start(k) if k == 0 else None)
        excluded = {finding.name for finding in verdict.neighbours if finding.excluded}
        assert excluded == ({f"car-{number}" for number in range(liars)} if 20 <= k < 38 else set()), f"epoch {k}"
        assert k == 0 or verdict.outcome == Outcome.PASS, "a neighbour that lies is no fault of a satellite"


def test_two_strangers_that_contradict_each_other_are_both_excluded() -> None:
    """With the own oscillator unknown nothing says which of the two lies."""
    rng, monitor = np.random.default_rng(10), started()
    first, second, _ = lying(1, rng, 1, 30.0)
    verdict = monitor.evaluate(epoch(1), STORE, (first, second), road_e=None, start=None)
    assert [finding.excluded for finding in verdict.neighbours] == [True, True]
    assert verdict.outcome == Outcome.NOT_EVALUATED and verdict.why == explain(Code.NO_NEIGHBOUR)


def test_honest_neighbours_are_excluded_at_the_design_rate() -> None:
    """Errors of estimate, published states and measurements as large as they are said to be; 5,000 lists at 1e-2."""
    rng, size, m, rate = np.random.default_rng(11), 10, 4, 1e-2
    P = np.diag([4.0, 4.0, 9.0, 1.0, 1.0, 0.1, 1.0, 4.0, 9.0, 9.0])
    position, velocity = rng.normal(0.0, (80.0, 80.0, 0.0), (m, 3)), rng.normal(0.0, (10.0, 10.0, 0.0), (m, 3))
    begun = 0
    for _ in range(5000):
        x = np.sqrt(np.diag(P)) * rng.standard_normal(size)
        published = Neighbours(position + rng.standard_normal((m, 3)), velocity, np.zeros(m), np.ones(m), np.ones(m))
        exact = published._replace(position_n=position)
        measured = range_rates(x, exact) + x[7] + rng.standard_normal(m)
        test = NeighbourTest(rate, 8, 3.0, 60.0)
        used, _ = test.evaluate(tuple("abcd"), published._replace(shifted_rate=measured), Estimate(0.0 * x, P), 0)
        begun += not used.all()
    assert abs(begun / 5000 - rate) < 4.0 * np.sqrt(rate / 5000)


def test_bad_satellites_are_counted_too() -> None:
    one = epoch(0)
    first = replace(one.measurements[0], pseudorange_m=0.0)
    bad = replace(one, measurements=(first, *one.measurements[1:]))
    verdict = CooperativeMonitor().evaluate(bad, STORE, neighbours(0), road_e=ROAD_E, start=start())
    assert verdict.rejected == {"implausible_pseudorange": 1} and verdict.outcome == Outcome.PASS
    empty = CooperativeMonitor().evaluate(replace(one, measurements=()), STORE, (), road_e=ROAD_E, start=start())
    assert empty.outcome == Outcome.NOT_EVALUATED and empty.why == explain(Code.NO_SATELLITE)


def test_satellites_that_come_and_go_do_not_disturb_the_others() -> None:
    monitor = CooperativeMonitor()
    for k in range(30):
        full = epoch(k)
        part = full.measurements if k % 7 < 3 else full.measurements[k % 3 :: 2]
        verdict = judged(monitor, replace(full, measurements=part), k)
        assert verdict.outcome == Outcome.PASS, f"epoch {k}: {verdict.why}"
        assert len(verdict.findings) == len(part)


def test_what_another_test_excludes_is_no_longer_used_until_it_has_agreed_for_eight_epochs() -> None:
    monitor = started()
    satellite = epoch(1).measurements[2].satellite
    monitor.exclude(frozenset({satellite}))
    for k in range(1, 12):
        verdict = judged(monitor, epoch(k), k)
        assert verdict.excluded == ((satellite,) if k < 8 else ()), f"epoch {k}"


def half_of_the_sky(k: int, rng: np.random.Generator | None = None) -> RawEpoch:
    """Every second satellite is not received: the others' directions are free for virtual ones."""
    full = epoch(k, rng)
    return replace(full, measurements=full.measurements[::2])


def test_the_papers_construction_can_be_selected_and_excludes_a_step() -> None:
    rng, monitor = np.random.default_rng(6), CooperativeMonitor(CooperativeSettings(paper_construction=True))
    satellite = half_of_the_sky(0).measurements[2].satellite
    for k in range(20):
        one = pushed(half_of_the_sky(k, rng), satellite, 150.0 if k in (10, 11) else 0.0)
        verdict = judged(monitor, one, k, rng)
        assert verdict.excluded == ((satellite,) if k in (10, 11) else ()), f"epoch {k}"


def test_the_alert_limit_selects_the_virtual_satellites_of_the_construction() -> None:
    """A level above the limit is published as it is; a wide limit leaves the sharpest tests."""
    levels = []
    for limit_m in (inf, 6.0, 1.0):
        rng, monitor = np.random.default_rng(6), CooperativeMonitor(CooperativeSettings(paper_construction=True))
        monitor.alert_limit_m = limit_m
        verdicts = [judged(monitor, half_of_the_sky(k, rng), k, rng) for k in range(8)]
        assert verdicts[-1].hpl_m is not None and not verdicts[-1].excluded
        levels.append(monitor.construction_level_m)
        assert verdicts[-1].hpl_m >= monitor.construction_level_m
    assert levels[0] == levels[1] > levels[2] > 1.0, "6 m are kept; of none within 1 m, the least is chosen"


def test_the_bank_excludes_a_ramp_of_1_m_s_earlier_than_the_papers_construction() -> None:
    satellite = half_of_the_sky(0).measurements[2].satellite
    found = []
    for paper in (True, False):
        rng, monitor = np.random.default_rng(7), CooperativeMonitor(CooperativeSettings(paper_construction=paper))
        times = [
            k
            for k in range(60)
            if judged(monitor, pushed(half_of_the_sky(k, rng), satellite, max(0.0, k - 15.0)), k, rng).excluded
        ]
        found.append(len(times))
    assert 0 < found[0] < found[1]


def test_without_virtual_satellites_the_construction_is_not_evaluated() -> None:
    one, store = epoch(0), EphemerisStore()
    received = {measurement.satellite for measurement in one.measurements}
    for ephemeris in constellation():
        if ephemeris.satellite in received:
            store.add(ephemeris)
    monitor = CooperativeMonitor(CooperativeSettings(paper_construction=True))
    verdict = monitor.evaluate(one, store, neighbours(0), road_e=ROAD_E, start=start())
    assert verdict.outcome == Outcome.NOT_EVALUATED and verdict.why == explain(Code.FEW_VIRTUAL)

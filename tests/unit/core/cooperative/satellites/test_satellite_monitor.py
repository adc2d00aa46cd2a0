"""Plain RAIM on synthetic epochs: where the receiver is, what is excluded, what is refused and why."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from services.core.cooperative.codes import Code
from services.core.cooperative.measurements import Constellation, Measurement, RawEpoch, SatelliteId
from services.core.cooperative.satellites.monitor import RaimSettings, SatelliteMonitor
from shared.maths.earth import Geodetic, ecef_from_geodetic, ned_from_ecef
from shared.messages.explanation import explain
from shared.messages.trust import Outcome
from tests.support.cases import each
from tests.support.gnss.constellation import NOW_NS, constellation, filled_store, pushed, raw_epoch, sight_of

HERE = np.array(ecef_from_geodetic(Geodetic(0.83, 0.16, 300.0)))
TO_NED = ned_from_ecef(0.83, 0.16)
VELOCITY = TO_NED.T @ np.array([20.0, -7.0, 0.5])
STORE = filled_store()
DAY_NS = 86_400 * 10**9


@pytest.mark.parametrize(
    "place",
    [Geodetic(0.83, 0.16, 300.0), Geodetic(-0.6, 3.1, 0.0), Geodetic(0.0, -1.5, 4000.0), Geodetic(1.57, 0.0, 0.0)],
)
def test_without_noise_position_velocity_and_clocks_are_the_truth(place: Geodetic) -> None:
    position = np.array(ecef_from_geodetic(place))
    epoch = raw_epoch(position, velocity_e=VELOCITY)
    verdict = SatelliteMonitor().evaluate(epoch, STORE)
    assert verdict.outcome == Outcome.PASS and verdict.fault_free and verdict.solution is not None
    assert np.linalg.norm(verdict.solution.position_e - position) < 0.02, "[m]; range times range-rate over c"
    assert verdict.solution.clock_m == pytest.approx({Constellation.GPS: 45.0, Constellation.GALILEO: 51.0}, abs=0.02)
    assert verdict.solution.velocity_e is not None
    assert np.linalg.norm(np.array(verdict.solution.velocity_e) - VELOCITY) < 0.01, "[m/s]; flight-time terms"
    assert verdict.solution.clock_drift_m_s == pytest.approx(3.0, abs=0.01)
    assert verdict.dof == len(epoch.measurements) - 5


def test_a_receiver_clock_that_is_a_millisecond_off_moves_nothing() -> None:
    epoch = raw_epoch(HERE, clock_m=299_792.0, galileo_clock_m=299_798.0)
    verdict = SatelliteMonitor().evaluate(epoch, STORE)
    assert verdict.solution is not None and np.linalg.norm(verdict.solution.position_e - HERE) < 5.0
    assert verdict.outcome == Outcome.PASS


def test_errors_are_as_large_as_the_covariance_says() -> None:
    rng = np.random.default_rng(1)
    squares = []
    for _ in range(150):
        solution = SatelliteMonitor().evaluate(raw_epoch(HERE, rng=rng), STORE).solution
        assert solution is not None and solution.velocity_e is not None and solution.velocity_cov_e is not None
        error = np.array(solution.position_e) - HERE
        speed = np.array(solution.velocity_e)
        squares.append(
            (
                error @ np.linalg.solve(solution.position_cov_e, error),
                speed @ np.linalg.solve(solution.velocity_cov_e, speed),
            )
        )
    # NEES of three axes: mean 3, standard deviation of the mean sqrt(6/150) = 0.2
    assert np.mean(squares, axis=0) == pytest.approx([3.0, 3.0], abs=0.7)


def test_false_alarms_come_at_the_design_rate() -> None:
    rng, rate, epochs = np.random.default_rng(2), 0.05, 200
    alarms = 0
    for _ in range(epochs):
        monitor = SatelliteMonitor(RaimSettings(false_alarm_rate=rate))
        alarms += monitor.evaluate(raw_epoch(HERE, rng=rng), STORE).outcome == Outcome.ACCUSES
    assert binom.ppf(0.005, epochs, rate) <= alarms <= binom.ppf(0.995, epochs, rate)


def test_a_push_of_50_m_is_excluded_within_one_epoch_wherever_it_can_be_attributed() -> None:
    rng = np.random.default_rng(3)
    tried = 0
    for systems in (tuple(Constellation), (Constellation.GPS,), (Constellation.GALILEO,)):
        epoch = raw_epoch(HERE, rng=rng, systems=systems)
        clean = SatelliteMonitor().evaluate(epoch, STORE)
        for finding in clean.findings:
            for bias in (50.0, -50.0):
                verdict = SatelliteMonitor().evaluate(pushed(epoch, finding.satellite, bias), STORE)
                if clean.dof < 2 or finding.mib_m is None or finding.mib_m >= 50.0:
                    continue
                tried += 1
                assert verdict.outcome == Outcome.ACCUSES and verdict.excluded == (finding.satellite,)
                assert verdict.statistic is not None and verdict.threshold is not None
                assert verdict.statistic <= verdict.threshold
                assert verdict.why.values["satellites"] == (finding.satellite.reference,)
    assert tried > 30


def test_two_pushed_satellites_are_both_excluded() -> None:
    epoch = raw_epoch(HERE, rng=np.random.default_rng(4))
    first, second = epoch.measurements[0].satellite, epoch.measurements[-1].satellite
    verdict = SatelliteMonitor().evaluate(pushed(pushed(epoch, first, 90.0), second, -120.0), STORE)
    assert set(verdict.excluded) == {first, second} and verdict.solution is not None
    assert np.linalg.norm(verdict.solution.position_e - HERE) < 15.0


def test_an_excluded_satellite_comes_back_after_eight_healthy_epochs() -> None:
    rng, monitor = np.random.default_rng(5), SatelliteMonitor()
    clean = raw_epoch(HERE, rng=rng)
    satellite = clean.measurements[2].satellite
    assert monitor.evaluate(pushed(clean, satellite, 80.0), STORE).excluded == (satellite,)
    states = []
    for _ in range(10):
        states.append(monitor.evaluate(raw_epoch(HERE), STORE).outcome)
    assert states == [Outcome.ACCUSES] * 8 + [Outcome.PASS] * 2


def test_a_fault_in_between_begins_the_count_again() -> None:
    monitor = SatelliteMonitor()
    clean = raw_epoch(HERE)
    satellite = clean.measurements[2].satellite
    faulty = pushed(clean, satellite, 80.0)
    outcomes = [monitor.evaluate(epoch, STORE).outcome for epoch in (faulty, *[clean] * 6, faulty, *[clean] * 8, clean)]
    assert outcomes == [Outcome.ACCUSES] * 16 + [Outcome.PASS]


def of_gps(count: int) -> RawEpoch:
    epoch = raw_epoch(HERE, systems=(Constellation.GPS,))
    return replace(epoch, measurements=epoch.measurements[:count])


def test_without_redundancy_nothing_is_evaluated_but_there_is_a_position() -> None:
    verdict = SatelliteMonitor().evaluate(of_gps(4), STORE)
    assert verdict.outcome == Outcome.NOT_EVALUATED and verdict.why == explain(
        Code.NO_REDUNDANCY, satellites_count=4, clocks_count=1
    )
    assert verdict.statistic is None and not verdict.fault_free and verdict.solution is not None


@pytest.mark.parametrize("count", [0, 1, 3])
def test_too_few_satellites_are_no_solution(count: int) -> None:
    verdict = SatelliteMonitor().evaluate(of_gps(count), STORE)
    assert verdict.outcome == Outcome.NOT_EVALUATED and verdict.solution is None


def test_with_one_redundancy_a_fault_accuses_nobody() -> None:
    epoch = of_gps(5)
    verdict = SatelliteMonitor().evaluate(pushed(epoch, epoch.measurements[0].satellite, 500.0), STORE)
    assert verdict.outcome == Outcome.ACCUSES and verdict.excluded == () and not verdict.fault_free
    assert verdict.statistic is not None and verdict.threshold is not None and verdict.statistic > verdict.threshold


def test_a_satellite_alone_in_its_constellation_is_left_out() -> None:
    both, gps = raw_epoch(HERE), raw_epoch(HERE, systems=(Constellation.GPS,))
    alone = next(
        measurement for measurement in both.measurements if measurement.satellite.constellation == Constellation.GALILEO
    )
    verdict = SatelliteMonitor().evaluate(replace(gps, measurements=(*gps.measurements, alone)), STORE)
    assert verdict.rejected == {"alone_in_constellation": 1} and verdict.dof == len(gps.measurements) - 4


def below_the_horizon() -> Measurement:
    for ephemeris in constellation():
        distance, sight = sight_of(ephemeris, HERE, NOW_NS)
        if (np.array(sight.position_e) - HERE) @ HERE < -1e6 * np.linalg.norm(HERE) and ephemeris.satellite.number < 12:
            return Measurement(ephemeris.satellite, distance, None, 45.0)
    raise AssertionError("a satellite of the constellation is below the horizon")


FIRST = raw_epoch(HERE).measurements[0]
BAD = (
    ("implausible_pseudorange", replace(FIRST, pseudorange_m=0.0)),
    ("implausible_pseudorange", replace(FIRST, pseudorange_m=float("nan"))),
    ("implausible_pseudorange", replace(FIRST, pseudorange_m=float("inf"))),
    ("implausible_pseudorange", replace(FIRST, pseudorange_m=-2e7)),
    ("weak_signal", replace(FIRST, cn0_db_hz=12.0)),
    ("weak_signal", replace(FIRST, cn0_db_hz=float("nan"))),
    ("no_ephemeris", replace(FIRST, satellite=SatelliteId(Constellation.GPS, 31))),
    ("duplicate_satellite", replace(raw_epoch(HERE).measurements[1])),
    ("below_horizon", below_the_horizon()),
)


@each(("reason", "bad"), BAD)
def test_bad_measurements_are_refused_with_a_counted_reason(reason: str, bad: Measurement) -> None:
    epoch = raw_epoch(HERE)
    rest = tuple(
        measurement
        for measurement in epoch.measurements
        if measurement is not FIRST and measurement.satellite != FIRST.satellite
    )
    verdict = SatelliteMonitor().evaluate(replace(epoch, measurements=(*rest, bad)), STORE)
    assert verdict.rejected == {reason: 1} and verdict.outcome == Outcome.PASS
    assert verdict.solution is not None and np.linalg.norm(verdict.solution.position_e - HERE) < 0.05


def test_ephemerides_of_two_days_ago_are_refused() -> None:
    epoch = raw_epoch(HERE)
    verdict = SatelliteMonitor().evaluate(replace(epoch, gps_time_ns=epoch.gps_time_ns + 2 * DAY_NS), STORE)
    assert verdict.outcome == Outcome.NOT_EVALUATED and verdict.rejected == {"old_ephemeris": len(epoch.measurements)}


@pytest.mark.parametrize("doppler", [None, float("nan"), 1e9])
def test_without_doppler_there_is_a_position_and_no_velocity(doppler: float | None) -> None:
    epoch = raw_epoch(HERE)
    silent = replace(
        epoch, measurements=tuple(replace(measurement, doppler_hz=doppler) for measurement in epoch.measurements)
    )
    verdict = SatelliteMonitor().evaluate(silent, STORE)
    assert verdict.outcome == Outcome.PASS and verdict.solution is not None and verdict.solution.velocity_e is None


def test_a_doppler_that_contradicts_the_others_is_left_out_of_the_velocity() -> None:
    epoch = raw_epoch(HERE, velocity_e=VELOCITY)
    wrong = replace(FIRST, doppler_hz=(FIRST.doppler_hz or 0.0) + 40.0)
    verdict = SatelliteMonitor().evaluate(replace(epoch, measurements=(wrong, *epoch.measurements[1:])), STORE)
    assert verdict.outcome == Outcome.PASS and verdict.solution is not None
    assert verdict.solution.doppler_excluded == (FIRST.satellite,) and verdict.solution.velocity_e is not None
    assert np.linalg.norm(np.array(verdict.solution.velocity_e) - VELOCITY) < 0.01


def test_weak_signals_count_less() -> None:
    epoch = raw_epoch(HERE)
    weak = replace(epoch, measurements=(replace(FIRST, cn0_db_hz=30.0), *epoch.measurements[1:]))
    sds = [SatelliteMonitor().evaluate(raw_epoch, STORE).findings[0].sd_m for raw_epoch in (epoch, weak)]
    assert sds[1] > 1.2 * sds[0]

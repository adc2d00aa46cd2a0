"""The process core.cooperative: raw epochs and navigation words in, the statement `satellites` out."""

from math import radians

import numpy as np
import pytest

from services.core.cooperative.codes import Code
from services.core.cooperative.measurements import Constellation, RawEpoch, SatelliteId
from services.core.cooperative.process import Config, In, Process
from services.core.cooperative.statements import MAX_TESTS
from shared.maths.earth import Geodetic, ecef_from_geodetic
from shared.messages.base import Tick
from shared.messages.explanation import Reference, ReferenceKind, explain
from shared.messages.gnss import Constellation as System
from shared.messages.gnss import FixType, GnssFix, GnssNavigationBits, GnssRawEpoch, RawMeasurement
from shared.messages.trust import Outcome, TrustMonitor
from shared.trust.result import SATELLITE_LEFT_OUT
from tests.support.gnss.constellation import NOW_NS, constellation, inav_pages, lnav_subframes, pushed, raw_epoch

NS = 1_000_000_000
HERE = np.array(ecef_from_geodetic(Geodetic(radians(42.37), radians(13.35), 700.0)))


def bits(time_s: float, satellites: tuple[str, ...] | None = None) -> list[GnssNavigationBits]:
    """The whole ephemerides of all satellites, or of some."""
    found = []
    for ephemeris in constellation():
        if satellites is not None and str(ephemeris.satellite) not in satellites:
            continue
        gps = ephemeris.satellite.constellation == Constellation.GPS
        for words in lnav_subframes(ephemeris, NOW_NS) if gps else inav_pages(ephemeris, NOW_NS):
            found.append(GnssNavigationBits(
                sampled_ns=round(time_s * NS), received_ns=round(time_s * NS), source="gnss0",
                constellation=System.GPS if gps else System.GALILEO, number=ephemeris.satellite.number,
                signal="1C" if gps else "1B", words=words,
            ))  # fmt: skip
    return found


def message(epoch: RawEpoch, time_s: float, source: str = "gnss0", signal: str = "1C") -> GnssRawEpoch:
    return GnssRawEpoch(
        sampled_ns=round(time_s * NS), received_ns=round(time_s * NS), source=source, gps_time_ns=epoch.gps_time_ns,
        measurements=tuple(
            RawMeasurement(
                constellation=System(measurement.satellite.constellation.value),
                number=measurement.satellite.number, signal=signal,
                pseudorange_m=measurement.pseudorange_m, doppler_hz=measurement.doppler_hz,
                cn0_db_hz=measurement.cn0_db_hz,
            )
            for measurement in epoch.measurements
        ),
    )  # fmt: skip


def at(second: int, seed: int = 1, push: tuple[SatelliteId, float] | None = None) -> RawEpoch:
    epoch = raw_epoch(HERE, gps_time_ns=NOW_NS + second * NS, rng=np.random.default_rng((seed, second)))
    return pushed(epoch, *push) if push else epoch


def said(process: Process, *messages: In) -> list[TrustMonitor]:
    produced = (item for message in messages for item in process.handle(message))
    return [trust_monitor for trust_monitor in produced if isinstance(trust_monitor, TrustMonitor)]


def informed(satellites: tuple[str, ...] | None = None, config: Config | None = None) -> Process:
    """A process that knows the time and ephemerides."""
    process = Process(config or Config())
    said(process, GnssFix(
        sampled_ns=0, received_ns=0, source="gnss0", gps_time_ns=NOW_NS, fix_type=FixType.THREE_D,
    ), *bits(0.0, satellites))  # fmt: skip
    return process


def test_before_raw_measurements_arrive_the_satellites_are_not_evaluated() -> None:
    process = Process(Config())
    first, second = said(process, Tick(now_ns=NS), Tick(now_ns=2 * NS))
    assert (first.monitor, first.outcome) == ("satellites", Outcome.NOT_EVALUATED)
    assert first.reason_code == explain(Code.NO_RECEIVER)
    assert (first.since_ns, second.since_ns, second.sampled_ns) == (NS, NS, 2 * NS)
    assert first.statistic is None and first.threshold is None and not first.tests


def test_satellites_that_agree_pass_with_one_test_each() -> None:
    (statement,) = said(informed(), message(at(1), 1.0))
    assert statement.outcome is Outcome.PASS
    assert statement.statistic is not None and statement.threshold is not None
    assert statement.statistic < statement.threshold
    assert statement.false_alarm_rate == 1e-5
    *satellites, cooperative, level = statement.tests
    assert level.threshold == 10.0, "the alert limit of a vehicle that states none"
    assert 10 < len(satellites) <= MAX_TESTS
    for test in satellites:
        assert test.outcome is Outcome.PASS and test.reason_code is not None and not test.reason
        assert test.reason_code.subject == Reference(kind=ReferenceKind.SATELLITE, name=test.name)
        assert test.reason_code.code == Code.USED and test.reason_code.values.keys() == {"residual_m", "bias_m"}
    assert (cooperative.name, cooperative.outcome) == ("cooperative", Outcome.NOT_EVALUATED)


def test_a_push_of_50_m_is_excluded_in_its_epoch_and_the_satellite_returns_when_it_has_agreed() -> None:
    process, victim = informed(), at(1).measurements[3].satellite
    (before,) = said(process, message(at(1), 1.0))
    (accusing,) = said(process, message(at(2, push=(victim, 50.0)), 2.0))
    assert before.outcome is Outcome.PASS
    assert (accusing.outcome, accusing.accused) == (Outcome.ACCUSES, (str(victim),))
    assert (accusing.since_ns, accusing.suspect_since_ns) == (2 * NS, NS)
    assert accusing.reason_code is not None and accusing.reason_code.values["satellites"] == (victim.reference,)
    first = accusing.tests[0]
    assert first.name == str(victim) and first.reason_code is not None
    assert (first.reason_code.subject, first.reason_code.code) == (victim.reference, SATELLITE_LEFT_OUT)
    later = said(process, *(message(at(k), float(k)) for k in range(3, 13)))
    assert [trust_monitor.outcome for trust_monitor in later[:7]] == [Outcome.ACCUSES] * 7, (
        "re-admission takes eight epochs"
    )
    assert {trust_monitor.since_ns for trust_monitor in later[:7]} == {2 * NS}
    assert later[-1].outcome is Outcome.PASS and not later[-1].accused


def test_a_fault_that_cannot_be_attributed_accuses_gnss() -> None:
    """Five GPS satellites have one degree of freedom: a fault is detected, and all w are equal."""
    gps = [
        measurement for measurement in at(1).measurements if measurement.satellite.constellation == Constellation.GPS
    ][:5]
    process = informed()
    five = RawEpoch(at(1).gps_time_ns, tuple(gps))
    (statement,) = said(process, message(pushed(five, gps[0].satellite, 500.0), 1.0))
    assert (statement.outcome, statement.accused) == (Outcome.ACCUSES, ("gnss",))
    assert statement.reason_code == explain(Code.UNRESOLVED, satellites_count=5)


def test_four_satellites_are_not_evaluated() -> None:
    gps = tuple(
        measurement for measurement in at(1).measurements if measurement.satellite.constellation == Constellation.GPS
    )[:4]
    (statement,) = said(informed(), message(RawEpoch(at(1).gps_time_ns, gps), 1.0))
    assert statement.outcome is Outcome.NOT_EVALUATED
    assert statement.reason_code == explain(Code.NO_REDUNDANCY, satellites_count=4, clocks_count=1)


def test_missing_ephemerides_are_the_reason() -> None:
    gps = tuple(
        measurement for measurement in at(1).measurements if measurement.satellite.constellation == Constellation.GPS
    )[:4]
    process = informed(tuple(str(measurement.satellite) for measurement in gps[:2]))
    (statement,) = said(process, message(RawEpoch(at(1).gps_time_ns, gps), 1.0))
    assert statement.outcome is Outcome.NOT_EVALUATED
    assert statement.reason_code == explain(Code.EPHEMERIDES_MISSING, known_count=2, measured_count=4)
    assert not process.rejects


def test_measurements_that_stop_are_not_evaluated_after_three_seconds() -> None:
    process = informed()
    assert not said(process, message(at(1), 1.0), Tick(now_ns=3 * NS))[1:]
    (statement,) = said(process, Tick(now_ns=5 * NS))
    assert (statement.outcome, statement.reason_code) == (Outcome.NOT_EVALUATED, explain(Code.SILENT, age_s=4))
    assert statement.since_ns == 5 * NS


def test_navigation_words_before_the_time_is_known_and_a_second_receiver_are_counted() -> None:
    process = Process(Config())
    said(process, *bits(0.0, ("G01",)))
    assert process.rejects == {"navigation_words_without_time": 3}
    process = informed()
    assert len(said(process, message(at(1), 1.0), message(at(2), 2.0, source="gnss1"))) == 1
    assert process.rejects == {"second_receiver": 1}
    assert len(said(process, message(at(9), 9.0, source="gnss1"))) == 1, "the first is silent"


def test_epochs_that_follow_faster_than_one_a_second_are_not_evaluated() -> None:
    assert len(said(informed(), *(message(at(0), 1.0 + 0.1 * k) for k in range(21)))) == 3


@pytest.mark.parametrize("signal", ["2L", "7Q", "5I"])
def test_other_frequencies_are_not_used(signal: str) -> None:
    (statement,) = said(informed(), message(at(1), 1.0, signal=signal))
    assert statement.reason_code == explain(Code.NO_MEASUREMENTS)


def test_an_implausible_pseudorange_is_refused_with_its_reason() -> None:
    process = informed()
    victim = at(1).measurements[0].satellite
    (statement,) = said(process, message(pushed(at(1), victim, 8e7), 1.0))
    assert statement.outcome is Outcome.PASS
    assert process.rejects == {"implausible_pseudorange": 1}

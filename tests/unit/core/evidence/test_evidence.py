"""The monitor `evidence`: each cause alone accuses by its own test, and a quiet receiver passes."""

from collections.abc import Callable, Iterator
from itertools import pairwise
from math import radians

import numpy as np
import pytest

from services.core.evidence.baselines import ClockPrediction, SlowMean, TimeOffset
from services.core.evidence.codes import Code
from services.core.evidence.monitor import EvidenceMonitor, EvidenceTest, evaluation
from services.core.evidence.process import Config, Process
from services.parsers.gnss.process import Config as ParserConfig
from services.parsers.gnss.process import Process as Parser
from services.sensors.simulator.world import DEFAULT_START_NS, messages
from shared.attacks import schedule
from shared.messages.base import Tick
from shared.messages.explanation import Explanation, explain
from shared.messages.gnss import (
    Constellation,
    FixType,
    GnssFix,
    GnssRaw,
    GnssSatellites,
    GnssSignalQuality,
    InterferenceState,
    RadioPath,
    ReceiverClock,
    ReceiverStatus,
    Satellite,
    SignalFlags,
)
from shared.messages.operation import HostClock
from shared.messages.trust import MonitorTest, Outcome, TrustMonitor
from shared.runtime.config import parse_vehicle
from shared.runtime.offline import OfflineUnit
from tests.support.cases import each
from tests.support.data import recording
from tests.support.drives.golden import VEHICLE

NS = 1_000_000_000
UTC_NS = 1_800_000_000 * NS
UNKNOWN, NONE, INDICATED, SEVERE = InterferenceState
PASS, ACCUSES, NOT_EVALUATED = Outcome.PASS, Outcome.ACCUSES, Outcome.NOT_EVALUATED
CN0 = (33.0, 36.0, 39.0, 42.0, 44.0, 46.0, 47.0, 40.0)
Epoch = tuple[GnssSignalQuality, GnssSatellites, GnssFix]
Change = Callable[[Epoch], Epoch]


def quality(second: int, **changes: object) -> GnssSignalQuality:
    bias_s = (4e-4 + 367e-9 * second + 5e-4) % 1e-3 - 5e-4
    quiet = GnssSignalQuality(
        sampled_ns=second * NS, received_ns=second * NS, source="gnss0", status=ReceiverStatus(spoofing=NONE),
        security=SignalFlags(jamming=NONE, spoofing=NONE),
        radio_paths=tuple(RadioPath(number=k, jamming=NONE, gain_ratio=0.6, noise_level=90) for k in (0, 1)),
        clock=ReceiverClock(bias_s=bias_s, drift_ratio=367e-9, bias_sd_s=1e-8, drift_sd_ratio=2e-10),
    )  # fmt: skip
    return quiet.model_copy(update=changes)


def satellites(second: int, cn0: tuple[float, ...] = CN0, top_deg: float = 80.0) -> GnssSatellites:
    rows = tuple(
        Satellite(constellation=Constellation.GPS, number=k + 1, cn0_db_hz=value, used=True,
                  elevation_rad=radians(10.0 + (top_deg - 10.0) * k / (len(cn0) - 1)))
        for k, value in enumerate(cn0)
    )  # fmt: skip
    return GnssSatellites(sampled_ns=second * NS, received_ns=second * NS, source="gnss0", satellites=rows)


def fix(second: int, ahead_s: float = 0.0, source: str = "gnss0") -> GnssFix:
    return GnssFix(
        sampled_ns=second * NS, received_ns=second * NS + 80_000_000, source=source, fix_type=FixType.THREE_D,
        utc_ns=UTC_NS + second * NS + round(ahead_s * NS),
    )  # fmt: skip


def host_clock(second: int, **changes: object) -> HostClock:
    held = HostClock(sampled_ns=second * NS, utc_ns=UTC_NS + second * NS, synchronised=True, maximum_error_s=0.1)
    return held.model_copy(update=changes)


def statements(
    seconds: int, change: Change, begin: int, process: Process | None = None,
    read_clock: Callable[[int], HostClock | None] = host_clock,
) -> Iterator[TrustMonitor]:  # fmt: skip
    """Statements of a quiet receiver, of which one thing changes from a second on, beside the host's clock."""
    process = process or Process(Config())
    for k in range(1, seconds + 1):
        epoch: Epoch = (quality(k), satellites(k), fix(k))
        if k % 10 == 1 and (reading := read_clock(k)) is not None:
            assert not list(process.handle(reading))
        for message in change(epoch) if k >= begin else epoch:
            assert not list(process.handle(message))
        yield from process.handle(Tick(now_ns=k * NS + NS // 2))


def by_name(statement: TrustMonitor) -> dict[str, MonitorTest]:
    return {test.name: test for test in statement.tests}


def unchanged(epoch: Epoch) -> Epoch:
    return epoch


def with_quality(**changes: object) -> Change:
    return lambda epoch: (epoch[0].model_copy(update=changes), *epoch[1:])


def jammed(number: int, state: InterferenceState) -> Change:
    return lambda epoch: (
        epoch[0].model_copy(update={"radio_paths": tuple(
            path.model_copy(update={"jamming": state}) if path.number == number else path
            for path in epoch[0].radio_paths
        )}), *epoch[1:],
    )  # fmt: skip


def gain(ratio: float) -> Change:
    return lambda epoch: (
        epoch[0].model_copy(update={"radio_paths": tuple(
            path.model_copy(update={"gain_ratio": ratio}) for path in epoch[0].radio_paths
        )}), *epoch[1:],
    )  # fmt: skip


def clock(bias_s: float = 0.0, drift_ratio: float = 0.0) -> Change:
    def change(epoch: Epoch) -> Epoch:
        old = epoch[0].clock
        assert old is not None
        new = {"bias_s": old.bias_s + bias_s, "drift_ratio": old.drift_ratio + drift_ratio}
        return epoch[0].model_copy(update={"clock": old.model_copy(update=new)}), *epoch[1:]

    return change


def level(cn0: tuple[float, ...]) -> Change:
    return lambda epoch: (epoch[0], satellites(epoch[0].sampled_ns // NS, cn0), epoch[2])


def pushed(ahead_s: float) -> Change:
    return lambda epoch: (epoch[0], epoch[1], fix(epoch[0].sampled_ns // NS, ahead_s))


BEGIN = 120
CAUSES: dict[str, tuple[Change, str]] = {
    "NAV-STATUS: spoofing indicated": (with_quality(status=ReceiverStatus(spoofing=INDICATED)), "spoofing_flag"),
    "SEC-SIG: spoofing affirmed": (
        with_quality(security=SignalFlags(jamming=NONE, spoofing=SEVERE)), "spoofing_flag",
    ),
    "SEC-SIG: jamming": (with_quality(security=SignalFlags(jamming=INDICATED, spoofing=NONE)), "jamming_flag"),
    "MON-RF: jamming of the second path": (jammed(1, SEVERE), "jamming_flag"),
    "gain 15 % lower": (gain(0.6 * 0.85), "gain"),
    "C/N0 12 dB higher": (level(tuple(value + 12.0 for value in CN0)), "cn0_level"),
    "equal C/N0": (level((44.0, 44.5, 45.0, 44.0, 43.5, 44.0, 44.5, 45.0)), "cn0_spread"),
    "clock 100 m late": (clock(bias_s=-100.0 / 299_792_458.0), "clock"),
    "drift 60 m/s": (clock(drift_ratio=2e-7), "clock"),
    "step of the clock mapping": (with_quality(time_step_s=1.0), "gnss_time"),
    "UTC 0.5 s ahead": (pushed(0.5), "gnss_time"),
    "UTC 0.5 s back": (pushed(-0.5), "gnss_time"),
}  # fmt: skip


@each("cause", CAUSES)
def test_each_cause_alone_accuses_gnss_by_exactly_its_own_test(cause: str) -> None:
    change, expected = CAUSES[cause]
    found = list(statements(BEGIN + 15, change, BEGIN))
    assert {statement.outcome for statement in found[: BEGIN - 1]} == {PASS}
    accusing = [statement for statement in found if statement.outcome is ACCUSES]
    assert accusing and {name for statement in accusing for name, test in by_name(statement).items()
                         if test.outcome is ACCUSES} == {expected}  # fmt: skip
    first = accusing[0]
    assert first.accused == ("gnss",) and first.sampled_ns / NS <= BEGIN + 11.5
    assert first.statistic is not None and first.threshold is not None and first.statistic > first.threshold
    assert first.suspect_since_ns is not None and first.suspect_since_ns / NS <= BEGIN


def test_a_quiet_receiver_passes_by_all_tests_once_the_means_are_learned() -> None:
    last = list(statements(100, unchanged, 1))[-1]
    others = {test.outcome for test in last.tests if test.name != "velocities"}  # that needs carrier phases
    assert last.outcome is PASS and others == {PASS} and by_name(last)["velocities"].outcome is NOT_EVALUATED
    missing = {"passed_count": 8, "tests_count": 9, "missing": ("velocities",)}
    assert last.reason_code == explain(Code.PASSES_PARTLY, **missing)


def host_time(found: Iterator[TrustMonitor]) -> list[MonitorTest]:
    return [by_name(statement)["host_time"] for statement in found]


@pytest.mark.parametrize("ahead_s", [3600.0, 3.0, -3.0])
def test_a_time_that_is_wrong_from_the_start_on_is_accused_by_the_clock_of_the_host(ahead_s: float) -> None:
    found = list(statements(30, pushed(ahead_s), 1))
    accusing = [s for s in found if s.outcome is ACCUSES]
    assert accusing[0].sampled_ns / NS == 6.5, "two evaluations of at least five arrivals"
    assert {test.name for s in accusing for test in s.tests if test.outcome is ACCUSES} == {"host_time"}
    why = accusing[-1].reason_code
    assert why is not None and why.code == Code.HOST_TIME
    assert why.values["ahead_s"] == pytest.approx(ahead_s - 0.08, rel=1e-6, abs=5e-4)
    assert accusing[-1].threshold == pytest.approx(2.1)


def test_a_time_that_is_pushed_slowly_is_accused_by_the_clock_of_the_host_alone() -> None:
    found = list(statements(300, lambda e: pushed(0.02 * (e[0].sampled_ns / NS - 60.0))(e), 60))
    accused = {test.name for s in found for test in s.tests if test.outcome is ACCUSES}
    first_s = next(s.sampled_ns / NS for s in found if s.outcome is ACCUSES)
    assert accused == {"host_time"} and 60.0 + 105.0 < first_s < 60.0 + 125.0, "2.1 s at 0.02 s a second"


@pytest.mark.parametrize(("attack", "accused"), [((), set()), (("time_push@35",), {"clock", "gnss_time", "host_time"})])
def test_the_time_of_a_simulated_receiver_agrees_with_its_host_until_it_is_pushed(
    attack: tuple[str, ...], accused: set[str]
) -> None:
    unit = OfflineUnit(parse_vehicle(VEHICLE.read_text()), ["parsers.gnss", "core.evidence"])
    drive = messages("parking_lot", 1, 60.0, attacks=[schedule(text) for text in attack])
    found = [m for m in unit.run(drive) if isinstance(m, TrustMonitor)]
    before = [by_name(s)["host_time"].outcome for s in found if s.sampled_ns < DEFAULT_START_NS + 35 * NS]
    assert before[-20:] == [PASS] * 20
    assert {test.name for s in found for test in s.tests if test.outcome is ACCUSES} == accused


def test_messages_that_are_a_second_late_do_not_contradict_the_clock_of_the_host() -> None:
    assert {test.outcome for test in host_time(statements(60, pushed(-1.0), 1))[10:]} == {PASS}


@pytest.mark.parametrize(
    ("read_clock", "why"),
    [
        (lambda second: None, explain(Code.NO_HOST_TIME)),
        (lambda second: host_clock(second, synchronised=False, maximum_error_s=None), explain(Code.NO_HOST_TIME)),
        (lambda second: host_clock(second) if second == 1 else None, explain(Code.SILENT, test="host_time", age_s=10)),
    ],
    ids=["never", "nothing holds it", "61 s old"],
)
def test_without_a_clock_that_is_held_the_time_is_not_compared(
    read_clock: Callable[[int], HostClock | None], why: Explanation
) -> None:
    last = host_time(statements(70, pushed(3600.0), 1, Process(Config(hold_s=0.0)), read_clock))[-1]
    assert last.outcome is NOT_EVALUATED and last.reason_code == why


def test_the_error_that_the_host_states_widens_the_limit() -> None:
    tests = host_time(statements(30, pushed(5.0), 1, None, lambda second: host_clock(second, maximum_error_s=16.0)))
    assert tests[-1].outcome is PASS and tests[-1].threshold == 18.0


def test_an_accusation_ends_ten_seconds_after_its_cause() -> None:
    flagged = with_quality(status=ReceiverStatus(spoofing=INDICATED))
    found = list(statements(BEGIN + 30, lambda e: flagged(e) if e[0].sampled_ns // NS < BEGIN + 5 else e, BEGIN))
    seconds = [s.sampled_ns / NS for s in found if s.outcome is ACCUSES]
    assert min(seconds) == BEGIN + 0.5 and max(seconds) == BEGIN + 13.5


@pytest.mark.parametrize("state", [None, UNKNOWN])
def test_a_detector_that_cannot_tell_is_not_evaluated(state: InterferenceState | None) -> None:
    silent = with_quality(
        status=ReceiverStatus(spoofing=state), security=SignalFlags(jamming=state, spoofing=state),
        radio_paths=(RadioPath(number=0, gain_ratio=0.6),),
    )  # fmt: skip
    last = list(statements(100, silent, 1))[-1]
    tests = by_name(last)
    assert tests["spoofing_flag"].outcome is tests["jamming_flag"].outcome is NOT_EVALUATED
    assert last.outcome is PASS and last.reason_code is not None
    assert last.reason_code.code == Code.PASSES_PARTLY
    assert last.reason_code.values["missing"] == ("spoofing_flag", "jamming_flag", "velocities")


def test_a_receiver_that_sends_no_evidence_is_not_evaluated_with_a_current_stamp() -> None:
    process = Process(Config())
    for k in range(1, 100):
        list(process.handle(fix(k, source="gnss0/nmea")))
        (statement,) = process.handle(Tick(now_ns=k * NS))
        assert statement.outcome is NOT_EVALUATED and statement.sampled_ns == k * NS
        assert statement.reason_code == explain(Code.NOTHING_STATED)


def test_evidence_that_stops_keeps_its_last_stamp_so_that_it_becomes_stale() -> None:
    process = Process(Config())
    assert list(statements(30, unchanged, 1, process))
    for k in range(31, 60):
        list(process.handle(fix(k)))
        (statement,) = process.handle(Tick(now_ns=k * NS))
        assert statement.sampled_ns == 30 * NS
    assert statement.outcome is NOT_EVALUATED and statement.reason_code is not None
    assert statement.reason_code.code == Code.NOTHING_EVALUATED
    assert by_name(statement)["spoofing_flag"].reason_code == explain(Code.SILENT, test="spoofing_flag", age_s=29)


def test_a_second_receiver_is_rejected_and_counted() -> None:
    process = Process(Config())
    list(process.handle(fix(1)))
    list(process.handle(fix(2, source="gnss1")))
    assert process.rejects == {"second receiver": 1}


def test_signals_from_one_height_are_not_judged_by_their_spread() -> None:
    even = (44.0, 44.5, 45.0, 44.0, 43.5, 44.0, 44.5, 45.0)
    last = list(statements(100, lambda e: (e[0], satellites(e[0].sampled_ns // NS, even, 45.0), e[2]), 1))[-1]
    assert last.outcome is PASS and by_name(last)["cn0_spread"].outcome is NOT_EVALUATED


def test_slow_drifts_of_gain_clock_and_time_are_no_evidence() -> None:
    def drifting(epoch: Epoch) -> Epoch:
        k = epoch[0].sampled_ns // NS
        slow = gain(0.6 - 1e-4 * k)(clock(bias_s=0.5e-9 * k * k, drift_ratio=1e-9 * k)(epoch))
        return slow[0], slow[1], fix(k, 100e-6 * k)

    assert {s.outcome for s in statements(600, drifting, 1)} == {PASS}


def test_a_jump_of_the_clock_by_a_millisecond_is_not_a_change() -> None:
    prediction = ClockPrediction()
    biases = [(4.5e-4 + 367e-9 * k + 5e-4) % 1e-3 - 5e-4 for k in range(600)]
    changes = [prediction.update((k + 1) * NS, bias_s, 367e-9, 1e-9) for k, bias_s in enumerate(biases)]
    assert any(b - a < -9e-4 for a, b in pairwise(biases)), "the clock has jumped"
    assert max(abs(change.bias_s) for change in changes if change is not None) < 1e-12


def test_the_prediction_uses_the_mean_drift_of_both_ends() -> None:
    prediction = ClockPrediction()
    assert prediction.update(NS, 0.0, 1e-7, 1e-8) is None
    change = prediction.update(3 * NS, 5e-7, 3e-7, 2e-8)
    assert change is not None and change.bias_s == pytest.approx(5e-7 - 2.0 * 2e-7, abs=1e-15)
    assert change.drift_ratio == pytest.approx(2e-7) and change.sd_s == 2e-8
    assert prediction.update(10 * NS, 0.0, 0.0, 1e-8) is None, "a pause is not predicted over"


def test_the_slow_mean_follows_a_step_with_its_time_constant() -> None:
    mean = SlowMean(100.0, 10.0)
    for k in range(200):
        mean.update(k * NS, 1.0)
    assert mean.value == pytest.approx(1.0)
    for k in range(200, 300):
        mean.update(k * NS, 2.0)
    assert mean.value == pytest.approx(2.0 - np.exp(-1.0), abs=1e-6)


def test_the_offset_of_time_ignores_delays_and_sees_a_jump_ahead_at_once() -> None:
    offset, rng = TimeOffset(), np.random.default_rng(3)
    steps = []
    for k in range(1, 200):
        utc_ns = UTC_NS + k * NS + (400_000_000 if k >= 150 else 0)
        delay_ns = round(1e9 * min(0.05 + rng.exponential(0.02), 0.4))
        steps.append(offset.step(k * NS + delay_ns, utc_ns))
    assert steps[13] is None and all(abs(step) < 0.1 for step in steps[20:149] if step is not None)
    assert steps[149] is not None and steps[149] == pytest.approx(0.4, abs=0.1)


def test_arrivals_that_become_late_little_by_little_are_no_jump_back_of_time() -> None:
    offset, rng = TimeOffset(), np.random.default_rng(3)
    for k in range(1, 300):
        late_s = min(max(0.0, 0.02 * (k - 150)), 1.5)
        step = offset.step(k * NS + round(1e9 * (late_s + 0.05 + rng.exponential(0.02))), UTC_NS + k * NS)
        assert step is None or abs(step) < 0.3


def test_a_jump_back_of_time_shows_when_it_is_ten_seconds_old() -> None:
    offset = TimeOffset()
    steps = [offset.step(k * NS, UTC_NS + k * NS - (800_000_000 if k >= 150 else 0)) for k in range(1, 200)]
    assert steps[149] == 0.0 and steps[159] == pytest.approx(-0.8)


@pytest.mark.recording
@pytest.mark.parametrize(
    ("folder", "name", "least"),
    [
        ("gpsd_receiver_logs", "ublox-zed-f9r.log", 25),
        ("gpsd_receiver_logs", "u-blox-m8t-time.log", 140),
        ("gpsd_receiver_logs", "ublox-neo-m8l.log", 15),
        ("gpsd_receiver_logs", "ublox-glo.log", 250),
        ("osnma", "ublox/ublox_2026_03.ubx", 4700),
    ],
)
def test_a_recorded_receiver_is_not_accused(folder: str, name: str, least: int) -> None:
    """The bytes have no stamps: each epoch is given the time at which it would arrive at 1 Hz."""
    parser, monitor = Parser(ParserConfig()), EvidenceMonitor()
    seconds, epochs, accused = 0, 0, 0
    data = (recording(folder) / name).read_bytes()
    for k in range(0, len(data), 64):
        raw = GnssRaw(received_ns=(seconds + 1) * NS + k, source="gnss0", data=data[k : k + 64])
        for message in parser.handle(raw):
            match message:
                case GnssSignalQuality():
                    epochs += 1
                    monitor.quality(message.model_copy(update={"sampled_ns": epochs * NS, "time_step_s": None}))
                case GnssSatellites():
                    seconds += 1
                    monitor.satellites(message.model_copy(update={"sampled_ns": seconds * NS}))
                    accused += any(test.outcome is ACCUSES for test in monitor.results(seconds * NS).values())
    assert seconds >= least and accused == 0


def test_a_test_is_silent_when_its_newest_evaluation_is_older_than_the_limit_and_not_before() -> None:
    one = EvidenceTest("gain", Code.SILENT, count=1, latency_s=1.0, hold_s=10.0)
    one.evaluated(0, evaluation(0.5, 1.0, "-", explain(Code.SILENT, test="gain", age_s=1)))
    assert one.result(5 * NS, 5.0).outcome is PASS
    assert one.result(5 * NS + 1, 5.0).outcome is NOT_EVALUATED

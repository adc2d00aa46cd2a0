"""A start: what is kept of the process before, and what a start needs before the position can be SAFE."""

from collections.abc import Iterable
from itertools import pairwise

import pytest

from services.core.trust.codes import Code
from services.core.trust.facts import Facts, Monitor, Statement
from services.core.trust.process import Config, Process
from services.core.trust.start import Start
from shared.messages.base import Message, Tick
from shared.messages.navigation import NavigationState
from shared.messages.trust import Belief, Hypothesis, Outcome, TrustLevel, TrustMonitor, TrustRecord, TrustState
from tests.unit.core.trust.test_process import SECOND_NS, navigation_state, passing, second, statement

IN_ORDER = TrustRecord(sampled_ns=0, ended_in_order=True, moving=True)
CUT = TrustRecord(sampled_ns=0, moving=True)
CUT_AT_REST = TrustRecord(sampled_ns=0, moving=False)


def started(*, in_motion: bool, at_s: int = 10) -> NavigationState:
    changes = {"started_ns": at_s * SECOND_NS, "started_in_motion": in_motion}
    return navigation_state(at_s * SECOND_NS, 10.0).model_copy(update=changes)


def long_window(outcome: Outcome, at_s: int) -> Facts:
    now_ns = at_s * SECOND_NS
    return Facts(now_ns, statements={Monitor.INERTIAL_LONG: Statement(Monitor.INERTIAL_LONG, outcome, now_ns, "")})


@pytest.mark.parametrize(
    ("record", "in_motion", "code"),
    [
        (None, False, Code.START_UNKNOWN),
        (IN_ORDER, False, None),
        (IN_ORDER, True, Code.START_IN_MOTION),
        (CUT, False, Code.START_AFTER_CUT),
        (CUT_AT_REST, False, None),
    ],
)
def test_a_start_is_confirmed_by_a_long_window_that_passes_since(
    record: TrustRecord | None, in_motion: bool, code: Code | None
) -> None:
    start, state = Start(), started(in_motion=in_motion)
    if record is not None:
        start.recall(record)
    why = start.unconfirmed(long_window(Outcome.NOT_EVALUATED, 20), state)
    assert (None if why is None else why.code) == code
    if code is not None:
        assert start.unconfirmed(long_window(Outcome.ACCUSES, 30), state) is not None
    assert start.unconfirmed(long_window(Outcome.PASS, 40), state) is None
    assert start.unconfirmed(long_window(Outcome.NOT_EVALUATED, 50), state) is None, "once"
    again = started(in_motion=True, at_s=60)
    assert start.unconfirmed(long_window(Outcome.NOT_EVALUATED, 61), again) is not None, "of another start of fusion"


def test_a_window_that_passed_before_a_restart_of_trust_alone_counts_and_one_of_another_boot_does_not() -> None:
    state = started(in_motion=True, at_s=10)
    for earlier_life, code in ((False, None), (True, Code.START_AFTER_CUT)):
        start = Start()
        start.recall(TrustRecord(sampled_ns=0, confirmed_ns=50 * SECOND_NS, earlier_life=earlier_life))
        why = start.unconfirmed(long_window(Outcome.NOT_EVALUATED, 60), state)
        assert (None if why is None else why.code) == code


def test_after_an_orderly_stop_a_short_window_confirms_a_start_in_motion_and_satellites_alone_do_not() -> None:
    def short(outcome: Outcome, at_s: int) -> Facts:
        now_ns = at_s * SECOND_NS
        known = {Monitor.INERTIAL_SHORT: outcome, Monitor.SATELLITES: Outcome.PASS}
        return Facts(
            now_ns, statements={monitor: Statement(monitor, how, now_ns, "") for monitor, how in known.items()}
        )

    for record, confirms in ((IN_ORDER, True), (CUT, False), (None, False)):
        start, state = Start(), started(in_motion=True)
        if record is not None:
            start.recall(record)
        assert start.unconfirmed(short(Outcome.NOT_EVALUATED, 20), state) is not None
        assert (start.unconfirmed(short(Outcome.PASS, 30), state) is None) is confirms
        assert (start.unconfirmed(short(Outcome.NOT_EVALUATED, 40), state) is None) is confirms, "once"


def records(published: Iterable[Message]) -> list[TrustRecord]:
    return [message for message in published if isinstance(message, TrustRecord)]


def accused(process: Process, seconds: range) -> list[Message]:
    """Seconds in which a long window accuses GNSS."""
    found: list[Message] = []
    for k in seconds:
        now_ns = k * SECOND_NS
        others = [
            trust_monitor
            for trust_monitor in passing(now_ns)
            if isinstance(trust_monitor, TrustMonitor) and trust_monitor.monitor != "inertial_long"
        ]
        accusing = statement(Monitor.INERTIAL_LONG, now_ns, Outcome.ACCUSES, ("gnss",))
        found += second(process, now_ns, [navigation_state(now_ns, 10.0), *others, accusing])
    return found


def test_a_record_is_written_every_10_s_at_once_with_a_change_and_every_5_s_of_a_conflict() -> None:
    process = Process(Config())
    process_records = records(m for k in range(1, 32) for m in second(process, k * SECOND_NS, passing(k * SECOND_NS)))
    assert sorted({process_record.sampled_ns // SECOND_NS for process_record in process_records}) == [1, 11, 21, 31]
    found = records(accused(process, range(32, 46)))
    times = [trust_record.sampled_ns // SECOND_NS for trust_record in found]
    assert times[0] == 32 and found[0].suspect_since_ns is not None and max(b - a for a, b in pairwise(times)) <= 5
    assert {belief.hypothesis for belief in found[-1].beliefs} >= {Hypothesis.GNSS}
    assert found[-1].trusted is not None and found[-1].trusted.sampled_ns <= 32 * SECOND_NS
    [last] = records(process.close())
    assert last.ended_in_order and last.suspect_since_ns == found[-1].suspect_since_ns


@pytest.mark.parametrize("cut_s", [1, 3600, 86400])
def test_a_conflict_and_its_beliefs_go_on_after_a_cut_of_any_length(cut_s: int) -> None:
    before = Process(Config())
    saved = records(accused(before, range(1, 8)))[-1]
    after = Process(Config())
    assert list(after.handle(saved)) == []
    published = second(after, (8 + cut_s) * SECOND_NS, [])
    state = next(message for message in published if isinstance(message, TrustState))
    assert state.state is not TrustLevel.SAFE and state.suspect_since_ns == saved.suspect_since_ns
    assert any(belief.hypothesis is Hypothesis.GNSS and belief.survives for belief in state.beliefs)
    assert not state.gnss_excluded, "fusion has no solution without GNSS any more"


@pytest.mark.parametrize("probability", [0.0, 1.0])
def test_any_record_that_the_contract_lets_through_is_used(probability: float) -> None:
    beliefs = tuple(
        Belief(hypothesis=Hypothesi, prior=0.0, probability=probability, survives=True, reason="", since_ns=-(2**40))
        for Hypothesi in Hypothesis
    )
    record = replace_times(TrustRecord(sampled_ns=2**61, beliefs=beliefs))
    process = Process(Config())
    assert list(process.handle(record)) == []
    for k in range(1, 5):
        assert second(process, k * SECOND_NS, passing(k * SECOND_NS))


def replace_times(record: TrustRecord) -> TrustRecord:
    far = 2**60
    return record.model_copy(
        update={"suspect_since_ns": far, "imu_suspect_since_ns": -far, "alike_since_ns": far, "confirmed_ns": far}
    )


def test_the_facts_of_a_start_are_part_of_the_verdict() -> None:
    process = Process(Config())
    others = [
        trust_monitor
        for trust_monitor in passing(SECOND_NS)
        if isinstance(trust_monitor, TrustMonitor) and trust_monitor.monitor != "inertial_long"
    ]
    state = [message for message in second(process, SECOND_NS, others) if isinstance(message, TrustState)][-1]
    assert state.state is TrustLevel.CAUTION and state.reason_codes[0].code == Code.START_UNKNOWN


def test_a_loss_with_interference_outlives_a_restart() -> None:
    process = Process(Config())
    list(process.handle(TrustRecord(sampled_ns=SECOND_NS, suspect_since_ns=5, disturbed_since_ns=7)))
    second(process, 2 * SECOND_NS, passing(2 * SECOND_NS))
    assert process._after_loss.since_ns == 7
    [last] = records(process.close())
    assert last.disturbed_since_ns == 7


def test_a_start_without_a_position_does_not_say_that_the_vehicle_moves() -> None:
    process = Process(Config())
    list(process.handle(TrustRecord(sampled_ns=SECOND_NS, moving=False, ended_in_order=True)))
    [first] = records(process.handle(Tick(now_ns=2 * SECOND_NS)))
    assert not first.moving and first.ended_in_order

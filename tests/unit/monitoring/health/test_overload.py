"""Whether this computer keeps up, by the delays of heartbeats and solutions."""

import json

import pytest

from services.monitoring.health.codes import Code
from services.monitoring.health.overload import Overload
from services.monitoring.health.watch import Watch
from shared.bus.codec import encode
from shared.messages.explanation import explain
from shared.messages.operation import ProcessHealth, ProcessState

S = 1_000_000_000
START_NS = 1_790_000_000 * S


def judged(overload: Overload, seconds: range, late_s: float, *, load: float = 5.2, behind_s: float = 0.0) -> None:
    for second in seconds:
        overload.judge(START_NS + second * S, load, [late_s] * 32, behind_s)


def test_a_delay_that_lasts_is_a_finding_with_load_delay_and_remedy_since_it_began() -> None:
    overload = Overload(processors=2)
    judged(overload, range(5), 1.0)
    assert overload.problem is None, "no moment's delay"
    judged(overload, range(5, 7), 1.0)
    assert overload.problem is not None
    assert overload.problem.text_code == explain(Code.OVERLOADED, load_count=5.2, processor_count=2, late_s=1.0)
    assert (overload.problem.what, overload.problem.since_ns) == ("computer", START_NS)


def test_a_filter_that_falls_behind_is_named_although_messages_are_prompt() -> None:
    overload = Overload(processors=1)
    judged(overload, range(7), 0.01, behind_s=13.7, load=1.1)
    assert overload.problem is not None
    assert overload.problem.text_code == explain(
        Code.OVERLOADED_FUSION, load_count=1.1, processor_count=1, behind_s=13.7
    )


def test_delays_without_load_are_no_overload_and_have_another_remedy() -> None:
    overload = Overload(processors=4)
    judged(overload, range(7), 1.0, load=0.3)
    assert overload.problem is not None
    assert overload.problem.text_code is not None and overload.problem.text_code.code == Code.SLOW


def test_it_ends_when_the_delay_has_been_small_for_five_seconds_and_not_between() -> None:
    overload = Overload(processors=2)
    judged(overload, range(7), 1.0)
    judged(overload, range(7, 30), 0.3)
    assert overload.problem is not None, "half of the limit is not small"
    judged(overload, range(30, 34), 0.01)
    judged(overload, range(34, 35), 1.0)
    judged(overload, range(35, 40), 0.01)
    assert overload.problem is not None
    judged(overload, range(40, 42), 0.01)
    assert overload.problem is None


@pytest.mark.parametrize("late_s", [0.0, 0.2])
def test_brief_delays_one_after_the_other_are_none_that_lasts(late_s: float) -> None:
    overload = Overload(processors=2)
    for begin in range(0, 40, 4):
        judged(overload, range(begin, begin + 3), 1.0)
        judged(overload, range(begin + 3, begin + 4), late_s)
    assert overload.problem is None


def test_the_report_has_the_finding_by_the_heartbeats_that_arrive_late() -> None:
    watch = Watch(("core.fusion",), START_NS, processors=2)
    now_ns = START_NS
    for beat in range(80):
        now_ns = START_NS + beat * S // 4
        health = ProcessHealth(
            process="core.fusion", state=ProcessState.READY, incarnation=START_NS, sent_ns=now_ns - 8 * S // 10
        )
        payload = encode(health)
        assert json.loads(payload)["sent_ns"] == health.sent_ns
        watch.take("health/core.fusion", payload, producer="core.fusion", received_ns=now_ns)
        watch.take_health(health, now_ns)
        watch.step(now_ns, connected=True)
        watch.judge_load(now_ns, 7.0)
    [problem] = watch.report(now_ns).problems
    assert problem.what == "computer" and problem.text_code == explain(
        Code.OVERLOADED, load_count=7.0, processor_count=2, late_s=0.8
    )
    assert problem.outage is None and problem.affected == ()

"""What the watchdog says of connections that were refused, and of a process that runs twice."""

from services.monitoring.health.codes import Code
from services.monitoring.health.intruders import DISPLAY_TIME_NS, Intruders
from services.monitoring.health.watch import Watch
from shared.messages.explanation import Explanation, QuotedText, explain, process
from shared.messages.operation import ProcessHealth, ProcessState

NOW_NS = 1_795_000_000_000_000_000
SECOND = 1_000_000_000
FUSION = "core.fusion"


def beat(life: int, now_ns: int, state: ProcessState = ProcessState.READY) -> ProcessHealth:
    return ProcessHealth(process=FUSION, state=state, incarnation=life, sent_ns=now_ns)


def codes(watch: Watch, now_ns: int) -> list[Explanation | None]:
    return [problem.text_code for problem in watch.report(now_ns).problems if problem.what in ("broker", FUSION)]


def test_connections_beyond_the_maximum_are_a_problem_for_a_minute() -> None:
    intruders = Intruders()
    intruders.crowded(0, NOW_NS)
    assert list(intruders.problems(NOW_NS)) == []
    intruders.crowded(3, NOW_NS)
    intruders.crowded(4, NOW_NS + SECOND)
    (problem,) = intruders.problems(NOW_NS + SECOND)
    assert problem.what == "broker" and problem.text_code == explain(Code.CROWDED, refused_count=4)
    assert list(intruders.problems(NOW_NS + 62 * SECOND)) == []


def test_refused_connections_are_a_problem_for_a_minute_with_the_names_that_were_given() -> None:
    intruders = Intruders()
    intruders.refused(0, [], NOW_NS)
    assert not list(intruders.problems(NOW_NS))
    intruders.refused(3, ["core.fusion", "core.fusion", "x"], NOW_NS)
    intruders.refused(5, ["x", "y"], NOW_NS + SECOND)
    [problem] = intruders.problems(NOW_NS + SECOND)
    assert problem.what == "broker" and problem.since_ns == NOW_NS
    clients = QuotedText(quoted="x, y")
    assert problem.text_code == explain(Code.REFUSED, refused_count=5, clients=clients)
    [problem] = intruders.problems(NOW_NS + DISPLAY_TIME_NS + 1)
    assert problem.text_code is not None
    assert problem.text_code.values["refused_count"] == 2, "the first three are over"
    assert not list(intruders.problems(NOW_NS + DISPLAY_TIME_NS + 2 * SECOND))


def test_names_of_any_length_fit_into_the_message() -> None:
    intruders = Intruders()
    intruders.refused(8, [f"{number}" + 63 * "x" for number in range(8)], NOW_NS)
    [problem] = intruders.problems(NOW_NS)
    assert problem.text_code is not None and problem.text_code.code == Code.REFUSED


def test_two_programs_under_one_name_are_named() -> None:
    watch = Watch((FUSION,), NOW_NS, processors=2)
    now_ns = NOW_NS
    for _ in range(3):  # each connection ends the other, and each comes again
        for life in (1, 2):
            now_ns += SECOND
            watch.take_health(beat(life, now_ns, ProcessState.LOST), now_ns)
            watch.take_health(beat(life, now_ns), now_ns)
    assert codes(watch, now_ns) == [explain(Code.RUNS_TWICE, process(FUSION))]
    assert not codes(watch, now_ns + DISPLAY_TIME_NS + SECOND)


def test_a_process_that_is_started_anew_does_not_run_twice() -> None:
    watch = Watch((FUSION,), NOW_NS, processors=2)
    now_ns = NOW_NS
    for life in range(1, 6):
        for _ in range(3):
            now_ns += SECOND
            watch.take_health(beat(life, now_ns), now_ns)
        watch.take_health(beat(life, now_ns, ProcessState.LOST), now_ns)
    watch.take_health(beat(5, now_ns), now_ns)
    watch.take_health(beat(4, now_ns, ProcessState.LOST), now_ns)  # a last will that comes late
    watch.take_health(beat(4, now_ns), now_ns, retained=True)
    assert explain(Code.RUNS_TWICE, process(FUSION)) not in codes(watch, now_ns)

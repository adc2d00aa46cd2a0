"""What the watchdog says of connections that were refused, and of a process that runs twice."""

from services.monitoring.health.intruders import SHOWN_NS, Intruders
from services.monitoring.health.watch import Watch
from shared.messages.operation import ProcessHealth, ProcessState

NOW_NS = 1_795_000_000_000_000_000
SECOND = 1_000_000_000
FUSION = "core.fusion"


def beat(life: int, now_ns: int, state: ProcessState = ProcessState.READY) -> ProcessHealth:
    return ProcessHealth(process=FUSION, state=state, incarnation=life, sent_ns=now_ns)


def texts(watch: Watch, now_ns: int) -> list[str]:
    return [problem.text for problem in watch.report(now_ns).problems if problem.what in ("broker", FUSION)]


def test_connections_beyond_the_maximum_are_a_problem_for_a_minute() -> None:
    intruders = Intruders()
    intruders.crowded(0, NOW_NS)
    assert list(intruders.problems(NOW_NS)) == []
    intruders.crowded(3, NOW_NS)
    intruders.crowded(4, NOW_NS + SECOND)
    (problem,) = intruders.problems(NOW_NS + SECOND)
    assert problem.what == "broker" and "refused 4 connections in the last minute" in problem.text
    assert list(intruders.problems(NOW_NS + 62 * SECOND)) == []


def test_refused_connections_are_a_problem_for_a_minute_with_the_names_that_were_given() -> None:
    intruders = Intruders()
    intruders.refused(0, [], NOW_NS)
    assert not list(intruders.problems(NOW_NS))
    intruders.refused(3, ["core.fusion", "core.fusion", "x"], NOW_NS)
    intruders.refused(5, ["x", "y"], NOW_NS + SECOND)
    [problem] = intruders.problems(NOW_NS + SECOND)
    assert problem.what == "broker" and problem.since_ns == NOW_NS
    assert "5 connections" in problem.text and "x, y" in problem.text
    [problem] = intruders.problems(NOW_NS + SHOWN_NS + 1)
    assert "2 connections" in problem.text, "the first three are over"
    assert not list(intruders.problems(NOW_NS + SHOWN_NS + 2 * SECOND))


def test_names_of_any_length_fit_into_the_message() -> None:
    intruders = Intruders()
    intruders.refused(8, [f"{number}" + 63 * "x" for number in range(8)], NOW_NS)
    [problem] = intruders.problems(NOW_NS)
    assert len(problem.text) == 400


def test_two_programs_under_one_name_are_named() -> None:
    watch = Watch((FUSION,), NOW_NS, processors=2)
    now_ns = NOW_NS
    for _ in range(3):  # each connection ends the other, and each comes again
        for life in (1, 2):
            now_ns += SECOND
            watch.take_health(beat(life, now_ns, ProcessState.LOST), now_ns)
            watch.take_health(beat(life, now_ns), now_ns)
    assert texts(watch, now_ns) == [
        f"{FUSION} runs twice: two programs send under its name and its secret; stop one of them"
    ]
    assert not texts(watch, now_ns + SHOWN_NS + SECOND)


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
    assert not any("runs twice" in text for text in texts(watch, now_ns))

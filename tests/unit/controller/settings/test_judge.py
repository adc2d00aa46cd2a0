"""Whether the unit is worse with a change of settings."""

from services.controller.settings.codes import Code
from services.controller.settings.judge import Before, Rejects, downstream, outstanding, worse
from shared.messages.operation import (
    DeadlineReport,
    Freshness,
    ProcessAge,
    ProcessHealth,
    ProcessState,
    ProcessStatus,
    TopicAge,
)
from shared.messages.settings import SettingDifference, SettingsChange, SettingsStage

S = 1_000_000_000
TOUCHED = ("sensors.gnss",)


def change(*touched: str, **runs: bool) -> SettingsChange:
    """A change at 9 s; `runs` names processes, a point written as two underscores, that it switches on or off."""
    differences = tuple(
        SettingDifference(name=name.replace("__", "."), before=str(not on).lower(), after=str(on).lower())
        for name, on in runs.items()
    )
    touched += tuple(one.name for one in differences)
    return SettingsChange(
        request_id="1", by="x", stage=SettingsStage.WATCHED, begun_ns=9 * S, differences=differences, touched=touched
    )


def report(
    topics: dict[str, Freshness], status: ProcessStatus = ProcessStatus.READY, restarts: int = 0
) -> DeadlineReport:
    return DeadlineReport(
        now_ns=100 * S,
        topics=tuple(
            TopicAge(topic=name, freshness=freshness, rate_hz=1.0, count=9) for name, freshness in topics.items()
        ),
        processes=(ProcessAge(process="sensors.gnss", status=status, restarts=restarts),),
    )


CAME = {"gnss/raw": Freshness.FRESH, "gnss/fix": Freshness.LATE, "can/raw": Freshness.FRESH}
BEFORE = Before.of(report(CAME))


def codes(after: DeadlineReport, rejects: Rejects | None = None) -> list[tuple[str, str]]:
    found = worse(BEFORE, change(*TOUCHED), after, rejects or Rejects(), 30.0)
    return [(one.code, one.subject.name if one.subject else "") for one in found]


def test_what_came_before_and_comes_no_more_is_worse_downstream_of_what_was_touched_alone() -> None:
    silent = dict.fromkeys(CAME, Freshness.STALE)
    assert codes(report(silent)) == [(Code.TOPIC_SILENT, "gnss/raw"), (Code.TOPIC_SILENT, "gnss/fix")]
    assert not codes(report(CAME)) and not codes(report({**CAME, "can/raw": Freshness.NEVER}))
    assert {"gnss/raw", "gnss/fix", "navigation/solution", "trust/state"} <= downstream(TOUCHED)
    assert "can/raw" not in downstream(TOUCHED)


def test_what_did_not_come_before_is_not_missed() -> None:
    assert not codes(report({**CAME, "gnss/satellites": Freshness.STALE}))


def test_a_process_that_does_not_run_or_keeps_ending_is_worse_and_one_restart_is_not() -> None:
    assert codes(report(CAME, ProcessStatus.LOST)) == [(Code.PROCESS_DOWN, "sensors.gnss")]
    assert codes(report(CAME, restarts=3)) == [(Code.KEEPS_ENDING, "sensors.gnss")]
    assert not codes(report(CAME, restarts=1))


def test_a_change_is_judged_from_the_start_of_the_processes_that_it_touches() -> None:
    assert outstanding({"sensors.gnss": 5 * S}, change(*TOUCHED)) == TOUCHED
    assert not outstanding({"sensors.gnss": 10 * S}, change(*TOUCHED))
    assert not outstanding({}, change(*TOUCHED)), "it does not run in this unit"


def test_a_process_that_is_switched_on_has_to_start_and_one_that_is_switched_off_has_not() -> None:
    on = change(sensors__simulator=True, sensors__gnss=False)
    assert outstanding({}, on) == ("sensors.simulator",)
    assert outstanding({"sensors.gnss": 5 * S, "sensors.simulator": 10 * S}, on) == ()


def test_what_a_process_that_is_switched_off_sent_is_missed_only_where_another_one_takes_its_place() -> None:
    silent, gone = dict.fromkeys(CAME, Freshness.STALE), report(CAME, ProcessStatus.LOST)
    off, instead = change(sensors__gnss=False), change(sensors__gnss=False, sensors__simulator=True)
    assert not worse(BEFORE, off, report(silent), Rejects(), 30.0) and not worse(BEFORE, off, gone, Rejects(), 30.0)
    found = worse(BEFORE, instead, report(silent), Rejects(), 30.0)
    assert {one.subject.name for one in found if one.subject} == {"gnss/raw", "gnss/fix", "can/raw"}


def health(process: str, sent_s: int, rejects: int, life_s: int = 0) -> ProcessHealth:
    return ProcessHealth(
        process=process, state=ProcessState.READY, incarnation=life_s * S, sent_ns=sent_s * S,
        rejects={"checksum": rejects},
    )  # fmt: skip


def test_rejects_are_compared_with_the_rate_of_before_in_the_same_life_and_in_a_new_one() -> None:
    rejects = Rejects()
    rejects.note(health("parsers.gnss", 100, 100))  # one a second
    rejects.begin()
    rejects.note(health("parsers.gnss", 110, 120))
    assert not codes(report(CAME), rejects), "twice as many are within what a road brings"
    rejects.note(health("parsers.gnss", 120, 200))
    assert codes(report(CAME), rejects) == [(Code.MORE_REJECTS, "parsers.gnss")]
    rejects.note(health("parsers.gnss", 130, 100, life_s=120))
    assert codes(report(CAME), rejects) == [(Code.MORE_REJECTS, "parsers.gnss")], "of its new life"


def test_a_long_life_does_not_dilute_the_rejects_of_now() -> None:
    rejects = Rejects()
    rejects.begin()
    rejects.note(health("parsers.gnss", 36_000, 0))
    rejects.note(health("parsers.gnss", 36_010, 1000))
    assert codes(report(CAME), rejects) == [(Code.MORE_REJECTS, "parsers.gnss")]


def test_rejects_of_a_process_that_does_not_read_what_was_touched_do_not_count() -> None:
    rejects = Rejects()
    rejects.begin()
    rejects.note(health("parsers.can", 110, 9000, life_s=100))
    assert not codes(report(CAME), rejects)

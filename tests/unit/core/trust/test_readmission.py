"""Conflict, decision and end of a conflict: minimum healthy time, doubled for each further fault, at most a minute."""

from dataclasses import replace

import pytest

from services.core.trust.facts import SECOND_NS, Alternative, Facts, Monitor, Posterior, Solution, Statement
from services.core.trust.readmission import (
    HEALTHY_BOUNDS_S,
    Admission,
    Judgement,
    Readmission,
    healthy_time,
    judge_gnss,
    judge_imu,
)
from shared.messages.trust import Hypothesis, Outcome
from tests.support.cases import each


class Source:
    """A source that is judged ten times a second."""

    def __init__(self) -> None:
        self.readmission, self.time_s = Readmission(), 0.0

    def update(self, duration_s: float, *, accused: bool = False, agrees: bool = True) -> Admission:
        last = Admission(open=False)
        for _ in range(round(10.0 * duration_s)):
            self.time_s += 0.1
            time_ns = round(self.time_s * SECOND_NS)
            last = self.readmission.update(
                time_ns, accused=accused, agrees=agrees, suspect_since_ns=time_ns - 5 * SECOND_NS if accused else None
            )
        return last

    def readmitted_after(self) -> float:
        """Time [s] of agreement until it is admitted again."""
        start_s = self.time_s
        while self.update(0.1).open:
            pass
        return self.time_s - start_s


@each(
    ("fault_s", "earlier", "required_s"),
    [(1.0, 0, 2.0), (9.9, 0, 2.0), (50.0, 0, 10.0), (1e6, 0, 60.0), (5.0, 1, 4.0), (5.0, 2, 8.0), (5.0, 5, 60.0),
     (20.0, 1, 8.0), (5.0, 10**6, 60.0)],
)  # fmt: skip
def test_minimum_healthy_time(fault_s: float, earlier: int, required_s: float) -> None:
    assert healthy_time(fault_s, earlier) == pytest.approx(required_s)


def test_a_source_that_is_not_accused_is_admitted_whether_it_can_be_judged_or_not() -> None:
    source = Source()
    assert source.update(10.0) == Admission(open=False)
    assert source.update(10.0, agrees=False) == Admission(open=False)


def test_a_short_fault_excludes_at_once_and_is_over_after_two_seconds_of_agreement() -> None:
    source = Source()
    source.update(10.0)
    assert source.update(0.1, accused=True).open
    source.update(5.0, accused=True)
    assert source.readmitted_after() == pytest.approx(2.1, abs=0.11)


def test_each_further_fault_within_ten_minutes_doubles_the_time_up_to_a_minute() -> None:
    source, found = Source(), []
    for _ in range(7):
        source.update(3.0, accused=True)
        found.append(source.readmitted_after())
        source.update(5.0)
    assert found == pytest.approx([2.0, 4.0, 8.0, 16.0, 32.0, 60.0, 60.0], abs=0.21)


def test_faults_of_more_than_ten_minutes_ago_are_forgotten() -> None:
    source = Source()
    for _ in range(2):
        source.update(3.0, accused=True)
        source.readmitted_after()
    source.update(620.0)
    source.update(3.0, accused=True)
    assert source.readmitted_after() == pytest.approx(2.0, abs=0.21)


def test_a_long_fault_takes_a_fifth_of_its_duration() -> None:
    source = Source()
    source.update(100.0, accused=True)
    assert source.readmitted_after() == pytest.approx(20.0, abs=0.21)


def test_what_is_not_evaluated_does_not_agree_and_begins_the_healthy_time_anew() -> None:
    source = Source()
    source.update(3.0, accused=True)
    assert source.update(1.8).open
    assert source.update(100.0, agrees=False).open
    assert source.update(1.8).open
    assert not source.update(0.5).open


def test_gnss_is_excluded_from_a_decision_on_until_the_conflict_ends_unless_fusion_declines() -> None:
    readmission = Readmission()
    found = [
        readmission.update(k * SECOND_NS, accused=True, agrees=False, decided=decided, declined=declined)
        for k, (decided, declined) in enumerate([(False, False), (True, False), (False, False), (False, True)])
    ]
    assert [admission.excluded for admission in found] == [False, True, True, False]
    assert all(admission.open for admission in found)


def test_an_accusation_during_the_healthy_time_continues_the_same_fault() -> None:
    source = Source()
    source.update(3.0, accused=True)
    first = source.update(1.0)
    again = source.update(1.0, accused=True)
    assert again.suspect_since_ns == first.suspect_since_ns
    assert source.readmitted_after() == pytest.approx(2.0, abs=0.21)


def test_the_suspect_time_is_the_earliest_one_stated() -> None:
    readmission = Readmission()
    readmission.update(100, accused=True, agrees=False, suspect_since_ns=50)
    assert readmission.update(200, accused=True, agrees=False, suspect_since_ns=20).suspect_since_ns == 20
    assert readmission.update(300, accused=True, agrees=False, suspect_since_ns=90).suspect_since_ns == 20


DEAD_RECKONING = Solution(0, True, "coasting", 8.0, 5.0, 30.0, 0)


def facts(**outcomes: tuple[Outcome, tuple[str, ...]]) -> Facts:
    statements = {}
    for monitor in Monitor:
        outcome, accused = outcomes.get(monitor.value, (Outcome.PASS, ()))
        statements[monitor] = Statement(monitor, outcome, 0, "", accused, suspect_since_ns=len(monitor))
    return Facts(0, DEAD_RECKONING, statements, conflict_open=True, gnss_excluded=True, exclusion_confirmed=True,
                 excluded_test_ratio=0.5, odometer_in_use=True)  # fmt: skip


ACCUSED, EITHER = (Outcome.ACCUSES, ("gnss",)), (Outcome.ACCUSES, ("gnss", "imu"))
SURVIVES = Posterior(Hypothesis.GNSS, 1e-4, 0.6, True, False, 7)
ALONE = replace(SURVIVES, probability=0.999, acted_on=True)


@each(
    ("given", "beliefs", "expected"),
    [
        (facts(), (), (False, False, True, True, None)),
        (facts(), (SURVIVES,), (False, False, False, True, 7)),
        (facts(inertial_short=EITHER), (SURVIVES,), (True, False, False, False, 7)),
        (facts(inertial_short=EITHER), (), (False, False, True, False, None)),
        (facts(inertial_short=ACCUSED), (ALONE,), (True, True, False, False, 7)),
        (facts(satellites=(Outcome.ACCUSES, ("G05",))), (), (False, False, True, True, None)),
        (facts(motion_fast=(Outcome.ACCUSES, ("gnss", "odometer"))), (SURVIVES,), (True, False, False, False, 7)),
        (facts(evidence=ACCUSED), (), (False, False, True, True, None)),
        (facts(inertial_long=(Outcome.NOT_EVALUATED, ())), (), (False, False, True, True, None)),
        (
            facts(inertial_long=(Outcome.NOT_EVALUATED, ()), inertial_short=(Outcome.NOT_EVALUATED, ())), (),
            (False, False, True, False, None),
        ),
    ],
)  # fmt: skip
def test_gnss_is_accused_while_its_hypothesis_survives_and_decided_while_it_alone_does(
    given: Facts, beliefs: tuple[Posterior, ...], expected: tuple[bool, bool, bool, bool, int | None]
) -> None:
    found = judge_gnss(replace(given, beliefs=beliefs))
    assert replace(found, within_s=HEALTHY_BOUNDS_S) == Judgement(*expected)


@pytest.mark.parametrize(
    ("was_apart", "ratio", "level_m", "agrees"),
    [(True, 0.5, 21.0, True), (False, 0.5, 21.0, False), (True, 1.5, 21.0, False), (True, 0.5, 31.0, False)],
    ids=["came back", "never was apart", "still apart", "the solution without GNSS is of no use"],
)
def test_where_positions_came_back_windows_that_reach_into_the_error_do_not_accuse(
    was_apart: bool, ratio: float, level_m: float, agrees: bool
) -> None:
    given = replace(
        facts(inertial_long=EITHER), beliefs=(SURVIVES,), gnss_was_apart=was_apart, excluded_test_ratio=ratio,
        without_gnss_level_m=level_m,
    )  # fmt: skip
    assert (judge_gnss(given).agrees, judge_gnss(given).accused) == (agrees, not agrees)


@pytest.mark.parametrize(
    ("other", "accusing", "agrees"),
    [
        (Alternative(2.0, 3.0, True), {}, True),
        (Alternative(20.0, 3.0, False), {}, False),
        (None, {}, False),
        (Alternative(2.0, 3.0, True), {"inertial_short": EITHER}, False),
        (Alternative(2.0, 3.0, True), {"gyroscope": (Outcome.ACCUSES, ("imu",))}, False),
        (Alternative(2.0, 3.0, True), {"inertial_long": EITHER}, True),
    ],
)
def test_inertial_sensors_agree_with_the_solution_without_them(
    other: Alternative | None, accusing: dict[str, tuple[Outcome, tuple[str, ...]]], agrees: bool
) -> None:
    given = replace(facts(**accusing), alternatives={} if other is None else {Hypothesis.IMU: other})
    assert judge_imu(given).agrees is agrees


def test_what_was_decided_is_taken_back_when_it_is_contradicted_and_a_conflict_can_be_ended() -> None:
    readmission = Readmission()
    assert readmission.update(0, accused=True, agrees=False, decided=True).excluded
    assert not readmission.update(SECOND_NS, accused=True, agrees=False, contradicted=True).excluded
    readmission.end(2 * SECOND_NS)
    assert readmission.update(3 * SECOND_NS, accused=False, agrees=True) == Admission(open=False)


def test_dead_inertial_monitors_keep_a_conflict_open() -> None:
    now_ns = 100 * SECOND_NS
    dead = replace(
        facts(inertial_long=ACCUSED, inertial_short=ACCUSED),
        beliefs=(SURVIVES,),
        time_ns=now_ns,
        solution=replace(DEAD_RECKONING, sampled_ns=now_ns),
    )
    readmission = Readmission()
    readmission.update(0, accused=True, agrees=False)
    for time_s in range(1, 100):
        judged = judge_gnss(dead)
        admission = readmission.update(time_s * SECOND_NS, accused=judged.accused, agrees=judged.agrees)
        assert admission.open


@each(
    ("changes", "agrees"),
    [
        ({}, True),
        ({"excluded_test_ratio": 1.2, "without_gnss_level_m": 11.0}, True),
        ({"excluded_test_ratio": 1.2, "without_gnss_level_m": 9.0}, False),
        ({"excluded_test_ratio": None, "exclusion_declined": "given up"}, True),
        ({"excluded_test_ratio": 1.2}, False),
        ({"excluded_test_ratio": None}, False),
        ({"excluded_test_ratio": 1.2, "solution": replace(DEAD_RECKONING, protection_level_horizontal_m=10.1)}, True),
        ({"excluded_test_ratio": 1.2, "solution": replace(DEAD_RECKONING, protection_level_vertical_m=20.1)}, True),
        (
            {"excluded_test_ratio": 200.0, "solution": replace(DEAD_RECKONING, protection_level_horizontal_m=10.1)},
            False,
        ),
    ],
)
def test_positions_that_contradict_the_solution_without_gnss_do_not_agree(
    changes: dict[str, object], agrees: bool
) -> None:
    assert judge_gnss(replace(facts(), **changes)).agrees is agrees  # type: ignore[arg-type]


@pytest.mark.parametrize("changes", [{"navigating": False}, {"sampled_ns": -3 * SECOND_NS}])
def test_gnss_is_readmitted_after_a_minute_without_accusation_where_the_solution_is_lost(
    changes: dict[str, object],
) -> None:
    lost = replace(
        facts(inertial_short=(Outcome.NOT_EVALUATED, ()), inertial_long=(Outcome.NOT_EVALUATED, ())),
        time_ns=0,
        solution=replace(DEAD_RECKONING, **{"sampled_ns": 0, **changes}),  # type: ignore[arg-type]
        exclusion_confirmed=False,
    )
    readmission = Readmission()
    readmission.update(0, accused=True, agrees=False)
    excluded = []
    for time_s in range(1, 70):
        judged = judge_gnss(lost)
        admission = readmission.update(
            time_s * SECOND_NS, accused=judged.accused, agrees=judged.agrees, within_s=judged.within_s
        )
        excluded.append(admission.open)
    assert excluded.count(True) == 60

"""The result of a test: what accuses, since when, which test decides, and the messages that publish it."""

from collections.abc import Sequence
from dataclasses import replace

import pytest

from shared.bus.codec import encode
from shared.messages.explanation import explain
from shared.messages.trust import MonitorTest, Outcome, TrustMonitor
from shared.trust.accused import GNSS, IMU
from shared.trust.inputs import SECOND_NS, Input, absent
from shared.trust.result import Test, dated, deciding, judged, lasting, published, statement, told

WHY = explain("motion.fast")
BASE = Test(
    Outcome.NOT_EVALUATED, WHY, window_s=5.0, statistic=1.0, threshold=2.0, accused=(GNSS, IMU), suspect_since_ns=5
)
SAID = "mean speed difference over 5 s: chi-square 1, limit 2"
PASS, ACCUSES = replace(BASE, outcome=Outcome.PASS), replace(BASE, outcome=Outcome.ACCUSES)


@pytest.mark.parametrize(("statistic", "outcome"), [(1.0, Outcome.PASS), (2.0, Outcome.PASS), (2.1, Outcome.ACCUSES)])
def test_it_accuses_strictly_above_its_threshold(statistic: float, outcome: Outcome) -> None:
    found = judged(BASE, statistic, 2.0)
    assert (found.outcome, found.statistic, found.threshold) == (outcome, statistic, 2.0)


@pytest.mark.parametrize("accuses", [False, True])
def test_a_monitor_that_counts_decides_by_itself(accuses: bool) -> None:
    assert judged(BASE, 1.0, 2.0, accuses=accuses).accuses == accuses


def test_an_outcome_lasts_since_it_was_reached_and_an_accusation_is_suspect_since_its_earliest_time() -> None:
    first = dated(ACCUSES, None, 10)
    second = dated(replace(ACCUSES, suspect_since_ns=7), first, 11)
    assert (second.since_ns, second.suspect_since_ns) == (10, 5)
    assert lasting(replace(ACCUSES, suspect_since_ns=7), first, 11).suspect_since_ns == 7
    third = dated(replace(PASS, suspect_since_ns=None), second, 12)
    assert (third.since_ns, third.suspect_since_ns) == (12, None)
    again = dated(replace(ACCUSES, suspect_since_ns=12), third, 13)
    assert (again.since_ns, again.suspect_since_ns) == (13, 12), "an earlier accusation has ended"


@pytest.mark.parametrize(
    ("tests", "decides"),
    [
        ([replace(PASS, statistic=9.0, threshold=10.0), replace(ACCUSES, statistic=3.0, threshold=2.0)], 1),
        ([replace(BASE, statistic=9.0, threshold=1.0), replace(PASS, statistic=1.0, threshold=2.0)], 1),
        ([replace(PASS, statistic=1.0, threshold=2.0), replace(PASS, statistic=9.0, threshold=10.0)], 1),
        ([replace(PASS, statistic=1.0, threshold=2.0), replace(PASS, statistic=1.0, threshold=2.0)], 0),
    ],
    ids=["accusing before passing", "passing before not evaluated", "the largest ratio", "the first of two alike"],
)
def test_one_test_decides(tests: Sequence[Test], decides: int) -> None:
    named = [replace(test, window_s=float(k)) for k, test in enumerate(tests)]
    assert deciding(named).window_s == decides


def test_the_deciding_test_accuses_as_narrowly_as_one_of_them_and_since_the_first_of_them() -> None:
    narrow = replace(ACCUSES, accused=(GNSS,), since_ns=8, suspect_since_ns=6)
    wide = replace(ACCUSES, statistic=9.0, threshold=1.0, since_ns=9, doubtful=True)
    found = deciding((narrow, wide, replace(PASS, accused=(), since_ns=1, suspect_since_ns=1)))
    assert (found.accused, found.since_ns, found.suspect_since_ns, found.doubtful) == ((GNSS,), 8, 5, True)


@pytest.mark.parametrize("test", [BASE, PASS, ACCUSES], ids=["not evaluated", "passes", "accuses"])
def test_accused_and_suspect_time_are_published_of_an_accusation_alone(test: Test) -> None:
    message = statement("motion", test, 20, {"fast": test})
    assert message.accused == ((GNSS, IMU) if test.accuses else ())
    assert message.suspect_since_ns == (5 if test.accuses else None)
    assert (message.reason_code, message.reason) == (WHY, SAID)
    assert message.tests == (published("fast", test),) and message.tests[0].reason == ""
    assert told(message) == told(message.tests[0]) == SAID


def test_what_is_at_its_default_is_not_encoded_and_decodes_to_the_same() -> None:
    silent = explain("motion.no_epoch")
    message = statement("motion", Test(Outcome.NOT_EVALUATED, silent), 20, {"a": Test(Outcome.NOT_EVALUATED, silent)})
    body = encode(message)
    assert TrustMonitor.model_validate_json(body) == message
    for field in (b'"values"', b'"unit"', b'"accused"', b'"doubtful"', b'"reason":""'):
        assert field not in body


def test_a_test_of_release_0_1_0_is_its_text() -> None:
    old = MonitorTest.model_validate_json(b'{"name":"G05","outcome":"pass","reason":"used, residual 0.4 m","unit":"-"}')
    assert old.reason_code is None and told(old) == "used, residual 0.4 m"


@pytest.mark.parametrize(
    ("newest", "expected"),
    [
        ({Input.GNSS_SPEED: 9 * SECOND_NS, Input.ODOMETER_SPEED: 8 * SECOND_NS}, None),
        ({Input.GNSS_SPEED: 8 * SECOND_NS - 1, Input.ODOMETER_SPEED: None},
         explain("x.silent", input=Input.GNSS_SPEED, age_s=2)),
        ({Input.GNSS_SPEED: 9 * SECOND_NS, Input.ODOMETER_SPEED: None},
         explain("x.never", input=Input.ODOMETER_SPEED)),
    ],
    ids=["all are current", "the first one is old", "one has never come"],
)  # fmt: skip
def test_the_first_input_that_is_missing_is_named(newest: dict[Input, int | None], expected: object) -> None:
    assert absent(newest, 10 * SECOND_NS, 2.0, never="x.never", silent="x.silent") == expected

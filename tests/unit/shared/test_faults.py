import logging
from collections import Counter

import pytest

from shared.errors import BadPayload, TooManyFaults
from shared.faults import FAULT, RANGE, Faults
from shared.messages.base import Tick

NS = 1_000_000_000


def fail(faults: Faults, now_s: float, error: Exception | None = None) -> None:
    with faults.handling(round(now_s * NS)):
        raise error or ZeroDivisionError("a fault")


def test_a_fault_costs_its_item_is_counted_and_logged(caplog: pytest.LogCaptureFixture) -> None:
    rejects: Counter[str] = Counter()
    faults = Faults(rejects)
    with caplog.at_level(logging.WARNING):
        for error in (ZeroDivisionError("one"), OverflowError("two")):
            fail(faults, 0.0, error)
    assert rejects == {FAULT: 2} and faults.last == "OverflowError: two"
    assert [record.exc_info is not None for record in caplog.records] == [True, True]


def test_the_third_fault_within_ten_seconds_ends_the_process_and_names_the_cause() -> None:
    faults = Faults(Counter())
    fail(faults, 0.0)
    fail(faults, 5.0)
    with pytest.raises(TooManyFaults, match="ZeroDivisionError: a fault") as raised:
        fail(faults, 10.0)
    assert isinstance(raised.value.__cause__, ZeroDivisionError)


def test_faults_further_apart_never_end_it() -> None:
    rejects: Counter[str] = Counter()
    faults = Faults(rejects)
    for k in range(100):
        fail(faults, 5.01 * k)
    assert rejects[FAULT] == 100


def test_a_message_that_its_model_refuses_is_foreseen_and_has_no_limit() -> None:
    rejects: Counter[str] = Counter()
    faults = Faults(rejects)
    for _ in range(1000):
        with faults.decoding(0):
            Tick(now_ns=2**70)
    assert rejects == {RANGE: 1000} and faults.last is None


def test_errors_of_the_unit_itself_pass() -> None:
    rejects: Counter[str] = Counter()
    with pytest.raises(BadPayload):
        fail(Faults(rejects), 0.0, BadPayload("known"))
    assert not rejects


def test_what_an_item_gives_before_its_fault_is_kept() -> None:
    faults, given = Faults(Counter()), []
    for k in range(4):
        with faults.handling(20 * NS * k):
            given.append(10 // (k - 1))
    assert given == [-10, 10, 5]

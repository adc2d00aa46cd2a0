"""The log: samples as arrays that grow and are moved, and entries in the order of their stamps."""

from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.core.fusion.aids.base import Kind, Measurement
from services.core.fusion.inertial.imu_faults import Sample
from services.core.fusion.timeline.log import FIRST_CAPACITY, Log

STEP_NS, ALL = 10_000_000, 10**9


def sample(k: int, fault: str | None = None) -> Sample:
    return Sample(k * STEP_NS, (0.5 * k, 1.0, -9.8), (0.0, 0.25 * k, -0.5), fault)


def filled(count: int, first: int = 1) -> Log:
    log = Log()
    for k in range(first, first + count):
        log.add(sample(k))
    return log


def rows_of(log: Log, after_ns: int = -ALL, until_ns: int = ALL * ALL, most: int = ALL) -> list[list[float]]:
    """Stamp and readings of samples."""
    found = log.samples(after_ns, until_ns, most)
    return [[t, *row] for t, row in zip(np.array(found.times_ns).tolist(), np.array(found.rows).tolist(), strict=True)]


def expected(begin: int, end: int) -> list[list[float]]:
    return [[s.time_ns, *s.force, *s.rate] for s in map(sample, range(begin, end))]


@dataclass(frozen=True)
class Value(Kind):
    """Measurement of a device; late ones are corrected as positions are."""

    time_ns: int
    received_ns: int = 0
    source: str = "gnss"
    value: int = 0
    left_out: tuple[str, ...] = ()

    def corrected(self, position_s: float, velocity_s: float) -> "Value":
        return replace(self, time_ns=self.time_ns - round(position_s * 1e9))


class EpochValue(Value):
    """Measurement of an epoch, which a fault-free fix may replace."""

    epoch = True


def entry(time_ns: int, received_ns: int = 0, source: str = "gnss", value: int = 0) -> Measurement:
    return cast(Measurement, Value(time_ns, received_ns, source, value))


def of_epoch(time_ns: int, received_ns: int, source: str = "gnss", left_out: tuple[str, ...] = ()) -> Measurement:
    return cast(Measurement, EpochValue(time_ns, received_ns, source, left_out=left_out))


@pytest.mark.parametrize("count", [1, FIRST_CAPACITY - 1, FIRST_CAPACITY, FIRST_CAPACITY + 1, 5 * FIRST_CAPACITY])
def test_samples_stay_as_they_were_given_however_often_the_arrays_grow(count: int) -> None:
    log = filled(count)
    assert log.size == count and log.newest == sample(count)
    assert rows_of(log) == expected(1, count + 1)


def test_arrays_stay_as_large_as_twice_what_is_kept_needs() -> None:
    """A log from which as much is dropped as comes: ten times the first capacity passes through it."""
    log = Log()
    for k in range(1, 10 * FIRST_CAPACITY):
        log.add(sample(k))
        log.drop((k - 300) * STEP_NS)
    assert rows_of(log) == expected(10 * FIRST_CAPACITY - 300, 10 * FIRST_CAPACITY)
    assert len(log._times_ns) == FIRST_CAPACITY


def test_samples_that_were_handed_out_do_not_change_when_the_log_goes_on() -> None:
    log = filled(FIRST_CAPACITY)
    part = log.samples(100 * STEP_NS, 200 * STEP_NS, ALL)
    kept = np.array(part.rows).copy()
    log.drop(500 * STEP_NS)
    for k in range(FIRST_CAPACITY + 1, FIRST_CAPACITY + 51):
        log.add(sample(k))
    assert rows_of(log) == expected(501, FIRST_CAPACITY + 51)
    assert np.array_equal(np.array(part.rows), kept)


def test_a_part_is_after_one_time_and_up_to_another_with_the_oldest_first() -> None:
    log = filled(20)
    assert rows_of(log, 5 * STEP_NS, 8 * STEP_NS) == expected(6, 9)
    assert rows_of(log, 5 * STEP_NS - 1, 8 * STEP_NS - 1) == expected(5, 8)
    assert rows_of(log, 5 * STEP_NS, most=2) == expected(6, 8)
    assert rows_of(log, 8 * STEP_NS, 5 * STEP_NS) == [] == rows_of(log, 20 * STEP_NS)


def test_faults_are_at_their_samples_in_every_part_and_dropped_with_them() -> None:
    log = Log()
    for k in range(1, 11):
        log.add(sample(k, "gyroscope saturated" if k in (3, 7) else None))
    assert log.samples(0, ALL, ALL).faults == {2: "gyroscope saturated", 6: "gyroscope saturated"}
    assert log.samples(4 * STEP_NS, ALL, ALL).faults == {2: "gyroscope saturated"}
    assert not log.samples(7 * STEP_NS, ALL, ALL).faults
    log.drop(3 * STEP_NS)
    assert log.samples(0, ALL, ALL).faults == {3: "gyroscope saturated"}
    log.drop(7 * STEP_NS)
    assert not log._faults


def test_a_sample_is_known_by_stamp_and_readings_while_it_is_kept_or_if_it_falls_into_a_gap() -> None:
    log = filled(20)
    log.drop(4 * STEP_NS)
    assert log.is_known(sample(10), oldest_ns=0)
    assert not log.is_known(sample(10)._replace(force=(0.0, 0.0, -9.8)), oldest_ns=0), "another reading"
    assert not log.is_known(sample(10)._replace(time_ns=10 * STEP_NS + 1), oldest_ns=0), "another stamp"
    assert not log.is_known(sample(10), oldest_ns=10 * STEP_NS), "older than the memory"
    assert not log.is_known(sample(3), oldest_ns=0), "dropped"
    assert not Log().is_known(sample(3), oldest_ns=0)
    log.add(sample(60))
    assert log.is_known(sample(40), oldest_ns=0), "within the bridged gap before the newest sample"
    assert log.is_known(sample(60), oldest_ns=0), "the newest sample again"


@given(st.lists(st.tuples(st.integers(0, 5), st.integers(0, 3), st.sampled_from(["a", "b"])), max_size=30))
def test_entries_are_in_the_order_of_stamp_arrival_and_device(given_order: list[tuple[int, int, str]]) -> None:
    log, seen = Log(), set[tuple[int, str]]()
    for time_ns, received_ns, source in given_order:
        is_new = log.insert(entry(time_ns, received_ns, source))
        assert is_new is ((time_ns, source) not in seen), "a repetition shares stamp, device and kind"
        seen.add((time_ns, source))
    found = [(entry.time_ns, entry.received_ns, entry.source) for entry in log.entries(-1, 5)]
    assert found == sorted(given_order)
    assert [entry.time_ns for entry in log.entries(1, 3)] == [t for t, _, _ in found if 1 < t <= 3]


def test_a_fault_free_fix_takes_the_place_of_the_receivers_own_of_its_epoch_whichever_comes_first() -> None:
    own, free = of_epoch(5, 10), of_epoch(5, 20, left_out=("G12",))
    other = [of_epoch(4, 10), of_epoch(5, 10, "second"), entry(5, 10, "wheels")]
    for first, second in ((own, free), (free, own)):
        log = Log()
        for measurement in (*other, first, second):
            if not log.supersedes(measurement):
                log.insert(measurement)
        left = log.entries(4, 5)
        assert free in left and own not in left and len(left) == 3 and log.entries(3, 4) == [other[0]]


def test_a_corrected_delay_moves_entries_after_a_time_and_leaves_those_out_that_were_true_before_it() -> None:
    log = Log()
    for time_ns in (1_000, 2_000, 3_000, 4_000):
        log.insert(entry(time_ns, value=time_ns))
    log.change(1_500, lambda measurement: measurement.corrected(1e-6, 0.0))
    assert [(entry.time_ns, cast(Value, entry).value) for entry in log.entries(0, ALL)] == [
        (1_000, 1_000), (2_000, 3_000), (3_000, 4_000),
    ]  # fmt: skip
    log.change(
        2_000, lambda measurement: measurement.corrected(1e-6, 0.0)
    )  # to the time itself, up to which all is done
    assert [entry.time_ns for entry in log.entries(0, ALL)] == [1_000, 2_000]


def test_entries_are_dropped_with_the_samples() -> None:
    log = filled(10)
    for k in range(1, 11):
        log.insert(entry(k * STEP_NS))
    log.drop(6 * STEP_NS)
    assert [entry.time_ns for entry in log.entries(0, ALL)] == [k * STEP_NS for k in range(7, 11)]
    assert log.size == 4

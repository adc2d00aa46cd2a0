"""Xbus messages are stamped by the tracker's UTC, or by its clock."""

import struct

import pytest

from cli.import_drive.devices.stamped import WITHOUT_DATE_NS, ClockKind
from cli.import_drive.devices.tracker import UTC_TIME, read_tracker
from shared.protocols import xbus
from tests.support.data import recording

NS = 1_000_000_000


def measurement(ticks: int, utc: bytes | None = None) -> bytes:
    fields = {xbus.SAMPLE_TIME_FINE: struct.pack(">I", ticks % (1 << 32))}
    if utc is not None:
        fields[UTC_TIME] = utc
    return xbus.encode_mtdata2(fields)


def utc(second: int, nano: int = 0, flags: int = 7) -> bytes:
    return struct.pack(">IH6B", nano, 2024, 5, 4, 12, 0, second, flags)


def test_the_clock_begins_at_its_first_value_and_wraps() -> None:
    found = read_tracker([b"".join(measurement((1 << 32) - 500 + step * 1000) for step in range(3))])
    assert found.clock is ClockKind.FREE
    assert [(portion.time_ns - WITHOUT_DATE_NS) / NS for portion in found.portions] == pytest.approx([0.0, 0.1, 0.2])


def test_utc_once_valid_is_that_of_the_whole_file() -> None:
    data = measurement(0, utc(1, flags=0)) + measurement(1000, utc(5, 500_000_000)) + measurement(2000)
    found = read_tracker([data])
    assert found.clock is ClockKind.UTC
    assert [portion.time_ns / NS % 60 for portion in found.portions] == pytest.approx([5.4, 5.5, 5.6])


def test_a_restart_of_the_clock_does_not_go_back() -> None:
    found = read_tracker([measurement(50_000) + measurement(100)])
    assert found.portions[-1].time_ns >= found.portions[0].time_ns


def test_measurements_without_a_time_are_counted() -> None:
    found = read_tracker([xbus.encode_mtdata2({xbus.PACKET_COUNTER: b"\0\1"}), xbus.encode_message(0x31, b"")])
    assert (found.rows, found.rejects["no_sample_time"], list(found.portions)) == (2, 1, [])


@pytest.mark.parametrize("bad", [b"\x10", struct.pack(">IH6B", 0, 0, 0, 0, 99, 0, 0, 7)])
def test_an_impossible_utc_is_none(bad: bytes) -> None:
    assert read_tracker([measurement(0, bad)]).clock is ClockKind.FREE


def test_a_recorded_capture() -> None:
    found = read_tracker([(recording("xsens_xbus/1/output.bin")).read_bytes()])
    assert found.rows == 100
    span_s = (found.portions[-1].time_ns - found.portions[0].time_ns) / NS
    assert span_s == pytest.approx(0.95, abs=0.06)

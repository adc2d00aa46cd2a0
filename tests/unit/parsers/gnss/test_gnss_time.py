from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.parsers.gnss.gnss_time import Unwrapper, gps_time_ns, utc_ns
from shared.maths.dates import DAY_NS, NS, WEEK_NS

GPS_EPOCH = datetime(1980, 1, 6, tzinfo=UTC)


def posix_ns(moment: datetime) -> int:
    return (moment - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(microseconds=1) * 1000


@given(st.datetimes(datetime(1990, 1, 1), datetime(2080, 1, 1)), st.integers(0, 20))  # made aware below
def test_gps_time_and_leap_seconds_follow_from_utc_and_time_of_week(moment: datetime, leap_s: int) -> None:
    moment = moment.replace(tzinfo=UTC, microsecond=moment.microsecond // 1000 * 1000)
    gps_ns = posix_ns(moment) - posix_ns(GPS_EPOCH) + leap_s * NS
    itow_ms = gps_ns % WEEK_NS // 1_000_000
    assert gps_time_ns(posix_ns(moment), itow_ms) == gps_ns


def test_the_week_rolls_over_with_the_time_of_week() -> None:
    # Week 2400 of GPS time began at 2026-01-03 23:59:42 UTC, 18 leap seconds before Sunday.
    last = utc_ns((2026, 1, 3, 23, 59, 41), 0)
    first = utc_ns((2026, 1, 3, 23, 59, 42), 0)
    assert last is not None
    assert first is not None
    before, after = gps_time_ns(last, 604_799_000), gps_time_ns(first, 0)
    assert before is not None
    assert after == before + NS
    assert after == 2400 * WEEK_NS


def test_a_negative_nanosecond_precedes_its_second() -> None:
    assert utc_ns((2026, 1, 1, 0, 0, 0), -400_000) == posix_ns(datetime(2026, 1, 1, tzinfo=UTC)) - 400_000


@pytest.mark.parametrize(
    "calendar", [(2026, 13, 1, 0, 0, 0), (2026, 2, 30, 0, 0, 0), (2026, 1, 1, 24, 0, 0), (0, 0, 0, 0, 0, 0)]
)
def test_an_invalid_date_gives_none(calendar: tuple[int, int, int, int, int, int]) -> None:
    assert utc_ns(calendar, 0) is None


def test_inconsistent_utc_and_time_of_week_give_none() -> None:
    utc = posix_ns(datetime(2026, 1, 5, 12, tzinfo=UTC))
    assert gps_time_ns(utc, 0) is None


def test_unwrapping_is_continuous_and_preserves_a_small_step_back() -> None:
    unwrapper = Unwrapper(DAY_NS)
    times = [DAY_NS - NS, 0, NS, 0, DAY_NS - NS, 0]
    steps = [unwrapper.unwrap(time) for time in times]
    assert steps == [DAY_NS - NS, DAY_NS, DAY_NS + NS, DAY_NS, DAY_NS - NS, DAY_NS]

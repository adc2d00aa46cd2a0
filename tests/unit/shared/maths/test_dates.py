from collections import Counter
from datetime import UTC, datetime, timedelta

from hypothesis import given
from hypothesis import strategies as st

from shared import RELEASED
from shared.maths.dates import (
    EARLIEST_HOST_NS,
    END_DATE_NS,
    ERA_NS,
    GPS_EPOCH_UTC_NS,
    MIN_DATE_NS,
    NS,
    DeviceDates,
    in_nearest_era,
    is_plausible,
    plausible_host_ns,
)
from tests.support.cases import each


def at(year: int, month: int = 1, day: int = 1, hour: int = 0) -> int:
    return (
        (datetime(year, month, day, hour, tzinfo=UTC) - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(seconds=1) * NS
    )


TODAY_NS = at(2026, 11, 25)


def dated(told_ns: int | None, host_ns: int | None) -> tuple[int | None, int]:
    rejects: Counter[str] = Counter()
    dates = DeviceDates(rejects)
    dates.host_ns = host_ns
    return dates.utc_ns(told_ns, "date"), rejects["date"]


def test_the_limits_are_the_years_1980_and_2100() -> None:
    assert at(1980) == MIN_DATE_NS and at(2101) == END_DATE_NS and at(1980, 1, 6) == GPS_EPOCH_UTC_NS
    assert is_plausible(MIN_DATE_NS) and is_plausible(END_DATE_NS - 1)
    assert not is_plausible(MIN_DATE_NS - 1) and not is_plausible(END_DATE_NS)


def test_a_date_1024_weeks_old_is_moved_to_the_era_of_the_host() -> None:
    assert dated(at(2007, 2, 5, 12), at(2026, 9, 21)) == (at(2026, 9, 21, 12), 0)


def test_a_host_whose_clock_is_before_the_release_counts_as_the_release_less_400_days() -> None:
    assert at(RELEASED.year, RELEASED.month, RELEASED.day) - 400 * 86_400 * NS == EARLIEST_HOST_NS
    for host_ns in (0, -(2**63), at(1970), at(2007, 2, 5), at(2500)):
        assert plausible_host_ns(host_ns) == EARLIEST_HOST_NS
        assert dated(at(2007, 2, 5), host_ns) == (at(2026, 9, 21), 0)
    assert plausible_host_ns(at(2040)) == at(2040)


def test_dates_of_a_file_are_as_recorded() -> None:
    for told_ns in (at(1980), at(2007, 2, 5), at(2100, 12, 31)):
        assert dated(told_ns, None) == (told_ns, 0)


@each("told_ns", [None, at(2300), at(1979, 12, 31), at(1), -(2**63), 2**63, 10**30])
@each("host_ns", [None, TODAY_NS])
def test_an_impossible_date_is_one_reject(told_ns: int | None, host_ns: int | None) -> None:
    assert dated(told_ns, host_ns) == (None, 1)


@given(st.integers(MIN_DATE_NS, END_DATE_NS - 1), st.integers(EARLIEST_HOST_NS, at(2085)))
def test_live_every_possible_date_is_within_half_an_era_of_the_host(told_ns: int, host_ns: int) -> None:
    found = in_nearest_era(told_ns, host_ns)
    assert abs(found - host_ns) <= ERA_NS // 2
    assert (found - told_ns) % ERA_NS == 0


def test_gps_time_has_the_same_rule() -> None:
    dates = DeviceDates(Counter())
    dates.host_ns = TODAY_NS
    week_ns = 604_800 * NS
    assert dates.gps_time_ns((2437 - 1024) * week_ns, "date") == 2437 * week_ns
    assert dates.gps_time_ns(65_535 * week_ns, "date") is None

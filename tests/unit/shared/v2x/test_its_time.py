from datetime import UTC, datetime

from shared.v2x import its_time
from tests.support.cases import each


def ns(*date: int) -> int:
    return round(datetime(*date, tzinfo=UTC).timestamp()) * 1_000_000_000  # type: ignore[arg-type,misc]


def test_its_time_of_the_standards_example() -> None:
    """TS 102 894-2 gives 94 694 401 000 ms for the begin of 2007, one leap second after 2004; four more followed."""
    assert its_time.its_time_ms(ns(2007, 1, 1)) == 94_694_401_000 + 4_000


def test_its_time_is_utc_and_five_leap_seconds_since_2017() -> None:
    elapsed_s = (datetime(2026, 11, 22, tzinfo=UTC) - datetime(2004, 1, 1, tzinfo=UTC)).total_seconds()
    assert its_time.its_time_ms(ns(2026, 11, 22)) == (elapsed_s + 5) * 1000


def test_utc_from_its_time_is_the_inverse() -> None:
    time_ms = its_time.its_time_ms(ns(2026, 11, 22, 17, 30) + 123_000_000)
    assert its_time.utc_ns_from_its_time(time_ms) == ns(2026, 11, 22, 17, 30) + 123_000_000


@each("age_ms", [0, 1, 1004, 32_767, -1, -1000, -32_768])
@each("cycle_ms", [0, 500, 65_535])
def test_the_age_is_found_across_the_wrap_of_generation_delta_time(age_ms: int, cycle_ms: int) -> None:
    received_ms = 12_345 * its_time.CYCLE_MS + cycle_ms
    assert its_time.generation_age_ms((received_ms - age_ms) % its_time.CYCLE_MS, received_ms) == age_ms

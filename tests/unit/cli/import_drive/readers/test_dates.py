from datetime import UTC, datetime

import pytest

from cli.import_drive.readers.dates import unix_time
from tests.support.cases import each

NOON = datetime(2026, 9, 21, 10, 20, 0, 500_000, tzinfo=UTC).timestamp()


@each(
    "text",
    [
        "2026-09-21T10:20:00.5", "2026-09-21 10:20:00.500", "2026/09/21 10:20:00.500", "2026/9/21 10:20:00,5",
        "21.09.2026 10:20:00.5", "21.9.2026, 10:20:00.5", "20260921T102000.500", "2026-09-21T12:20:00.5+02:00",
        "2026-09-21T10:20:00.5Z", "2026-09-21 10:20:00.500000000", "2026.09.21 10:20:00.5 am",
    ],
)  # fmt: skip
def test_a_date_in_any_unambiguous_form_is_the_same_time(text: str) -> None:
    assert unix_time(text) == NOON


def test_a_twelve_hour_clock_and_a_time_of_day_alone_are_read() -> None:
    assert unix_time("2026/09/21 10:20:00.5 PM") == NOON + 43_200.0
    assert unix_time("2026/09/21 12:20:00.5 AM") == NOON - 36_000.0
    assert unix_time("9:20:00.5") == 33_600.5
    assert unix_time("2026/09/21") == NOON - 37_200.5


@pytest.mark.parametrize(("text", "why"), [
    ("09/21/2026 10:20", "day and month in an order"), ("2026/13/21 10:20", "is no date"), ("soon", "is no date"),
    ("1790000000", "is no date"), ("2026-09-21 25:00:00", "is no date"),
])  # fmt: skip
def test_what_is_no_date_says_why(text: str, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        unix_time(text)

from datetime import UTC, datetime

import numpy as np

from cli.import_drive.conversion.scales import Scale, utc_of
from tests.support.cases import each


@each(
    ("scale", "day", "ahead_s"),
    [
        ("utc", (2026, 9, 21), 0.0), ("gps", (2026, 9, 21), 18.0), ("tai", (2026, 9, 21), 37.0),
        ("beidou", (2026, 9, 21), 4.0), ("gps", (2016, 12, 31), 17.0), ("gps", (1980, 1, 6), 0.0),
        ("gps", (2008, 6, 1), 14.0), ("tai", (1980, 1, 7), 19.0),
    ],
)  # fmt: skip
def test_the_leap_seconds_of_the_date_are_removed(scale: Scale, day: tuple[int, int, int], ahead_s: float) -> None:
    utc = datetime(*day, 12, tzinfo=UTC).timestamp()
    assert utc_of(np.array([utc + ahead_s]), scale).tolist() == [utc]


def test_utc_goes_on_in_the_second_after_a_leap_second() -> None:
    end = datetime(2017, 1, 1, tzinfo=UTC).timestamp()
    assert utc_of(np.array([end + 16.0, end + 18.0, end + 19.0]), "gps").tolist() == [end - 1.0, end, end + 1.0]

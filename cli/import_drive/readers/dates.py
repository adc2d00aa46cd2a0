"""Reads dates and times of day, in the forms in which loggers and spreadsheets write them."""

import re
from datetime import UTC, datetime

from shared.errors import UserError

DAY_S = 86_400.0
# The day first with dots (21.09.2026), the year first with any separator; with slashes the day and the month cannot be
# told apart unless the year is first.
DAY = re.compile(r"(?P<year>\d{4})[-/.](?P<month>\d{1,2})[-/.](?P<day>\d{1,2})"
                 r"|(?P<day_first>\d{1,2})\.(?P<month_second>\d{1,2})\.(?P<year_last>\d{4})")  # fmt: skip
CLOCK = re.compile(r"(?P<hour>\d{1,2}):(?P<rest>\d{2}(?::\d{2}(?:[.,]\d+)?)?)\s*(?P<half>[AaPp][Mm])?(?P<zone>.*)")
AMBIGUOUS = re.compile(r"\d{1,2}/\d{1,2}/\d{4}")


def unix_time(text: str) -> float:
    """Seconds since 1970 of a date, UTC without a zone; seconds of the day of a time of day without a date.

    Raises
    ------
    ValueError
        Neither a date nor a time of day, with the reason.
    """
    text = text.strip()
    if AMBIGUOUS.match(text):
        raise ValueError("has day and month in an order that is not known; write 2026-09-21 or 21.09.2026")
    day = DAY.match(text)
    clock = _clock(text[day.end() :].lstrip("Tt ,;") if day else text)
    try:
        if day is not None:
            parts = [int(number) for number in day.groups() if number is not None]
            year, month, of_month = parts if day["year"] else reversed(parts)
            date = datetime.fromisoformat(f"{year:04d}-{month:02d}-{of_month:02d}T{clock or '00:00'}")
        elif CLOCK.match(text):
            date = datetime.fromisoformat(f"1970-01-01T{clock}")
        else:
            date = datetime.fromisoformat(text)
    except ValueError as error:
        raise ValueError("is no date; dates are such as 2026-09-21T10:20:00.5 or 2026/09/21 10:20:00.5") from error
    return (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp()


def is_time_of_day(text: str) -> bool:
    """Whether a field is a time of day without a date."""
    return CLOCK.match(text.strip()) is not None


def is_day(text: str) -> bool:
    """Whether a field is a date without a time of day."""
    return DAY.fullmatch(text.strip()) is not None


def checked_dates(first_s: float, where: str, column: str) -> None:
    """Raise UserError if the stamps are times of day, of which the day is not known."""
    if 0.0 <= first_s < DAY_S:
        raise UserError(
            f"{where}: column {column!r} holds times of day without a date; name the column of the dates by "
            "`date_column` in `time`, or give the midnight before the first row as `start_utc_s`"
        )


def _clock(text: str) -> str:
    """A time of day of ISO 8601 from one with an hour of one digit or of a twelve-hour clock."""
    found = CLOCK.match(text)
    if found is None:
        return text
    hour = int(found["hour"])
    if found["half"]:
        hour = hour % 12 + (12 if found["half"].lower() == "pm" else 0)
    return f"{hour:02d}:{found['rest']}{found['zone'].strip()}"

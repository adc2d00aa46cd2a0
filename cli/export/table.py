"""Formats messages as CSV: one row a message, one column a field; fields inside fields are joined by a dot."""

import csv
import json
from collections.abc import Callable, Iterable, Iterator
from io import StringIO

from shared.messages.base import Message
from shared.track_files import iso_time

UTC = "time_utc"
STAMPS = ("sampled_ns", "now_ns", "received_ns")  # of a message, by preference


def csv_lines(messages: Callable[[], Iterable[Message]], utc_ns: Callable[[int], int]) -> Iterator[str]:
    """Format messages of one type, which are read twice: for the columns that occur, and for the rows.

    The first column is the time in UTC, by `utc_ns` from the unit's time line; the others are the fields as they are
    recorded, stamps in the unit's time line. Short tuples have a column for each element, named by its number from 0; a
    list of things, such as of satellites, is one column of JSON. Unknown values are empty.
    """
    names = dict.fromkeys(name for message in messages() for name, _ in _cells("", message.model_dump(mode="json")))
    columns = [name for name in names if not any(other.startswith(f"{name}.") for other in names)]
    yield _row([UTC, *columns])
    for message in messages():
        row = dict(_cells("", message.model_dump(mode="json")))
        yield _row([_time(message, utc_ns), *(row.get(name) for name in columns)])


def _time(message: Message, utc_ns: Callable[[int], int]) -> str | None:
    """UTC of a message, of a batch that of its first sample; None for one without a stamp."""
    stamp = next((value for name in STAMPS if (value := getattr(message, name, None)) is not None), None)
    first = stamp[0] if isinstance(stamp, tuple) and stamp else stamp
    return iso_time(utc_ns(first)) if isinstance(first, int) else None


def _cells(prefix: str, value: object) -> Iterator[tuple[str, object]]:
    match value:
        case dict():
            for key, inner in value.items():
                yield from _cells(f"{prefix}.{key}" if prefix else str(key), inner)
        case list() if value and all(isinstance(inner, (int, float)) for inner in value) and len(value) <= 9:
            for place, inner in enumerate(value):
                yield f"{prefix}.{place}", inner
        case list():
            yield prefix, json.dumps(value, separators=(",", ":"))
        case _:
            yield prefix, value


def _row(cells: Iterable[object]) -> str:
    text = StringIO()
    csv.writer(text, lineterminator="\n").writerow(["" if cell is None else cell for cell in cells])
    return text.getvalue()

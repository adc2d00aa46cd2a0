"""Formats messages as CSV: one row a message, one column a field; fields inside fields are joined by a dot."""

import csv
import json
from collections.abc import Callable, Iterable, Iterator
from io import StringIO

from shared.messages.base import Message


def csv_lines(messages: Callable[[], Iterable[Message]]) -> Iterator[str]:
    """Format messages of one type, which are read twice: for the columns that occur, and for the rows.

    Short tuples have a column for each element, named by its number from 0; a list of things, such as of satellites, is
    one column of JSON. Unknown values are empty.
    """
    names = dict.fromkeys(name for message in messages() for name, _ in _cells("", message.model_dump(mode="json")))
    columns = [name for name in names if not any(other.startswith(f"{name}.") for other in names)]
    yield _row(columns)
    for message in messages():
        row = dict(_cells("", message.model_dump(mode="json")))
        yield _row([row.get(name) for name in columns])


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

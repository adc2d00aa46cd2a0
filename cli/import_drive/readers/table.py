"""Parses rows of text to columns of numbers; rows with invalid numbers are counted and omitted."""

import difflib
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from shared.errors import UserError
from shared.maths.earth import FloatArray

from .dates import unix_time

DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+(?:[eE][-+]?\d+)?")
OTHER_SEPARATORS = (";", "\t", ",", "|", " ")
DATE_LIKE = re.compile(r"\d{1,2}:\d{2}|\d{4}[-/.]\d{1,2}[-/.]\d{1,2}")


@dataclass
class Table:
    """The wanted columns of a file, and the number of omitted rows by reason."""

    columns: tuple[str, ...]
    values: FloatArray  # shape (rows, columns)
    row_numbers: FloatArray  # shape (rows,): number of each row in its file, from 0, omitted rows included
    rejects: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)  # what was found in rows, one sentence each

    def __len__(self) -> int:
        return len(self.values)

    def __getitem__(self, column: str) -> FloatArray:
        values: FloatArray = self.values[:, self.columns.index(column)]
        return values

    def many(self, columns: Sequence[str]) -> FloatArray:
        """Several columns side by side, shape (rows, len(columns))."""
        return np.column_stack([self[column] for column in columns])

    def keep(self, wanted: npt.NDArray[np.bool_], reason: str) -> "Table":
        """Keep the wanted rows, and count the others under a reason."""
        rejects = Counter(self.rejects)
        if dropped := int(len(wanted) - wanted.sum()):
            rejects[reason] += dropped
        return Table(self.columns, self.values[wanted], self.row_numbers[wanted], rejects, self.notes)


@dataclass(frozen=True)
class Forms:
    """How the fields of a file are written."""

    dates: Sequence[
        str
    ] = ()  # columns of dates or times of day, which are converted to Unix time [s]; default zone: UTC
    decimal: str = "."
    first_line: int = 1  # line number of the first row, from 1


def read_table(
    lines: Iterable[list[str]], header: Sequence[str], wanted: Sequence[str], where: str, forms: Forms | None = None
) -> Table:
    """Extract the wanted columns of a CSV file.

    Parameters
    ----------
    lines : iterable of list of str
        The rows after the header, split into fields.
    header : sequence of str
        The name of each column, in the order of the file.
    wanted : sequence of str
        The columns to keep; each must be in the header.
    where : str
        File name for error messages.
    forms : Forms, optional
        How the fields are written.

    Returns
    -------
    Table
        Rows whose wanted fields are all finite numbers; the others are counted in `rejects` as
        "not a number", "not finite" (inf, nan) or "too short".

    Raises
    ------
    UserError
        A wanted column is missing in the header, or no valid row remains.
    """
    forms = forms or Forms()
    columns = tuple(dict.fromkeys(wanted))
    as_number = _number_of(forms.decimal)
    places = {_place(column, header, where): unix_time if column in forms.dates else as_number for column in columns}
    values: list[list[float]] = []
    numbers: list[int] = []
    rejects: Counter[str] = Counter()
    first = ""
    for number, fields in enumerate(lines):
        row = _numbers(fields, places)
        if isinstance(row, str):
            rejects[row] += 1
            first = first or f"row {number + 1} (line {number + forms.first_line}), {_fault(fields, places, header)}"
            continue
        values.append(row)
        numbers.append(number)
    _check_any(len(values), first, where)
    notes = [f"{where}: the first rejected row is {first}."] if first else []
    return Table(columns, np.array(values), np.array(numbers, dtype=float), rejects, notes)


def arrays_table(arrays: Mapping[str, npt.NDArray[np.generic]], wanted: Sequence[str], where: str) -> Table:
    """Extract the wanted columns of arrays.

    Parameters
    ----------
    arrays : mapping of str to ndarray, shape (rows,) or (rows, k)
        The arrays of the file; unused ones may have other lengths.
    wanted : sequence of str
        `name` of a one-dimensional array; `name[0]`, `name[1]`... of a two-dimensional one.
    where : str
        File name for error messages.

    Returns
    -------
    Table
        Rows whose wanted numbers are all finite; the others are counted.

    Raises
    ------
    UserError
        A wanted column is missing, or the columns differ in length.
    """
    header = [name for key, array in arrays.items() for name in _names(key, array)]
    columns = tuple(dict.fromkeys(wanted))
    found = [_column(arrays, header[_place(column, header, where)]) for column in columns]
    if len({len(column) for column in found}) > 1:
        lengths = ", ".join(f"{name} {len(column)}" for name, column in zip(columns, found, strict=True))
        raise UserError(f"{where}: the arrays differ in length ({lengths}); a table requires arrays of equal length")
    values = np.column_stack(found)
    if not len(values):
        raise UserError(f"{where} holds empty arrays: nothing to import")
    finite: npt.NDArray[np.bool_] = np.isfinite(values)
    first = ""
    if not finite.all():
        row, column = np.argwhere(~finite)[0].tolist()
        first = f"row {row + 1}, column {columns[column]!r}: {values[row, column]} is not finite"
    notes = [f"{where}: the first rejected row is {first}."] if first else []
    table = Table(columns, values, np.arange(len(values), dtype=float), notes=notes)
    table = table.keep(np.asarray(finite.all(axis=1)), "not finite")
    _check_any(len(table), first, where)
    return table


def _check_any(rows: int, first: str, where: str) -> None:
    """Raise UserError if no row is left, with the first field that is no number."""
    if rows:
        return
    if not first:
        raise UserError(f"{where} holds no row behind its header; check `skip_rows` and `header` of the mapping")
    raise UserError(f"{where} holds no row whose wanted columns are all numbers; the first one that fails: {first}")


def _names(key: str, array: npt.NDArray[np.generic]) -> list[str]:
    """Column names of an array; empty unless it is a table of numbers."""
    if not np.issubdtype(array.dtype, np.number) or array.ndim not in (1, 2):
        return []
    return [key] if array.ndim == 1 else [f"{key}[{k}]" for k in range(array.shape[1])]


def _column(arrays: Mapping[str, npt.NDArray[np.generic]], name: str) -> FloatArray:
    key, _, place = name.removesuffix("]").partition("[")
    column = arrays[name] if name in arrays else arrays[key][:, int(place)]
    return column.astype(np.float64)


def _numbers(fields: list[str], places: Mapping[int, Callable[[str], float]]) -> list[float] | str:
    """The numbers of these fields, or the reason why the row is invalid."""
    try:
        row = [number(fields[place]) for place, number in places.items()]
    except IndexError:
        return "too short"
    except ValueError:
        return "not a number"
    return row if all(map(math.isfinite, row)) else "not finite"


def _number_of(decimal: str) -> Callable[[str], float]:
    """Parser of numbers with a decimal point or comma."""
    if decimal == ".":
        return float

    def parse(text: str) -> float:
        return float(text.replace(decimal, "."))

    return parse


def _fault(fields: Sequence[str], places: Mapping[int, Callable[[str], float]], header: Sequence[str]) -> str:
    """Which field of a rejected row is no number, and why."""
    for place, number in places.items():
        if place >= len(fields):
            held = ",".join(fields)[:40]
            return (
                f"column {header[place]!r}: it is number {place + 1}, and the row has {len(fields)} fields ({held!r}); "
                "check `separator`"
            )
        text = fields[place]
        try:
            if not math.isfinite(number(text)):
                return f"column {header[place]!r}: {text!r} is not finite"
        except ValueError as error:
            return f"column {header[place]!r}: {text[:40]!r} {_why(text.strip(), number, error)}"
    raise ValueError("a row without fault")


def _why(text: str, number: Callable[[str], float], error: ValueError) -> str:
    """Why a field is no number, and what to set where the form is known."""
    if number is unix_time:
        return str(error)
    if not text:
        return "is empty"
    if DECIMAL_COMMA.fullmatch(text):
        return 'is not a number: it has a decimal comma; set `decimal = ","` in the table of this file'
    if any(mark in text for mark in OTHER_SEPARATORS):
        return "is not a number, but several; check `separator`"
    if DATE_LIKE.search(text):
        return 'is not a number, but a date or time of day; set `unit = "date"` in `time`'
    return "is not a number; check `separator`, `skip_rows` and the name of the column"


def _place(column: str, header: Sequence[str], where: str) -> int:
    if column in header:
        return header.index(column)
    near = difflib.get_close_matches(column, header, n=1)
    hint = f"did you mean {near[0]!r}?" if near else f"it has {', '.join(header)}"
    raise UserError(f"{where} has no column {column!r}; {hint}")

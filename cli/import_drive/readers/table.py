"""Parses rows of text to columns of numbers; rows with invalid numbers are counted and omitted."""

import difflib
import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime

import numpy as np
import numpy.typing as npt

from shared.errors import UserError
from shared.maths.earth import FloatArray


@dataclass
class Table:
    """The wanted columns of a file, and the number of omitted rows by reason."""

    columns: tuple[str, ...]
    values: FloatArray  # shape (rows, columns)
    row_numbers: FloatArray  # shape (rows,): number of each row in its file, from 0, omitted rows included
    rejects: Counter[str] = field(default_factory=Counter)

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
        return Table(self.columns, self.values[wanted], self.row_numbers[wanted], rejects)


def read_table(
    lines: Iterable[list[str]], header: Sequence[str], wanted: Sequence[str], where: str, dates: Sequence[str] = ()
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
    dates : sequence of str
        Columns with dates (ISO 8601), which are converted to Unix time [s]; without a zone they are UTC.

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
    columns = tuple(dict.fromkeys(wanted))
    places = {_place(column, header, where): _unix_time if column in dates else float for column in columns}
    values: list[list[float]] = []
    numbers: list[int] = []
    rejects: Counter[str] = Counter()
    for number, fields in enumerate(lines):
        row = _numbers(fields, places)
        if isinstance(row, str):
            rejects[row] += 1
            continue
        values.append(row)
        numbers.append(number)
    if not values:
        raise UserError(f"{where} holds no valid row of numbers; check `separator` and `skip_rows` of the mapping")
    return Table(columns, np.array(values), np.array(numbers, dtype=float), rejects)


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
    table = Table(columns, values, np.arange(len(values), dtype=float))
    return table.keep(np.isfinite(values.sum(axis=1)), "not finite")


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


def _unix_time(text: str) -> float:
    """Seconds since 1970 of a date."""
    date = datetime.fromisoformat(text.strip())
    return (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp()


def _place(column: str, header: Sequence[str], where: str) -> int:
    if column in header:
        return header.index(column)
    near = difflib.get_close_matches(column, header, n=1)
    hint = f"did you mean {near[0]!r}?" if near else f"it has {', '.join(header)}"
    raise UserError(f"{where} has no column {column!r}; {hint}")

"""Rows of text become columns of numbers; what is no number is counted and left out."""

import difflib
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from shared.errors import UserError
from shared.maths.earth import FloatArray


@dataclass
class Table:
    """The wanted columns of a file, and how many rows were left out for which reason."""

    columns: tuple[str, ...]
    values: FloatArray  # shape (rows, columns)
    row_numbers: FloatArray  # shape (rows,): of each row in its file, from 0, rejected ones counted
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
        """Leave out the rows that are not wanted, and count them under a reason."""
        rejects = Counter(self.rejects)
        if dropped := int(len(wanted) - wanted.sum()):
            rejects[reason] += dropped
        return Table(self.columns, self.values[wanted], self.row_numbers[wanted], rejects)


def read_table(lines: Iterable[list[str]], header: Sequence[str], wanted: Sequence[str], where: str) -> Table:
    """Take the wanted columns out of the rows of a CSV file.

    Parameters
    ----------
    lines : iterable of list of str
        The rows behind the header, cut into fields.
    header : sequence of str
        The name of each column, in the order of the file.
    wanted : sequence of str
        The columns to keep; each must be in the header.
    where : str
        The file's name, for the error.

    Returns
    -------
    Table
        Rows whose wanted fields are all finite numbers; the others are in its `rejects` as
        "not a number", "not finite" (inf, nan) or "too short".

    Raises
    ------
    UserError
        A wanted column is not in the header, or no row is left.
    """
    columns = tuple(dict.fromkeys(wanted))
    places = [_place(column, header, where) for column in columns]
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
        raise UserError(f"{where} holds no row of numbers; check `separator` and `skip_rows` in the mapping")
    return Table(columns, np.array(values), np.array(numbers, dtype=float), rejects)


def _numbers(fields: list[str], places: list[int]) -> list[float] | str:
    """The numbers at these places, or the reason why there are none."""
    try:
        row = [float(fields[place]) for place in places]
    except IndexError:
        return "too short"
    except ValueError:
        return "not a number"
    return row if all(map(math.isfinite, row)) else "not finite"


def _place(column: str, header: Sequence[str], where: str) -> int:
    if column in header:
        return header.index(column)
    near = difflib.get_close_matches(column, header, n=1)
    hint = f"did you mean {near[0]!r}?" if near else f"it has {', '.join(header)}"
    raise UserError(f"{where} has no column {column!r}; {hint}")

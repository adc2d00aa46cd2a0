"""The first field that is no number is named, with its row, its column, its text and why."""

import numpy as np
import pytest

from cli.import_drive.readers.table import Forms, arrays_table, read_table
from shared.errors import UserError
from tests.support.cases import each

HEADER = ("t", "lat", "h")


@each(
    ("row", "said"),
    [
        (["1790000000,000", "47,2", "450"], r"column 't': '1790000000,000' is not a number: it has a decimal comma"),
        (["1", "-,5", "450"], r"column 'lat': '-,5' is not a number: it has a decimal comma"),
        (["1", "47.2;450", "1"], r"column 'lat': '47.2;450' is not a number, but several; check `separator`"),
        (["1", "", "450"], r"column 'lat': '' is empty"),
        (["1", "nan", "450"], r"column 'lat': 'nan' is not finite"),
        (["1", "47.2"], r"column 'h': it is number 3, and the row has 2 fields \('1,47.2'\); check `separator`"),
        (["10:20:00", "47.2", "450"], r"column 't': '10:20:00' is not a number, but a date or time of day; set `unit"),
        (["1", "47.2N", "450"], r"column 'lat': '47.2N' is not a number; check `separator`, `skip_rows`"),
    ],
)  # fmt: skip
def test_a_file_without_a_valid_row_names_its_first_bad_field(row: list[str], said: str) -> None:
    with pytest.raises(UserError, match=rf"g.csv holds no row .* row 1 \(line 5\), {said}"):
        read_table([row], HEADER, HEADER, "g.csv", Forms(first_line=5))


def test_a_single_bad_row_is_a_note() -> None:
    table = read_table([["1", "47", "450"], ["2", "x", "451"], ["3", "y", "452"]], HEADER, HEADER, "g.csv")
    assert len(table) == 2 - 1 and table.rejects == {"not a number": 2}
    (note,) = table.notes
    assert note.startswith("g.csv: the first rejected row is row 2 (line 2), column 'lat': 'x' is not a number;")


def test_a_decimal_comma_is_read_with_its_setting() -> None:
    table = read_table([["1790000000,25", "-47,5", "4,5e2"]], HEADER, HEADER, "g.csv", Forms(decimal=","))
    assert table.values.tolist() == [[1_790_000_000.25, -47.5, 450.0]]


def test_a_file_that_ends_with_its_header_says_so() -> None:
    with pytest.raises(UserError, match=r"g\.csv holds no row behind its header"):
        read_table([], HEADER, HEADER, "g.csv")


def test_arrays_without_a_finite_row_name_the_first_value() -> None:
    arrays = {"t": np.array([0.0, 1.0]), "h": np.array([np.nan, np.inf])}
    with pytest.raises(UserError, match="row 1, column 'h': nan is not finite"):
        arrays_table(arrays, ("t", "h"), "a.npz")

"""Tables of `obu papers` in a narrow terminal: cells go on in the next line, and nothing of them is cut."""

from collections import Counter
from io import StringIO

import pytest
from rich.console import Console

from cli.papers.report import Table, printed

TRIPLES = Table(
    "False alarms, missed step, missed ramp [%]",
    ("ratio", "paper", "open loop", "Baarda", "closed loop", "leave-one-out"),
    [("1.0", *["12.53 11.08 150.2"] * 5), ("mean", *["2.83 0.46 47.3"] * 5)],
)


@pytest.mark.parametrize("columns", [80, 200])
def test_every_number_of_a_table_is_printed_whole(columns: int) -> None:
    console = Console(file=StringIO(), width=columns)
    console.print(printed(TRIPLES))
    assert isinstance(console.file, StringIO)
    text = console.file.getvalue()
    assert "…" not in text
    expected = Counter(word for row in (TRIPLES.columns, *TRIPLES.rows) for cell in row for word in cell.split())
    found = Counter(text.split())
    assert all(found[word] >= count for word, count in expected.items())

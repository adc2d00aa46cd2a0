"""The lists of figures and tables as texts, and as docs/reference/papers.md."""

from shared.bus.contract import table

from .coverage import HELD, Coverage, Row, Status, compared, coverage, names, stored

COLUMNS = ("item", "shows", "status", "paper: ours", "command, or why not")
HEAD = """# What of the papers is reproduced

Figure by figure and table by table. `figure 12` is the highest number of a paper that the documents of this project
name: the papers are not part of the repository, and a figure that these documents do not describe is *not reproduced*.
Numbers beside the paper's are of the results in `benchmarks/results/papers`, each with the version of the code;
`make papers KEEP=1` computes them again. `obu papers list` prints these tables. *Reproduced* numbers are held by
`tests/scenarios/papers/test_coverage.py`, and so are *fitted* ones, to which the simulation was fitted: agreement there
is no independent evidence. A figure without a number is *reproduced* by a test of its form, which is named.
"""


def cells(name: str, row: Row) -> tuple[str, ...]:
    """One row as texts."""
    form = f"held by `tests/{row.test}`" if row.status in HELD and not row.numbers else ""
    last = "; ".join(text for text in (row.command and f"`{row.command}`", form, row.why) if text)
    return row.item, row.shows or "-", row.status.value, compared(row, stored(name)) or "-", last


def title_of(listed: Coverage) -> str:
    """Title of a paper, and how many of its rows are reproduced."""
    counts = [sum(row.status is status for row in listed.rows) for status in Status]
    counted = f"{counts[0]} reproduced, {counts[1]} fitted, {counts[2]} differ, {counts[3]} not reproduced"
    return f"{listed.number} {listed.title}: {counted}"


def coverage_page() -> str:
    """All lists as a page."""
    parts = [HEAD]
    for name in names():
        listed, result = coverage(name), stored(name) or {}
        origin = f"Stored result: version {result.get('version')}, commit {result.get('commit')}." if result else ""
        body = table(COLUMNS, [cells(name, row) for row in listed.rows])
        parts.append(f"\n## {title_of(listed)}\n\n{origin}\n\n{body}\n")
    return "".join(parts)

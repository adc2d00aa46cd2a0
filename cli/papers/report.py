"""What `obu papers` prints and writes of a paper: tables beside the published ones, remarks, figures, JSON."""

import json as json_module
import re
import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table as RichTable

from shared import VERSION
from shared.errors import UserError

if TYPE_CHECKING:
    from matplotlib.axes import Axes


RESULT = "result.json"  # beside the figures


@dataclass(frozen=True)
class Table:
    """A table of texts; the first column names the row."""

    title: str
    columns: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]


@dataclass(frozen=True)
class Figure:
    """A figure as SVG; its file is named after the title."""

    title: str
    svg: str

    @property
    def file(self) -> str:
        """Name of its file."""
        return re.sub(r"\W+", "-", self.title.lower()).strip("-") + ".svg"


@dataclass(frozen=True)
class Paper:
    """A reproduced paper; `deviations` are tolerances and limits that are exceeded, which fail the command."""

    name: str
    tables: Sequence[Table]
    document: dict[str, object]
    fitted: Sequence[str] = ()
    not_reproduced: Sequence[str] = ()
    skipped: Sequence[str] = ()  # what was not computed, for want of a recording
    deviations: Sequence[str] = ()
    figures: Sequence[Figure] = field(default=())


@contextmanager
def figure(
    title: str, store: Callable[[Figure], None], *, columns: int = 1, height: float = 3.2
) -> Iterator[list["Axes"]]:
    """Create axes side by side; on exit pass the figure to `store`."""
    from matplotlib import style  # takes 0.5 s to import
    from matplotlib.figure import Figure as Canvas

    from cli.solve.report.drawing import STYLE

    with style.context(STYLE):
        canvas = Canvas(figsize=(8.6, height), layout="constrained")
        yield list(canvas.subplots(1, columns, squeeze=False)[0])
        text = StringIO()
        canvas.savefig(text, format="svg", metadata={"Date": None, "Creator": None}, facecolor="white")
    store(Figure(title, text.getvalue()))


def publish(paper: Paper, *, json: bool, out: Path | None) -> int:
    """Print a paper and write its figures; return 1 if a number is outside its tolerance."""
    if out is not None:
        _write(paper, out)
    if json:
        print(json_module.dumps(whole(paper), indent=2))
    else:
        _print(paper, Console(), out)
    return 1 if paper.deviations else 0


def whole(paper: Paper) -> dict[str, object]:
    """Numbers and remarks of a paper, for JSON."""
    remarks = {
        "fitted": paper.fitted, "not_reproduced": paper.not_reproduced, "skipped": paper.skipped,
        "deviations": paper.deviations,
    }  # fmt: skip
    return {"paper": paper.name, **paper.document, **remarks}


def stamped(paper: Paper) -> dict[str, object]:
    """The same with the version of the code, and its commit where it is a clone of the repository."""
    try:
        done = subprocess.run(
            ["git", "describe", "--always", "--dirty"], cwd=Path(__file__).parent, capture_output=True, text=True,
            check=False,
        )  # fmt: skip
        commit = done.stdout.strip() or None
    except OSError:  # no git: an installed unit
        commit = None
    return {"version": VERSION, "commit": commit, **whole(paper)}


def _write(paper: Paper, out: Path) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
        for figure in paper.figures:
            (out / figure.file).write_text(figure.svg, encoding="utf-8")
        (out / RESULT).write_text(json_module.dumps(stamped(paper), indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise UserError(f"cannot write to {out}: {error.strerror}; choose another folder with --out") from error


def printed(table: Table) -> RichTable:
    """Lay out a table for the terminal: where that is too narrow, cells go on in another line, and nothing is cut."""
    rich = RichTable(title=escape(table.title), title_justify="left", box=SIMPLE_HEAD)
    rich.pad_edge = rich.show_edge = False
    rich.padding = (0, 1, 0, 0)
    for number, heading in enumerate(table.columns):
        longest = max(len(word) for row in (table.columns, *table.rows) for word in row[number].split() or ("",))
        rich.add_column(escape(heading), justify="right" if number else "left", overflow="fold", min_width=longest)
    for row in table.rows:
        rich.add_row(*map(escape, row))
    return rich


def _print(paper: Paper, console: Console, out: Path | None) -> None:
    for table in paper.tables:
        console.print(printed(table))
        console.print()
    for heading, remarks in (
        ("Fitted", paper.fitted), ("Not reproduced", paper.not_reproduced), ("Skipped", paper.skipped)
    ):  # fmt: skip
        for remark in remarks:
            console.print(f"[bold]{heading}:[/] {escape(remark)}", highlight=False)
    if out is not None:
        names = ", ".join(figure.file for figure in paper.figures)
        console.print(f"In {out}: {RESULT}{f', {names}' if names else ''}", highlight=False)
    for deviation in paper.deviations:
        console.print(f"[red]limit exceeded:[/] {escape(deviation)}", highlight=False)
    if not paper.deviations:
        console.print("[green]all limits met[/]")

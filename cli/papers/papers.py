"""`obu papers`: compares simulations and recordings with published results."""

import json as json_module
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.padding import Padding

from shared.errors import UserError

from . import navigation as drives_table
from . import outages as outages_table
from .coverage.coverage import Status, coverage, later_commits, names, stored
from .coverage.page import cells, title_of
from .navigation_figures import drawn_drives
from .report import Paper, publish

MIN_DRIVES = 6
COLOURS = {Status.REPRODUCED: "green", Status.FITTED: "cyan", Status.DIFFERS: "yellow", Status.NOT_REPRODUCED: "dim"}


def navigation(runs: int, json: bool, out: Path | None = None, *, short: bool = False) -> int:
    """Print drives and outages; return 1 if a limit is exceeded. Goals missed with default settings are only named."""
    if runs < 1:
        raise UserError(f"{runs} runs: at least 1 is required: try `obu papers navigation --runs 10`")
    workers = drives_table.WORKERS
    cases = [case for case in drives_table.CASES if case.paper_fused or not short]
    aids = [row for row in outages_table.AIDS if row.wheels or not short]
    drives = drives_table.measure_all(cases, runs, workers, progress=True)
    outages = outages_table.measure_all(aids, runs, workers, progress=True)
    missed = drives_table.missed_goals(drives)
    document = {
        "runs": runs, "drives": drives_table.document(drives), "mean": drives_table.mean_document(drives),
        "outages": outages_table.document(outages), "missed_goals": missed,
    }  # fmt: skip
    paper = Paper(
        "navigation", (), document, drives_table.FITTED, drives_table.not_reproduced(drives),
        deviations=drives_table.shortcomings(drives) + outages_table.shortcomings(outages),
        figures=drawn_drives(1 if short else None, workers) if out is not None else (),
    )  # fmt: skip
    if not json:
        console = Console()
        drives_table.print_table(drives, runs, console)
        outages_table.print_table(outages, runs, console)
        for goal in missed:
            console.print(f"[yellow]goal missed:[/] {goal}")
    return publish(paper, json=json, out=out)


def listed(paper: str | None, json: bool) -> int:
    """Print what of each paper is reproduced, figure by figure and table by table; 0."""
    lists = {name: coverage(name) for name in ([paper] if paper is not None else names())}
    if json:
        rows = {name: {**one.model_dump(mode="json"), "result": stored(name)} for name, one in lists.items()}
        print(json_module.dumps(rows, indent=2))
        return 0
    console = Console()
    for name, one in lists.items():
        console.print(f"[bold]{title_of(one)}[/]", highlight=False)
        if text := _age(name):
            console.print(f"  [yellow]{text}[/]", highlight=False)
        for row in one.rows:
            item, shows, status, numbers, last = cells(name, row)
            console.print(f"  {item} [{COLOURS[row.status]}]{status}[/]: {escape(shows)}", highlight=False)
            for text in (numbers, last):
                if text not in ("", "-"):
                    console.print(Padding(escape(text), (0, 0, 0, 4)), highlight=False)
        console.print()
    return 0


def _age(name: str) -> str:
    """That a stored result is older than the code; empty where it is not, or git does not know."""
    result = stored(name)
    later = later_commits(result.get("commit")) if result is not None else None
    if result is None or not later:
        return ""
    again = f"obu papers {name}"
    return f"numbers are of {result['commit']}: {later} later commits change code; `{again}` computes them again"


def motion_conflict(drives: int, json: bool, out: Path | None) -> int:
    """Reproduce the speed check of the smart tachograph; return 1 if a number is outside its tolerance."""
    from .motion_conflict.paper import reproduce

    return publish(reproduce(drives, progress=True), json=json, out=out)


def cooperative(runs: int, json: bool, out: Path | None) -> int:
    """Reproduce V2X-assisted fault detection; return 1 if a number is outside its tolerance."""
    from .cooperative import reproduce

    return publish(reproduce(runs, progress=True), json=json, out=out)


def spoofing(drives: int, json: bool, out: Path | None) -> int:
    """Reproduce spoofing detection by a phone's sensors; return 1 if a number is outside its tolerance."""
    if drives < MIN_DRIVES:
        raise UserError(f"{drives} drives: 6 are required, four to learn of: try `obu papers spoofing --drives 6`")
    from .spoofing.paper import reproduce

    return publish(reproduce(drives, progress=True), json=json, out=out)


def toll(runs: int, json: bool, out: Path | None) -> int:
    """Reproduce tracking by CAM and decide lanes; return 1 if a number is outside its tolerance."""
    from .toll.paper import reproduce

    return publish(reproduce(runs, progress=True), json=json, out=out)

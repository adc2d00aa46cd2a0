"""`obu papers`: compares simulations and recordings with published results."""

import json as json_module
from pathlib import Path

from rich.console import Console

from shared.errors import UserError

from . import navigation as drives_table
from . import outages as outages_table
from .report import publish

MIN_DRIVES = 6


def navigation(runs: int, json: bool) -> int:
    """Print drives and outages; return 1 if a limit is exceeded. Goals missed with default settings are only named."""
    if runs < 1:
        raise UserError(f"{runs} runs: at least 1 is required: try `obu papers navigation --runs 10`")
    workers = drives_table.WORKERS
    drives = drives_table.measure_all(drives_table.CASES, runs, workers, progress=True)
    outages = outages_table.measure_all(outages_table.AIDS, runs, workers, progress=True)
    faults = drives_table.shortcomings(drives) + outages_table.shortcomings(outages)
    missed = drives_table.missed_goals(drives)
    if json:
        rows = {"drives": drives_table.document(drives), "outages": outages_table.document(outages)}
        remarks = {"fitted": drives_table.FITTED, "not_reproduced": drives_table.not_reproduced(drives)}
        print(
            json_module.dumps(
                {"runs": runs, **rows, "shortcomings": faults, "missed_goals": missed, **remarks}, indent=2
            )
        )
        return 1 if faults else 0
    console = Console()
    drives_table.print_table(drives, runs, console)
    outages_table.print_table(outages, runs, console)
    for heading, remarks_ in (("Fitted", drives_table.FITTED), ("Not reproduced", drives_table.not_reproduced(drives))):
        for remark in remarks_:
            console.print(f"[bold]{heading}:[/] {remark}", highlight=False)
    for fault in faults:
        console.print(f"[red]limit exceeded:[/] {fault}")
    for goal in missed:
        console.print(f"[yellow]goal missed:[/] {goal}")
    if not faults:
        console.print("[green]all limits met[/]")
    return 1 if faults else 0


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

"""`obu papers navigation`: simulated drives and outages beside what the OBU paper and a correct filter reach."""

import json as json_module
import sys

from rich.console import Console

from shared.errors import UserError

from . import papers_navigation, papers_outages


def navigation(runs: int, json: bool) -> int:
    """Print drives, then outages; 1 if a number is not reproduced. A goal missed as delivered is named only."""
    if runs < 1:
        raise UserError(f"{runs} runs measure nothing: try `obu papers navigation --runs 10`")
    workers, progress = papers_navigation.WORKERS, sys.stderr.isatty()
    drives = papers_navigation.measure_all(papers_navigation.CASES, runs, workers, progress)
    outages = papers_outages.measure_all(papers_outages.AIDS, runs, workers, progress)
    faults = papers_navigation.shortcomings(drives) + papers_outages.shortcomings(outages)
    missed = papers_navigation.missed_goals(drives)
    if json:
        rows = {"drives": papers_navigation.document(drives), "outages": papers_outages.document(outages)}
        print(json_module.dumps({"runs": runs, **rows, "shortcomings": faults, "missed_goals": missed}, indent=2))
        return 1 if faults else 0
    console = Console()
    papers_navigation.print_table(drives, runs, console)
    papers_outages.print_table(outages, runs, console)
    for fault in faults:
        console.print(f"[red]not reached:[/] {fault}")
    for goal in missed:
        console.print(f"[yellow]goal missed:[/] {goal}")
    if not faults:
        console.print(f"[green]{'all others' if missed else 'all'} as small as they must be[/]")
    return 1 if faults else 0

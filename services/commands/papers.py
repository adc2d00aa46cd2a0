"""`obu papers navigation`: simulated drives and outages beside what the OBU paper and a correct filter reach."""

import json as json_module
import sys

from rich.console import Console

from shared.errors import UserError

from . import papers_navigation, papers_outages


def navigation(runs: int, json: bool) -> int:
    """Print drives, then outages; 0 if all errors are as small as they must be."""
    if runs < 1:
        raise UserError(f"{runs} runs measure nothing: try `obu papers navigation --runs 10`")
    workers, progress = papers_navigation.WORKERS, sys.stderr.isatty()
    drives = papers_navigation.measure_all(papers_navigation.CASES, runs, workers, progress)
    outages = papers_outages.measure_all(papers_outages.AIDS, runs, workers, progress)
    faults = papers_navigation.shortcomings(drives) + papers_outages.shortcomings(outages)
    if json:
        rows = {"drives": papers_navigation.document(drives), "outages": papers_outages.document(outages)}
        print(json_module.dumps({"runs": runs, **rows, "shortcomings": faults}, indent=2))
        return 1 if faults else 0
    console = Console()
    papers_navigation.print_table(drives, runs, console)
    papers_outages.print_table(outages, runs, console)
    for fault in faults:
        console.print(f"[red]not reached:[/] {fault}")
    if not faults:
        console.print("[green]all as small as they must be[/]")
    return 1 if faults else 0

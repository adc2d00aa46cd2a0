"""`obu papers`: reproduces what the published papers report."""

from pathlib import Path
from typing import Annotated

import typer

JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of the tables.")]
FiguresOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FOLDER", help="Folder of the figures (SVG) and of result.json; without it neither is written."
    ),
]


def navigation(
    runs: Annotated[int, typer.Option(min=1, metavar="COUNT", help="Number of seeds per row.")] = 10,
    as_json: JsonOption = False,
    out: FiguresOption = None,
    short: Annotated[
        bool, typer.Option("--short", help="The five drives of the paper and outages with wheels only.")
    ] = False,
) -> int:
    """Simulate the degraded scenarios of the EMERGE paper, compare with its table 2, and simulate outages.

    The figures are the errors of each scenario with an outage of 30 s. Ends with 1 if a number is not reproduced. A
    goal that only the filter as delivered misses is named, and is no failure.

    Examples:
    [bold]obu papers navigation --runs 2[/]
    [bold]obu papers navigation --out figures[/]
    """
    from ..papers.papers import navigation as repeat

    return repeat(runs, as_json, out, short=short)


def listed(
    paper: Annotated[
        str | None, typer.Argument(metavar="[PAPER]", help="navigation, motion-conflict, cooperative, spoofing, toll.")
    ] = None,
    as_json: JsonOption = False,
) -> int:
    """List every figure, table and number of the papers: reproduced by which command, or why not.

    The numbers of the texts stand beside ours as they are stored in the repository.

    Examples:
    [bold]obu papers list[/]
    [bold]obu papers list toll --json[/]
    """
    from ..papers.papers import listed as show

    return show(paper, as_json)


def motion_conflict(
    drives: Annotated[
        int, typer.Option(min=1, metavar="COUNT", help="Simulated drives of 15 minutes, of each kind.")
    ] = 20,
    as_json: JsonOption = False,
    out: FiguresOption = None,
) -> int:
    """Sweep gaps, delays and scales of the smart tachograph's speed check, and count false detections.

    The paper's break-points are printed beside ours, with simulated and recorded drives, and speeds of GPS alone
    against Galileo alone. OBU_DATA is the folder of the recordings. Ends with 1 if a number is outside its tolerance.

    Examples:
    [bold]obu papers motion-conflict --out figures[/]
    [bold]obu papers motion-conflict --drives 2 --json[/]
    """
    from ..papers.papers import motion_conflict as repeat

    return repeat(drives, as_json, out)


def cooperative(
    runs: Annotated[
        int, typer.Option(min=1, metavar="COUNT", help="Runs of 90 epochs of each of the ten ratios.")
    ] = 500,
    as_json: JsonOption = False,
    out: FiguresOption = None,
) -> int:
    """Repeat the ten ratios of V2X-assisted fault detection, with the leave-one-out bank beside the paper's test.

    Prints position errors with and without exclusion too. Ends with 1 if a number is outside its tolerance.

    Examples:
    [bold]obu papers cooperative --out figures[/]
    [bold]obu papers cooperative --runs 50 --json[/]
    """
    from ..papers.papers import cooperative as repeat

    return repeat(runs, as_json, out)


def spoofing(
    drives: Annotated[
        int, typer.Option(min=6, metavar="COUNT", help="Simulated drives of 15 minutes: two thirds to learn of.")
    ] = 36,
    as_json: JsonOption = False,
    out: FiguresOption = None,
) -> int:
    """Repeat spoofing detection by a phone's sensors, with the improved methods beside the paper's.

    False detections, standard deviations by dynamics, a sweep of the cut-off, attacks, a phone without barometer, and
    drives that phones recorded (OBU_DATA). Ends with 1 if a number is outside its tolerance.

    Examples:
    [bold]obu papers spoofing --out figures[/]
    [bold]obu papers spoofing --drives 6 --json[/]
    """
    from ..papers.papers import spoofing as repeat

    return repeat(drives, as_json, out)


def toll(
    runs: Annotated[
        int,
        typer.Option(min=2, metavar="COUNT", help="Runs of the filters per noise model; 30 times as many of lanes."),
    ] = 20,
    as_json: JsonOption = False,
    out: FiguresOption = None,
) -> int:
    """Track vehicles by CAM with the filters of the C-ITS toll paper, and decide lanes with and without delta position.

    Table III is printed beside ours, with processor times. Ends with 1 if a number is outside its tolerance.

    Examples:
    [bold]obu papers toll --out figures[/]
    [bold]obu papers toll --runs 4 --json[/]
    """
    from ..papers.papers import toll as repeat

    return repeat(runs, as_json, out)

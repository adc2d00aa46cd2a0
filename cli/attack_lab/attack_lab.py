"""`obu attack-lab`: runs attacks on drives, and writes the report card."""

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from shared.errors import UserError

from .. import campaign
from ..campaign import Job
from .cases import AFTER_S, ATTACKS, CLEAN, Case, plan
from .report import answer_rows, document, write
from .run import run
from .score import CONFIDENCE, WARM_UP_S, Run

# Columns of the report's table of answers that a terminal has room for.
SHOWN = ("detected", "suspected rightly", "SAFE above level", "SAFE above limit", "usable again after")
QUICK = ("drag_off", "position_jump", "jam", "odometer_scale")
CLEAN_S, QUICK_CLEAN_S = 600.0, 180.0


def attack_lab(  # noqa: PLR0913  # one argument an option
    *,
    attack: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ATTACK", help="Attack as in `obu demo --attack`; may be repeated. Default: all. `clean` for none."
        ),
    ] = None,
    scenario: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Simulated drive; may be repeated. Default: urban."),
    ] = None,
    seeds: Annotated[
        int, typer.Option(min=0, max=1000, metavar="COUNT", help="Runs of each simulated drive, seeds 1 to this.")
    ] = 1,
    recording: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE", help="Recording of `obu record` or `obu import` to attack; may be repeated."),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Four attacks, one seed of the urban drive: two minutes.")
    ] = False,
    after: Annotated[
        float,
        typer.Option(
            min=0.0,
            max=3600.0,
            metavar="SECONDS",
            help="How long a simulated drive goes on after its attack; 300 for a full campaign.",
        ),
    ] = AFTER_S,
    clean: Annotated[
        float | None,
        typer.Option(
            min=10.0,
            max=36_000.0,
            metavar="SECONDS",
            help="Length of a simulated drive without an attack; default: 600, with --quick 180.",
        ),
    ] = None,
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Output folder.")] = Path("attack-lab"),
    jobs: Annotated[
        int, typer.Option(min=0, metavar="COUNT", help="Runs at the same time; 0: one for each processor.")
    ] = 0,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Do again what is kept of earlier runs of the same code.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report card as JSON.")] = False,
) -> int:
    """Attack simulated and recorded drives; write report.html and report.json with rates of detection and false alarm.

    Ctrl-C ends the campaign early; the report then has the runs that are finished, first all cases of seed 1. Finished
    runs are kept in .obu/campaigns: the same command goes on, as long as the code is the same.

    Examples:
    [bold]obu attack-lab --quick[/]
    [bold]obu attack-lab --scenario urban --scenario highway --seeds 3[/]
    [bold]obu attack-lab --attack drag_off --attack 'drag_off(acceleration=0.1,speed=1)' --seeds 10[/]
    [bold]obu attack-lab --attack gyroscope_bias --scenario urban --after 300[/]
    [bold]obu attack-lab --recording drive.mcap --seeds 0 --attack position_jump@300:60[/]
    """
    texts = attack or list(QUICK if quick else ATTACKS)
    scenarios = scenario or ["urban"]
    attacks = [text for text in texts if text != CLEAN]
    cases = list(
        plan(attacks, scenarios, seeds, recording or [], clean or (QUICK_CLEAN_S if quick else CLEAN_S), after)
    )
    if not cases:
        raise UserError("nothing to run: give --seeds of at least 1, or a --recording")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"cannot create the folder {out}: {error.strerror}; choose another one with --out") from error
    runs = run_all(cases, jobs, fresh=fresh)
    if not runs:
        raise UserError("no run was finished: there is no report")
    card = document(runs, planned=cases)
    write(out, card, runs)
    if as_json:
        print(json.dumps(card))
    else:
        _print(runs, card, Console(), out)
    return 0


def run_all(cases: list[Case], jobs: int = 0, *, fresh: bool = False) -> list[Run]:
    """Run all cases in parallel, in the order of the plan; after an interrupt those that are finished."""
    work = [
        Job(f"{case.label} on {Path(case.drive).name}, seed {case.seed}", run, (case,), _files(case)) for case in cases
    ]
    outcome = campaign.run("attack-lab", work, workers=jobs, fresh=fresh)
    return [(cases[number], timeline) for number, timeline in outcome.numbered]


def _files(case: Case) -> tuple[Path, ...]:
    return (Path(case.drive),) if case.recorded else ()


def _print(runs: list[Run], card: dict[str, object], console: Console, out: Path) -> None:
    head, rows = answer_rows(runs)
    table = Table(title=f"Answers to the attacks; rates with {100 * CONFIDENCE:.0f} % Clopper-Pearson intervals")
    for name in ("attack", *SHOWN):
        table.add_column(name)
    for row in rows:
        cells = dict(zip(head, row, strict=True))
        cells["suspected rightly"] += f"\n{cells['suspected']}"
        table.add_row(cells["attack"], *(cells[name] for name in SHOWN))
    console.print(table)
    share = card["safe_share_clean"]
    if isinstance(share, float):
        console.print(f"Clean drives are SAFE for {100.0 * share:.1f} % of the time after the first {WARM_UP_S:.0f} s.")
    if len(runs) < int(str(card["planned"])):
        console.print(f"Interrupted: the report has {len(runs)} of {card['planned']} runs.")
    console.print(f"Wrote {out / 'report.html'} and report.json.")

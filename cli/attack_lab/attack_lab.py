"""`obu attack-lab`: runs attacks on drives, and writes the report card."""

import json
import os
import signal
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import active_children
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from shared.errors import UserError

from ..progress import progress_on
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
        typer.Option(metavar="NAME", help="Simulated drive; may be repeated. Default: urban and highway."),
    ] = None,
    seeds: Annotated[
        int, typer.Option(min=0, max=1000, metavar="COUNT", help="Runs of each simulated drive, seeds 1 to this.")
    ] = 3,
    recording: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE", help="Recording of `obu record` or `obu import` to attack; may be repeated."),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Four attacks, one seed of the urban drive: a few minutes.")
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
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Output folder.")] = Path("attack-lab"),
    jobs: Annotated[
        int, typer.Option(min=0, metavar="COUNT", help="Runs at the same time; 0: one for each processor.")
    ] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report card as JSON.")] = False,
) -> int:
    """Attack simulated and recorded drives; write report.html and report.json with rates of detection and false alarm.

    Ctrl-C ends the campaign early; the report then has the runs that are finished, first all cases of seed 1.

    Examples:
    [bold]obu attack-lab --quick[/]
    [bold]obu attack-lab --attack drag_off --attack 'drag_off(acceleration=0.1,speed=1)' --seeds 10[/]
    [bold]obu attack-lab --attack gyroscope_bias --scenario urban --after 300[/]
    [bold]obu attack-lab --recording drive.mcap --seeds 0 --attack position_jump@300:60[/]
    """
    texts = attack or list(QUICK if quick else ATTACKS)
    scenarios = scenario or (["urban"] if quick else ["urban", "highway"])
    attacks = [text for text in texts if text != CLEAN]
    count = 1 if quick and seeds == 3 else seeds  # 3: the default
    cases = list(plan(attacks, scenarios, count, recording or [], QUICK_CLEAN_S if quick else CLEAN_S, after))
    if not cases:
        raise UserError("nothing to run: give --seeds of at least 1, or a --recording")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"cannot create the folder {out}: {error.strerror}; choose another one with --out") from error
    console = Console(stderr=True)
    runs = run_all(cases, jobs or os.cpu_count() or 1, console)
    if not runs:
        raise UserError("interrupted before the first run was finished: there is no report")
    card = document(runs, planned=cases)
    write(out, card, runs)
    if as_json:
        print(json.dumps(card))
    else:
        _print(runs, card, Console(), out)
    return 0


def run_all(cases: list[Case], jobs: int, console: Console) -> list[Run]:
    """Run all cases in parallel, in the order of the plan; after an interrupt those that are finished."""
    found: dict[int, Run] = {}
    with (
        _interruptible(),
        progress_on(console) as progress,
        ProcessPoolExecutor(min(jobs, len(cases)), initializer=_ignore) as pool,
    ):
        task = progress.add_task("attacking", total=len(cases))
        waiting = {pool.submit(run, case): number for number, case in enumerate(cases)}
        try:
            for future in as_completed(waiting):
                number = waiting[future]
                case = cases[number]
                found[number] = (case, future.result())
                progress.update(task, advance=1, description=f"{case.drive} {case.label}")
        except (UserError, BrokenProcessPool):
            pool.shutdown(wait=False, cancel_futures=True)
            raise
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
            for worker in active_children():
                worker.kill()
    return [found[number] for number in sorted(found)]


def _ignore() -> None:
    """Leave Ctrl-C, which reaches all processes of a terminal, to the process that writes the report."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def _interruptible() -> Iterator[None]:
    """SIGTERM ends a campaign as Ctrl-C does."""
    before = {number: signal.signal(number, signal.default_int_handler) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


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

"""`obu fleet run`: one command for thousands of recordings, on all cores or on a Dask cluster.

What was done is known by the content of the recording, the command with its options, and the sources: the same call
goes on where the last one ended. Each recording is solved, verified or attacked by the ordinary command, in a process
of its own.
"""

import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from shared.errors import UserError
from shared.runtime.reports import VARIABLE, read_report

from ..campaign import ROOT, Job, code_of
from ..campaign import run as run_campaign

if TYPE_CHECKING:
    from distributed import Client

BLOCK = 1 << 20
MAX_ROWS = 20  # rows of the table that is printed; summary.json has all
SHOWN_LETTERS = 160  # of a result in it
PROGRESS_FILE = "told.json"  # in the folder of a recording: what the command tells
MAX_DURATION_S = 6 * 3600.0  # of one recording
CONNECT_S = 10
FAILED = 2  # exit code of a command whose input cannot be used


class Command(StrEnum):
    """What is done with each recording."""

    SOLVE = "solve"
    VERIFY = "verify"
    ATTACK_LAB = "attack-lab"


MODULES = {
    Command.SOLVE: "cli.solve.solve",
    Command.VERIFY: "cli.recordings.verify",
    Command.ATTACK_LAB: "cli.attack_lab.attack_lab",
}
MAKES = {Command.SOLVE: "metrics.json", Command.ATTACK_LAB: "report.json"}


@dataclass(frozen=True)
class CommandOutcome:
    """A command that has ended; of `verify`, codes other than 0 are findings."""

    recording: str
    sha256: str
    command: str
    code: int
    seconds: float
    out: str  # folder with what it has written
    said: str  # what it has found, in a sentence


def run(
    command: Annotated[Command, typer.Argument(help="What to do with each recording.")],
    recordings: Annotated[list[Path], typer.Argument(help="Recordings, or folders of them.")],
    out: Annotated[
        Path, typer.Option("--out", metavar="FOLDER", help="Where a folder for each recording is made.")
    ] = Path("fleet-run"),
    option: Annotated[
        list[str] | None,
        typer.Option("--option", metavar="WORD", help="A word for the command, such as --option=--smooth; repeatable."),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            "--scheduler",
            metavar="ADDRESS",
            help="Address of a Dask scheduler, such as tcp://10.0.0.5:8786, whose workers have this version of the "
            "program and see the recordings under the same path; without it this machine alone.",
        ),
    ] = None,
    jobs: Annotated[int, typer.Option("--jobs", metavar="COUNT", min=0, help="Recordings at once; 0: cores.")] = 0,
    fresh: Annotated[bool, typer.Option("--fresh", help="Do again what is done.")] = False,
) -> int:
    """Solve, verify or attack many recordings; write a folder for each, and summary.json.

    A recording that is done is not done again while its content, the command and the program are the same. A worker
    that is killed costs nothing: its recording is begun again elsewhere. Ends with 1 if a recording has failed.

    Examples:
    [bold]obu fleet run solve drives/ --out solved[/]
    [bold]obu fleet run verify drives/*.mcap[/]
    [bold]obu fleet run attack-lab drives/ --option=--attack --option=position_jump@300:60[/]
    [bold]obu fleet run solve /nfs/drives --out /nfs/solved --scheduler tcp://10.0.0.5:8786[/]
    """  # fmt: skip
    words = tuple(option or ())
    _check_folder(out)
    work = [_job(command, path, digest, words, out) for digest, path in _distinct(recordings).items()]
    with cluster(scheduler, jobs) as client:
        outcome = run_campaign(f"fleet-{command}", work, fresh=fresh, executor=client.get_executor())
    rows = [asdict(result) for result in outcome.results]
    (out / "summary.json").write_text(json.dumps(rows, indent=1), encoding="utf-8")
    _show(outcome.results, outcome.planned, out)
    return 0 if outcome.complete else 1


def work_on(recording: str, sha256: str, command: str, words: tuple[str, ...], out: str, code: str) -> CommandOutcome:
    """Run one command on one recording, wherever a worker is; raises `UserError`."""
    if code != code_of(MODULES[Command(command)]):
        raise UserError("the worker has another version of the program than this command")
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    given = {
        Command.SOLVE: ["solve", recording, "--out", out],
        Command.VERIFY: ["verify", recording],
        Command.ATTACK_LAB: ["attack-lab", "--recording", recording, "--seeds", "0", "--jobs", "1", "--out", out],
    }[Command(command)]
    begin, told = time.monotonic(), (folder / PROGRESS_FILE).resolve()
    told.unlink(missing_ok=True)
    try:
        done = subprocess.run(
            [sys.executable, "-m", "cli", *given, *words], cwd=ROOT, capture_output=True, text=True, errors="replace",
            timeout=MAX_DURATION_S, check=False, stdin=subprocess.DEVNULL, env={**os.environ, VARIABLE: str(told)},
        )  # fmt: skip
    except subprocess.TimeoutExpired as error:
        raise UserError(f"it took more than {MAX_DURATION_S / 3600:.0f} hours") from error
    (folder / "output.txt").write_text(done.stdout + done.stderr, encoding="utf-8")
    failed = done.returncode if command != Command.VERIFY else done.returncode == FAILED or done.returncode < 0
    if failed:
        said = read_report(told).error or "it failed without a reason"
        raise UserError(f"{said} (code {done.returncode}; {folder / 'output.txt'})")
    seconds = round(time.monotonic() - begin, 2)
    said = _attacks_detected(folder) if command == Command.ATTACK_LAB else read_report(told).finding
    return CommandOutcome(recording, sha256, command, done.returncode, seconds, out, said)


def _check_folder(out: Path) -> None:
    """Make the folder of the results; raises `UserError` before hours of work, not after them."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):
            pass
    except OSError as error:
        raise UserError(f"cannot write to {out}: {error.strerror}; name another folder with --out") from error


def _attacks_detected(folder: Path) -> str:
    """What the attack lab has found, by the file that it makes."""
    made = json.loads((folder / MAKES[Command.ATTACK_LAB]).read_text(encoding="utf-8"))
    runs, detected = (sum(row[name] for row in made["answers"]) for name in ("runs", "detected"))
    share = made["safe_share_clean"]
    clean = "" if share is None else f"; without attack SAFE for {100.0 * share:.1f} % of the time"
    return f"{detected} of {runs} attacks detected{clean}"


def _job(command: Command, path: Path, sha256: str, words: tuple[str, ...], out: Path) -> Job[CommandOutcome]:
    digest = sha256[:8]  # a recording that was renamed keeps its folder
    folder = next(iter(sorted(out.glob(f"*-{digest}"))), out / f"{path.stem}-{digest}").resolve()
    made = MAKES.get(command)
    return Job(
        path.name,
        work_on,
        (str(path), sha256, str(command), words, str(folder), code_of(MODULES[command])),
        makes=folder / made if made else None,
        also=(MODULES[command],),
        identity=(sha256, str(command), words, str(out.resolve())),
    )


def _distinct(given: Sequence[Path]) -> dict[str, Path]:
    """Recordings by the SHA-256 of their content; raises `UserError`."""
    paths: list[Path] = []
    for path in given:
        if path.is_dir():
            paths += sorted(path.rglob("*.mcap"))
        elif path.is_file():
            paths.append(path)
        else:
            raise UserError(f"{path} is no recording and no folder of recordings; check the name")
    if not paths:
        raise UserError("there is no .mcap file in what was given; make one with `obu record` or `obu import`")
    found: dict[str, Path] = {}
    for path in paths:
        found.setdefault(_digest(path), path.resolve())
    return found


def _digest(path: Path) -> str:
    digest = hashlib.sha256()
    try:
        with path.open("rb") as file:
            while block := file.read(BLOCK):
                digest.update(block)
    except OSError as error:
        raise UserError(f"cannot read {path}: {error.strerror}; check its owner") from error
    return digest.hexdigest()


@contextmanager
def cluster(scheduler: str | None, jobs: int) -> "Iterator[Client]":
    """Connect to a scheduler, or start workers here; raises `UserError`."""
    try:
        from distributed import Client, LocalCluster
    except ModuleNotFoundError as error:
        raise UserError(f"this needs {error.name}: pip install --require-hashes -r requirements-fleet.lock") from error
    if scheduler is not None:
        try:
            client = Client(scheduler, timeout=CONNECT_S)
        except (OSError, ValueError, TimeoutError) as error:
            raise UserError(f"no Dask scheduler at {scheduler}: {error}; start one with `dask scheduler`") from error
        with client:
            yield client
        return
    workers = LocalCluster(
        n_workers=jobs or None, threads_per_worker=1, host="127.0.0.1", dashboard_address="127.0.0.1:0", silence_logs=50
    )
    with workers, Client(workers) as client:
        yield client


def _show(found: Sequence[CommandOutcome], planned: int, out: Path) -> None:
    table = Table("recording", "code", "seconds", "result")
    for done in found[:MAX_ROWS]:
        table.add_row(
            Path(done.recording).name, str(done.code), f"{done.seconds:.1f}", shorten(done.said, SHOWN_LETTERS)
        )
    console = Console()
    console.print(table)
    more = f"{len(found) - MAX_ROWS} more in" if len(found) > MAX_ROWS else "also in"
    console.print(f"{len(found)} of {planned} recordings done; {more} {out / 'summary.json'}", soft_wrap=True)

"""Campaigns: independent jobs on all cores, whose results are kept, so that a campaign that was stopped goes on.

A job is a call of a function of a module. What it returns is written to `.obu/campaigns/<campaign>/<key>.json` as soon
as it is there; the key is a digest of the sources that the function imports, of its arguments and of the files that it
reads. A job whose result is there is not done again, and a change of a source makes all its jobs new.
"""

import argparse
import ast
import hashlib
import json
import os
import platform
import signal
import traceback
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, as_completed, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from multiprocessing import active_children, get_context
from operator import itemgetter
from pathlib import Path
from typing import Annotated, Any, Generic, NamedTuple, TypeVar, get_type_hints

import numpy as np
from pydantic import PlainSerializer, PlainValidator, TypeAdapter
from rich.console import Console

from shared.errors import UserError
from shared.maths.earth import FloatArray
from shared.runtime.config import state_dir

from .progress import progress_on

Found = TypeVar("Found")
Kept = Annotated[FloatArray, PlainValidator(np.asarray), PlainSerializer(lambda array: array.tolist())]

ROOT = Path(__file__).resolve().parents[1]
# What is imported by name (processes), read beside the code (vehicles, schemas), or imported by nearly every job.
MEASURED_FOLDERS = ("services/core", "services/parsers", "services/sensors", "shared", "deploy/vehicles")
PACKAGES = ("numpy", "scipy")  # whose results are those of the job
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # more stand in each other's way


@dataclass(frozen=True)
class Job(Generic[Found]):
    """A call of a function that can be imported.

    The annotation of what the function returns says how that is kept: a dataclass, tuple, ... of plain values, with
    arrays as `Kept`.
    """

    name: str  # for those who wait
    work: Callable[..., Found]
    arguments: tuple[object, ...]  # the same `repr` for the same values
    reads: tuple[Path, ...] = ()
    makes: Path | None = None  # a file: the job is done where it is there
    also: tuple[str, ...] = ()  # modules of programs that it runs
    identity: tuple[object, ...] | None = None  # what tells jobs apart in place of their arguments

    @property
    def key(self) -> str:
        """Digest of everything that the result depends on."""
        there = [(path, path.stat()) for path in self.reads if path.exists()]
        stamps = [(str(path), stat_result.st_size, stat_result.st_mtime_ns) for path, stat_result in there]
        code = [code_of(module) for module in (self.work.__module__, *self.also)]
        what = self.arguments if self.identity is None else self.identity
        known = (code, self.work.__qualname__, what, stamps)
        return hashlib.sha256(repr(known).encode()).hexdigest()[:24]

    @property
    def kind(self) -> TypeAdapter[Found]:
        """What turns the result into JSON and back."""
        return TypeAdapter(get_type_hints(self.work, include_extras=True)["return"])


@dataclass(frozen=True)
class Failure:
    """Why there is no result of a job."""

    reason: str


Results = Iterator[tuple[int, Found | Failure]]  # number and result of each job, as they are finished


@dataclass(frozen=True)
class Outcome(Generic[Found]):
    """What a campaign found, in the order of its jobs; those that failed or were not finished are left out."""

    numbered: list[tuple[int, Found]]  # place in the list of jobs, and result
    planned: int

    @property
    def results(self) -> list[Found]:
        """The results alone."""
        return [item for _, item in self.numbered]

    @property
    def complete(self) -> bool:
        """Whether there is a result of every job."""
        return len(self.numbered) == self.planned


def run(
    name: str,
    jobs: Sequence[Job[Found]],
    *,
    workers: int = 0,
    fresh: bool = False,
    smoke: bool = False,
    executor: Executor | None = None,
) -> Outcome[Found]:
    """Do what is not done yet, as many jobs at once as there are workers (0: cores), and show how long it takes.

    An `executor` runs the jobs in place of processes of this machine, and decides how many at once. A job that fails,
    or whose process dies, is named on standard error and leaves the others alone. After Ctrl-C the outcome holds what
    is finished. `fresh` does everything again. `smoke` does the first job alone, whatever was found before, and keeps
    nothing: it shows that the campaign can run.
    """
    console = Console(stderr=True)
    if smoke:
        jobs, fresh = jobs[:1], True
    paths = [state_dir() / "campaigns" / name / f"{job.key}.json" for job in jobs]
    found = {} if fresh else dict(_recalled(jobs, paths))
    if found:
        console.print(f"{name}: {len(found)} of {len(jobs)} results are those of earlier runs of the same code")
    waiting = {number: job for number, job in enumerate(jobs) if number not in found}
    with suppress(KeyboardInterrupt), progress_on(console) as progress:
        task = progress.add_task(name, total=len(waiting))
        for number, failure in _done(waiting, workers, executor):
            progress.update(task, advance=1, description=f"{name}: {jobs[number].name}")
            if isinstance(failure, Failure):
                console.print(f"{name}: {jobs[number].name} failed: {failure.reason}", markup=False, soft_wrap=True)
                continue
            if not smoke:
                _keep(jobs[number], failure, paths[number])
            found[number] = failure
    return Outcome(sorted(found.items(), key=itemgetter(0)), len(jobs))


def _done(jobs: Mapping[int, Job[Found]], workers: int, executor: Executor | None) -> Results[Found]:
    if executor is None:
        yield from in_processes(jobs, workers)
    else:
        yield from in_executor(jobs, executor)


def _recalled(jobs: Sequence[Job[Found]], paths: Sequence[Path]) -> Iterator[tuple[int, Found]]:
    for number, (job, path) in enumerate(zip(jobs, paths, strict=True)):
        if path.is_file() and (job.makes is None or job.makes.is_file()):
            yield number, job.kind.validate_python(json.loads(path.read_text(encoding="utf-8")))


def _keep(job: Job[Found], one: Found, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_suffix(".part")
    unfinished.write_text(json.dumps(job.kind.dump_python(one)), encoding="utf-8")
    unfinished.rename(path)


def in_processes(jobs: Mapping[int, Job[Found]], workers: int = 0) -> Results[Found]:
    """Do jobs in processes with one thread of linear algebra each, and yield them as they are finished.

    Each process has a group of its own, with all that it starts: Ctrl-C reaches the one alone that waits for the jobs.
    A process that dies ends those beside it: what was running is done again at the end, each job alone.
    """
    waiting = list(jobs.items())
    alone: list[tuple[int, Job[Found]]] = []
    with _interruptible(), _environment(ONE_THREAD):
        while waiting:
            alone += yield from _until_one_dies(waiting, workers or os.cpu_count() or 1)
        for number, job in alone:
            if (yield from _until_one_dies([(number, job)], 1)):
                yield number, Failure("its process died")


def in_executor(jobs: Mapping[int, Job[Found]], executor: Executor) -> Results[Found]:
    """Do jobs by an executor, such as that of a Dask cluster, and yield them as they are finished.

    The death of a worker is the executor's affair; what it gives up is a failure of that job alone.
    """
    with _interruptible():
        running = {executor.submit(_called, job): number for number, job in jobs.items()}
        try:
            for future in as_completed(running):
                try:
                    one = future.result()
                except Exception as error:  # noqa: BLE001  # of the executor: the other jobs go on
                    one = Failure(f"it was given up: {type(error).__name__}: {error}")
                yield running[future], one
        finally:
            for future in running:
                future.cancel()


def _until_one_dies(
    waiting: list[tuple[int, Job[Found]]], workers: int
) -> Generator[tuple[int, Found | Failure], None, list[tuple[int, Job[Found]]]]:
    """Do what is waiting; after the death of a process return what was running then, and leave the rest waiting."""
    running: dict[Future[Found | Failure], tuple[int, Job[Found]]] = {}
    with ProcessPoolExecutor(
        min(workers, len(waiting)), mp_context=get_context("spawn"), initializer=os.setpgrp
    ) as pool:
        try:
            while waiting or running:
                while waiting and len(running) < workers:
                    running[pool.submit(_called, waiting[0][1])] = waiting[0]
                    del waiting[0]
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    one = future.result()
                    yield running.pop(future)[0], one
        except BrokenProcessPool:
            return list(running.values())
        except BaseException:  # an interrupt: nobody waits for what is running
            pool.shutdown(wait=False, cancel_futures=True)
            for process in active_children():
                if process.pid is not None:
                    with suppress(ProcessLookupError):  # one that has no group of its own yet has started nothing
                        os.killpg(process.pid, signal.SIGKILL)
                process.kill()
            raise
    return []


def _called(job: Job[Found]) -> Found | Failure:
    try:
        return job.work(*job.arguments)
    except UserError as error:
        return Failure(str(error))
    except Exception:  # noqa: BLE001  # whatever it is, the other jobs go on
        return Failure(traceback.format_exc())


@contextmanager
def _interruptible() -> Iterator[None]:
    """SIGTERM ends a campaign as Ctrl-C does."""
    before = {number: signal.signal(number, signal.default_int_handler) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def _environment(changes: Mapping[str, str]) -> Iterator[None]:
    """Processes that begin meanwhile have these variables."""
    before = {name: os.environ.get(name) for name in changes}
    os.environ.update(changes)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@cache
def code_of(module: str) -> str:
    """Digest of the sources that a module of the project depends on, and of the versions of Python and `PACKAGES`."""
    digest = hashlib.sha256(f"{platform.python_version()} {[version(name) for name in PACKAGES]}".encode())
    for path in sorted(sources_of(module)):
        digest.update(f"\n{path.relative_to(ROOT)}\n{_content_of(path, path.stat().st_mtime_ns)}".encode())
    return digest.hexdigest()


@cache
def _content_of(path: Path, _changed_ns: int) -> str:
    """Digest of a file as it was last changed; of Python without comments and docstrings, which change no result."""
    content = path.read_bytes()
    if path.suffix == ".py":
        tree = ast.parse(content)
        for node in ast.walk(tree):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
                node.body = node.body[1:]
        content = ast.dump(tree).encode()
    return hashlib.sha256(content).hexdigest()


def sources_of(module: str) -> set[Path]:
    """All files of `MEASURED_FOLDERS`, the module's own file, and those that it imports, directly or not."""
    found = {
        path
        for folder in MEASURED_FOLDERS
        for path in (ROOT / folder).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    todo = [module]
    while todo:
        for path in _files_of(todo.pop()) - found:
            found.add(path)
            todo += _imported_by(path)
    return found


def _files_of(module: str) -> set[Path]:
    """Files of a module or of a name in it, and of the packages around; none if it is not one of the project."""
    parts = module.split(".")
    places = [ROOT.joinpath(*parts[:k]) for k in range(1, len(parts) + 1)]
    return {path for place in places for path in (place.with_suffix(".py"), place / "__init__.py") if path.is_file()}


def _imported_by(path: Path) -> Iterator[str]:
    """Names that a file imports: of what is imported from a package also the name as a module of it."""
    package = path.relative_to(ROOT).parts[:-1]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            name = ".".join([*base, *([node.module] if node.module else [])])
            yield from (f"{name}.{alias.name}" for alias in node.names)


class Size(NamedTuple):
    """How many runs a campaign has: in the short form of two minutes, as it is called, and for the best confidence."""

    short: int
    usual: int
    full: int
    unit: str = "runs"

    def note(self, runs: int) -> str:
        """Say what a number of runs is worth."""
        if runs >= self.full:
            return f"{runs} {self.unit}, the full campaign."
        return f"{runs} {self.unit}; the full campaign (`FULL=1`) has {self.full}, and bounds rare events better."


def options_of(parser: argparse.ArgumentParser, arguments: Sequence[str] | None, size: Size) -> argparse.Namespace:
    """Parse the options of a campaign, with those that all have: `runs`, `workers`, `short`, `smoke`, `fresh`."""
    how_many = parser.add_mutually_exclusive_group()
    how_many.add_argument("--runs", type=_at_least_one, default=size.usual, help=f"{size.unit}; default: %(default)s")
    how_many.add_argument("--full", action="store_const", dest="runs", const=size.full, help=f"{size.full} {size.unit}")
    how_many.add_argument(
        "--short", action="store_true", help=f"{size.short} {size.unit}, in two minutes at most; stores no result"
    )
    how_many.add_argument("--smoke", action="store_true", help="one job, to see that it runs; stores no result")
    parser.add_argument("--fresh", action="store_true", help="do again what is kept of earlier runs of the same code")
    parser.add_argument("--workers", type=int, default=0, metavar="COUNT", help="jobs at once; 0: one for each core")
    options = parser.parse_args(arguments)
    options.short |= options.smoke
    if options.short:
        options.runs = 1 if options.smoke else size.short
    return options


def _at_least_one(text: str) -> int:
    if (number := int(text)) < 1:
        raise argparse.ArgumentTypeError(f"{number} is less than 1")
    return number


def worth_storing(options: argparse.Namespace, *outcomes: Outcome[Any]) -> bool:
    """Whether results replace the stored ones; if not, say why on standard error."""
    missing = sum(outcome.planned - len(outcome.numbered) for outcome in outcomes)
    console = Console(stderr=True)
    if missing:
        console.print(f"{missing} jobs are not done: nothing is stored, and the same command goes on with them.")
    if options.short:
        console.print("This is the short form: no result is stored.")
    return not missing and not options.short

"""Put faults into a copy of the tree, one at a time, and run the unit tests nearest to each.

    python -m benchmarks.mutants --seed 1 --number 60

A fault is found if a test fails, or if none ends within the limit. The sites are drawn from all candidates with a seed,
so that the same ones can be tried again after tests were changed.
"""

import argparse
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from tests.support.changed import tests_of

from .sites import Site, draw, sites_of

ROOT = Path(__file__).resolve().parents[2]
WHERE = (
    "services/core", "shared/maths", "shared/inertial", "services/parsers", "services/monitoring/ledger",
    "services/monitoring/uplink", "shared/access",
)  # fmt: skip
COPIED = ("services", "shared", "cli", "broker", "fleet", "benchmarks", "tests", "deploy", "pyproject.toml", "obu.toml")
LIMIT_S = 60.0
RESULT = ROOT / "benchmarks" / "results" / "mutants.md"


class Tried(NamedTuple):
    """A fault, and what the tests said."""

    site: Site
    outcome: str  # killed, hangs, survived, untested

    @property
    def row(self) -> str:
        """Line of the table."""
        site = self.site
        return f"| `{site.path}:{site.line}` | {site.kind} | `{site.replacement[:60]}` | {self.outcome} |"


def candidates() -> list[Site]:
    """Every place of the folders in which faults are tried."""
    paths = sorted(path for folder in WHERE for path in (ROOT / folder).rglob("*.py"))
    return [site for path in paths for site in sites_of(path.relative_to(ROOT), path.read_text(encoding="utf-8"))]


def tried(sites: Sequence[Site], copy: Path) -> Iterator[Tried]:
    """Try each fault in a copy of the tree."""
    for site in sites:
        tests = tests_of(PurePosixPath(site.path))
        if tests is None:
            yield Tried(site, "untested")
            continue
        target = copy / site.path
        source = target.read_text(encoding="utf-8")
        target.write_text(site.applied(source), encoding="utf-8")
        try:
            yield Tried(site, _outcome(copy, tests))
        finally:
            target.write_text(source, encoding="utf-8")


def _outcome(copy: Path, tests: PurePosixPath) -> str:
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-m", "not slow", str(tests)]
    try:
        found = subprocess.run(command, cwd=copy, capture_output=True, timeout=LIMIT_S, check=False)
    except subprocess.TimeoutExpired:
        return "not within the limit"
    return "survived" if found.returncode == 0 else "killed"


def copied(to: Path) -> Path:
    """Copy what the tests need."""
    for name in COPIED:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, to / name, ignore=shutil.ignore_patterns("__pycache__", "node_modules"))
        elif (ROOT / name).exists():
            shutil.copy(ROOT / name, to / name)
    return to


def table(found: Sequence[Tried], seed: int, number_of_candidates: int) -> str:
    """Page of a run."""
    counts = {outcome: sum(one.outcome == outcome for one in found) for outcome in sorted({o.outcome for o in found})}
    return "\n".join([
        "# Faults put into the code on purpose", "",
        f"`python -m benchmarks.mutants --seed {seed} --number {len(found)}`, {datetime.now(UTC):%Y-%m-%d}: "
        f"{len(found)} of {number_of_candidates} places; " + ", ".join(f"{n} {o}" for o, n in counts.items()) + ".", "",
        "Each is tried with the unit tests of the nearest folder, up to a minute.", "",
        "| place | kind | in its place | tests |", "| --- | --- | --- | --- |", *(one.row for one in found), "",
    ])  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Run; 0 if every fault was found."""
    parser = argparse.ArgumentParser(prog="benchmarks.mutants", description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seed", type=int, default=1, help="of the draw (default: %(default)s)")
    parser.add_argument("--number", type=int, default=60, help="of faults (default: %(default)s)")
    parser.add_argument("--list", action="store_true", help="name the places and try nothing")
    parser.add_argument("--store", action="store_true", help=f"write {RESULT.relative_to(ROOT)}")
    options = parser.parse_args(arguments)
    places = candidates()
    drawn = draw(places, options.number, options.seed)
    if options.list:
        sys.stdout.writelines(f"{site.path}:{site.line} {site.kind}: {site.replacement}\n" for site in drawn)
        return 0
    found: list[Tried] = []
    with tempfile.TemporaryDirectory() as folder:
        for one in tried(drawn, copied(Path(folder))):
            found.append(one)
            sys.stdout.write(f"{len(found)} of {len(drawn)} {one.row}\n")
            sys.stdout.flush()
    page = table(found, options.seed, len(places))
    if options.store:
        RESULT.write_text(page, encoding="utf-8")
    return 1 if any(one.outcome in ("survived", "untested") for one in found) else 0


if __name__ == "__main__":
    sys.exit(main())

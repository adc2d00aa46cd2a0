"""Put faults into a copy of the tree, one at a time, and run the tests that execute each.

    python -m benchmarks.mutants --seed 1 --number 60 --coverage .obu/coverage/data

A fault is found if a test fails that passes without it. The sites are drawn from all candidates with a seed, so that
the same ones can be tried again after tests were changed. Tests are chosen by the contexts of `make coverage`; without
its file those of the files that import it, or of the nearest folder.
"""

import argparse
import sys
import tempfile
import tomllib
from collections import Counter
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from benchmarks.tables import publish

from .covering import MOST, Covering, Selection, nearest
from .sites import Site, draw, sites_of
from .trial import LIMIT_S, Copy, MutantResult

ROOT = Path(__file__).resolve().parents[2]
WHERE = (
    "services/core", "shared/maths", "shared/inertial", "services/parsers", "services/monitoring/ledger",
    "services/monitoring/uplink", "shared/access",
)  # fmt: skip
RESULT = Path("benchmarks/results/mutants.md")
NOT_FOUND = "survived", "time out", "untested"
EQUIVALENTS = tomllib.loads((Path(__file__).parent / "equivalents.toml").read_text(encoding="utf-8"))["fault"]


def candidates(root: Path) -> list[Site]:
    """Every place of the folders in which faults are tried."""
    paths = sorted(path for folder in WHERE for path in (root / folder).rglob("*.py"))
    return [site for path in paths for site in sites_of(path.relative_to(root), path.read_text(encoding="utf-8"))]


def equivalent(site: Site, source: str) -> str | None:
    """Why a fault changes nothing that the program does; None of one that does."""
    here = {"path": site.path.as_posix(), "line": source.splitlines()[site.line - 1].strip()}
    known = (item for item in EQUIVALENTS if item == here | {"replacement": site.replacement, "why": item["why"]})
    return next((str(item["why"]) for item in known), None)


def table(found: Sequence[MutantResult], seed: int, number_of_candidates: int) -> str:
    """Page of a run."""
    counts = Counter(tried.outcome for tried in found)
    return "\n".join([
        "# Faults put into the code on purpose", "",
        f"`python -m benchmarks.mutants --seed {seed} --number {len(found)}`, {datetime.now(UTC):%Y-%m-%d}: "
        f"{len(found)} of {number_of_candidates} places; " + ", ".join(f"{n} {o}" for o, n in counts.items()) + ".", "",
        f"Each is tried with at most {MOST} tests, up to {LIMIT_S} s of processor time. The last column says how they",
        "were chosen: they execute the line, or one with the name that is assigned there, or any line of the file, or",
        "they lie in a file that imports it, or in the nearest folder.", "",
        "| place | kind | in its place | outcome | tests chosen by, or why it changes nothing |",
        "| --- | --- | --- | --- | --- |",
        *(tried.row for tried in found), "",
    ])  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Run; 0 if every fault was found."""
    parser = argparse.ArgumentParser(prog="benchmarks.mutants", description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seed", type=int, default=1, help="of the draw (default: %(default)s)")
    parser.add_argument("--number", type=int, default=60, help="of faults (default: %(default)s)")
    parser.add_argument("--first", type=int, default=1, help="fault of the draw to begin with (default: %(default)s)")
    parser.add_argument("--root", type=Path, default=ROOT, help="tree to copy (default: this one)")
    parser.add_argument("--coverage", type=Path, help="data of `make coverage` (default: nearest tests)")
    parser.add_argument("--list", action="store_true", help="name the places and try nothing")
    parser.add_argument("--store", action="store_true", help=f"write {RESULT}")
    options = parser.parse_args(arguments)
    places = candidates(options.root)
    drawn = draw(places, options.number, options.seed)[options.first - 1 :]
    if options.list:
        sys.stdout.writelines(f"{site.path}:{site.line} {site.kind}: {site.replacement}\n" for site in drawn)
        return 0
    found: list[MutantResult] = []
    with tempfile.TemporaryDirectory() as folder:
        copy = Copy(options.root, Path(folder))
        choose: Callable[[Site, str], Selection] = partial(nearest, options.root)
        if options.coverage:
            choose = Covering(options.coverage, options.root, copy.tests()).tests
        else:
            sys.stdout.write("no --coverage: tests that import the file of a fault are run, or of the nearest folder\n")
        for site in drawn:
            why = equivalent(site, (options.root / site.path).read_text(encoding="utf-8"))
            found.append(MutantResult(site, "equivalent", why) if why else copy.tried(site, choose))
            sys.stdout.write(f"{len(found)} of {len(drawn)} {found[-1].row}\n")
            sys.stdout.flush()
    page = table(found, options.seed, len(places))
    if options.store:
        publish(ROOT / RESULT, page)
    return int(any(tried.outcome in NOT_FOUND for tried in found))


if __name__ == "__main__":
    sys.exit(main())

"""What core.trust makes of recorded drives: verdicts, exclusions and their harm; `docs/reference/trust-on-drives.md`.

Each drive is solved once with the aiding of its vehicle file, and a second time without core.trust where that excluded
anything (`obu solve` does both).
"""

import argparse
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from typing import TypedDict, cast

from benchmarks import tables
from benchmarks.bus.report import machine
from cli import campaign
from cli.solve.metrics.trust import WORDS

from .runs import REPOSITORY, data_folder, import_drives, present, solve_job

RESULTS = REPOSITORY / "benchmarks" / "results" / "trust-on-drives.json"
PAGE = REPOSITORY / "docs" / "reference" / "trust-on-drives.md"
DRIVES = ("comma", "rtkexp", "wid02", "wid08", "wid10", "navmatlab", "navmatlab 0327")
SIZE = campaign.Size(short=2, usual=len(DRIVES), full=len(DRIVES), unit="drives")
HEAD = (
    "<!-- Printed by `make drives-trust` from benchmarks/results/trust-on-drives.json; a test holds it to that file. "
    "-->\n\n"
)
KEPT = (
    "duration_s", "without_solution_s", "horizontal_rmse_m", "gnss_excluded_s", "errors_above_level_horizontal",
    "errors_above_level_vertical", "harm_ratio",
)  # fmt: skip
NOTES = """
These receivers were not attacked: each second without GNSS is a false alarm, and so is each second UNSAFE, DEAD
RECKONING or NO FIX that follows from it. Every drive is solved once with the aiding of its vehicle file, as the vehicle
does, with the grade of the IMU that it states. Until 20 s after the alignment no inertial window is evaluated, and the
verdict is CAUTION; UNSAFE are seconds with a protection level above the alert limit
([how the verdict is found](../explanation/trust.md)).

*Above the level* is the share of the errors above the published protection level; the integrity risk allows 0.1 %.
*Harm* is the horizontal error (root mean square) over that of a run without `core.trust` at the same times, where a
missing solution counts as the last one held: 1 if nothing was excluded, above 1 if exclusions made the position worse.
The truth of `rtkexp` and `wid` is the receiver's own RTK. *No solution* are intervals of more than 2 s after the first
solution.
"""


class Verdicts(TypedDict):
    """What is kept of one drive."""

    seconds: dict[str, float] | None  # by verdict
    metrics: dict[str, float | None]  # those of `KEPT`


class Document(TypedDict):
    """All that was measured in one run."""

    measured_at: str
    machine: str
    drives: dict[str, Verdicts]


def main(arguments: Sequence[str]) -> int:
    """Solve the drives that are there, and print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.navigation.trust", description=__doc__)
    parser.add_argument("--only", nargs="+", choices=DRIVES, help="these drives alone; prints, and keeps nothing")
    parser.add_argument(
        "--print", action="store_true", help="print the page of the last results again; measure nothing"
    )
    options = campaign.options_of(parser, arguments, SIZE)
    if options.print:
        tables.reprint(PAGE, HEAD + page(json.loads(RESULTS.read_text(encoding="utf-8"))))
        return 0
    names = present(options.only or DRIVES[: 1 if options.smoke else options.runs])
    if not names:
        print(f"no drive is measured: {data_folder()} holds none of them; set OBU_DATA to the folder of the recordings")
        return 0
    imported = import_drives(names, workers=options.workers, fresh=options.fresh)
    jobs = [solve_job(name, name) for name in names]
    solved = campaign.run("drives-trust", jobs, workers=options.workers, fresh=options.fresh, smoke=options.smoke)
    drives = {names[number]: kept(item.metrics) for number, item in solved.numbered}
    document = Document(measured_at=datetime.now(UTC).isoformat(timespec="seconds"), machine=machine(), drives=drives)
    print(page(document))
    if campaign.worth_storing(options, imported, solved) and not options.only:
        RESULTS.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
        tables.publish(PAGE, HEAD + page(document))
    return 0 if imported.complete and solved.complete else 1


def kept(metrics: Mapping[str, object]) -> Verdicts:
    """Select what the page shows from a file metrics.json."""
    return Verdicts(
        seconds=cast("dict[str, float] | None", metrics["trust_seconds"]),
        metrics={name: cast("float | None", metrics[name]) for name in KEPT},
    )


def page(document: Document) -> str:
    """Lay out what was measured."""
    head = (
        "drive", "duration", *WORDS.values(), "GNSS excluded", "no solution", "horizontal RMSE",
        "above the level, horizontal", "above the level, vertical", "harm",
    )  # fmt: skip
    lines = [head, ("---", *("---:",) * (len(head) - 1)), *rows(document["drives"])]
    return (
        "# The verdict on drives\n\n"
        f"Measured {document['measured_at']} on {document['machine']}, by `make drives-trust`.\n\n"
        + "".join(f"| {' | '.join(line)} |\n" for line in lines)
        + NOTES
    )


def rows(drives: Mapping[str, Verdicts]) -> Iterator[tuple[str, ...]]:
    """One row for each drive."""
    for name, drive in drives.items():
        metrics, seconds = drive["metrics"], drive["seconds"] or {}
        yield (
            name,
            _said(metrics["duration_s"], "{:.0f} s"),
            *(_said(seconds.get(level), "{:.0f} s") for level in WORDS),
            _said(metrics["gnss_excluded_s"], "{:.1f} s"),
            _said(metrics["without_solution_s"], "{:.0f} s"),
            _said(metrics["horizontal_rmse_m"], "{:.4g} m"),
            _said(metrics["errors_above_level_horizontal"], "{:.2%}"),
            _said(metrics["errors_above_level_vertical"], "{:.2%}"),
            _said(metrics["harm_ratio"], "{:.4g}"),
        )


def _said(value: float | None, form: str) -> str:
    return "unknown" if value is None else form.format(value)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

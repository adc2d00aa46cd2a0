"""Measures everything, prints the table beside goals and peers, and keeps it; `docs/reference/drives.md` is a copy."""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from math import degrees
from pathlib import Path
from typing import TypedDict

from benchmarks import tables
from benchmarks.bus.report import machine
from cli import campaign

from .cases import CASES, GNSS_ALONE, ROWS, Row
from .peers import PEERS, PeerResult
from .runs import REPOSITORY, Metrics, data_folder, import_drives, jobs_of, metrics_of, present, recording

RESULTS = REPOSITORY / "benchmarks" / "results"
PAGE = REPOSITORY / "docs" / "reference" / "drives.md"
SIZE = campaign.Size(short=1, usual=1, full=3, unit="shifted runs of each pattern of outages")
SHORT = ("comma", "truck", "balzer")  # of a minute each
SPEED_SETS = ("rtk", "spp")
HOW_TO = REPOSITORY / "docs" / "how-to" / "solve-a-recorded-drive.md"
BEGIN, END = "<!-- printed by `make drives` -->\n", "<!-- end -->\n"
OWN_FIXES = (
    "`rtkexp_drive`",
    "`wid_car` trial 02",
    "`wid_car` trial 08",
    "`wid_car` trial 10",
)  # truth: their RTK fixes
# Name in the how-to, its case, and that of its outages of 10 s.
REAL_DRIVES = (
    ("`rtkexp_drive`", "rtkexp", "rtkexp nhc 10 s"),
    *((f"`wid_car` trial {trial}", f"wid{trial}", f"wid{trial} nhc 10 s") for trial in ("02", "08", "10")),
    ("`navmatlab_car`", "navmatlab", None),
    ("`navmatlab_car_0327`", "navmatlab 0327", None),
    ("`comma_segment`", "comma", "comma wheel 10 s"),
)
UNMEASURED = "not measured"
NOTES = """
`rtk` and `spp` are the two sets of `rtk_drive_57min`: errors of the 300 s after the protocol's start are left out,
outages of 60 s come every 180 s in three runs shifted by 60 s. Those of `navmatlab` and `rtkexp` are shifted alike.
`free` is GNSS, IMU and standstill; `nhc` adds wheels that do not slide; `odometer` and `wheel` add the speed as well.
The odometer of `navmatlab` is made from its reference with 0.1 m/s of noise, for the car had none. Recordings are not
part of the repository; docs/how-to/import-a-drive.md says how to come by a recording of your own.
*Receiver only* is the receiver's position against the same truth, at the antenna and at the times of the fixes given to
the filter (docs/reference/metrics.md), with our error at the same fixes in brackets, which is compared with it: that of
the solution before the fix is used, where it is largest. The column *ours* holds errors at all times of the truth.

"""
HEAD = "<!-- Printed by `make drives` from benchmarks/results/navigation.json; a test holds it to that file. -->\n\n"


class Cost(TypedDict):
    """What one inertial sample costs: batch, one core."""

    us_per_sample: float
    samples: int
    peak_mb: float


class Document(TypedDict):
    """All that was measured in one run."""

    measured_at: str
    machine: str
    load_before: float
    quick: bool  # of runs that are shifted against each other the first alone
    cases: dict[str, Metrics]
    speed: dict[str, Cost]
    peers: dict[str, PeerResult]


def main(arguments: Sequence[str]) -> int:
    """Measure the drives that are there."""
    options = _options(arguments)
    if options.print:
        write_pages(json.loads((RESULTS / "navigation.json").read_text(encoding="utf-8")), tables.reprint)
        return 0
    only = options.only or (SHORT[:1] if options.smoke else SHORT if options.short else None)
    cases = {
        key: replace(case, outages=case.outages[: options.runs])
        for key, case in CASES.items()
        if not only or case.drive in only
    }
    drives = present(case.drive for case in cases.values())
    if not drives:
        print(f"no drive is measured: {data_folder()} holds none of them; set OBU_DATA to the folder of the recordings")
        return 0
    cases = {key: case for key, case in cases.items() if case.drive in drives}
    load = os.getloadavg()[0]
    imported = import_drives(drives, workers=options.workers, fresh=options.fresh)
    jobs = [job for key, case in cases.items() for job in jobs_of(key, case)]
    solved = campaign.run("drives", jobs, workers=options.workers, fresh=options.fresh, smoke=options.smoke)
    with tempfile.TemporaryDirectory(prefix="obu-drives-") as folder:
        document = Document(
            measured_at=datetime.now(UTC).isoformat(timespec="seconds"),
            machine=machine(),
            quick=options.runs < SIZE.full,
            load_before=round(load, 2),
            cases=metrics_of(cases, jobs, dict(solved.numbered)),
            speed={name: _speed(recording(name)) for name in SPEED_SETS if name in drives},
            peers={} if options.short else {peer.name: peer.measure(Path(folder)) for peer in PEERS},
        )
    print(page(document))
    if campaign.worth_storing(options, imported, solved) and not options.only:
        store(document)
    return 0 if imported.complete and solved.complete else 1


def _options(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.navigation", description=__doc__)
    names = sorted({case.drive for case in CASES.values()})
    parser.add_argument("--only", nargs="+", choices=names, help="these drives alone; prints, and keeps nothing")
    parser.add_argument(
        "--print", action="store_true", help="print the pages of the last results again; measure nothing"
    )
    return campaign.options_of(parser, arguments, SIZE)


def _speed(path: Path) -> Cost:
    command = [sys.executable, "-m", "benchmarks.navigation.speed", str(path)]
    done = subprocess.run(command, cwd=REPOSITORY, check=True, capture_output=True, text=True)
    cost: Cost = json.loads(done.stdout)
    return cost


def store(document: Document) -> None:
    """Keep the table with all numbers behind it."""
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "navigation.json").write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
    write_pages(document, tables.publish)


def write_pages(document: Document, write: Callable[[Path, str], None]) -> None:
    """Print benchmarks/results/navigation.md, docs/reference/drives.md, and the tables of the how-to."""
    write(RESULTS / "navigation.md", page(document))
    write(PAGE, HEAD + page(document))
    HOW_TO.write_text(with_tables(HOW_TO.read_text(encoding="utf-8"), document), encoding="utf-8")


def with_tables(text: str, document: Document) -> str:
    """Replace the table of real drives in the how-to, which lies between two marks."""
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise ValueError(f"{HOW_TO} has no {BEGIN.strip()} ... {END.strip()}")
    return f"{before}{begin}{real_drives(document['cases'])}{end}{after}"


def real_drives(cases: dict[str, Metrics]) -> str:
    """Lay out the table of the how-to."""
    rows = []
    for name, case, cut in REAL_DRIVES:
        metrics, outages = cases.get(case, {}), cases.get(cut, {}) if cut else {}
        median, largest = (outages.get(f"outage_end_error_{what}_m") for what in ("median", "max"))
        gap = "" if cut is None else f"{_metres(median)}, {_metres(largest)}{_count(outages)}"
        alone = "" if name in OWN_FIXES else _metres(metrics.get("gnss_alone_horizontal_rmse_m"))
        found = (_metres(metrics.get(metric)) for metric in ("horizontal_rmse_m", "innovation_horizontal_rms_m"))
        ours, innovation = found
        rows.append((name, ours, alone, innovation, gap))
    head = ("drive", "horizontal RMSE [m]", "receiver only [m]", "horizontal innovation RMS [m]",
            "end of a 10 s outage: median, maximum [m]")  # fmt: skip
    return _markdown(head, rows)


def _metres(value: float | None) -> str:
    return UNMEASURED if value is None else f"{value:.2g}"


def page(document: Document) -> str:
    """Lay out what was measured."""
    return (
        "# Accuracy on drives\n\n"
        f"Measured {document['measured_at']} on {document['machine']}; load {document['load_before']:.1f} before. "
        + ("**Of the shifted runs the first alone was made.** " if document["quick"] else "")
        + "Peers: published or measured by others on the same data, none of them in this run.\n\n"
        + _markdown(
            ("drive", "quantity", "ours", "receiver only", "goal", "holds", "peers"),
            list(rows_of(document["cases"])),
        )
        + NOTES
        + "## Cost of an inertial sample\n\n"
        + _markdown(("program", "set", "CPU, us a sample", "peak memory, MB"), list(_costs(document)))
        + "\nOurs is the navigator alone, without reading the file, with fixes and wheels as late as they came. The\n"
        "goals are of positions alone, with nothing late:\n"
        "`python -m benchmarks.navigation.ways`, docs/decisions/0008. Peers are whole programs, files included.\n\n"
        "## Peers in this run\n\n" + "".join(f"- {sentence}\n" for sentence in _peers(document["peers"]))
    )


def rows_of(cases: dict[str, Metrics]) -> Iterator[tuple[str, ...]]:
    """One row for each goal: drive, quantity, our value, receiver only, goal, whether it holds, and peers."""
    for row in ROWS:
        metrics = cases.get(row.case, {})
        value, (alone, at_fixes) = shown(row, metrics), gnss_alone(row, metrics)
        met = [] if row.goal is None or value is None else [value <= row.goal]
        met += [at_fixes <= alone] if row.at_most_gnss and alone is not None and at_fixes is not None else []
        wanted = (row.goal is not None) + row.at_most_gnss
        holds = "" if not wanted or (len(met) < wanted and all(met)) else ("yes" if all(met) else "**no**")
        goals = [f"<= {row.goal:g}"] if row.goal is not None else []
        goals += ["<= receiver only"] if row.at_most_gnss else []
        yield (f"{row.case}{_count(metrics)}", row.quantity, _with_unit(value, row), _alone(row, alone, at_fixes),
               " and ".join(goals), holds, row.peers)  # fmt: skip


def _with_unit(value: float | None, row: Row) -> str:
    return UNMEASURED if value is None else f"{value:.3g} {row.unit}".strip()


def _alone(row: Row, alone: float | None, at_fixes: float | None) -> str:
    """The receiver only, and ours at its fixes, beside a row; empty where it says nothing, as against its own fixes."""
    if alone is None or at_fixes is None:
        return UNMEASURED if row.at_most_gnss else ""
    return f"{_with_unit(alone, row)} (ours {_with_unit(at_fixes, row)})"


def gnss_alone(row: Row, metrics: Metrics) -> tuple[float | None, float | None]:
    """Errors of the receiver's positions and of the solution, both at the same fixes, in the unit of a row."""
    alone, at_fixes = GNSS_ALONE.get(row.metric, ("", ""))
    return metrics.get(alone), metrics.get(at_fixes)


def shown(row: Row, metrics: Metrics) -> float | None:
    """Value of a row in its unit."""
    value = metrics.get(row.metric)
    if value is None:
        return None
    return degrees(value) if row.unit == "deg" else 100.0 * value if row.unit == "%" else value


def _count(metrics: Metrics) -> str:
    count = metrics.get("outage_count")
    return f" ({count:.0f} outages)" if count else ""


def _costs(document: Document) -> Iterator[tuple[str, ...]]:
    for name, cost in document["speed"].items():
        yield "ours", name, f"{cost['us_per_sample']:.2f}", f"{cost['peak_mb']:.0f}"
    for peer, result in document["peers"].items():
        for name, set_result in result["sets"].items():
            yield peer, name, f"{set_result['us_per_sample']:.2f}", f"{set_result['peak_mb']:.0f}"


def _peers(peers: dict[str, PeerResult]) -> Iterator[str]:
    for name, result in peers.items():
        if result["absent"] is not None:
            yield f"{name}: not run. {result['absent']}"
        for case, set_result in result["sets"].items():
            yield f"{name} on {case}: " + ", ".join(f"{key} {value}" for key, value in set_result["accuracy"].items())


def _markdown(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)

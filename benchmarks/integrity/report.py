"""The campaign: how often an error was above its protection level, and how much larger levels are than errors."""

import argparse
import json
import platform
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from benchmarks import tables
from cli import campaign

from .simulated import CASES, ErrorsAndLevels, jobs_of

RESULTS = Path(__file__).resolve().parents[1] / "results"
SIZE = campaign.Size(short=10, usual=300, full=1000)
SHARE_GOAL, RATIO_GOAL = 1e-3, 6.0
# Recording and options of `obu solve`; docs/how-to/solve-a-recorded-drive.md says how each is imported.
RECORDINGS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("rtkexp_drive", ()),
    ("rtkexp_drive", ("--outage", "10/30")),
    ("rtkexp_drive", ("--outage", "15/45")),
    ("rtkexp_drive", ("--outage", "15/45", "--aiding", "free")),
    ("wid_car_trial02", ()),
    ("wid_car_trial02", ("--outage", "10/30")),
    ("wid_car_trial08", ()),
    ("wid_car_trial08", ("--outage", "10/30")),
    ("wid_car_trial10", ()),
    ("wid_car_trial10", ("--outage", "10/30")),
    ("navmatlab_car", ()),
    ("navmatlab_car", ("--outage", "60/180@120", "--aiding", "nhc")),
    ("navmatlab_car", ("--outage", "60/180@180", "--aiding", "free")),
    ("mems_rtk_200hz", ()),
    ("mems_rtk_200hz", ("--outage", "60/180@650", "--aiding", "odometer")),
    ("mems_rtk_200hz", ("--outage", "60/180@710", "--aiding", "free")),
    ("mems_spp_100hz", ()),
    ("mems_spp_100hz", ("--outage", "60/180@650", "--aiding", "odometer")),
)


@dataclass(frozen=True)
class Row:
    """One line of the table; pairs are horizontal and vertical."""

    name: str
    runs: int
    epochs: int
    above: tuple[float, float]  # share of the epochs whose error is above the level
    proven: tuple[float, float]  # the same, by more than the truth's own doubt
    ratio: tuple[float, float]  # level over error, median
    worst: tuple[float, float]  # error over level, largest
    level_m: tuple[float, float]  # median

    @property
    def holds(self) -> bool:
        """Whether errors are above levels as seldom as they must be."""
        return max(self.above) <= SHARE_GOAL


def main(arguments: Sequence[str] | None = None) -> int:
    """Run, print, store; 1 if errors are above levels more often than they may be in the simulation."""
    parser = argparse.ArgumentParser(description="Protection levels against true errors.")
    parser.add_argument("--seed", type=int, default=0, help="of the first runs")
    parser.add_argument("--recordings", type=Path, help="folder with imported recordings")
    options = campaign.options_of(parser, arguments, SIZE)
    jobs = jobs_of(options.runs, options.seed)
    outcome = campaign.run("integrity", jobs, workers=options.workers, fresh=options.fresh, smoke=options.smoke)
    judged = outcome.results
    simulated = [*rows_of(judged), row_of("all simulated", judged)] if judged else []
    recorded = recordings_in(options.recordings) if options.recordings and not options.short else []
    now = datetime.now(UTC)
    made = f"{now:%Y-%m-%d}, {platform.machine()}, Python {platform.python_version()}"
    text = "\n".join(page(simulated, recorded, made, SIZE.note(options.runs)))
    print(text)
    if campaign.worth_storing(options, outcome):
        store(simulated, recorded, text, f"{now:%Y-%m-%d}")
    return 0 if outcome.complete and all(row.holds for row in simulated) else 1


def rows_of(judged: Sequence[ErrorsAndLevels]) -> list[Row]:
    """Make one row a case, of all its runs."""
    groups = [(case.name, [item for item in judged if item.case == case.name]) for case in CASES]
    return [row_of(name, runs) for name, runs in groups if runs]


def row_of(name: str, runs: Sequence[ErrorsAndLevels]) -> Row:
    """Put runs together."""
    error = np.concatenate([run.error_m for run in runs])
    level = np.concatenate([run.level_m for run in runs])
    share = error / level
    above, worst = (share > 1.0).mean(axis=0).tolist(), share.max(axis=0).tolist()
    ratio, median = (1.0 / np.median(share, axis=0)).tolist(), np.median(level, axis=0).tolist()
    return Row(name, len(runs), len(error), _pair(above), _pair(above), _pair(ratio), _pair(worst), _pair(median))


def _pair(values: Sequence[float]) -> tuple[float, float]:
    horizontal, vertical = values
    return horizontal, vertical


def recordings_in(folder: Path) -> list[Row]:
    """Solve what is there of `RECORDINGS`, each in a process of its own."""
    rows = []
    for name, options in RECORDINGS:
        path = folder / f"{name}.mcap"
        if not path.exists():
            print(f"{name}: {path} is not there, left out", file=sys.stderr)
            continue
        with tempfile.TemporaryDirectory(prefix="obu-integrity-") as out:
            command = [sys.executable, "-m", "cli", "solve", str(path), *options, "--out", out, "--json"]
            done = subprocess.run(command, check=True, capture_output=True, text=True)
        m = json.loads(done.stdout)

        def both(metric: str, m: dict[str, float] = m) -> tuple[float, float]:
            return m[f"protection_horizontal_{metric}"], m[f"protection_vertical_{metric}"]

        words = " ".join((name, *(option.removeprefix("--") for option in options)))
        above, proven = both("misleading_fraction"), both("misleading_proven_fraction")
        ratio, worst = both("ratio_median"), both("error_share_max")
        rows.append(Row(words, 1, int(m["truth_count"]), above, proven, ratio, worst, both("median_m")))
        print(line(rows[-1]), file=sys.stderr)
    return rows


def store(simulated: Sequence[Row], recorded: Sequence[Row], text: str, date: str) -> None:
    """Write the page and its numbers."""
    RESULTS.mkdir(exist_ok=True)
    tables.publish(RESULTS / "integrity.md", text + "\n")
    numbers = {
        "date": date,
        "simulated": [asdict(row) for row in simulated],
        "recorded": [asdict(row) for row in recorded],
    }
    (RESULTS / "integrity.json").write_text(json.dumps(numbers, indent=1) + "\n", encoding="utf-8")


def page(simulated: Sequence[Row], recorded: Sequence[Row], made: str, size: str) -> list[str]:
    """Draw up the page, line by line."""
    heading = [
        "| | runs | epochs | error above level, % "
        "| by more than the truth's doubt, % | level / error, median | error / level, largest | level, median m |",
        "| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    lines = [
        "# Protection levels against true errors",
        "",
        f"Measured {made}, by `make integrity`. Pairs are horizontal / vertical; the integrity risk is 0.001 an epoch.",
        f"Goals: above in at most {100.0 * SHARE_GOAL:g} %, ratio at most {RATIO_GOAL:g}. "
        "Simulated drives last 180 s, without GNSS for 15 s of every minute, half of them with an odometer.",
        size,
        "",
        *heading,
        *map(line, simulated),
    ]
    if recorded:
        lines += [
            "",
            "Recordings, solved by `obu solve` with the options that are named.",
            "",
            *heading,
            *map(line, recorded),
        ]
    return lines


def line(row: Row) -> str:
    """Print a row."""

    def both(values: tuple[float, float], form: str) -> str:
        return " / ".join(format(value, form) for value in values)

    above = both((100.0 * row.above[0], 100.0 * row.above[1]), ".3g")
    proven = both((100.0 * row.proven[0], 100.0 * row.proven[1]), ".3g")
    numbers = (above, proven, both(row.ratio, ".1f"), both(row.worst, ".2f"), both(row.level_m, ".2f"))
    return f"| {row.name} | {row.runs} | {row.epochs} | {' | '.join(numbers)} |"

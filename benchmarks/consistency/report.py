"""The campaign: normalised errors squared, block by block, beside the band that chi-square allows their mean."""

import argparse
import json
import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from math import radians
from pathlib import Path

import numpy as np

from benchmarks import tables
from cli import campaign
from services.sensors.simulator.gnss.gnss_errors import ErrorKind, InjectedError
from shared.maths.quantiles import chi_square_limit

from . import matched, whole
from .matched import CORRELATION_S, POSITION_SD, Model
from .sizes import BLOCKS, Sizes
from .whole import Unit

RESULTS = Path(__file__).resolve().parents[1] / "results"
SIZE = campaign.Size(short=3, usual=50, full=200)
SCENARIO, DURATION_S = "urban", 140.0
BAND = 0.95
RMSE = (float(POSITION_SD[0]), float(POSITION_SD[1]), float(POSITION_SD[2]))
WHITE, CORRELATED = InjectedError(ErrorKind.WHITE, RMSE), InjectedError(ErrorKind.GAUSS_MARKOV, RMSE, CORRELATION_S)
NO_LASTING = {"gnss.time_correlated_errors": False}
FREE = {**NO_LASTING, "standstill.enabled": False, "non_holonomic.enabled": False}
# Biases at switch-on as the simulator draws them.
NO_MARGINS = {**FREE, "imu.accelerometer_bias_sd_m_s2": 0.0196, "imu.gyroscope_bias_sd_rad_s": 0.00175}
CASES: dict[str, Model | Unit] = {
    "matched, white errors": Model(),
    "matched, errors of 60 s": Model(time_correlated=True),
    "matched, white errors, gyroscope biases of 2.5 deg/s": Model(gyroscope_bias_sd=radians(2.5)),
    "matched but for what has to be learnt: white errors": Model(known=False),
    "matched but for what has to be learnt: errors of 60 s": Model(time_correlated=True, known=False),
    "as delivered, white errors": Unit(WHITE),
    "as delivered, errors of 60 s": Unit(CORRELATED),
    "white errors, and given as white": Unit(WHITE, NO_LASTING),
    "and neither standstill nor wheels": Unit(WHITE, FREE),
    "and biases no larger than the simulator's": Unit(WHITE, NO_MARGINS),
}
BOUND = ("matched, white errors", "matched, errors of 60 s")  # must be within their bands


@dataclass(frozen=True)
class Row:
    """One case; all numbers are over their dimensions, so that one is right."""

    name: str
    runs: int
    nees: dict[str, float]  # by block: mean over runs and instants
    inside: dict[str, float]  # share of the instants at which the mean over the runs is within its band
    innovations: tuple[float, float]  # RMS of normalised ones: velocity, position

    @property
    def within(self) -> bool:
        """Whether every block is within the band of one instant, and innovations are within 0.8 and 1.2."""
        blocks = (band(self.runs, dimension(name)) for name in self.nees)
        nees = all(low <= size <= high for size, (low, high) in zip(self.nees.values(), blocks, strict=True))
        return nees and all(0.8 <= size <= 1.2 for size in self.innovations)


def dimension(block: str) -> int:
    """Count the components of a block."""
    return BLOCKS[block].stop - BLOCKS[block].start


def band(runs: int, size: int) -> tuple[float, float]:
    """Bounds between which the mean of chi-squares over their dimension lies with 95 % probability."""
    degrees = runs * size
    low, high = (chi_square_limit(degrees, 0.5 * (1.0 + side * BAND)) / degrees for side in (1.0, -1.0))
    return low, high


def run(case: Model | Unit, seed: int) -> Sizes:
    """Do one drive of a case."""
    if isinstance(case, Model):
        return matched.run(case, SCENARIO, seed, DURATION_S)
    return whole.run(case, SCENARIO, seed, DURATION_S)


def row_of(name: str, runs: Sequence[Sizes]) -> Row:
    """Put runs together; instants at which not all of them have a solution are left out."""
    errors = np.array([run.errors for run in runs])
    errors = errors[:, np.isfinite(errors).all(axis=(0, 2))]
    means = errors.mean(axis=0)
    nees, inside = {}, {}
    for k, block in enumerate(BLOCKS):
        low, high = band(len(runs), dimension(block))
        nees[block] = float(means[:, k].mean())
        inside[block] = float(((low <= means[:, k]) & (means[:, k] <= high)).mean())
    velocity, position = np.sqrt(np.nanmean(np.array([run.innovations for run in runs]), axis=(0, 1))).tolist()
    return Row(name, len(runs), nees, inside, (velocity, position))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run, print, store; 1 if a filter that knows its errors does not know how large they are."""
    parser = argparse.ArgumentParser(description="Normalised errors of the filter.")
    parser.add_argument("--seed", type=int, default=0, help="of the first runs")
    options = campaign.options_of(parser, arguments, SIZE)
    seeds = range(options.seed, options.seed + options.runs)
    jobs = [campaign.Job(name, run, (case, seed)) for seed in seeds for name, case in CASES.items()]
    outcome = campaign.run("consistency", jobs, workers=options.workers, fresh=options.fresh, smoke=options.smoke)
    found: dict[str, list[Sizes]] = {}
    for number, sizes in outcome.numbered:
        found.setdefault(jobs[number].name, []).append(sizes)
    rows = [row_of(name, found[name]) for name in CASES if name in found]
    text = "\n".join(page(rows)) + "\n"
    print(text)
    if campaign.worth_storing(options, outcome):
        tables.publish(RESULTS / "consistency.md", text)
        kept = {"date": f"{datetime.now(UTC):%Y-%m-%d}", "rows": [asdict(row) for row in rows]}
        (RESULTS / "consistency.json").write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
    return 0 if outcome.complete and all(row.within for row in rows if row.name in BOUND) else 1


def page(rows: Sequence[Row]) -> list[str]:
    """Draw up the page, line by line."""
    runs = max((row.runs for row in rows), default=1)
    bands = {band(runs, dimension(block)) for block in BLOCKS}
    (low, high), (low_all, high_all) = sorted(bands)
    made = f"{datetime.now(UTC):%Y-%m-%d}, {platform.machine()}, Python {platform.python_version()}"
    return [
        "# Errors over what the filter says of them",
        "",
        f"Measured {made}, by `make consistency`: drives through a town of {DURATION_S:g} s, in each row "
        f"{SIZE.note(runs)}",
        "Normalised errors squared (NEES) over their dimensions: mean over drives and instants, and how often the mean",
        f"over the drives is within its 95 % band, in %. The band is {low:.2f} to {high:.2f} of three components,",
        f"{low_all:.2f} to {high_all:.2f} of all 15. Above it the filter is too sure of itself.",
        "Innovations: RMS over their standard deviation.",
        "",
        f"| | {' | '.join(BLOCKS)} | innovations: velocity, position |",
        f"| --- |{' ---: |' * (len(BLOCKS) + 1)}",
        *map(line, rows),
    ]


def line(row: Row) -> str:
    """Print a row."""
    blocks = (f"{row.nees[block]:.2f} ({100.0 * row.inside[block]:.0f})" for block in BLOCKS)
    innovations = ", ".join(f"{size:.2f}" for size in row.innovations)
    return f"| {row.name} | {' | '.join(blocks)} | {innovations} |"

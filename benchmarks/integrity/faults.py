"""Drives with one random fault each: how often an error is then above its level, and how much that adds to the risk.

`python -m benchmarks.integrity.faults --runs 100`. Drives are counted and not seconds, for those of one drive are not
independent. Each drive is the whole unit with core.trust, as a vehicle runs it.
"""

import argparse
import json
import platform
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from benchmarks import tables
from cli import campaign
from cli.attack_lab.run import simulated
from cli.attack_lab.score import binomial_interval
from shared.attacks import ScheduledAttack, schedule
from shared.messages.trust import TrustLevel

RESULTS = Path(__file__).resolve().parents[1] / "results"
SIZE = campaign.Size(short=8, usual=100, full=400)
STREAM = 17  # of random numbers that no other part of the simulator draws
DURATION_S, EARLIEST_S, LATEST_S = 90.0, 30.0, 65.0
SHORTEST_S, LONGEST_S = 5.0, 40.0
SCENARIOS = ("urban", "highway", "tunnel")
RISK = 1e-3
KINDS = ("imu", "odometer", "gnss", "two")
# Faults per hour, times the hour for which one is present on average: the probability that one is present now. IMU and
# odometer as wear and mounting faults, GNSS as faults and attacks, two at once as an attack on both.
PRIOR: Mapping[str, float] = {"imu": 1e-3, "odometer": 1e-3, "gnss": 1e-4, "two": 1e-5}


@dataclass(frozen=True)
class Faulty:
    """One drive."""

    kind: str
    fault: str
    drive: str
    seed: int
    above_s: float  # with an error above its level, horizontal or vertical, from the fault on
    safe_above_s: float  # of these, while the verdict was SAFE
    largest_share: float  # error over level


@dataclass(frozen=True)
class Row:
    """All drives of a kind."""

    kind: str
    drives: int
    above: int  # drives with an error above its level at any time
    interval: tuple[float, float]  # of the probability, Clopper-Pearson
    safe_above: int  # drives with such an error while SAFE
    prior: float
    product: float  # prior times the share of these drives
    at_most: float  # prior times the upper end of the interval


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _fault(rng: np.random.Generator, kind: str) -> str:
    """Draw a fault of a kind, in the notation of attacks without its times."""
    sign = float(rng.choice([-1.0, 1.0]))
    direction = f"direction={rng.uniform(-180.0, 180.0):.0f}"
    drag = f"acceleration={_log(rng, 0.01, 1.0):.3f},speed={_log(rng, 0.3, 5.0):.2f}"
    choices = {
        "imu": (
            f"gyroscope_bias(bias={sign * _log(rng, 0.05, 3.0):.3f})",
            f"accelerometer_bias(bias={sign * _log(rng, 0.05, 2.0):.3f})",
        ),
        "odometer": (
            f"odometer_scale(factor={rng.uniform(0.8, 1.25):.3f})", "odometer_freeze", "wheel_zero",
            f"tyre_change(factor={rng.uniform(0.94, 1.06):.3f})",
        ),
        "gnss": (
            f"position_jump(distance={_log(rng, 5.0, 200.0):.0f},{direction})", f"drag_off({drag},{direction})",
            f"climb({drag})", f"satellite_step(error={_log(rng, 20.0, 200.0):.0f})",
            f"satellite_ramp(rate={_log(rng, 0.3, 5.0):.2f})",
            f"tunnel_return(gap={rng.uniform(3.0, 15.0):.0f},distance={_log(rng, 5.0, 100.0):.0f},{direction})",
            f"staircase(distance={_log(rng, 2.0, 20.0):.0f},period={rng.uniform(5.0, 20.0):.0f},{direction})",
            f"subset(portion={rng.uniform(0.3, 0.9):.2f})", "freeze",
            f"drag_hold(speed={_log(rng, 0.3, 5.0):.2f},{direction})",
            f"stopwatch(share={rng.uniform(0.01, 0.2):.3f})",
        ),
    }[kind]  # fmt: skip
    return str(rng.choice(choices))


def faults_of(seed: int) -> tuple[str, list[ScheduledAttack]]:
    """Kind and faults of a drive; the same seed gives the same."""
    rng = np.random.default_rng((seed, STREAM))
    kind = KINDS[seed % len(KINDS)]
    kinds = [kind] if kind != "two" else rng.permutation(KINDS[:3])[:2].tolist()
    start_s, duration_s = rng.uniform(EARLIEST_S, LATEST_S), rng.uniform(SHORTEST_S, LONGEST_S)
    return kind, [schedule(f"{_fault(rng, kind)}@{start_s:.1f}:{duration_s:.1f}") for kind in kinds]


def drive_of(seed: int) -> Faulty:
    """Drive once."""
    kind, faults = faults_of(seed)
    drive = SCENARIOS[seed // len(KINDS) % len(SCENARIOS)]
    timeline = simulated(drive, 1000 + seed, DURATION_S, faults)
    rows = (timeline.error_s >= faults[0].start_s) & np.isfinite(timeline.level_m).all(axis=1)
    times, share = timeline.error_s[rows], timeline.error_m[rows] / np.maximum(timeline.level_m[rows], 1e-6)
    above = np.any(share > 1.0, axis=1)
    safe = np.array([verdict is TrustLevel.SAFE for verdict in timeline.verdict_at(times)], dtype=bool)
    step_s = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    names = " and ".join(
        f"{fault.attack}({', '.join(f'{key}={value:g}' for key, value in fault.parameters.items())})"
        for fault in faults
    )
    text = f"{names} at {faults[0].start_s:.0f} s for {faults[0].duration_s:.0f} s"
    largest = float(share.max()) if len(share) else 0.0
    return Faulty(kind, text, drive, seed, float(above.sum()) * step_s, float((above & safe).sum()) * step_s, largest)


def rows_of(drives: Sequence[Faulty]) -> list[Row]:
    """Make one row a kind."""
    rows = []
    for kind in KINDS:
        found = [drive for drive in drives if drive.kind == kind]
        if found:
            above = sum(faulty.above_s > 0.0 for faulty in found)
            interval = binomial_interval(above, len(found))
            safe = sum(faulty.safe_above_s > 0.0 for faulty in found)
            rows.append(Row(kind, len(found), above, interval, safe, PRIOR[kind], PRIOR[kind] * above / len(found),
                            PRIOR[kind] * interval[1]))  # fmt: skip
    return rows


def percent(value: float) -> str:
    """Print a share."""
    return f"{100.0 * value:.3g} %"


def page(drives: Sequence[Faulty], made: str) -> list[str]:
    """Draw up the page, line by line."""
    rows = rows_of(drives)
    total, most = sum(row.product for row in rows), sum(row.at_most for row in rows)
    worst = sorted((drive for drive in drives if drive.above_s > 0.0), key=lambda faulty: -faulty.largest_share)
    return [
        "# Protection levels under random faults",
        "",
        f"Measured {made}, by `make integrity`: {SIZE.note(len(drives))} A run is a simulated drive of "
        f"{DURATION_S:.0f} s with one random fault, the whole unit with `core.trust`. "
        "A drive counts as above if one error, horizontal or vertical, is above its level at any time from the fault "
        "on. Prior: faults an hour, present for an hour.",
        "",
        "| fault in | drives | above a level | probability, 95 % | above while SAFE | prior | product |",
        "| --- | ---: | ---: | ---: | ---: | ---: | ---: |",
        *(
            f"| {row.kind} | {row.drives} | {row.above} | {percent(row.interval[0])} to {percent(row.interval[1])} "
            f"| {row.safe_above} | {row.prior:g} | {percent(row.product)}, at most {percent(row.at_most)} |"
            for row in rows
        ),
        "",
        f"Together {percent(total)}, with the upper ends of the intervals {percent(most)} (goal: {percent(RISK)}).",
        "",
        "## Drives with an error above its level",
        "",
        "| drive | fault | above, s | above while SAFE, s | error / level, largest |",
        "| --- | --- | ---: | ---: | ---: |",
        *(
            f"| {faulty.drive}, {faulty.seed} | {faulty.fault} | {faulty.above_s:.1f} | {faulty.safe_above_s:.1f} "
            f"| {faulty.largest_share:.2f} |"
            for faulty in worst
        ),
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run, print, store; 1 if the product with the priors is above the risk."""
    parser = argparse.ArgumentParser(description="Protection levels under one random fault a drive.")
    parser.add_argument("--seed", type=int, default=0, help="of the first drive")
    options = campaign.options_of(parser, arguments, SIZE)
    seeds = range(options.seed, options.seed + options.runs)
    jobs = [campaign.Job(f"drive {seed}", drive_of, (seed,)) for seed in seeds]
    outcome = campaign.run("faults", jobs, workers=options.workers, fresh=options.fresh, smoke=options.smoke)
    drives = outcome.results
    now = datetime.now(UTC)
    text = "\n".join(page(drives, f"{now:%Y-%m-%d}, {platform.machine()}, Python {platform.python_version()}"))
    print(text)
    if campaign.worth_storing(options, outcome):
        RESULTS.mkdir(exist_ok=True)
        tables.publish(RESULTS / "faults.md", text + "\n")
        numbers = {"date": f"{now:%Y-%m-%d}", "rows": [asdict(row) for row in rows_of(drives)]}
        (RESULTS / "faults.json").write_text(json.dumps(numbers, indent=1) + "\n", encoding="utf-8")
    return 0 if outcome.complete and sum(row.product for row in rows_of(drives)) <= RISK else 1


if __name__ == "__main__":
    sys.exit(main())

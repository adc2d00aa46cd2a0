"""How soon a unit that is switched on anywhere knows where the vehicle points, by kinds of receivers."""

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from math import degrees, erf, inf, radians, sqrt
from pathlib import Path

import numpy as np
import numpy.typing as npt
from rich.console import Console

from benchmarks import tables
from cli import campaign
from services.sensors.simulator.drive import Drive

from .start import HIGH_SPEED_M_S, STEP_S, Receiver, Start, drive

SIZE = campaign.Size(short=1, usual=6, full=20)  # starts of each drive, from rest and at speed
RESULTS = Path(__file__).resolve().parents[1] / "results"
TITLE = """# Switched on anywhere: how soon the heading is known

By `make starts`; docs/explanation/navigation.md says what is tried. Gyroscope biases of 0.1 deg/s (1 sigma) are
simulated. Each receiver is tried with the default of `core.fusion.imu.gyroscope_bias_sd_rad_s`, which covers biases
of several degrees a second, and with 0.2 deg/s, as the data sheet of an MTi-630 states.

"""
LIMIT = radians(3.0)
WITHIN_S = 5.0
WATCHED_S = 20.0
DRIVES = (("parking_lot", 1, 240.0), ("urban", 2, 300.0), ("tunnel", 3, 200.0))
RECEIVERS = (
    *(Receiver(rate_hz) for rate_hz in (1, 5)),
    *(Receiver(rate_hz, velocity=False, course=True) for rate_hz in (1, 5)),
    *(Receiver(rate_hz, velocity=False) for rate_hz in (1, 5)),
    *(Receiver(1, velocity=False, white_m=white_m) for white_m in (1.0, 2.0)),
)


SETTINGS: dict[str, dict[str, object]] = {
    "default": {},
    "0.2 deg/s": {"imu.gyroscope_bias_sd_rad_s": radians(0.2)},
}


@dataclass(frozen=True)
class Row:
    """One kind of receiver, with one kind of settings: how soon its starts knew the heading."""

    receiver: Receiver
    settings: str
    passed: int
    starts: int
    median_s: float
    slowest_s: float
    wrong: int  # starts whose solution was off by more than 15 degrees later than that
    bound: float | None  # share of the starts that the best use of positions would let pass

    @property
    def name(self) -> str:
        """Kind of receiver in words."""
        receiver = self.receiver
        velocity = "velocity" if receiver.velocity else "speed and course" if receiver.course else "positions only"
        return f"{self.receiver.rate_hz} Hz, {velocity}, white noise {self.receiver.white_m:g} m"


def moments(travelled: Drive, moving: bool) -> npt.NDArray[np.floating]:
    """Times [s] in motion, or just before driving off, with time enough left to watch."""
    speed = np.hypot(travelled.velocity_n[:, 0], travelled.velocity_n[:, 1])[: -round((WATCHED_S + 5.0) / STEP_S)]
    if moving:
        return np.flatnonzero(speed > 4.0) * STEP_S
    return np.flatnonzero((speed[1:] > 0.0) & (speed[:-1] == 0.0)) * STEP_S - 0.1


def starts(receiver: Receiver, each: int) -> list[Start]:
    """Draw starts, the same for all receivers: half of them from rest without levelling, half at speed."""
    drawn = []
    for scenario, seed, duration_s in DRIVES:
        travelled = drive(scenario, seed, duration_s)
        for moving in (False, True):
            rng = np.random.default_rng((seed, moving))
            times = moments(travelled, moving)
            for k in range(each):
                at_s, wait_s = float(rng.choice(times)), float(rng.uniform(0.0, 1.5))
                drawn.append(Start(travelled, receiver, at_s, wait_s, k))
    return drawn


def probability(start: Start) -> float:
    """Probability that positions alone can give the heading within the limit and the time.

    The standard deviation of the direction of a track whose form is known, at n positions with noise s, is
    s / sqrt(sum |d - mean(d)|²), d being the way. No sideslip, no tilt, no drift: nothing does better from positions.
    """
    d, receiver = start.drive, start.receiver
    first = round((start.at_s + start.first_fix_s) / STEP_S)
    fast = first + int(np.argmax(np.hypot(*d.velocity_n[first:, :2].T) > HIGH_SPEED_M_S))
    every = round(1.0 / (receiver.rate_hz * STEP_S))
    way = np.cumsum(d.velocity_n[first : fast + round(WITHIN_S / STEP_S), :2], axis=0)[::every] * STEP_S
    spread = float(((way - way.mean(axis=0)) ** 2).sum())
    return erf(LIMIT * sqrt(0.5 * spread) / receiver.white_m)


def row(receiver: Receiver, settings: str, each: int) -> Row:
    """Try all starts of one receiver with one kind of settings."""
    times, wrong, bounds = [], 0, []
    for start in starts(receiver, each):
        settled_s, worst, _ = start.known_after_s(LIMIT, WATCHED_S, SETTINGS[settings])
        times.append(settled_s)
        wrong += worst > radians(15.0)
        bounds.append(probability(start))
    bound = None if receiver.velocity or receiver.course else float(np.mean(bounds))
    passed = sum(time <= WITHIN_S for time in times)
    return Row(receiver, settings, passed, len(times), float(np.median(times)), max(times), wrong, bound)


def table(rows: Sequence[Row]) -> str:
    """Print rows as Markdown."""
    lines = [
        f"| receiver | bias stated | {degrees(LIMIT):.0f}° within {WITHIN_S:.0f} s of 3 m/s | median | slowest "
        "| later wrong by 15° | best that positions allow |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        bound = "" if row.bound is None else f"{100.0 * row.bound:.0f} %"
        slowest = f"over {WATCHED_S:.0f} s" if row.slowest_s == inf else f"{row.slowest_s:.1f} s"
        passed = f"{row.passed} of {row.starts}"
        lines.append(
            f"| {row.name} | {row.settings} | {passed} | {row.median_s:.1f} s | {slowest} | {row.wrong} | {bound} |"
        )
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str]) -> int:
    """Run all receivers and write `benchmarks/results/starts.md`; a run is a start of each drive, of both kinds."""
    options = campaign.options_of(argparse.ArgumentParser(description=__doc__), arguments, SIZE)
    jobs = [
        campaign.Job(f"receiver {number}", row, (receiver, settings, options.runs))
        for number, (receiver, settings) in enumerate(product(RECEIVERS, SETTINGS), 1)
    ]
    outcome = campaign.run("starts", jobs, workers=options.workers, fresh=options.fresh, smoke=options.smoke)
    rows = outcome.results
    Console().print(table(rows), markup=False, soft_wrap=True)
    if campaign.worth_storing(options, outcome):
        store(rows, options.runs)
    return 0 if outcome.complete else 1


def store(rows: Sequence[Row], each: int) -> None:
    """Write the page and its numbers."""
    tables.publish(RESULTS.joinpath("starts.md"), f"{TITLE}{SIZE.note(each)}\n\n{table(rows)}")
    figures = [
        {
            "receiver": row.name,
            "bias_stated": row.settings,
            "passed": row.passed,
            "starts": row.starts,
            "bound": row.bound,
        }
        for row in rows
    ]
    RESULTS.joinpath("starts.json").write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")

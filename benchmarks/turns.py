"""Smallest turn rate of a GNSS track that the observer finds: `make turns`.

A direct simulation of `core.spoofing.observer`, without fusion and without a world: increments of a level vehicle whose
gyroscope has the errors that its grade states, and courses of a receiver whose velocities have 0.05 m/s on each axis,
correlated over 2 s. From a time on the courses turn away at a constant rate. What is printed is the rate that nine of
ten runs find within the time. The scale of the gyroscope is drawn from what the grade states.
"""

import argparse
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from math import exp, radians, sqrt
from pathlib import Path

import numpy as np
from rich.console import Console

from cli import campaign
from cli.papers.report import Table, printed
from services.core.spoofing.grade import Grade
from services.core.spoofing.gyroscope.sources import Course
from services.core.spoofing.observer.monitor import ObserverMonitor
from services.core.spoofing.process import Config
from services.core.spoofing.settings import Settings
from shared.inertial.increments import Increment
from shared.maths.earth import STANDARD_GRAVITY
from shared.messages.trust import Outcome

CAMPAIGN = campaign.Size(short=20, usual=50, full=200, unit="runs of each cell")
RESULTS = Path(__file__).parent / "results" / "turns.json"
STEP_NS = 100_000_000
STEP_S = 0.1
FOUND = 0.9  # share of the runs that find the rate
LARGEST_DEG_S = 1.0
HALVINGS = 9
VELOCITY_SD, CORRELATION_S = 0.05, 2.0  # [m/s], [s]
BIAS_S = 200.0  # correlation time of the instability
TURN_ON = radians(0.3)  # [rad/s]
# [rad/√s] White noise of a gyroscope at standstill, by data sheets; while driving it is what the grade states.
STILL_NOISE: Mapping[Grade, float] = {
    Grade.CONSUMER: radians(0.01), Grade.AUTOMOTIVE: radians(0.007), Grade.INDUSTRIAL: radians(0.007),
    Grade.TACTICAL: radians(0.0007),
}  # fmt: skip


@dataclass(frozen=True)
class Drive:
    """A column: length of the last standstill, time driven since then, speed, and turn while the courses turn away."""

    stood_s: int
    since_s: int
    speed_m_s: float
    turn_deg: float = 0.0


DRIVES = {
    "straight, 10 m/s, stood 10 s ten minutes ago": Drive(10, 600, 10.0),
    "motorway, 30 m/s, stood 60 s half an hour ago": Drive(60, 1800, 30.0),
    "the first, with a bend of 90 degrees": Drive(10, 600, 10.0, 90.0),
}
WITHIN_S = (60, 120, 300)


class Vehicle:
    """Increments and courses of one run."""

    def __init__(self, settings: Settings, grade: Grade, drive: Drive, seed: int) -> None:
        self._rng, self._drive = np.random.default_rng((seed, list(Grade).index(grade))), drive
        self._grade, self._walk, self._still = settings.observer, settings.long, STILL_NOISE[grade]
        self._bias = TURN_ON * self._rng.standard_normal(3)
        self._run = self._grade.gyroscope_instability_rad_s * self._rng.standard_normal(3)
        self._scale = settings.long.gyroscope_scale_sd * self._rng.standard_normal()
        self._error = VELOCITY_SD * self._rng.standard_normal(2)
        self.yaw, self.k = 0.0, 0
        self._forget = exp(-STEP_S / BIAS_S)

    def step(self, rate: float, *, stands: bool) -> Increment:
        """Advance by 100 ms at a yaw rate [rad/s]."""
        draw = self._rng.standard_normal((4, 3))
        self._bias = self._bias + self._grade.gyroscope_bias_walk_rad_s_sqrt_s * sqrt(STEP_S) * draw[0]
        fresh = self._grade.gyroscope_instability_rad_s * sqrt(1.0 - self._forget**2)
        self._run = self._forget * self._run + fresh * draw[1]
        noise = self._still if stands else self._walk.angle_random_walk_rad_sqrt_s
        w = self._bias + self._run + noise / sqrt(STEP_S) * draw[2]
        w[2] += (1.0 + self._scale) * rate
        shaking = 0.005 if stands else 0.3  # [m/s²]
        f = shaking * draw[3] - [0.0, 0.0, STANDARD_GRAVITY]
        self.yaw += rate * STEP_S
        begin_ns = self.k * STEP_NS
        self.k += 1
        return Increment(begin_ns, begin_ns + STEP_NS, [*f.tolist(), *w.tolist(), STEP_S], 0.0, self.k == 1)

    def course(self, turned: float) -> Course:
        """Course at the end of the last increment, turned by an attack [rad]."""
        p = exp(-1.0 / CORRELATION_S)
        self._error = p * self._error + VELOCITY_SD * sqrt(1.0 - p * p) * self._rng.standard_normal(2)
        speed = self._drive.speed_m_s
        angle = self.yaw + turned + float(self._error[1]) / speed
        return Course(self.k * STEP_NS, angle, (VELOCITY_SD / speed) ** 2, 0.0, 0.0)


def settings_of(grade: Grade) -> Settings:
    """Settings of a vehicle of that grade."""
    return Config.model_validate({"grade": grade})


def prepared(grade: Grade, drive: Drive, seed: int) -> tuple[Vehicle, ObserverMonitor]:
    """Stand, then drive until the courses begin to turn away."""
    settings = settings_of(grade)
    vehicle, monitor = Vehicle(settings, grade, drive, seed), ObserverMonitor(settings)
    monitor.advance(vehicle.step(0.0, stands=True) for _ in range(10 * (drive.stood_s + 2)))
    for second in range(drive.since_s):
        # A time at which neither wheels nor GNSS say that it drives: forces do.
        monitor.advance([vehicle.step(0.0, stands=False) for _ in range(10)])
        if second >= drive.since_s - max(WITHIN_S):
            monitor.courses([vehicle.course(0.0)])
            monitor.advance([])
    return vehicle, monitor


def found_s(vehicle: Vehicle, monitor: ObserverMonitor, drive: Drive, rate: float, within_s: int) -> int | None:
    """Seconds until a test accuses, None if none does within a time."""
    vehicle, monitor = deepcopy((vehicle, monitor))
    for second in range(1, within_s + 1):
        bend = radians(drive.turn_deg) / 10.0 if 20 <= second < 30 else 0.0
        monitor.advance([vehicle.step(bend, stands=False) for _ in range(10)])
        monitor.courses([vehicle.course(rate * second)])
        monitor.advance([])
        tests = monitor.verdicts(vehicle.k * STEP_NS, lambda *_: None)
        if any(test.outcome is Outcome.ACCUSES for test in tests.values()):
            return second
    return None


def smallest(grade: Grade, drive: Drive, seed: int, within_s: int) -> float:
    """Smallest turn rate [deg/s] that one run finds within a time, by bisection."""
    vehicle, monitor = prepared(grade, drive, seed)
    low, high = 0.0, LARGEST_DEG_S
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high) if low else 0.2 * high
        if found_s(vehicle, monitor, drive, radians(middle), within_s) is None:
            low = middle
        else:
            high = middle
    return high


def jobs_of(runs: int, within: Sequence[int]) -> Iterator[campaign.Job[float]]:
    """One job a run."""
    for seed in range(runs):
        for name, drive in DRIVES.items():
            for grade in Grade:
                for within_s in within:
                    yield campaign.Job(f"{name}|{grade}|{within_s}", smallest, (grade, drive, seed, within_s))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the campaign, and print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.turns", description=__doc__)
    options = campaign.options_of(parser, arguments, CAMPAIGN)
    within = WITHIN_S[:1] if options.short or options.smoke else WITHIN_S
    jobs = list(jobs_of(options.runs, within))
    outcome = campaign.run("turns", jobs, workers=options.workers, fresh=options.fresh, smoke=options.smoke)
    cells: dict[str, list[float]] = {}
    for number, rate in outcome.numbered:
        cells.setdefault(jobs[number].name, []).append(rate)
    rates = {name: float(np.quantile(cell, FOUND)) for name, cell in cells.items()}
    Console().print(printed(table(rates, within)))
    print(CAMPAIGN.note(options.runs))
    if campaign.worth_storing(options, outcome):
        RESULTS.write_text(json.dumps({"runs": options.runs, "deg_s": rates}, indent=2) + "\n", encoding="utf-8")
    return 0 if outcome.complete else 1


def table(rates: Mapping[str, float], within: Sequence[int]) -> Table:
    """Rates by grade, drive and time."""
    rows = [
        (name, f"{within_s} s", *(_said(rates.get(f"{name}|{grade}|{within_s}")) for grade in Grade))
        for name in DRIVES
        for within_s in within
    ]
    return Table(
        "Smallest turn rate that nine of ten runs find [deg/s]",
        ("drive", "within", *(grade.value for grade in Grade)),
        rows,
    )


def _said(rate: float | None) -> str:
    return "-" if rate is None else f"{rate:.3f}"


if __name__ == "__main__":
    sys.exit(main())

"""False alarms of the monitors on fault-free drives: `python -m benchmarks.false_alarms --monitor motion`.

Windows overlap, so that one error exceeds a threshold in several successive evaluations: these are one episode.
The design rate is that of an evaluation. It holds if it is not below the binomial interval of episodes over
evaluations; a monitor with the interval below it is more cautious than designed.
"""

import argparse
import json
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from rich.console import Console

from cli import campaign
from cli.attack_lab.score import CONFIDENCE, binomial_interval
from cli.papers.report import Table, printed
from services.core.fusion.process import Config as FusionConfig
from services.core.fusion.process import Process as Fusion
from services.core.motion_conflict.monitor import MotionMonitor
from services.core.motion_conflict.settings import Settings as MotionSettings
from services.core.spoofing.grade import Grade
from services.core.spoofing.process import Config as SpoofingConfig
from services.core.spoofing.process import In as SpoofingIn
from services.core.spoofing.process import Process as Spoofing
from services.sensors.simulator.drive import simulate
from shared.messages.base import Tick
from shared.messages.navigation import FilterState, NavigationSolution
from shared.messages.trust import Outcome, TrustMonitor
from tests.support.drives.motion import World, drives_and_stops
from tests.support.drives.spoofing import inputs

CAMPAIGN = campaign.Size(short=1000, usual=30_000, full=100_000, unit="fault-free epochs")
DESIGN_RATES = (1e-3, None)  # None: as delivered
MOTION_S, INERTIAL_S = 5000, 900  # of a drive
SCENARIOS = ("urban", "highway", "parking_lot", "tunnel")


@dataclass(frozen=True)
class Count:
    """Episodes of a test in a number of evaluations; `design` is per evaluation, None where a rule fixes the limit."""

    test: str
    design: float | None
    evaluations: int
    episodes: int
    accusing: int  # evaluations that accuse: an episode has one or more

    @property
    def interval(self) -> tuple[float, float]:
        """Binomial interval of the rate (Clopper and Pearson)."""
        return binomial_interval(self.episodes, self.evaluations)

    @property
    def verdict(self) -> str:
        """Whether the design rate is inside the interval."""
        low, high = self.interval
        if self.design is None:
            return "-" if self.episodes else "none"
        return "too many" if low > self.design else "cautious" if high < self.design else "inside"


Key = tuple[str, float | None]  # test, design rate
Result = tuple[str, float | None, bool | None]  # test, design rate, accuses (None: not evaluated)
Drive = Callable[[int, int], list[Count]]  # of a seed and seconds, at all design rates


def counted(epochs: Iterator[Sequence[Result]]) -> list[Count]:
    """Count evaluations and uninterrupted accusations of each test and design rate."""
    evaluations: Counter[Key] = Counter()
    episodes: Counter[Key] = Counter()
    accusing: Counter[Key] = Counter()
    before: dict[Key, bool] = {}
    for outcomes in epochs:
        for test, rate, accuses in outcomes:
            key = test, rate
            evaluations[key] += accuses is not None
            episodes[key] += accuses is True and not before.get(key, False)
            accusing[key] += accuses is True
            before[key] = accuses is True
    return [Count(*key, evaluations[key], episodes[key], accusing[key]) for key in evaluations if evaluations[key]]


def motion(seed: int, seconds: int) -> list[Count]:
    """All tests of core.motion_conflict on a random drive whose odometer has a scale and a delay."""
    found = {(count.test, count.design): count for rate in DESIGN_RATES for count in motion_at(seed, seconds, rate)}
    return list(found.values())  # tests whose rate is no setting count once


def motion_at(seed: int, seconds: int, rate: float | None) -> list[Count]:
    """The same tests at one design rate; None: as delivered."""
    rng = np.random.default_rng((seed, 7))
    settings = MotionSettings()
    if rate is not None:
        settings = MotionSettings(fast_false_alarm_rate=rate, scale_false_alarm_rate=rate)
    world = World(
        drives_and_stops(seed, float(seconds)), MotionMonitor(settings), seed,
        scale=rng.uniform(0.95, 1.05), delay_s=rng.uniform(0.0, 1.5),
    )  # fmt: skip

    def epochs() -> Iterator[list[Result]]:
        for verdicts in world.run(float(seconds)):
            yield [
                (name, test.false_alarm_rate, test.accuses if test.evaluated else None)
                for name, test in verdicts.named().items()
            ]

    return counted(epochs())


def inertial(seed: int, seconds: int) -> list[Count]:
    """All tests of core.spoofing on a simulated drive of the unit, with the solutions of core.fusion.

    The 5 s window has a learned profile, whose rate is not a setting: the design rates are those of the long windows.
    """
    drive = simulate(SCENARIOS[seed % len(SCENARIOS)], seed, float(seconds))
    values = {"vehicle.gnss.lever_arm_body_m": tuple(drive.lever_arm_b)}
    fusion = Fusion(FusionConfig().with_values(values))
    monitors = [
        Spoofing(
            SpoofingConfig(grade=Grade.INDUSTRIAL).with_values(
                values if rate is None else values | {"long.false_alarm_rate": rate}
            )
        )
        for rate in DESIGN_RATES
    ]

    def epochs() -> Iterator[list[Result]]:
        for message in inputs(drive):
            received: list[SpoofingIn] = [message]
            if not isinstance(message, Tick):
                solved = fusion.handle(message)
                received = [*(item for item in solved if isinstance(item, NavigationSolution | FilterState)), message]
            tests = [
                test
                for monitor in monitors
                for item in received
                for statement in monitor.handle(item)
                if isinstance(statement, TrustMonitor)
                for test in statement.tests
            ]
            found = {(test.name, test.false_alarm_rate): test.outcome for test in tests}
            yield [
                (*key, None if outcome is Outcome.NOT_EVALUATED else outcome is Outcome.ACCUSES)
                for key, outcome in found.items()
            ]

    return counted(epochs())


MONITORS: dict[str, tuple[Drive, int]] = {"motion": (motion, MOTION_S), "inertial": (inertial, INERTIAL_S)}


def jobs_of(monitor: str, epochs: int) -> list[campaign.Job[list[Count]]]:
    """List enough drives."""
    work, drive_s = MONITORS[monitor]
    drives = max(1, round(epochs / drive_s))
    seconds = min(drive_s, epochs)
    return [campaign.Job(f"{monitor}, drive {seed}", work, (seed, seconds)) for seed in range(1, drives + 1)]


def summed(drives: Iterable[Sequence[Count]]) -> list[Count]:
    """Put the counts of several drives together."""
    total: dict[Key, Count] = {}
    for item in (count for counts in drives for count in counts):
        known = total.get((item.test, item.design), Count(item.test, item.design, 0, 0, 0))
        total[item.test, item.design] = Count(
            item.test,
            item.design,
            known.evaluations + item.evaluations,
            known.episodes + item.episodes,
            known.accusing + item.accusing,
        )
    return list(total.values())


def table(monitor: str, counts: Sequence[Count]) -> Table:
    """Observed rates with their intervals."""
    rows = [
        (
            count.test,
            "-" if count.design is None else f"{count.design:.0e}",
            *map(str, (count.evaluations, count.accusing, count.episodes)),
            f"{count.interval[0]:.1e} to {count.interval[1]:.1e}",
            count.verdict,
        )
        for count in counts
    ]
    interval = f"{100 * CONFIDENCE:.0f} % interval"
    columns = ("test", "design", "evaluations", "accusing", "episodes", interval, "design rate")
    return Table(f"False alarms of {monitor} on fault-free simulated drives", columns, rows)


def document(epochs: int, found: Mapping[str, Sequence[Count]]) -> dict[str, object]:
    """All counts, for programs."""
    return {
        "made": datetime.now(UTC).date().isoformat(),
        "epochs": epochs,
        "monitors": {
            monitor: [{**asdict(count), "interval": count.interval, "verdict": count.verdict} for count in counts]
            for monitor, counts in found.items()
        },
    }


def main() -> int:
    """Run the campaign; return 1 if a test has more false alarms than designed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.false_alarms", description=__doc__)
    parser.add_argument("--monitor", choices=(*MONITORS, "all"), default="all")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write JSON to this file")
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")
    options = campaign.options_of(parser, None, CAMPAIGN)
    chosen = list(MONITORS) if options.monitor == "all" else [options.monitor]
    outcomes = {
        monitor: campaign.run(
            f"alarms-{monitor}",
            jobs_of(monitor, options.runs),
            workers=options.workers,
            fresh=options.fresh,
            smoke=options.smoke,
        )
        for monitor in chosen
    }
    found = {monitor: summed(outcome.results) for monitor, outcome in outcomes.items()}
    text = json.dumps(document(options.runs, found), indent=2)
    if options.json:
        print(text)
    else:
        console = Console()
        for monitor, counts in found.items():
            console.print(printed(table(monitor, counts)))
        console.print(CAMPAIGN.note(options.runs))
    if campaign.worth_storing(options, *outcomes.values()) and options.out:
        options.out.write_text(text + "\n", encoding="utf-8")
    complete = all(outcome.complete for outcome in outcomes.values())
    return 1 if not complete or any(count.verdict == "too many" for counts in found.values() for count in counts) else 0


if __name__ == "__main__":
    sys.exit(main())

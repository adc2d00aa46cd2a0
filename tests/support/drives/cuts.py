"""Simulated drives on which the unit, or some of its processes, end and begin again."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise, takewhile
from pathlib import Path

import numpy as np

from cli.attack_lab.timeline import Collector, Timeline
from services.sensors.simulator.process import Config as Simulator
from services.sensors.simulator.scenarios import scenario_of
from services.sensors.simulator.world import DEFAULT_START_NS, Equipment, World
from shared.attacks import schedule
from shared.messages.base import Message
from shared.messages.navigation import TruthState
from shared.messages.trust import TrustLevel, TrustState
from shared.runtime.config import VehicleFile, load_vehicle
from shared.runtime.offline import OfflineUnit
from shared.topics import BY_MESSAGE

NS = 1_000_000_000
SIMULATED = Path(__file__).parents[3] / "deploy" / "vehicles" / "simulated.toml"


@dataclass(frozen=True)
class Cut:
    """From and until when processes do not run [s since the start of the drive]; without names the whole unit."""

    begin_s: float
    end_s: float
    processes: tuple[str, ...] = ()
    in_order: bool = False  # as SIGTERM ends them


class CutUnit:
    """A unit with a cut; what it has saved of persistent topics outlives it."""

    def __init__(self, vehicle: VehicleFile, cut: Cut | None) -> None:
        self._vehicle, self._cut = vehicle, cut
        self._unit: OfflineUnit | None = OfflineUnit(vehicle)
        self._saved: dict[type[Message], Message] = {}
        self._ended = False

    def run(self, due_ns: int, message: Message) -> Iterator[Message]:
        """Use one message; yield what is published."""
        cut = self._cut
        time_s = (due_ns - DEFAULT_START_NS) / NS
        if cut is not None and not self._ended and time_s >= cut.begin_s:
            self._ended = True
            yield from self._end(cut)
        if cut is not None and self._ended and time_s >= cut.end_s:
            self._cut = None
            yield from self._keeping(self._begin(cut))
        if self._unit is None:
            if isinstance(message, TruthState):
                yield message
            return
        yield from self._keeping(self._unit.run([message]))

    def _end(self, cut: Cut) -> Iterator[Message]:
        assert self._unit is not None
        if cut.in_order:
            yield from self._keeping(self._unit.close())
        if cut.processes:
            self._unit.end(cut.processes)
        else:
            self._unit = None

    def _begin(self, cut: Cut) -> Iterator[Message]:
        if self._unit is not None:
            yield from self._unit.begin(cut.processes)
            return
        self._unit = OfflineUnit(self._vehicle, stopped=False)
        yield from self._unit.run(list(self._saved.values()))

    def _keeping(self, messages: Iterable[Message]) -> Iterator[Message]:
        for message in messages:
            if BY_MESSAGE[type(message)].persist:
                self._saved[type(message)] = message
            yield message


@dataclass(frozen=True)
class CutDrive:
    """What was published on a drive."""

    timeline: Timeline
    states: list[TrustState]

    def seconds(self, level: TrustLevel, begin_s: float, end_s: float) -> float:
        """Time within [begin_s, end_s] with a verdict [s]; that before a cut does not last through it."""
        times = [(state.sampled_ns - DEFAULT_START_NS) / NS for state in self.states]
        spans = [min(b - a, 1.0) if begin_s <= a < end_s else 0.0 for a, b in pairwise(times)]
        return sum(s for s, state in zip(spans, self.states, strict=False) if state.state is level)

    def above_level_s(self, levels: Sequence[TrustLevel], begin_s: float, end_s: float) -> float:
        """Time with one of these verdicts and a horizontal error above the level [s]."""
        line = self.timeline
        known = np.isin(line.verdict_at(line.error_s), np.array(levels, dtype=object))
        inside = (line.error_s >= begin_s) & (line.error_s < end_s)
        return 0.1 * float((known & inside & (line.error_m[:, 0] > line.level_m[:, 0])).sum())


def cut_drive(
    scenario: str, seed: int, duration_s: float, attack: str | None, cut: Cut | None
) -> CutDrive:  # fmt: skip
    """Drive a simulated vehicle whose unit is cut; `attack` in the notation of `shared.attacks`."""
    vehicle = load_vehicle(SIMULATED)
    settings = vehicle.section("sensors.simulator", Simulator)
    equipment = Equipment(settings.protocols, settings.mounting_rpy_deg, settings.second_antenna_m, 0)
    attacks = [schedule(attack)] if attack else []
    world = World(scenario_of(scenario, seed), seed, DEFAULT_START_NS, equipment, attacks)
    end_ns = DEFAULT_START_NS + round(duration_s * NS)
    unit, collector = CutUnit(vehicle, cut), Collector()
    for due_ns, message in takewhile(lambda pair: pair[0] <= end_ns, world):
        for out in unit.run(due_ns, message):
            collector.add(out)
    lever_arm = vehicle.facts.gnss.lever_arm_body_m
    line = collector.timeline((DEFAULT_START_NS, end_ns), lever_arm, None)
    return CutDrive(line, collector.states)

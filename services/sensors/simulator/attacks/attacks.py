"""The attacks of one drive: when each is active, and what all make of signals, odometer and inertial sensors."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np
import numpy.typing as npt

from shared.attacks import BY_NAME, ScheduledAttack
from shared.maths.earth import Geodetic, ned_from_geodetic_difference
from shared.messages.simulation import (
    AttackCommand,
    AttackName,
    AttackRun,
    SimulationAttack,
    SimulationState,
)

from ..scenarios import Scenario
from ..v2x.radio import Deception
from ..vehicle import AntennaState, Readings, Vehicle, antenna_at
from .effects import ON_INERTIAL, ON_NEIGHBOURS, ON_ODOMETER, ON_SIGNALS, Start, Track
from .signals import Odometer, Signals

NS = 1_000_000_000
MAX_RUNS = 32  # runs in a `SimulationState`
MAX_ACTIVE = 16
REPLAY_STEP_S = 0.02
REPLAY_BLOCK = 50  # [steps] simulated at once


@dataclass
class _Run:
    key: int
    attack: AttackName
    parameters: dict[str, float]
    started_ns: int
    ended_ns: int | None
    start: Start | None = None  # once it is applied to signals for the first time
    first_ns: int = 0

    def active(self, at_ns: int) -> bool:
        return self.started_ns <= at_ns and (self.ended_ns is None or at_ns < self.ended_ns)


class OtherDrive:
    """The antenna of another drive of the same scenario, as a function of the time after a part that is left out."""

    def __init__(self, scenario: Scenario, seed: int, skip_s: float) -> None:
        self._vehicle, self._skip_s = Vehicle(scenario, seed, REPLAY_STEP_S), skip_s
        self._motion = self._vehicle.advance(REPLAY_BLOCK).motion
        self._begin: Geodetic = self._antenna(0.0).position

    def at(self, t: float) -> Track:
        """Offset from the beginning, and velocity; times must not decrease from call to call."""
        antenna = self._antenna(t)
        return Track(ned_from_geodetic_difference(antenna.position, self._begin), antenna.velocity_n)

    def _antenna(self, t: float) -> AntennaState:
        node = (self._skip_s + t) / REPLAY_STEP_S
        while node > self._motion.first + REPLAY_BLOCK:
            self._motion = self._vehicle.advance(REPLAY_BLOCK).motion
        return antenna_at(self._motion, node)


class Attacks:
    """Keeps the attacks of a drive, scheduled and commanded; every time is on the time line of the simulation."""

    def __init__(self, scenario: Scenario, seed: int, start_ns: int, scheduled: Sequence[ScheduledAttack] = ()) -> None:
        self._scenario, self._seed = scenario, seed
        self._keys = count()
        self._runs: list[_Run] = []
        self._request_id: str | None = None
        self._refused: str | None = None
        for scheduled_attack in sorted(scheduled, key=lambda row: row.start_s):
            parameters = BY_NAME[scheduled_attack.attack].complete(scheduled_attack.parameters)
            self._begin(
                scheduled_attack.attack,
                parameters,
                start_ns + round(scheduled_attack.start_s * NS),
                scheduled_attack.duration_s,
            )

    def changes_ns(self) -> list[int]:
        """Times at which an attack begins or ends, as far as they are known."""
        return [ns for run in self._runs for ns in (run.started_ns, run.ended_ns) if ns is not None]

    def command(self, message: SimulationAttack, at_ns: int) -> None:
        """Execute a command at a time, or note why it is refused."""
        self._request_id, self._refused = message.request_id, None
        try:
            if message.command is AttackCommand.STOP:
                self._stop(message.attack, at_ns)
            elif message.attack is None:
                raise ValueError("name the attack that shall start")
            else:
                self._start(message.attack, message, at_ns)
        except ValueError as error:
            self._refused = str(error)[:400]

    def state(self, at_ns: int) -> SimulationState:
        """The attacks that have begun up to a time, and the answer to the last command."""
        begun = [run for run in self._runs if run.started_ns <= at_ns]
        return SimulationState(
            sampled_ns=at_ns,
            request_id=self._request_id,
            refused=self._refused,
            attacks=tuple(
                AttackRun(
                    attack=run.attack,
                    parameters=run.parameters,
                    started_ns=run.started_ns,
                    ended_ns=run.ended_ns if run.ended_ns is not None and run.ended_ns <= at_ns else None,
                )
                for run in begun[-MAX_RUNS:]
            ),
        )

    def signals(self, antenna: AntennaState, at_ns: int) -> Signals:
        """Signals at the antenna at an epoch; epochs must not decrease."""
        signals = Signals(antenna)
        for run in self._runs:
            if run.active(at_ns) and run.attack in ON_SIGNALS:
                if run.start is None:
                    run.start, run.first_ns = self._start_of(run, signals.source), at_ns
                signals = ON_SIGNALS[run.attack](signals, run.start, (at_ns - run.first_ns) / NS)
        return signals

    def odometer(self, at_ns: int) -> Odometer:
        """State of the odometer at a time."""
        odometer = Odometer()
        for run in self._runs:
            if run.active(at_ns) and run.attack in ON_ODOMETER:
                odometer = ON_ODOMETER[run.attack](odometer, run.parameters, (at_ns - run.started_ns) / NS)
        return odometer

    def inertial(self, readings: Readings, sampled_ns: npt.NDArray[np.int64]) -> Readings:
        """Make of a block of readings, at times of shape (n,), what the inertial sensors report."""
        for run in self._runs:
            if run.attack in ON_INERTIAL:
                active = sampled_ns >= run.started_ns
                if run.ended_ns is not None:
                    active &= sampled_ns < run.ended_ns
                if active.any():
                    readings = ON_INERTIAL[run.attack](readings, run.parameters, active)
        return readings

    def deception(self, at_ns: int) -> Deception | None:
        """What lying neighbours add to their states at a time; the attack that began last counts."""
        active = [run for run in self._runs if run.active(at_ns) and run.attack in ON_NEIGHBOURS]
        if not active:
            return None
        parameters = active[-1].parameters
        return Deception(round(parameters.get("neighbours", 1.0)), parameters["ahead"], parameters["speed"])

    def _start_of(self, run: _Run, antenna: AntennaState) -> Start:
        other = None
        if run.attack is AttackName.REPLAY_DRIVE:
            other = OtherDrive(self._scenario, self._seed + 1 + run.key, run.parameters["skip"]).at
        return Start(antenna, run.parameters, run.key, other)

    def _start(self, attack: AttackName, message: SimulationAttack, at_ns: int) -> None:
        parameters = BY_NAME[attack].complete(message.parameters)
        running = [run for run in self._runs if run.ended_ns is None or run.ended_ns > at_ns]
        if len([run for run in running if run.attack != attack]) >= MAX_ACTIVE:
            raise ValueError(f"{MAX_ACTIVE} attacks are active or scheduled; stop one first")
        for run in running:
            if run.attack == attack and run.started_ns <= at_ns:
                run.ended_ns = at_ns
        self._begin(attack, parameters, at_ns, message.duration_s)

    def _stop(self, attack: AttackName | None, at_ns: int) -> None:
        active = [run for run in self._runs if run.active(at_ns) and attack in (None, run.attack)]
        if attack is not None and not active:
            raise ValueError(f"{attack} is not active")
        for run in active:
            run.ended_ns = at_ns

    def _begin(self, attack: AttackName, parameters: dict[str, float], at_ns: int, duration_s: float | None) -> None:
        ended_ns = None if duration_s is None else at_ns + round(duration_s * NS)
        self._runs.append(_Run(next(self._keys), attack, parameters, at_ns, ended_ns))
        old = [run for run in self._runs if run.ended_ns is not None and run.ended_ns <= at_ns]
        for run in old[: max(0, len(self._runs) - 2 * MAX_RUNS)]:  # memory is bounded
            self._runs.remove(run)

"""The cases of the laboratory: which attack on which drive."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path

from services.sensors.simulator.scenarios import scenario_of
from shared.attacks import BY_NAME, ScheduledAttack, schedule
from shared.errors import UserError

from .recorded import POSSIBLE

CLEAN = "clean"
# Each attack with its default parameters, and the variants of the reference numbers.
ATTACKS = (
    "tunnel", "jam", "freeze", "static_replay", "straight_replay", "replay_drive", "delay", "position_jump",
    "drag_off", "drag_off(direction=90)", "drag_off(acceleration=0.1,speed=1)",
    "drag_off(acceleration=0.1,speed=1,direction=90)", "climb", "time_push",
    "satellite_step", "satellite_step(satellites=2)", "satellite_ramp", "satellite_ramp(satellites=2)",
    "odometer_scale", "odometer_freeze", "tyre_change", "neighbour_lie", "neighbour_collusion",
)  # fmt: skip
START_S, ATTACK_S, AFTER_S = 120.0, 90.0, 90.0


@dataclass(frozen=True)
class Case:
    """One run: a drive, and an attack on it or none."""

    drive: str  # name of a scenario, or path of a recording
    seed: int
    duration_s: float  # 0 of a recording, which runs to its end
    attack: ScheduledAttack | None = None
    recorded: bool = False

    @property
    def label(self) -> str:
        """Attack with the parameters that differ from their defaults."""
        if self.attack is None:
            return CLEAN
        defaults = BY_NAME[self.attack.attack].defaults
        changed = (f"{name}={value:g}" for name, value in self.attack.parameters.items() if value != defaults[name])
        text = ", ".join(changed)
        return f"{self.attack.attack}({text})" if text else str(self.attack.attack)

    @property
    def interval_s(self) -> tuple[float, float]:
        """Start and end of the attack in seconds since the start of the drive; empty at its end without one."""
        if self.attack is None:
            return self.duration_s, self.duration_s
        longest_s = self.duration_s or inf
        end_s = longest_s if self.attack.duration_s is None else self.attack.start_s + self.attack.duration_s
        return self.attack.start_s, min(end_s, longest_s)


def plan(
    attacks: Sequence[str], scenarios: Sequence[str], seeds: int, recordings: Sequence[Path], clean_s: float
) -> Iterator[Case]:
    """List all cases: every attack on every scenario, seed and recording, and a clean run of each.

    Parameters
    ----------
    attacks : sequence of str
        In the notation of `shared.attacks`; without `@` the attack begins at 120 s and lasts 90 s.
    scenarios : sequence of str
        Names of simulated drives.
    seeds : int
        Number of seeds of each scenario, from 1 on.
    recordings : sequence of Path
        Recordings of `obu record` or `obu import`.
    clean_s : float
        [s] Duration of a clean simulated drive.

    Raises
    ------
    UserError
        An attack or a scenario is unknown.
    """
    scheduled = [_scheduled(text) for text in attacks]
    for name in scenarios:
        try:
            scenario_of(name, 1)
        except ValueError as error:
            raise UserError(str(error)) from error
    for seed in range(1, seeds + 1):
        for name in scenarios:
            yield Case(name, seed, clean_s)
            for attack in scheduled:
                yield Case(name, seed, attack.start_s + (attack.duration_s or ATTACK_S) + AFTER_S, attack)
    for path in recordings:
        yield Case(str(path), 0, 0.0, recorded=True)
        for attack in scheduled:
            if attack.attack in POSSIBLE:
                yield Case(str(path), 0, 0.0, attack, recorded=True)


def _scheduled(text: str) -> ScheduledAttack:
    try:
        attack = schedule(text if "@" in text else f"{text}@{START_S:g}:{ATTACK_S:g}")
    except ValueError as error:
        raise UserError(f"{error}; example: obu attack-lab --attack 'drag_off(acceleration=0.1)@120:90'") from error
    return attack if attack.duration_s is not None else replace(attack, duration_s=ATTACK_S)

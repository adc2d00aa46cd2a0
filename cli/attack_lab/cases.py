"""The cases of the laboratory: which attack on which drive."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path

from services.sensors.simulator.scenarios import scenario_of
from shared.attacks import BY_NAME, ScheduledAttack, schedule
from shared.errors import UserError
from shared.messages.simulation import AttackName

from .recorded import POSSIBLE

CLEAN = "clean"
START_S, ATTACK_S, AFTER_S = 100.0, 90.0, 170.0  # the monitors need 100 s until all of them are evaluated
COLD_S = 120.0  # of a cold start, which begins with the drive
# Each attack with its default parameters, and variants of it. Those that need another time than 90 s state it.
ATTACKS = (
    "tunnel", "jam", "freeze", "static_replay", "straight_replay", "replay_drive", "delay", "position_jump",
    "drag_off", "drag_off(direction=90)", "drag_off(acceleration=0.1,speed=1)",
    "drag_off(acceleration=0.1,speed=1,direction=90)", "drag_off(acceleration=0.03,speed=1)@100:100",
    "drag_off(acceleration=0.03,speed=1,direction=90)@100:100",
    "drag_off(acceleration=0.01,speed=0.3)@100:110", "drag_off(acceleration=0.01,speed=0.3,direction=90)@100:110",
    "drag_off(acceleration=0.005,speed=0.2)@100:120", "drag_off(acceleration=0.005,speed=0.2,direction=90)@100:120",
    "drag_off(acceleration=0.005,speed=0.5,direction=90)@100:120",
    "climb", "climb(acceleration=0.02,speed=0.2)@100:120", "climb(acceleration=0.03,speed=0.5)@100:120", "time_push",
    "stopwatch@100:100", "stopwatch(share=0.05)@100:100", "stopwatch(share=0.01)@100:120",
    "coherent_scale(rise=0)@100:100", "coherent_scale(rise=45)@100:100", "coherent_scale(factor=1.03,rise=45)@100:100",
    "cold_start", "tunnel_return@100:120", "tunnel_return(gap=8)@100:120", "tunnel_return(gap=30,distance=60)@100:120",
    "ratchet@100:120", "ratchet(distance=6,period=25)@100:120", "ratchet(distance=3,period=15,gap=4)@100:120",
    "staircase@100:100", "intermittent@100:100", "intermittent(distance=30)@100:100", "drag_hold@100:100",
    "clock_drift", "clock_drift(rate=1)", "utc_drift@100:100",
    "accuracy_lie@100:60", "accuracy_lie(accuracy=100)@100:60",
    "masked_drag(speed=1.5,direction=90)",
    "masked_drag(acceleration=0.02,speed=0.4,direction=90,deviation=1.1)@100:110",
    "masked_drag(acceleration=0.02,speed=0.4,deviation=1.1)@100:110",
    "few_satellites(acceleration=0.1,speed=1,direction=90)",
    "satellite_step", "satellite_step(satellites=2)", "satellite_ramp", "satellite_ramp(satellites=2)",
    "subset", "subset(distance=60,speed=0)",
    "odometer_scale", "odometer_freeze", "wheel_zero", "tyre_change",
    "gyroscope_bias@100:60", "gyroscope_bias(bias=0.1)", "accelerometer_bias@100:60",
    "neighbour_lie", "neighbour_collusion",
)  # fmt: skip


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
    attacks: Sequence[str], scenarios: Sequence[str], seeds: int, recordings: Sequence[Path], clean_s: float,
    after_s: float = AFTER_S,
) -> Iterator[Case]:  # fmt: skip
    """List all cases: every attack on every scenario, seed and recording, and a clean run of each.

    Parameters
    ----------
    attacks : sequence of str
        In the notation of `shared.attacks`; without `@` the attack begins at 100 s and lasts 90 s, a cold start begins
        at 0 and lasts 120 s.
    scenarios : sequence of str
        Names of simulated drives.
    seeds : int
        Number of seeds of each scenario, from 1 on.
    recordings : sequence of Path
        Recordings of `obu record` or `obu import`.
    clean_s : float
        [s] Duration of a clean simulated drive.
    after_s : float
        [s] How long a simulated drive goes on after its attack.

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
                yield Case(name, seed, attack.start_s + (attack.duration_s or ATTACK_S) + after_s, attack)
    for path in recordings:
        yield Case(str(path), 0, 0.0, recorded=True)
        for attack in scheduled:
            if attack.attack in POSSIBLE:
                yield Case(str(path), 0, 0.0, attack, recorded=True)


def labels(texts: Sequence[str]) -> list[str]:
    """Labels of attacks in their notation."""
    return [Case("", 0, 0.0, _scheduled(text)).label for text in texts]


def _scheduled(text: str) -> ScheduledAttack:
    cold = text.partition("(")[0].strip() == AttackName.COLD_START
    begin_s, lasting_s = (0.0, COLD_S) if cold else (START_S, ATTACK_S)
    try:
        attack = schedule(text if "@" in text else f"{text}@{begin_s:g}:{lasting_s:g}")
    except ValueError as error:
        raise UserError(f"{error}; example: obu attack-lab --attack 'drag_off(acceleration=0.1)@100:90'") from error
    return attack if attack.duration_s is not None else replace(attack, duration_s=ATTACK_S)

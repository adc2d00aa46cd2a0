"""When attacks were noticed: the first sign of the verdict or of a monitor that was not there before the attack."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from shared.attacks import BY_NAME
from shared.messages.explanation import ReferenceKind
from shared.messages.simulation import AttackName, AttackRun
from shared.messages.trust import Outcome, TrustLevel, TrustState
from shared.trust.accused import reference

NS = 1_000_000_000
MAX_GAP_S = 2.0  # between two states; beyond it nothing is known about the verdict
ALARMS = (TrustLevel.UNSAFE, TrustLevel.DEAD_RECKONING)


@dataclass(frozen=True)
class AttackSummary:
    """One attack and when it was detected."""

    name: str
    started_s: float  # since the start of the drive
    detected_after_s: float | None
    detected_by: tuple[str, ...]  # all signs of that moment


def signs(state: TrustState, attack: AttackName) -> tuple[str, ...]:
    """What counts as a detection: an exclusion, an alarming verdict, a monitor that accuses.

    Neighbours that are accused are a sign of an attack by neighbours, and of no other.
    """
    excluded = (("gnss", state.gnss_excluded), ("odometer", state.odometer_excluded))
    by_neighbours = BY_NAME[attack].accused == "neighbour"
    found = [f"{name} excluded" for name, is_so in excluded if is_so]
    found += [f"verdict {state.state}"] if state.state in ALARMS else []
    for monitor in state.monitors:
        accused = [
            name for name in monitor.accused if (reference(name).kind is ReferenceKind.NEIGHBOUR) == by_neighbours
        ]
        if monitor.outcome is Outcome.ACCUSES and accused:
            found.append(f"{monitor.monitor} suspects {', '.join(accused)}")
    return tuple(found)


def summarise(runs: Sequence[AttackRun], states: Sequence[TrustState], begin_ns: int) -> tuple[AttackSummary, ...]:
    """Find the detection of each attack.

    Parameters
    ----------
    runs : sequence of AttackRun
        The attacks.
    states : sequence of TrustState
        The verdicts of the drive, by time.
    begin_ns : int
        [ns] Start of the drive.

    Returns
    -------
    tuple of AttackSummary
        A sign that the last verdict before the attack had already does not count, until it has gone.
    """
    return tuple(_summary(run, states, begin_ns) for run in runs)


def _summary(run: AttackRun, states: Sequence[TrustState], begin_ns: int) -> AttackSummary:
    before = [state for state in states if state.sampled_ns < run.started_ns]
    known = set(signs(before[-1], run.attack)) if before else set()
    started_s = round((run.started_ns - begin_ns) / NS, 1)
    for state in states[len(before) :]:
        if run.ended_ns is not None and state.sampled_ns > run.ended_ns:
            break
        found = signs(state, run.attack)
        if new := tuple(sign for sign in found if sign not in known):
            return AttackSummary(run.attack, started_s, round((state.sampled_ns - run.started_ns) / NS, 1), new)
        known &= set(found)
    return AttackSummary(run.attack, started_s, None, ())


def seconds_in_states(states: Sequence[TrustState]) -> dict[str, float]:
    """Time in each state [s]; every state lasts until the next one, but not longer than `MAX_GAP_S`."""
    seconds = dict.fromkeys(TrustLevel, 0.0)
    for state, after in pairwise(states):
        seconds[state.state] += min((after.sampled_ns - state.sampled_ns) / NS, MAX_GAP_S)
    return {level.value: round(value, 1) for level, value in seconds.items()}

"""Which detector pulse belongs to which passage."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import log

MINIMUM_PROBABILITY = 1e-3  # of a lane that the posterior excludes: detectors contradict it rarely, not never


@dataclass(frozen=True)
class Pulse:
    """A detector pulse: its key in the ledger, its lane, its time."""

    key: int
    lane: str
    time_ns: int


@dataclass(frozen=True)
class Crossing:
    """A passage at the gate line: key, time and its standard deviation, lane (None: undecided) and posterior."""

    key: int
    time_ns: int
    sd_s: float
    lane: str | None
    lanes: Mapping[str, float]


def match(
    pulses: Sequence[Pulse], crossings: Sequence[Crossing], *, detector_sd_s: float, gate_s: float
) -> dict[int, int]:
    """Assign pulses to crossings, at most one to one.

    Parameters
    ----------
    pulses, crossings : sequence
        In any order.
    detector_sd_s : float
        [s] Standard deviation of a pulse's time.
    gate_s : float
        [s] Pulses further than this from a crossing are not its own.

    Returns
    -------
    dict
        Key of the crossing by key of the pulse.

    Notes
    -----
    Pairs are taken in the order of their cost, minus twice the log-likelihood of lane and time::

        c = -2 ln p(lane) + (Δt)² / (σ_crossing² + σ_detector²)

    A decided lane takes pulses of that lane only: a charge must not explain another lane's detection.
    """
    pairs = sorted(
        (_cost(pulse, crossing, detector_sd_s), pulse.key, crossing.key)
        for pulse in pulses
        for crossing in crossings
        if abs(pulse.time_ns - crossing.time_ns) <= gate_s * 1e9 and crossing.lane in (None, pulse.lane)
    )
    found: dict[int, int] = {}
    taken: set[int] = set()
    for _, pulse_key, crossing_key in pairs:
        if pulse_key not in found and crossing_key not in taken:
            found[pulse_key] = crossing_key
            taken.add(crossing_key)
    return found


def _cost(pulse: Pulse, crossing: Crossing, detector_sd_s: float) -> float:
    away_s = (pulse.time_ns - crossing.time_ns) * 1e-9
    probability = max(crossing.lanes.get(pulse.lane, 0.0), MINIMUM_PROBABILITY)
    return away_s**2 / (crossing.sd_s**2 + detector_sd_s**2) - 2.0 * log(probability)

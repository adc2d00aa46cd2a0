"""Which detector pulse belongs to which passage."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

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
        [s] Pulses further than this from a crossing, and than three of its standard deviations, are not its own.

    Returns
    -------
    dict
        Key of the crossing by key of the pulse.

    Notes
    -----
    Of the assignments with the largest number of pairs, the one with the least sum of costs. The cost of a pair is
    minus twice the log-likelihood of lane and time::

        c = -2 ln p(lane) + (Δt)² / (σ_crossing² + σ_detector²)

    A decided lane takes pulses of that lane only: a charge must not explain another lane's detection. Pairs that are
    taken one by one in the order of their costs leave crossings without the pulse that another one has taken.
    """
    if not pulses or not crossings:
        return {}
    pulses, crossings = sorted(pulses, key=lambda p: p.key), sorted(crossings, key=lambda c: c.key)
    lanes = sorted({pulse.lane for pulse in pulses})
    decided = np.array([[crossing.lane in (None, lane) for lane in lanes] for crossing in crossings])
    probability = np.array([[crossing.lanes.get(lane, 0.0) for lane in lanes] for crossing in crossings])
    lane = [lanes.index(pulse.lane) for pulse in pulses]
    time_ns, crossing_ns = np.array([p.time_ns for p in pulses]), np.array([c.time_ns for c in crossings])
    sd_s = np.array([crossing.sd_s for crossing in crossings])

    away_s = 1e-9 * np.abs(time_ns[:, None] - crossing_ns)
    likelihood = np.maximum(probability, MINIMUM_PROBABILITY)[:, lane].T
    cost = away_s**2 / (sd_s**2 + detector_sd_s**2) - 2.0 * np.log(likelihood)
    possible = (away_s <= np.maximum(gate_s, 3.0 * sd_s)) & decided[:, lane].T
    pair_is_worth = 1.0 + len(pulses) * cost.max(where=possible, initial=0.0)  # more than any sum of costs
    chosen = linear_sum_assignment(np.where(possible, cost - pair_is_worth, 0.0))
    return {pulses[i].key: crossings[k].key for i, k in zip(*chosen, strict=True) if possible[i, k]}

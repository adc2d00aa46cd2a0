"""Which detector pulse belongs to which passage."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import exp, log, pi, sqrt

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment

MINIMUM_PROBABILITY = 1e-3  # of a lane that the posterior excludes: detectors contradict it rarely, not never
OUTLIERS = 0.01  # share of pulses whose time errs by more than is stated, uniformly within the gate
ONE_VEHICLE_NS = 600_000_000  # pulses of a lane less apart are one vehicle's: a double axle
NEAR = 16  # pulses and crossings around one crossing that are judged together

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Pulse:
    """A detector pulse: its key in the ledger, its lane, its time."""

    key: int
    lane: str
    time_ns: int


@dataclass(frozen=True)
class Mode:
    """Time and lane of a crossing if the vehicle's receiver errs in one of the ways that are possible."""

    offset_s: float  # after the crossing's time
    sd_s: float
    lanes: Mapping[str, float]  # and that it errs so


@dataclass(frozen=True)
class Crossing:
    """A passage at the gate line: key, time and its standard deviation, lane (None: undecided) and posterior."""

    key: int
    time_ns: int
    sd_s: float
    lane: str | None
    lanes: Mapping[str, float]
    modes: tuple[Mode, ...] = ()  # whose lanes add up to these; none: one mode

    def probability(self, lane: str) -> float:
        """Probability of a lane before any pulse is known; zero where another one is decided."""
        if self.lane not in (None, lane):
            return 0.0
        return max(self.lanes.get(lane, 0.0), MINIMUM_PROBABILITY)


@dataclass(frozen=True)
class PulseModel:
    """What pulses and crossings are without each other, and how far apart they may be."""

    detector_sd_s: float  # [s] standard deviation of a pulse's time
    gate_s: float  # [s] pulses further than this from a crossing, and than three standard deviations, are not its own
    missed: float = 0.01  # share of vehicles that a detector does not count
    others_per_s: float = 0.03  # [1/s] pulses of a lane that are of no crossing


@dataclass(frozen=True)
class Ownership:
    """The pulse with which a crossing was counted."""

    pulse: Pulse
    probability: float  # that it was counted, and by this pulse


def match(
    pulses: Sequence[Pulse], crossings: Sequence[Crossing], *, detector_sd_s: float, gate_s: float
) -> dict[int, int]:
    """Assign pulses to crossings, at most one to one: an account in which each pulse has one outcome.

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
    taken one by one in the order of their costs leave crossings without the pulse that another one has taken. Pulses
    and crossings that no chain of possible pairs connects are assigned apart from each other.
    """
    if not pulses or not crossings:
        return {}
    pulses, crossings = sorted(pulses, key=lambda p: p.key), sorted(crossings, key=lambda c: c.key)
    i, k, cost, group = _possible(pulses, crossings, detector_sd_s, gate_s)
    if not len(i):
        return {}
    order = np.argsort(group, kind="stable")
    found = {}
    for part in np.split(order, np.flatnonzero(np.diff(group[order])) + 1):
        for pair in part[_chosen(i[part], k[part], cost[part])]:
            found[pulses[i[pair]].key] = crossings[k[pair]].key
    return found


def _possible(
    pulses: Sequence[Pulse], crossings: Sequence[Crossing], detector_sd_s: float, gate_s: float
) -> tuple[IntArray, IntArray, FloatArray, IntArray]:
    """Pairs that may belong together: indices of pulse and crossing, the cost, and the group that pairs connect.

    The pulses of a lane that a crossing reaches follow each other: crossings of several lanes join such blocks.
    """
    of_lane: dict[str, list[int]] = defaultdict(list)
    for index, pulse in enumerate(pulses):
        of_lane[pulse.lane].append(index)
    times_ns = np.array([crossing.time_ns for crossing in crossings])
    sds = np.array([crossing.sd_s for crossing in crossings])
    reach_ns = np.maximum(gate_s, 3.0 * sds) * 1e9
    found = []
    parent: list[int] = []  # of each block
    block_of: dict[int, int] = {}  # of each crossing
    for lane, indices in of_lane.items():
        own_ns = np.array([pulses[index].time_ns for index in indices])
        order = np.argsort(own_ns, kind="stable")
        own_ns = own_ns[order]
        rows = np.flatnonzero([crossing.lane in (None, lane) for crossing in crossings])
        first = np.searchsorted(own_ns, times_ns[rows] - reach_ns[rows], side="left")
        counts = np.searchsorted(own_ns, times_ns[rows] + reach_ns[rows], side="right") - first
        reached = np.zeros(len(own_ns) + 1, dtype=np.int64)
        np.add.at(reached, first[counts > 1], 1)
        np.add.at(reached, (first + counts - 1)[counts > 1], -1)
        begins = np.cumsum(reached)[:-1] == 0  # whether no crossing reaches this pulse and the next
        block = len(parent) + np.concatenate([[0], np.cumsum(begins)[:-1]])
        parent += range(len(parent), int(block[-1]) + 1)
        for row, own in zip(rows[counts > 0].tolist(), block[first[counts > 0]].tolist(), strict=True):
            one, other = _root(parent, block_of.setdefault(row, own)), _root(parent, own)
            parent[max(one, other)] = min(one, other)
        k = np.repeat(rows, counts)
        at = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts) + np.repeat(first, counts)
        away_s = 1e-9 * (own_ns[at] - times_ns[k])
        likelihood = np.array([crossings[row].probability(lane) for row in rows.tolist()])
        cost = away_s**2 / (sds[k] ** 2 + detector_sd_s**2) - 2.0 * np.log(np.repeat(likelihood, counts))
        found.append((np.array(indices)[order[at]], k, cost, block[at]))
    i, k, costs, blocks = (np.concatenate(parts) for parts in zip(*found, strict=True))
    roots = np.array([_root(parent, block) for block in range(len(parent))])
    return i.astype(np.int64), k.astype(np.int64), costs, roots[blocks]


def _root(parent: list[int], block: int) -> int:
    """The first block of those that are joined with one; the way there is shortened."""
    while parent[block] != block:
        parent[block] = parent[parent[block]]
        block = parent[block]
    return block


def _chosen(i: IntArray, k: IntArray, cost: FloatArray) -> IntArray:
    """Choose among pairs of one group: positions of those that belong together."""
    if len(i) == 1:
        return np.zeros(1, dtype=np.int64)
    rows, row = np.unique(i, return_inverse=True)
    columns, column = np.unique(k, return_inverse=True)
    pair_is_worth = 1.0 + len(rows) * cost.max()  # more than any sum of costs
    table = np.zeros((len(rows), len(columns)))
    table[row, column] = cost - pair_is_worth
    place = np.full(table.shape, -1)
    place[row, column] = np.arange(len(i))
    found = place[linear_sum_assignment(table)]
    return found[found >= 0]


def near(crossing: Crossing, times_ns: Mapping[int, int]) -> list[int]:
    """Keys of what is nearest in time to a crossing, at most `NEAR`; in the order of the keys."""
    nearest = sorted(times_ns, key=lambda key: (abs(times_ns[key] - crossing.time_ns), key))
    return sorted(nearest[:NEAR])


def ownership(
    crossing: Crossing, pulses: Sequence[Pulse], rivals: Sequence[Crossing], model: PulseModel
) -> Ownership | None:
    """Find the pulse with which a crossing was counted, with all crossings around it.

    Parameters
    ----------
    crossing : Crossing
        The one that is judged.
    pulses : sequence of Pulse
        All around it.
    rivals : sequence of Crossing
        The others around it: a pulse that is better explained by one of them is not left for it.
    model : PulseModel
        What a pulse without a crossing, and a crossing without a pulse, cost.

    Returns
    -------
    Ownership or None
        Its pulse in the best assignment, and the probability of that; None if it has no pulse there.

    Notes
    -----
    Of pairs (i, j) with a time Δt between them, one is worth what its likelihood exceeds that of a pulse of something
    else and of a vehicle that was not counted::

        g_ij = ln [ (1 - m) p_j(lane_i) ((1 - ε) N(Δt; 0, σ_j² + σ_d²) + ε / 2T) / (m λ) ]

    Where the vehicle's receiver may err in several ways h, p N is Σ_h p_j(h, lane_i) N(Δt - Δ_h; 0, σ_h² + σ_d²);
    m is the share of vehicles that detectors miss, λ the rate of pulses of a lane that belong to no crossing, ε
    the share of times that err by more than they state, within the gate T. The best assignment has the largest sum of
    worths W. Against the crossing's pulse stand the best assignments in which it has another one, or none::

        P = exp(W) / (exp(W) + Σ_other pulses exp(W_i) + exp(W_none))

    Pulses of one lane less than 0.6 s apart are those of one vehicle, and the best of them counts.
    """
    worth = np.array([[_worth(each, pulse, model) for pulse in pulses] for each in rivals])
    rest = np.maximum(worth.reshape(len(rivals), len(pulses)), 0.0)
    none = _best(rest)
    found: list[tuple[float, int]] = []  # the best sum of worths with each pulse
    for index, pulse in enumerate(pulses):
        if np.isfinite(own := _worth(crossing, pulse, model)):
            found.append((own + _best(np.delete(rest, index, axis=1)), index))
    vehicles: list[tuple[float, int]] = []  # the best pulse of each
    for total, index in sorted(found, key=lambda each: (-each[0], each[1])):
        if not any(is_one_vehicle(pulses[index], pulses[other]) for _, other in vehicles):
            vehicles.append((total, index))
    if not vehicles or vehicles[0][0] <= none:
        return None
    best, chosen = vehicles[0]
    against = exp(none - best) + sum(exp(total - best) for total, _ in vehicles)  # 1 of it is the best itself
    return Ownership(pulses[chosen], 1.0 / against)


def is_one_vehicle(pulse: Pulse, other: Pulse) -> bool:
    """Whether two pulses are so near to each other that one vehicle has caused both."""
    return pulse.lane == other.lane and abs(pulse.time_ns - other.time_ns) < ONE_VEHICLE_NS


def _worth(crossing: Crossing, pulse: Pulse, model: PulseModel) -> float:
    away_s = 1e-9 * (pulse.time_ns - crossing.time_ns)
    lane, gate_s = crossing.probability(pulse.lane), max(model.gate_s, 3.0 * crossing.sd_s)
    if not lane or abs(away_s) > gate_s:
        return -np.inf
    modes = crossing.modes or (Mode(0.0, crossing.sd_s, {pulse.lane: lane}),)
    total = sum(mode.lanes.get(pulse.lane, 0.0) for mode in modes)
    density = (
        sum(
            mode.lanes.get(pulse.lane, 0.0) / total * _normal(away_s - mode.offset_s, mode.sd_s, model)
            for mode in modes
        )
        if total > 0.0
        else _normal(away_s, crossing.sd_s, model)
    )
    likelihood = (1.0 - OUTLIERS) * density + OUTLIERS / (2.0 * gate_s)
    return log((1.0 - model.missed) * lane * likelihood / (model.missed * model.others_per_s))


def _normal(away_s: float, sd_s: float, model: PulseModel) -> float:
    """Density [1/s] of a pulse so far from its crossing."""
    variance = sd_s**2 + model.detector_sd_s**2
    return exp(-0.5 * away_s**2 / variance) / sqrt(2.0 * pi * variance)


def _best(worth: FloatArray) -> float:
    """The largest sum of worths of pairs."""
    rows, columns = linear_sum_assignment(worth, maximize=True)
    return float(worth[rows, columns].sum())

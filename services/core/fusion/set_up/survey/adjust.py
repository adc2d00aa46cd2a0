"""The least squares over all arcs: mounting, lever arm, delay and scale at once, with standard deviations.

The starts of the arcs are eliminated from each arc's normal equations. Standard deviations are the larger of those by
the residuals and those by leaving out a tenth of the arcs at a time (jackknife), which hold what the model does not.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..motion import Motion
from ..regression import FloatArray
from . import rows as kinds
from .arcs import START, STEP_S, Increments, Path, Starts, path_of, rotations
from .rows import (
    ARM,
    AXLE,
    DELAY,
    FORCE_BIAS,
    RATE_BIAS,
    RATIO,
    SHARED,
    SLIP,
    TURN,
    VELOCITY_LAG,
    WHEEL_LAG,
    Rows,
    Unknowns,
)

ITERATIONS = 15
# Largest step over its standard deviation at which the search ends, and above which its result is none: what counts
# less changes from step to step.
SETTLED, STILL_MOVING = 0.05, 0.5
HUBER = 2.0  # standard deviations from which on a row counts less
GROUPS = 10  # of arcs, of which each is left out once
MIN_ARCS = 3
# Kinds of rows: standard deviation at first, and the least that is believed.
SPREADS = {
    "position": (2.0, 0.01), "height": (3.0, 0.02), "velocity": (0.2, 0.02), "vertical": (0.4, 0.03),
    "lateral": (0.3, 0.03), "off the road": (0.3, 0.03), "roll": (0.05, 0.02), "pitch": (0.05, 0.02),
    "speed": (0.3, 0.02), "plane": (0.05, 0.005),
}  # fmt: skip
# Standard deviations of what is shared before anything is measured.
PRIOR = np.zeros(SHARED)
PRIOR[FORCE_BIAS], PRIOR[RATE_BIAS], PRIOR[ARM] = 0.05, 0.01, 3.0
PRIOR[DELAY], PRIOR[VELOCITY_LAG], PRIOR[TURN], PRIOR[AXLE], PRIOR[RATIO] = 1.0, 0.05, 0.5, 1.5, 0.5
PRIOR[WHEEL_LAG], PRIOR[SLIP] = 0.3, 0.01
ARC_FORCE_BIAS, ARC_RATE_BIAS = 0.02, 3e-4  # [m/s², rad/s] standard deviations of those of one arc
TURNED_RAD = 0.5  # least angle of a bend whose axis is that of the road
LAG_SDS, SAME_S = 3.0, 1e-4  # velocities whose lag is below it have that of positions
ENDS_M_S2 = 0.3  # lateral acceleration before and behind it


@dataclass(frozen=True)
class Adjusted:
    """Result of the least squares: what is shared, its standard deviations, and the residuals of each kind.

    Attributes
    ----------
    of : Unknowns
    sd : ndarray, shape (19,)
        Order of `rows`.
    residuals : dict
        Robust standard deviation of each kind of row, and how many there were.
    arcs, bends : int
        That were used.
    """

    of: Unknowns
    sd: FloatArray
    residuals: dict[str, tuple[float, int]]
    arcs: int
    bends: int
    settled: bool


@dataclass(frozen=True)
class _Normal:
    """Normal equations of one arc or bend for what is shared: its start is eliminated."""

    N: FloatArray
    b: FloatArray


def adjust(motion: Motion, arcs: Increments, starts: Starts, first: Unknowns) -> Adjusted | None:
    """Find what is shared by all arcs.

    Parameters
    ----------
    motion : Motion
        Of the whole drive.
    arcs : Increments
        In the axes of the vehicle as they are believed at first.
    starts : Starts
        Of the arcs.
    first : Unknowns
        Where the search begins, with the identity as its matrix.

    Returns
    -------
    Adjusted or None
        None with too few arcs, or where the search does not end.
    """
    free = _searched(motion, arcs, starts, first, PRIOR)
    if free is None or abs(free.of.velocity_lag_s) > LAG_SDS * free.sd[VELOCITY_LAG]:
        return free
    prior = PRIOR.copy()
    prior[VELOCITY_LAG] = SAME_S
    same = _searched(motion, arcs, starts, first, prior)
    if same is None:
        return None
    sd = same.sd.copy()
    sd[VELOCITY_LAG] = free.sd[VELOCITY_LAG]
    return replace(same, sd=sd)


def _searched(motion: Motion, arcs: Increments, starts: Starts, first: Unknowns, prior: FloatArray) -> Adjusted | None:
    """Search with standard deviations of what is shared before anything is measured, shape (19,)."""
    if len(arcs.begin) < MIN_ARCS or motion.place is None:
        return None
    of, spreads = first, {name: at_first for name, (at_first, _) in SPREADS.items()}
    for iteration in range(ITERATIONS):
        path = path_of(arcs, starts, of.force_bias, of.rate_bias, motion.place)
        found = dict(_rows_of(motion, arcs.begin, path, of))
        normals, eliminated = _normals(found, spreads, starts)
        bends = list(_bends(arcs, path, of))
        total = [*normals, *(_plane(bend, spreads["plane"]) for bend in bends)]
        step, formal = _solved(total, of, prior)
        if not np.isfinite(step).all():
            return None
        turn = rotations(step[TURN])
        starts = _moved(starts, eliminated, step, turn)
        of, arcs = of.changed(step, turn), arcs.turned(turn)
        spreads = _spreads(found, eliminated, step, bends)
        moved = float(np.max(np.abs(step) / formal))
        if iteration > 2 and moved < SETTLED:
            break
    counts = {name: len(rows.z) for name, rows in found.items()} | {"plane": 2 * len(bends)}
    sd = np.maximum(formal, _jackknife(total, of, prior))
    residuals = {name: (spreads[name], count) for name, count in counts.items()}
    return Adjusted(of, sd, residuals, len(arcs.begin), len(bends), moved < STILL_MOVING)


def _rows_of(motion: Motion, begins: FloatArray, path: Path, of: Unknowns) -> Iterator[tuple[str, Rows]]:
    yield from zip(("position", "height"), kinds.positions(motion, begins, path, of), strict=True)
    if len(motion.velocities):
        yield from zip(("velocity", "vertical"), kinds.velocities(motion, begins, path, of), strict=True)
    names = "lateral", "off the road", "roll", "pitch"
    yield from zip(names, kinds.constraints(begins, path, of), strict=True)
    if len(motion.speeds):
        yield from zip(("speed",), kinds.speeds(motion, begins, path, of), strict=True)


@dataclass(frozen=True)
class _Eliminated:
    """The steps of the starts, shape (k, 15), less their change with what is shared, shape (k, 15, 19)."""

    own: FloatArray
    by_shared: FloatArray


def _normals(found: dict[str, Rows], spreads: dict[str, float], starts: Starts) -> tuple[list[_Normal], _Eliminated]:
    """Normal equations of each arc without its start."""
    arcs = len(starts.velocity)
    N = np.zeros((arcs, START + SHARED, START + SHARED))
    b = np.zeros((arcs, START + SHARED))
    for name, rows in found.items():
        scaled = spreads[name] * rows.spread
        size = np.abs(rows.z) / scaled
        root = np.sqrt(np.minimum(1.0, HUBER / np.maximum(size, 1e-9))) / scaled
        H = np.concatenate([rows.start, rows.shared], axis=1) * root[:, np.newaxis]
        order = np.argsort(rows.arc, kind="stable")
        edges = np.searchsorted(rows.arc[order], np.arange(arcs + 1))
        for arc in range(arcs):
            chosen = order[edges[arc] : edges[arc + 1]]
            N[arc] += H[chosen].T @ H[chosen]
            b[arc] += H[chosen].T @ (rows.z * root)[chosen]
    own, weight = slice(0, START), np.repeat([ARC_FORCE_BIAS**-2, ARC_RATE_BIAS**-2], 3)
    N[:, 9:START, 9:START] += np.diag(weight)
    b[:, 9:START] -= weight * np.hstack([starts.force_bias, starts.rate_bias])
    inverse = np.linalg.inv(N[:, own, own] + 1e-9 * np.eye(START))
    gain = inverse @ N[:, own, START:]
    reduced = N[:, START:, START:] - N[:, START:, own] @ gain
    right = b[:, START:] - (N[:, START:, own] @ (inverse @ b[:, own, np.newaxis]))[..., 0]
    normals = [_Normal(n, r) for n, r in zip(reduced, right, strict=True)]
    return normals, _Eliminated((inverse @ b[:, own, np.newaxis])[..., 0], gain)


def _solved(normals: list[_Normal], of: Unknowns, prior: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Step and standard deviations of what is shared."""
    values = np.zeros(SHARED)
    values[FORCE_BIAS], values[VELOCITY_LAG], values[AXLE] = of.force_bias, of.velocity_lag_s, of.axle
    values[WHEEL_LAG], values[SLIP] = of.wheel_lag_s, of.slip
    weight = 1.0 / prior**2
    N = np.sum([normal.N for normal in normals], axis=0) + np.diag(weight)
    b = np.sum([normal.b for normal in normals], axis=0)
    drawn = [*range(FORCE_BIAS.start, FORCE_BIAS.stop), VELOCITY_LAG, *range(AXLE.start, AXLE.stop), WHEEL_LAG, SLIP]
    b[drawn] -= (weight * values)[drawn]
    P = np.linalg.inv(N)
    return P @ b, np.sqrt(P.diagonal())


def _jackknife(normals: list[_Normal], of: Unknowns, prior: FloatArray) -> FloatArray:
    """Standard deviations by leaving out each of some groups."""
    groups = min(GROUPS, len(normals))
    steps = np.array([
        _solved([normal for place, normal in enumerate(normals) if place % groups != group], of, prior)[0]
        for group in range(groups)
    ])  # fmt: skip
    found: FloatArray = np.sqrt((groups - 1) / groups * ((steps - steps.mean(axis=0)) ** 2).sum(axis=0))
    return found


def _moved(starts: Starts, eliminated: _Eliminated, step: FloatArray, turn: FloatArray) -> Starts:
    own = eliminated.own - eliminated.by_shared @ step
    return Starts(
        rotations(own[:, :3]) @ starts.attitude @ turn, starts.velocity + own[:, 3:6], starts.position + own[:, 6:9],
        (starts.force_bias + own[:, 9:12]) @ turn, (starts.rate_bias + own[:, 12:15]) @ turn,
    )  # fmt: skip


def _spreads(
    found: dict[str, Rows], eliminated: _Eliminated, step: FloatArray, bends: list[FloatArray]
) -> dict[str, float]:
    """Robust standard deviations of the residuals of each kind."""
    own = eliminated.own - eliminated.by_shared @ step
    spreads = {}
    for name, (_, least) in SPREADS.items():
        if name == "plane":
            left = np.array([value for *xy, size in bends for value in np.multiply(xy, size)])
        elif name in found:
            rows = found[name]
            left = (rows.z - (rows.start * own[rows.arc]).sum(axis=1) - rows.shared @ step) / rows.spread
        else:
            left = np.zeros(0)
        spreads[name] = max(least, 1.4826 * float(np.median(np.abs(left)))) if len(left) > 3 else SPREADS[name][0]
    return spreads


def _bends(arcs: Increments, path: Path, of: Unknowns) -> Iterator[FloatArray]:
    """Axis of the rotation from before a bend to behind it, forward and right, and twice the sine of half the angle.

    On a plane the axis is its normal, however the plane is banked, and the vehicle leans as little behind as before.
    """
    turning = np.einsum("kni,kni->kn", path.velocity, path.velocity) ** 0.5 * path.rate[..., 2]
    turned = np.cumsum(path.rate[..., 2], axis=1) * STEP_S
    for arc in range(len(arcs.begin)):
        straight = np.flatnonzero(np.abs(turning[arc]) < ENDS_M_S2)
        if not len(straight):
            continue
        last = straight[0]
        for node in straight[1:].tolist():
            if node - last > 1 and abs(turned[arc, node] - turned[arc, last]) > TURNED_RAD:
                axis = path.attitude[arc, last].T @ path.attitude[arc, node]
                vector = np.array([axis[2, 1] - axis[1, 2], axis[0, 2] - axis[2, 0], axis[1, 0] - axis[0, 1]])
                angle = np.arccos(np.clip(0.5 * (np.trace(axis) - 1.0), -1.0, 1.0))
                if 0.3 < angle < 2.9:
                    down = vector * np.sign(vector[2]) / np.linalg.norm(vector)
                    yield np.array([down[0], down[1], 2.0 * np.sin(0.5 * angle)])
            last = node


def _plane(bend: FloatArray, spread: float) -> _Normal:
    """Rows of one bend: down is (turn_y, -turn_x, 1) in the believed axes."""
    x, y, size = bend
    H = np.zeros((2, SHARED))
    H[0, TURN.start + 1], H[1, TURN.start] = 1.0, -1.0
    weight = (size / spread) ** 2
    return _Normal(weight * H.T @ H, weight * H.T @ np.array([x, y]))

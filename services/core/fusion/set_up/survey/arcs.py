"""Short arcs of dead reckoning, and how they change with what is unknown.

An arc is 10 or 20 s of inertial samples. From a start of unknown attitude, velocity and position it follows by the
strapdown equations in a local frame, and its errors are linear in those of its start and of the biases::

    phi(t) = phi_0 - B(t) dbg                     B(t) = integral of C
    dv(t)  = dv_0 - [F(t) x] phi_0 - B(t) dba + G(t) dbg
    dp(t)  = dp_0 + integral of dv

with C the attitude (NED from body), F the integral of C f, and G(t) the integral of [C f x] B. What is measured is
compared with the arc at any of its times.

References
----------
P. Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, 2nd ed., 5.3 and 14.2.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.maths.earth import Geodetic, earth_rate_n, gravity

from ..motion import Motion, Velocities
from ..regression import FloatArray

IntArray = npt.NDArray[np.int64]

STEP_S = 0.05  # between two nodes of an arc
SPAN_S, SHORT_S = 20.0, 10.0  # of an arc, and where a drive has few
FEW = 8  # arcs
MOVING_M_S = 3.0  # from here on a course is a direction
MIN_FIXES = 6  # in an arc
START = 15  # unknowns of an arc: attitude, velocity, position at its start, and what its biases differ from the mean


@dataclass(frozen=True)
class Increments:
    """Changes of velocity and angle over the steps of k arcs of n steps, and the time at which each begins.

    Attributes
    ----------
    begin : ndarray, shape (k,)
        [s]
    force, rate : ndarray, shape (k, n, 3)
        [m/s², rad/s; body] Means over the steps.
    """

    begin: FloatArray
    force: FloatArray
    rate: FloatArray

    def turned(self, matrix: FloatArray) -> "Increments":
        """In other axes, whose columns in the present ones are those of a matrix."""
        return Increments(self.begin, self.force @ matrix, self.rate @ matrix)


@dataclass(frozen=True)
class Starts:
    """Attitude (NED from body), velocity [m/s, NED] and position [m, NED] at the beginning of k arcs.

    `force_bias` and `rate_bias` [m/s², rad/s; body] are what the mean errors of an arc differ from the biases by: bias
    instability, and noise, whose integral is nearly a straight line over an arc.
    """

    attitude: FloatArray  # shape (k, 3, 3)
    velocity: FloatArray  # shape (k, 3)
    position: FloatArray  # shape (k, 3)
    force_bias: FloatArray  # shape (k, 3)
    rate_bias: FloatArray  # shape (k, 3)


@dataclass(frozen=True)
class Path:
    """States at the n + 1 nodes of k arcs, and their sensitivities."""

    attitude: FloatArray  # shape (k, n + 1, 3, 3)
    velocity: FloatArray  # shape (k, n + 1, 3)
    position: FloatArray  # shape (k, n + 1, 3)
    rate: FloatArray  # [rad/s, body] shape (k, n + 1, 3), without the bias
    force: FloatArray  # [m/s², NED] shape (k, n + 1, 3), without the bias
    attitude_by: FloatArray  # of the rotation in NED, by (phi_0, dv_0, dp_0, dba, dbg), shape (k, n + 1, 3, 15)
    velocity_by: FloatArray
    position_by: FloatArray

    @property
    def span_s(self) -> float:
        """Length of an arc [s]."""
        return STEP_S * float(self.velocity.shape[1] - 1)


def increments_of(motion: Motion, begins: FloatArray, span_s: float) -> Increments:
    """Mean force and rate over the steps of arcs of a length that begin at some times."""
    steps = round(span_s / STEP_S)
    nodes = begins[:, np.newaxis] + STEP_S * np.arange(steps + 1)
    means = np.moveaxis(np.diff(motion.integrals_at(nodes), axis=2), 0, 2) / STEP_S
    return Increments(begins, means[..., :3], means[..., 3:])


def arcs_of(motion: Motion, velocities: Velocities) -> Increments | None:
    """Arcs with samples and fixes throughout, in which the vehicle moves; None if there are none."""
    begins, span_s = _begins(motion, velocities, SPAN_S), SPAN_S
    if len(begins) < FEW:
        begins, span_s = _begins(motion, velocities, SHORT_S), SHORT_S
    return increments_of(motion, begins, span_s) if len(begins) else None


def _begins(motion: Motion, velocities: Velocities, span_s: float) -> FloatArray:
    begins = np.arange(motion.nodes[0], motion.nodes[-1] - span_s, span_s)
    gaps = np.interp(begins + span_s, motion.nodes, motion.gaps) - np.interp(begins, motion.nodes, motion.gaps)
    middle, speed = 0.5 * (velocities.begin + velocities.end), np.hypot(*velocities.ned[:, :2].T)
    found = []
    for begin, gap in zip(begins.tolist(), gaps.tolist(), strict=True):
        inside = (middle > begin) & (middle < begin + span_s)
        if gap == 0.0 and inside.sum() >= MIN_FIXES and (speed[inside] > MOVING_M_S).sum() >= MIN_FIXES:
            found.append(begin)
    return np.array(found)


def starts_of(arcs: Increments, motion: Motion, velocities: Velocities, bias: FloatArray) -> Starts:
    """Level starts with the course, velocity and position of GNSS; `bias` is that of the gyroscopes [rad/s, body]."""
    middle = 0.5 * (velocities.begin + velocities.end)
    course, speed = np.arctan2(velocities.ned[:, 1], velocities.ned[:, 0]), np.hypot(*velocities.ned[:, :2].T)
    headings, nodes = [], STEP_S * np.arange(arcs.rate.shape[1] + 1)
    span_s = float(nodes[-1])
    for begin, rate in zip(arcs.begin.tolist(), arcs.rate[..., 2] - bias[2], strict=True):
        fit = (middle > begin) & (middle < begin + span_s) & (speed > MOVING_M_S)
        turned = np.interp(middle[fit] - begin, nodes, np.append(0.0, rate.cumsum() * STEP_S))
        headings.append(np.angle(np.exp(1j * (course[fit] - turned)).mean()))
    c, s = np.cos(headings), np.sin(headings)
    zero, one = np.zeros_like(c), np.ones_like(c)
    attitude = np.stack([c, -s, zero, s, c, zero, zero, zero, one], axis=-1).reshape(-1, 3, 3)
    ned = np.nan_to_num(velocities.ned)
    velocity = np.column_stack([np.interp(arcs.begin, middle, ned[:, axis]) for axis in range(3)])
    time, *track = motion.positions.T
    position = np.column_stack([np.interp(arcs.begin, time, axis) for axis in track])
    return Starts(attitude, velocity, position, np.zeros_like(velocity), np.zeros_like(velocity))


def path_of(arcs: Increments, starts: Starts, force_bias: FloatArray, rate_bias: FloatArray, place: Geodetic) -> Path:
    """Follow all arcs at once, with their sensitivities.

    Parameters
    ----------
    arcs : Increments
        In the axes of the vehicle as they are believed.
    starts : Starts
        Of the arcs.
    force_bias, rate_bias : ndarray, shape (3,)
        [m/s², rad/s; body]
    place : Geodetic
        Where the arcs are, for gravity and the rotation of the Earth; that of the local frame against it is left out.
    """
    earth = np.array(earth_rate_n(place.latitude))
    rate = arcs.rate - rate_bias - starts.rate_bias[:, np.newaxis]
    force = arcs.force - force_bias - starts.force_bias[:, np.newaxis]
    turns, earth_turn = rotations(rate * STEP_S), rotations(-earth * STEP_S)
    attitude = np.empty((len(arcs.begin), rate.shape[1] + 1, 3, 3))
    attitude[:, 0] = starts.attitude
    for step in range(rate.shape[1]):
        attitude[:, step + 1] = earth_turn @ attitude[:, step] @ turns[:, step]
    mean = 0.5 * (attitude[:, :-1] + attitude[:, 1:])
    pushed = (mean @ force[..., np.newaxis])[..., 0]
    felt = _summed(pushed)  # F
    pull = np.array([0.0, 0.0, gravity(place.latitude, place.height)])
    elapsed = STEP_S * np.arange(rate.shape[1] + 1)
    velocity = starts.velocity[:, np.newaxis] + felt + pull * elapsed[:, np.newaxis]
    velocity -= _summed(np.cross(2.0 * earth, 0.5 * (velocity[:, :-1] + velocity[:, 1:])))  # Coriolis
    position = starts.position[:, np.newaxis] + _summed(0.5 * (velocity[:, :-1] + velocity[:, 1:]))
    turned = _summed(mean)  # B
    shape = (*velocity.shape[:2], 3, 3)
    identity = np.broadcast_to(np.eye(3), shape)
    zero = np.zeros(shape)
    by_rate = _summed(skews(pushed) @ (0.5 * (turned[:, :-1] + turned[:, 1:])))  # G
    attitude_by = np.concatenate([identity, zero, zero, zero, -turned], axis=-1)
    velocity_by = np.concatenate([-skews(felt), identity, zero, -turned, by_rate], axis=-1)
    along = 0.5 * (velocity_by[:, :-1] + velocity_by[:, 1:])
    position_by = _summed(along)
    position_by[..., 6:9] += np.eye(3)
    pair = np.concatenate([rate[:, :1], 0.5 * (rate[:, :-1] + rate[:, 1:]), rate[:, -1:]], axis=1)
    acting = np.concatenate([pushed[:, :1], 0.5 * (pushed[:, :-1] + pushed[:, 1:]), pushed[:, -1:]], axis=1)
    return Path(attitude, velocity, position, pair, acting, attitude_by, velocity_by, position_by)


def skews(vectors: FloatArray) -> FloatArray:
    """Matrices of the cross product, shape (..., 3, 3)."""
    found = np.zeros((*vectors.shape, 3))
    x, y, z = np.moveaxis(vectors, -1, 0)
    found[..., 0, 1], found[..., 0, 2], found[..., 1, 2] = -z, y, -x
    found[..., 1, 0], found[..., 2, 0], found[..., 2, 1] = z, -y, x
    return found


def rotations(vectors: FloatArray) -> FloatArray:
    """Rotation matrices of rotation vectors [rad], shape (..., 3, 3)."""
    angle = np.linalg.norm(vectors, axis=-1)[..., np.newaxis, np.newaxis]
    S = skews(vectors)
    found: FloatArray = np.eye(3) + np.sinc(angle / np.pi) * S + 0.5 * np.sinc(0.5 * angle / np.pi) ** 2 * (S @ S)
    return found


def _summed(values: FloatArray) -> FloatArray:
    """Integral at each node of what holds over the steps between them."""
    found: FloatArray = np.concatenate([np.zeros_like(values[:, :1]), np.cumsum(values, axis=1) * STEP_S], axis=1)
    return found

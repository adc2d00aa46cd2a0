"""Paths along lanes, and how vehicles follow each other on them."""

from bisect import bisect_right
from dataclasses import dataclass
from math import atan2, cos, pi, sin, sqrt

import numpy as np
import numpy.typing as npt

from shared.toll.plaza import Lane, along

FloatArray = npt.NDArray[np.float64]

MAX_ACCELERATION = 1.5  # [m/s²]
COMFORTABLE_BRAKING = 2.0  # [m/s²]
STANDSTILL_GAP = 2.5  # [m]
HEADWAY_S = 1.3
TURN_RADIUS = 6.0  # [m]
TURN_SPEED = 4.0  # [m/s]


@dataclass(frozen=True)
class Pose:
    """Front point in the plane (north, east), heading [rad] clockwise from north, curvature [1/m]."""

    north: float
    east: float
    heading: float
    curvature: float  # positive to the left


class Path:
    """A polyline with arc length, from the begin of a lane to its end or through a turn back."""

    def __init__(self, points: FloatArray, turn: tuple[float, float] | None = None) -> None:
        steps = np.diff(points, axis=0)
        lengths = np.hypot(steps[:, 0], steps[:, 1])
        self._points: list[list[float]] = points.tolist()
        self._steps: list[list[float]] = steps.tolist()
        self._lengths: list[float] = lengths.tolist()
        self._begin: list[float] = [0.0, *np.cumsum(lengths).tolist()]
        self.turn = turn  # begin and end of the turn back

    @property
    def length(self) -> float:
        """Arc length [m]."""
        return self._begin[-1]

    def pose(self, distance: float, offset: float) -> Pose:
        """Give the pose at an arc length, `offset` metres to the right of the line."""
        k = max(0, min(bisect_right(self._begin, distance) - 1, len(self._lengths) - 1))
        share = (distance - self._begin[k]) / self._lengths[k]
        (north, east), (along_n, along_e) = self._points[k], self._steps[k]
        heading = atan2(along_e, along_n)
        turning = self.turn is not None and self.turn[0] <= distance < self.turn[1]
        return Pose(
            north + share * along_n - offset * sin(heading),
            east + share * along_e + offset * cos(heading),
            heading,
            1.0 / TURN_RADIUS if turning else 0.0,
        )


def lane_path(lane: Lane) -> Path:
    """Path of a vehicle that passes the gate."""
    return Path(lane.centre)


def turning_path(lane: Lane, before_gate: float) -> Path:
    """Path of a vehicle that turns around to the left, `before_gate` metres before the gate line."""
    start = gate_distance(lane) - before_gate
    straight = lane_path(lane)
    pose = straight.pose(start, 0.0)
    ahead = np.array([cos(pose.heading), sin(pose.heading)])
    left = np.array([sin(pose.heading), -cos(pose.heading)])
    here = np.array([pose.north, pose.east])
    angles = np.linspace(0.0, pi, 25)[:, None]
    arc = here + TURN_RADIUS * (left * (1.0 - np.cos(angles)) + ahead * np.sin(angles))
    points = np.vstack([lane.centre[:1], arc, arc[-1:] - ahead * start])
    return Path(points, (start, start + pi * TURN_RADIUS))


def gate_distance(lane: Lane) -> float:
    """Arc length [m] of a lane's gate line."""
    distance = along(lane.centre, lane.gate)
    assert distance is not None, "the plaza's file was checked for it"
    return distance


def acceleration(speed: float, wanted: float, gap: float | None, closing: float) -> float:
    """Acceleration [m/s²] of the intelligent driver model.

    Parameters
    ----------
    speed, wanted : float
        [m/s] Present and desired speed.
    gap, closing : float
        [m], [m/s] Distance to the vehicle or stop line ahead (None: free road), and the rate at which it shrinks.

    Notes
    -----
    With s* = s₀ + v T + v Δv / (2 √(a b))::

        a_IDM = a (1 - (v/v₀)⁴ - (s*/s)²)

    References
    ----------
    M. Treiber et al., "Congested traffic states in empirical observations and microscopic simulations",
    Phys. Rev. E 62, 2000, eq. 3.
    """
    free = 1.0 - (speed / wanted) ** 4
    if gap is None:
        return MAX_ACCELERATION * free
    braking = speed * closing / (2.0 * sqrt(MAX_ACCELERATION * COMFORTABLE_BRAKING))
    desired = STANDSTILL_GAP + max(0.0, speed * HEADWAY_S + braking)
    return max(MAX_ACCELERATION * (free - (desired / max(gap, 0.1)) ** 2), -8.0)

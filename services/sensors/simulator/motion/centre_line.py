"""The centre line of a course on the ground, as a map shows it."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from shared.maths.earth import Geodetic
from shared.messages.simulation import RoadLine, RoadNetwork

from ..imu.ideal_imu import integrate_position
from .roads import Course, Road

FloatArray = npt.NDArray[np.float64]

STEP_M = 0.5  # of the integral along the course
TURN_RAD = 0.02  # a vertex at every change of heading by this
WIDTH_M = 7.0  # two lanes


def road_network(course: Course, start: Geodetic, now_ns: int) -> RoadNetwork:
    """State the road of a course, in parts that are all in a tunnel or all outside."""
    roads = tuple(
        RoadLine(
            tunnel=tunnel,
            width_m=WIDTH_M,
            latitude_deg=tuple(np.degrees(vertices[:, 0]).round(8).tolist()),
            longitude_deg=tuple(np.degrees(vertices[:, 1]).round(8).tolist()),
        )
        for tunnel, vertices in centre_line(course, start)
    )
    return RoadNetwork(sampled_ns=now_ns, roads=roads)


def centre_line(course: Course, start: Geodetic) -> Iterator[tuple[bool, FloatArray]]:
    """Follow a course for one lap at unit speed.

    Parameters
    ----------
    course : Course
        The closed road.
    start : Geodetic
        [rad, rad, m] Its beginning.

    Yields
    ------
    (bool, ndarray of shape (n, 2))
        A part: whether it is in a tunnel, and latitude and longitude [rad] of its vertices, the last of which is
        the first of the next part. A straight has vertices at its ends only.
    """
    road = Road(course)
    steps = int(np.ceil(road.length / STEP_M))
    stations = np.minimum(np.linspace(0.0, road.length, steps + 1), np.nextafter(road.length, 0.0))
    heading, slope, _ = road.at(stations)
    along_n = np.column_stack([np.cos(slope) * np.cos(heading), np.cos(slope) * np.sin(heading), -np.sin(slope)])
    places = integrate_position(start, along_n, road.length / steps).position[:, :2]
    covered = road.covered(stations)
    changes = np.flatnonzero(np.diff(covered.astype(int))) + 1
    turned = np.flatnonzero(np.diff(np.floor(heading / TURN_RAD))) + 1
    for first, last in pairwise([0, *changes.tolist(), steps]):
        between = turned[(turned > first) & (turned < last)]
        yield bool(covered[first]), places[np.r_[first, between, last]]

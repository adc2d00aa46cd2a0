"""True motion of neighbouring vehicles on the road of the simulated vehicle.

A neighbour is at the arc length s of the course, with a lateral offset l to the right. With the heading psi, the
slope theta and the curvature k = d psi/ds at s::

    p = p_0 + ∫ a ds + l r,    a = (cos theta cos psi, cos theta sin psi, -sin theta),    r = (-sin psi, cos psi, 0)
    v = ds/dt (a - l k (cos psi, sin psi, 0))
"""

from dataclasses import dataclass
from math import ceil, floor

import numpy as np
import numpy.typing as npt

from ..motion.roads import Road
from ..motion.speed import SpeedProfile
from ..scenarios import Scenario
from ..vehicle import Stream

FloatArray = npt.NDArray[np.float64]

MAX_COUNT = 6
AHEAD_S, BESIDE_S, BEHIND_S = 3.0, 1.0, -3.0  # by which a car drives the course before or after the vehicle
GAP_M = 10.0  # to the car ahead and behind at standstill
LANE_M = 3.5
PARKED_EVERY_M, PARKED_ASIDE_M = 150.0, 8.0
ONCOMING_M_S, ONCOMING_EVERY_M = (9.0, 14.0), 500.0
STEP_M = 0.2  # of the integral along the course


@dataclass(frozen=True)
class Car:
    """One neighbour: the position is relative to the vehicle's reference point."""

    station_id: int
    position_n: FloatArray  # shape (3,) [m, NED]
    velocity_n: FloatArray  # shape (3,) [m/s, NED]
    along_n: FloatArray  # shape (3,) [-, NED] direction of the course at its place


class Traffic:
    """Up to six neighbours: ahead, oncoming, beside, parked, behind, and a second oncoming one.

    Parked and oncoming cars are followed by others with other station IDs when they are left behind.
    """

    def __init__(self, scenario: Scenario, seed: int, count: int) -> None:
        self._count, self._road = count, Road(scenario.course)
        route = np.random.default_rng((seed, Stream.ROUTE))  # the speeds of the vehicle itself
        standstill = float(route.uniform(*scenario.standstill_s))
        self._speeds = SpeedProfile(scenario.course, standstill, scenario.acceleration_m_s2, route)
        self._begin = np.random.default_rng((seed, Stream.NEIGHBOURS)).uniform(0.0, ONCOMING_EVERY_M, 2).tolist()

    def at(self, time_s: float) -> tuple[Car, ...]:
        """Compute all neighbours at a time [s] since the start; times do not decrease from call to call."""
        distance, speed = self._speeds.at(time_s + np.array([BEHIND_S, 0.0, BESIDE_S, AHEAD_S]))
        (behind, own, beside, ahead), (v_behind, _, v_beside, v_ahead) = distance.tolist(), speed.tolist()
        parked = ceil(own / PARKED_EVERY_M)
        cars = (
            (1, ahead + GAP_M, v_ahead, 0.0),
            self._oncoming(0, own, time_s),
            (2, beside + GAP_M, v_beside, LANE_M),
            (100_000 + parked, parked * PARKED_EVERY_M, 0.0, PARKED_ASIDE_M),
            (3, behind - GAP_M, v_behind, 0.0),
            self._oncoming(1, own, time_s),
        )
        return tuple(self._car(own, *car) for car in cars[: self._count])

    def _oncoming(self, which: int, own: float, time_s: float) -> tuple[int, float, float, float]:
        """One of a row of equally spaced oncoming cars: the nearest to the vehicle."""
        speed = ONCOMING_M_S[which]
        first = self._begin[which] - speed * time_s
        number = floor((own - first) / ONCOMING_EVERY_M + 0.5)
        return 2000 + 10_000 * which + number, first + number * ONCOMING_EVERY_M, -speed, -LANE_M

    def _car(self, own: float, station_id: int, s: float, speed: float, offset: float) -> Car:
        stations = np.linspace(own, s, ceil(abs(s - own) / STEP_M) + 2)
        heading, slope, curvature = self._road.at(stations)
        level = np.column_stack([np.cos(heading), np.sin(heading), np.zeros(len(stations))])
        along = level * np.cos(slope)[:, np.newaxis] - np.outer(np.sin(slope), [0.0, 0.0, 1.0])
        right = np.array([-level[-1, 1], level[-1, 0], 0.0])
        position_n = np.trapezoid(along, stations, axis=0) + offset * right
        velocity_n = speed * (along[-1] - offset * curvature[-1] * level[-1])
        return Car(station_id, position_n, velocity_n, along[-1])

"""What neighbours publish, with their errors, and the carrier frequency offsets that the vehicle's radio measures."""

from dataclasses import dataclass
from math import exp, sqrt

import numpy as np
import numpy.typing as npt

from shared.maths.earth import Geodetic, ecef_from_geodetic, geodetic_from_ned_difference, ned_from_ecef
from shared.maths.frequency_offset import cfo_from_range_rate
from shared.messages.base import Symmetric3
from shared.messages.neighbours import Neighbour, NeighbourStates

from ..scenarios import Scenario
from ..vehicle import AntennaState, Stream
from .traffic import Car, Traffic

FloatArray = npt.NDArray[np.float64]

SOURCE = "radio0"
DELAY_NS = 5_000_000
POSITION_SD_N = np.array([1.0, 1.0, 1.5])  # [m] of published positions; first-order Gauss-Markov
CORRELATION_S = 30.0
VELOCITY_SD = 0.05  # [m/s] white
CFO_SD_HZ = 15.0  # 0.8 m/s
OFFSET_RANGE = 2e-6  # [-] of an oscillator that is disciplined or calibrated
OFFSET_SD = 3e-10  # [-] error of the published offset: 0.1 m/s
OFFSET_WALK = 1e-9  # [- per sqrt(s)] of the vehicle's own oscillator


@dataclass(frozen=True)
class Deception:
    """What lying neighbours add to the states that they publish, along the course; several that lie collude."""

    neighbours: int = 1  # so many of them lie, in the order of `Traffic`
    ahead_m: float = 0.0
    speed_m_s: float = 5.0


class Radio:
    """Receives all neighbours once a second, at the GNSS antenna; `deception` may be set and removed at any time."""

    def __init__(self, scenario: Scenario, seed: int, count: int) -> None:
        self._traffic = Traffic(scenario, seed, count)
        self._rng = np.random.default_rng((seed, Stream.NEIGHBOURS, 1))
        self._own_offset = float(self._rng.uniform(-OFFSET_RANGE, OFFSET_RANGE))
        self._offsets = self._rng.uniform(-OFFSET_RANGE, OFFSET_RANGE, count)
        self._errors = POSITION_SD_N * self._rng.standard_normal((count, 3))
        self._time_s: float | None = None
        self.deception: Deception | None = None

    def receive(self, time_s: float, sampled_ns: int, reference: Geodetic, antenna: AntennaState) -> NeighbourStates:
        """Receive the neighbours at a time.

        Parameters
        ----------
        time_s : float
            [s] Since the start; later than in the call before.
        sampled_ns : int
            [ns, OBU time line] The same time.
        reference : Geodetic
            [rad, rad, m] Reference point of the vehicle.
        antenna : AntennaState
            State of the antenna.
        """
        cars = self._traffic.at(time_s)
        step_s = 0.0 if self._time_s is None else time_s - self._time_s
        self._time_s = time_s
        kept = exp(-step_s / CORRELATION_S)
        fresh = sqrt(1.0 - kept**2) * POSITION_SD_N
        self._errors = kept * self._errors + fresh * self._rng.standard_normal(self._errors.shape)
        self._own_offset += OFFSET_WALK * sqrt(step_s) * float(self._rng.standard_normal())
        return NeighbourStates(
            sampled_ns=sampled_ns, received_ns=sampled_ns + DELAY_NS, source=SOURCE,
            neighbours=tuple(self._neighbour(number, car, reference, antenna) for number, car in enumerate(cars)),
        )  # fmt: skip

    def _neighbour(self, number: int, car: Car, reference: Geodetic, antenna: AntennaState) -> Neighbour:
        white = self._rng.standard_normal(5)
        offset = float(self._offsets[number])
        cfo = cfo_from_range_rate(range_rate(car, reference, antenna), offset, self._own_offset)
        lie = self.deception if self.deception and number < self.deception.neighbours else Deception(0, 0.0, 0.0)
        north, east, down = (car.position_n + self._errors[number] + lie.ahead_m * car.along_n).tolist()
        place = geodetic_from_ned_difference((north, east, down), reference)
        velocity_n = car.velocity_n + VELOCITY_SD * white[:3] + lie.speed_m_s * car.along_n
        v_north, v_east, v_down = velocity_n.tolist()
        return Neighbour(
            station_id=car.station_id,
            latitude_deg=float(np.degrees(place.latitude)), longitude_deg=float(np.degrees(place.longitude)),
            height_ellipsoid_m=place.height, velocity_ned_m_s=(v_north, v_east, v_down),
            position_cov_ned_m2=_diagonal(POSITION_SD_N**2),
            velocity_cov_ned_m2_s2=_diagonal(np.full(3, VELOCITY_SD**2)),
            oscillator_offset=offset + OFFSET_SD * float(white[3]),
            cfo_hz=cfo + CFO_SD_HZ * float(white[4]), cfo_sd_hz=CFO_SD_HZ,
        )  # fmt: skip


def range_rate(car: Car, reference: Geodetic, antenna: AntennaState) -> float:
    """Rate [m/s] at which the distance from a car to the antenna grows."""
    north, east, down = car.position_n.tolist()
    there = ecef_from_geodetic(geodetic_from_ned_difference((north, east, down), reference))
    away_e = np.array(ecef_from_geodetic(antenna.position)) - np.array(there)
    away_n = ned_from_ecef(reference.latitude, reference.longitude) @ away_e
    return float(away_n @ (np.array(antenna.velocity_n) - car.velocity_n) / np.linalg.norm(away_n))


def _diagonal(variances: FloatArray) -> Symmetric3:
    north, east, down = variances.tolist()
    return north, 0.0, 0.0, east, 0.0, down

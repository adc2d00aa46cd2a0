"""Satellites in view of a position: direction, signal strength (C/N0) and dilution of precision."""

from dataclasses import dataclass
from functools import lru_cache
from math import cos, hypot, pi, radians, sin, sqrt

import numpy as np
import numpy.typing as npt

from shared.maths.earth import GRAVITATIONAL_CONSTANT, Geodetic, ecef_from_geodetic, ned_from_ecef

from .orbits import Orbits

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

HORIZON_DEG = 5.0  # elevation below which satellites are not searched
MIN_DB_HZ = 24.0  # C/N0 below which a signal is tracked but not used
TRACKED_DB_HZ = 10.0  # C/N0 below which a signal is lost
MIN_SATELLITES = 4  # satellites of a fix
UNKNOWN_DOP = 99.99
NAVIGATION = ("gps", "galileo")  # constellations whose measurements and navigation words are simulated
# Errors of pseudoranges: what orbits, clocks and atmosphere leave varies slowly; noise is white and grows as
# 1/sin(elevation), and as the signal gets weaker than the reference.
SLOW_SD_M, SLOW_S = 1.0, 300.0
NOISE_SD_M, REFERENCE_DB_HZ = 0.4, 45.0


@dataclass(frozen=True)
class Constellation:
    """Evenly spaced satellites on circular orbits in evenly spaced planes."""

    gnss_id: int  # as in UBX messages
    nmea_id: int  # system id of NMEA 4.11
    nmea_offset: int  # NMEA number of the first satellite, minus one
    planes: int
    per_plane: int
    inclination_deg: float
    radius_m: float
    mu: float = GRAVITATIONAL_CONSTANT  # [m³/s²]


CONSTELLATIONS = {
    "gps": Constellation(0, 1, 0, 6, 5, 55.0, 26.560e6, 3.986005e14),  # IS-GPS-200N, table 20-IV
    "galileo": Constellation(2, 3, 0, 3, 8, 56.0, 29.600e6),
    "beidou": Constellation(3, 4, 0, 3, 8, 55.0, 27.906e6),
    "glonass": Constellation(6, 2, 64, 3, 8, 64.8, 25.510e6),
}


@dataclass(frozen=True)
class Dop:
    """Dilution of precision [-]."""

    north: float
    east: float
    vertical: float
    time: float

    @property
    def horizontal(self) -> float:
        """Horizontal dilution of precision: north and east."""
        return hypot(self.north, self.east)

    @property
    def position(self) -> float:
        """Position dilution of precision: all three axes."""
        return hypot(self.horizontal, self.vertical)

    @property
    def geometric(self) -> float:
        """Geometric dilution of precision: position and time."""
        return hypot(self.position, self.time)


@dataclass(frozen=True)
class Sky:
    """n satellites above the horizon, by descending elevation within each constellation."""

    satellite: npt.NDArray[np.intp]  # shape (n,) index into all satellites of the model
    system: npt.NDArray[np.intp]  # shape (n,) index into the names of the constellations
    number: npt.NDArray[np.intp]  # shape (n,) 1, 2, ... within the constellation
    elevation_deg: FloatArray  # shape (n,)
    azimuth_deg: FloatArray  # shape (n,) 0 to 360
    cn0_db_hz: FloatArray  # shape (n,) 0 without a signal
    residual_m: FloatArray  # shape (n,) pseudorange residual
    used: BoolArray  # shape (n,)
    dop: Dop


class SkyModel:
    """The satellites of given constellations as functions of time and position."""

    def __init__(self, names: tuple[str, ...], seed: tuple[int, ...]) -> None:
        rows = [CONSTELLATIONS[name] for name in names]
        self.rows, self.names = rows, names
        self.navigation_systems = [i for i, name in enumerate(names) if name in NAVIGATION]
        counts = [row.planes * row.per_plane for row in rows]
        self._system = np.repeat(np.arange(len(rows)), counts)
        self._number = np.concatenate([np.arange(1, count + 1) for count in counts])
        radius, mu = (np.repeat(values, counts) for values in zip(*((r.radius_m, r.mu) for r in rows), strict=True))
        inclination = np.radians(np.repeat([row.inclination_deg for row in rows], counts))
        plane = np.concatenate([np.repeat(np.arange(row.planes) / row.planes, row.per_plane) for row in rows])
        slot = np.concatenate([np.tile(np.arange(row.per_plane) / row.per_plane, row.planes) for row in rows])
        rng = np.random.default_rng(seed)
        turned = np.repeat(rng.random((2, len(rows))), counts, axis=1)
        node, phase = 2.0 * pi * (plane + turned[0]), 2.0 * pi * (slot + plane / 3.0 + turned[1])
        self.orbits = Orbits(self._number, mu, radius, inclination, node, phase)
        self._wave = 2.0 * pi * rng.random((2, len(plane)))
        self._seed = seed
        self._knot = lru_cache(maxsize=4)(self._draw)

    def at(self, time_s: float, place: Geodetic, *, mask_deg: float, loss_db: float, covered: bool) -> Sky:
        """Compute the satellites in view.

        Parameters
        ----------
        time_s : float
            [s] GPS time.
        place : Geodetic
            Position of the antenna.
        mask_deg : float
            [deg] Elevation below which obstructions block the signals.
        loss_db : float
            [dB] Attenuation relative to open sky.
        covered : bool
            Whether all signals are blocked.

        Returns
        -------
        Sky
            Satellites above the horizon; those that are blocked have no signal.
        """
        distance, elevation, azimuth = self._directions(time_s, place)
        seen = np.flatnonzero(elevation > radians(HORIZON_DEG))
        seen = seen[np.lexsort((-elevation[seen], self._system[seen]))]
        elevation, azimuth = elevation[seen], azimuth[seen]
        # Antenna gain rises by 12 dB from horizon to zenith; multipath is a slow variation of 1.5 dB.
        wave = np.sin(2.0 * pi * time_s / 47.0 + self._wave[0, seen])
        cn0 = 36.0 + 12.0 * np.sin(elevation) - 20.0 * np.log10(distance[seen] / 23e6) + 1.5 * wave - loss_db
        hidden = covered | (elevation < radians(mask_deg)) | (cn0 < TRACKED_DB_HZ)
        used = ~hidden & (cn0 >= MIN_DB_HZ)
        weakness = 10.0 ** (np.maximum(0.0, REFERENCE_DB_HZ - cn0) / 20.0)
        slow, white = self._errors(time_s)[:, seen]
        error = SLOW_SD_M * slow + NOISE_SD_M * weakness / np.sin(elevation) * white
        residual = self.split(error, self._system[seen], used, elevation, azimuth)[1]
        return Sky(
            seen,
            self._system[seen],
            self._number[seen],
            np.degrees(elevation),
            np.degrees(azimuth),
            np.where(hidden, 0.0, cn0),
            residual,
            used,
            dilution(elevation[used], azimuth[used]),
        )

    def split(
        self,
        error: FloatArray,
        system: npt.NDArray[np.intp],
        used: BoolArray,
        elevation: FloatArray,
        azimuth: FloatArray,
        *,
        one_clock: bool = False,
    ) -> tuple[FloatArray, FloatArray]:
        """Divide errors of pseudoranges into the shift of position and clocks, and what stays in the residuals.

        Parameters
        ----------
        error : ndarray, shape (n,)
            [m] Of each satellite.
        system, used, elevation, azimuth : ndarray, shape (n,)
            The satellites, angles in rad.
        one_clock : bool
            Whether all constellations have the same clock, as they have for range-rates.

        Returns
        -------
        tuple of ndarray, of shapes (3,) and (n,)
            [m, NED] Shift of the position; [m] residuals, 0 for satellites that are not used.

        Notes
        -----
        With H = [-u, clocks] of the used satellites of GPS and Galileo, one clock column for each constellation::

            shift = H^+ error,    residual = (I - H H^+) error

        The other constellations have the clock that leaves no mean residual.
        """
        shift: FloatArray = np.zeros(3)
        residual = np.zeros_like(error)
        solved = used & np.isin(system, self.navigation_systems)
        if solved.any():
            H = _design(elevation[solved], azimuth[solved])
            if not one_clock:
                clocks = system[solved, np.newaxis] == np.unique(system[solved])
                H = np.hstack([H[:, :3], clocks.astype(np.float64)])
            solution = np.linalg.lstsq(H, error[solved], rcond=None)[0].astype(np.float64, copy=False)
            shift, residual[solved] = solution[:3], error[solved] - H @ solution
        for other in np.unique(system[used & ~solved]):
            rows = used & (system == other)
            residual[rows] = error[rows] - error[rows].mean()
        return shift, residual

    def _errors(self, time_s: float) -> FloatArray:
        """Slow and white errors of unit standard deviation of all satellites, shape (2, m): functions of time alone.

        The slow one passes from one normally distributed number to the next within `SLOW_S`::

            x(t) = cos(pi f / 2) g_k + sin(pi f / 2) g_k+1,    k + f = t / SLOW_S
        """
        knot, share = divmod(time_s, SLOW_S)
        angle = 0.5 * pi * share / SLOW_S
        slow = cos(angle) * self._knot(0, int(knot)) + sin(angle) * self._knot(0, int(knot) + 1)
        return np.stack([slow, self._knot(1, round(time_s * 1e3))])

    def _draw(self, kind: int, index: int) -> FloatArray:
        return np.random.default_rng((*self._seed, kind, index % 2**63)).standard_normal(len(self._number))

    def _directions(self, time_s: float, place: Geodetic) -> tuple[FloatArray, FloatArray, FloatArray]:
        of = self.orbits.broadcast(time_s)
        satellite_e = self.orbits.position_e(of, np.array(time_s - of.toe_s), np.arange(len(self._number)))
        sight_n = (satellite_e - ecef_from_geodetic(place)) @ ned_from_ecef(place.latitude, place.longitude).T
        distance = np.linalg.norm(sight_n, axis=1)
        azimuth = np.arctan2(sight_n[:, 1], sight_n[:, 0]) % (2.0 * pi)
        return distance, np.arcsin(-sight_n[:, 2] / distance), azimuth


def dilution(elevation: FloatArray, azimuth: FloatArray) -> Dop:
    """Dilution of precision of the used satellites.

    Parameters
    ----------
    elevation, azimuth : ndarray, shape (n,)
        [rad] Directions of the satellites.

    Returns
    -------
    Dop
        All 99.99 with fewer than four satellites.

    Notes
    -----
    With u the unit vectors to the satellites in NED, and H = [-u, 1]::

        (n², e², v², t²) = diag( (H' H)^-1 )
    """
    if len(elevation) < 4:
        return Dop(UNKNOWN_DOP, UNKNOWN_DOP, UNKNOWN_DOP, UNKNOWN_DOP)
    H = _design(elevation, azimuth)
    variances = np.diag(np.linalg.pinv(H.T @ H)).tolist()
    north, east, vertical, time = (min(UNKNOWN_DOP, sqrt(max(0.0, v))) for v in variances)
    return Dop(north, east, vertical, time)


def _design(elevation: FloatArray, azimuth: FloatArray) -> FloatArray:
    """H = [-u, 1] with u in NED axes, shape (n, 4)."""
    level = np.cos(elevation)
    return np.column_stack([-level * np.cos(azimuth), -level * np.sin(azimuth), np.sin(elevation), np.ones_like(level)])

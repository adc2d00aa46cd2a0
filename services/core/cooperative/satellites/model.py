"""From a raw epoch and ephemerides to linearised observations: geometry, delays and standard deviations.

::

    rho + c dt_s = |R(w tau) s - r| + c dt_constellation + I + T + v

with the satellite s at its time of transmission, turned by R through the Earth's rotation during the flight time tau.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import hypot, isfinite, radians, sin

import numpy as np

from shared.maths.earth import Geodetic, geodetic_from_ecef, ned_from_ecef
from shared.maths.ellipsoid import SEMI_MAJOR_AXIS
from shared.maths.gnss_signals import (
    EARTH_RATE,
    L1_FREQUENCY,
    SECONDS_PER_DAY,
    SPEED_OF_LIGHT,
    Klobuchar,
    klobuchar_delay_m,
    saastamoinen_zenith_m,
    troposphere_mapping,
)
from shared.maths.rotation import Vector

from ..broadcast.ephemeris import Ephemeris, SatelliteState, satellite_state
from ..broadcast.store import EphemerisStore
from ..measurements import FloatArray, Measurement, RawEpoch, SatelliteId

WAVELENGTH = SPEED_OF_LIGHT / L1_FREQUENCY  # [m]
MIN_PSEUDORANGE, MAX_PSEUDORANGE = 1.5e7, 4.5e7  # [m] medium orbits are 19,000 to 29,000 km away; the clock adds some
TYPICAL_FLIGHT_S = 0.075
MAX_DOPPLER = 50_000.0  # [Hz] orbit, vehicle and an oscillator that is 20 ppm off
LOWEST, HIGHEST = -2_000.0, 100_000.0  # [m] heights at which the delays of the atmosphere are evaluated


@dataclass(frozen=True)
class ErrorModel:
    """Standard deviations of pseudoranges and Doppler, and the limits of what is used."""

    elevation_mask_rad: float = radians(10.0)
    min_cn0_db_hz: float = 25.0
    signal_in_space_sd_m: float = 1.0
    zenith_troposphere_sd_m: float = 0.12  # RTCA DO-229D, A.4.2.4
    ionosphere_fraction: float = 0.3  # sd over the delay that the Klobuchar model gives, which removes half or more
    # Without coefficients the model gives its night-time delay. By day it is several times that, but most of the
    # difference is common to all satellites or looks like height: the residuals show about a tenth of it.
    unknown_ionosphere_fraction: float = 1.0
    code_sd_m: float = 0.4  # noise and multipath at the zenith; grows as 1/sin(elevation)
    range_rate_sd_m_s: float = 0.1
    reference_cn0_db_hz: float = 45.0  # below it, the noise grows: `noise_factor`


@dataclass(frozen=True)
class SatelliteMeasurement:
    """A usable measurement with its satellite at the time of transmission; the satellite's clock is removed."""

    satellite: SatelliteId
    pseudorange: float  # [m]
    range_rate: float | None  # [m/s]
    cn0: float | None  # [dB-Hz]
    position_e: Vector
    velocity_e: Vector


def usable_sights(
    epoch: RawEpoch, store: EphemerisStore, model: ErrorModel
) -> tuple[tuple[SatelliteMeasurement, ...], dict[str, int]]:
    """Pair each measurement with its satellite's state.

    Parameters
    ----------
    epoch : RawEpoch
        Measurements of one reception time.
    store : EphemerisStore
        Broadcast ephemerides.
    model : ErrorModel
        Limits.

    Returns
    -------
    tuple of Sight, dict of str to int
        What can be used, and how many measurements cannot, by reason.
    """
    sights: dict[SatelliteId, SatelliteMeasurement] = {}
    rejected: dict[str, int] = {}
    for measurement in epoch.measurements:
        sight = _sight(measurement, epoch.gps_time_ns, store, model)
        if isinstance(sight, SatelliteMeasurement) and measurement.satellite in sights:
            sight = "duplicate_satellite"
        if isinstance(sight, SatelliteMeasurement):
            sights[measurement.satellite] = sight
        else:
            rejected[sight] = rejected.get(sight, 0) + 1
    return tuple(sights.values()), rejected


def _sight(
    measurement: Measurement, gps_time_ns: int, store: EphemerisStore, model: ErrorModel
) -> SatelliteMeasurement | str:
    pseudorange, doppler, cn0 = measurement.pseudorange_m, measurement.doppler_hz, measurement.cn0_db_hz
    if not MIN_PSEUDORANGE < pseudorange < MAX_PSEUDORANGE:
        return "implausible_pseudorange"
    if cn0 is not None and not cn0 >= model.min_cn0_db_hz:
        return "weak_signal"
    ephemeris = store.select(measurement.satellite, gps_time_ns)
    if isinstance(ephemeris, str):
        return ephemeris
    state = at_transmission(ephemeris, pseudorange, gps_time_ns)
    range_rate = None
    if doppler is not None and isfinite(doppler) and abs(doppler) < MAX_DOPPLER:
        range_rate = -WAVELENGTH * doppler + SPEED_OF_LIGHT * state.clock_drift
    corrected = pseudorange + SPEED_OF_LIGHT * state.clock_s
    return SatelliteMeasurement(measurement.satellite, corrected, range_rate, cn0, state.position_e, state.velocity_e)


def at_transmission(ephemeris: Ephemeris, pseudorange: float, gps_time_ns: int) -> SatelliteState:
    """State of a satellite when it sent what is received at a time by the receiver's clock, by the pseudorange [m].

    The pseudorange ends at the satellite's own clock, group delay included for this signal.
    """
    flight_s = pseudorange / SPEED_OF_LIGHT
    clock_s = satellite_state(ephemeris, gps_time_ns, flight_s).clock_s
    return satellite_state(ephemeris, gps_time_ns, flight_s + clock_s)


@dataclass(frozen=True)
class Geometry:
    """Observations linearised at a position; rows belong to the sights in their order."""

    position_e: FloatArray  # [m, ECEF] shape (3,)
    ned_from_ecef: FloatArray  # shape (3, 3)
    line_of_sight_n: FloatArray  # [-, NED] shape (n, 3), receiver to satellite
    distance: FloatArray  # [m] shape (n,), Earth rotation included
    delay: FloatArray  # [m] shape (n,), ionosphere and troposphere
    ionosphere: FloatArray  # [m] shape (n,), that part of it; a carrier phase has it with the other sign
    sd: FloatArray  # [m] shape (n,)
    noise_sd: FloatArray  # [m] shape (n,), the part of it that is white from epoch to epoch
    elevation: FloatArray  # [rad] shape (n,)
    azimuth: FloatArray  # [rad] shape (n,)
    satellite_velocity_n: FloatArray  # [m/s] shape (n, 3), of the ECEF frame in NED axes


@dataclass(frozen=True)
class Sky:
    """What the model of one epoch needs besides the position."""

    sights: tuple[SatelliteMeasurement, ...]
    gps_time_ns: int
    ionosphere: Klobuchar | None
    model: ErrorModel

    def geometry(self, position_e: FloatArray) -> Geometry:
        """Linearise at a position.

        Parameters
        ----------
        position_e : ndarray, shape (3,)
            [m, ECEF] Away from the Earth's centre.
        """
        satellites = np.array([sight.position_e for sight in self.sights])
        velocities = np.array([sight.velocity_e for sight in self.sights])
        flight_s = np.linalg.norm(satellites - position_e, axis=1) / SPEED_OF_LIGHT
        away = turned(satellites, EARTH_RATE * flight_s) - position_e
        distance = np.linalg.norm(away, axis=1)
        x, y, z = position_e.tolist()
        place = geodetic_from_ecef((x, y, z))
        to_ned = ned_from_ecef(place.latitude, place.longitude)
        sight_n = away / distance[:, np.newaxis] @ to_ned.T
        elevation = np.arcsin(np.clip(-sight_n[:, 2], -1.0, 1.0))
        azimuth = np.arctan2(sight_n[:, 1], sight_n[:, 0])
        delay, ionosphere, sd, noise_sd = self._delays(place, elevation, azimuth)
        velocity_n = turned(velocities, EARTH_RATE * flight_s) @ to_ned.T
        return Geometry(
            position_e, to_ned, sight_n, distance, delay, ionosphere, sd, noise_sd, elevation, azimuth, velocity_n
        )  # fmt: skip

    def _delays(self, place: Geodetic, elevation: FloatArray, azimuth: FloatArray) -> FloatArray:
        """Delay, that of the ionosphere, sd and sd of the noise [m], shape (4, n); below the mask as at the mask."""
        rows = []
        second_of_day = self.gps_time_ns * 1e-9 % SECONDS_PER_DAY
        at_height = Geodetic(place.latitude, place.longitude, min(max(place.height, LOWEST), HIGHEST))
        zenith = saastamoinen_zenith_m(at_height.latitude, at_height.height)
        model = self.model
        fraction = model.ionosphere_fraction if self.ionosphere else model.unknown_ionosphere_fraction
        for sight, up, towards in zip(self.sights, elevation.tolist(), azimuth.tolist(), strict=True):
            el = max(up, model.elevation_mask_rad)
            ionosphere = klobuchar_delay_m(
                self.ionosphere, at_height, elevation=el, azimuth=towards, second_of_day=second_of_day
            )
            mapping = troposphere_mapping(el)
            noise = model.code_sd_m * noise_factor(sight.cn0, model) / sin(el)
            parts = (
                model.signal_in_space_sd_m,
                fraction * ionosphere,
                model.zenith_troposphere_sd_m * mapping,
            )
            rows.append((ionosphere + zenith * mapping, ionosphere, hypot(*parts, noise), noise))
        return np.array(rows).T


def noise_factor(cn0: float | None, model: ErrorModel) -> float:
    """Growth of noise with a weak signal: 10^((reference - C/N0)/20), not below 1; 1 where it is not known."""
    return 1.0 if cn0 is None else float(10.0 ** (max(0.0, model.reference_cn0_db_hz - cn0) / 20.0))


def turned(vectors_e: FloatArray, angles: FloatArray) -> FloatArray:
    """Turn vectors, shape (n, 3), into ECEF axes that have turned with the Earth by angles [rad], shape (n,)."""
    c, s = np.cos(angles), np.sin(angles)
    x, y, z = vectors_e.T
    return np.column_stack([c * x + s * y, c * y - s * x, z])


def rough_position(sights: tuple[SatelliteMeasurement, ...]) -> FloatArray:
    """Point of the Earth's surface [m, ECEF] below the mean of the satellites: where a solution may start from."""
    mean = np.mean([sight.position_e for sight in sights], axis=0)
    start: FloatArray = mean / max(float(np.linalg.norm(mean)), 1.0) * SEMI_MAJOR_AXIS
    return start


def clock_columns(sights: tuple[SatelliteMeasurement, ...]) -> tuple[FloatArray, Mapping[str, int]]:
    """One column of ones and zeros for each constellation, shape (n, c), and the column of each."""
    column: dict[str, int] = {}
    for sight in sights:
        column.setdefault(sight.satellite.constellation, len(column))
    design = np.zeros((len(sights), len(column)))
    for row, sight in enumerate(sights):
        design[row, column[sight.satellite.constellation]] = 1.0
    return design, column


def virtual_sights(
    store: EphemerisStore, gps_time_ns: int, received: frozenset[SatelliteId]
) -> tuple[SatelliteMeasurement, ...]:
    """Satellites whose ephemeris is valid although they are not received; pseudorange 0."""
    found = []
    for satellite in store.satellites():
        ephemeris = store.select(satellite, gps_time_ns)
        if satellite in received or isinstance(ephemeris, str):
            continue
        state = satellite_state(ephemeris, gps_time_ns, TYPICAL_FLIGHT_S)
        found.append(SatelliteMeasurement(satellite, 0.0, None, None, state.position_e, state.velocity_e))
    return tuple(found)

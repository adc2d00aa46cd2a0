"""Pseudoranges and Doppler of which least squares are the receiver's fix, and carrier phases of the antenna's path.

The errors of a fix are those of pseudoranges: metres. A phase follows the antenna itself, with millimetres of noise.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.maths.earth import Geodetic, ecef_from_geodetic, ned_from_ecef
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

from .orbits import Broadcast, Orbits
from .reception import Fix
from .sky import Sky, SkyModel

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]

# Multiples of the units in which the coefficients are broadcast.
IONOSPHERE = Klobuchar(
    (12 * 2.0**-30, 2 * 2.0**-27, -1 * 2.0**-24, -1 * 2.0**-24),
    (43 * 2.0**11, 1 * 2.0**14, -3 * 2.0**16, -2 * 2.0**16),
)
CLOCK_DRIFT = 50e-9  # [s/s] of the receiver's oscillator
CLOCK_RANGE_S = 1e-3  # the receiver keeps its clock within half of it of GPS time, by jumps
GALILEO_OFFSET_M = 6.0  # of Galileo system time and the receiver's delays
WAVELENGTH = SPEED_OF_LIGHT / L1_FREQUENCY  # [m]
FLIGHT_S, FLIGHT_ROUNDS = 0.075, 4
PHASE_NOISE_M, MIN_SINE = 0.0015, 0.1  # standard deviation at the zenith; it grows as 1/sin(elevation)
HALF_STEP_S = 0.5  # of the difference quotient that is the range-rate: right to 1e-6 m/s


@dataclass(frozen=True)
class RawMeasurements:
    """What the receiver measures of n satellites on L1 and E1 at one time."""

    gps_s: float  # [s] by the receiver's clock
    satellite: IntArray  # shape (n,) index into the satellites of the model
    gnss_id: IntArray  # shape (n,) as in UBX messages
    number: IntArray  # shape (n,) within the constellation
    pseudorange_m: FloatArray  # shape (n,)
    carrier_cycles: FloatArray  # shape (n,)
    doppler_hz: FloatArray  # shape (n,) positive while the satellite approaches
    cn0_db_hz: FloatArray  # shape (n,)


def clock_bias_s(gps_s: float) -> float:
    """Compute how far the receiver's clock is ahead of a GPS time [s]."""
    return (CLOCK_DRIFT * gps_s) % CLOCK_RANGE_S - CLOCK_RANGE_S / 2.0


@dataclass(frozen=True)
class Phases:
    """What the carrier phases follow."""

    antenna: Geodetic  # of the signals: the antenna's own place, or where an attack says that it is
    noise: FloatArray  # shape (n,) of unit variance, one for each satellite of a sky


@dataclass(frozen=True)
class RangeErrors:
    """What attacks add to the pseudoranges of the n satellites of a sky."""

    error_m: FloatArray  # shape (n,)
    rate_m_s: FloatArray  # shape (n,) its derivative


def measure(model: SkyModel, sky: Sky, fix: Fix, gps_s: float, added: RangeErrors, phases: Phases) -> RawMeasurements:
    """Measure all satellites of GPS and Galileo that are used; none where there is no fix.

    Parameters
    ----------
    model : SkyModel
        The satellites.
    sky : Sky
        Which of them are used, and the residuals.
    fix : Fix
        Position and velocity of the receiver, errors included, but not what `added` makes of them.
    gps_s : float
        [s] GPS time of the measurement, as the signals state it.
    added : RangeErrors
        Errors of attacks.
    phases : Phases
        What the carrier phases follow.

    Returns
    -------
    RawMeasurements
        Pseudoranges are those to the reported position, and their rates those of the reported velocity. Residuals are
        orthogonal to position and clock (`sky.residuals`), so that least squares return the fix.
    """
    used = sky.used & np.isin(sky.system, model.navigation_systems) & fix.valid
    satellite = sky.satellite[used]
    place = fix.position
    to_ned = ned_from_ecef(place.latitude, place.longitude)
    here, velocity = np.array(ecef_from_geodetic(place)), to_ned.T @ np.array(fix.velocity_n)
    of = model.orbits.broadcast(gps_s)
    after_s = gps_s - of.toe_s
    away = _line_of_sight(model.orbits, of, satellite, after_s, here)
    later, earlier = (
        np.linalg.norm(_line_of_sight(model.orbits, of, satellite, after_s + dt, here + dt * velocity), axis=1)
        for dt in (HALF_STEP_S, -HALF_STEP_S)
    )
    distance = np.linalg.norm(away, axis=1)
    ionosphere, troposphere = _delays(away / distance[:, np.newaxis] @ to_ned.T, place, gps_s)
    bias_s = clock_bias_s(gps_s)
    clock = SPEED_OF_LIGHT * (bias_s - model.orbits.clock_s[satellite] + model.orbits.group_delay_s)
    clock += np.where(sky.system[used] == model.names.index("gps"), 0.0, GALILEO_OFFSET_M)
    clock += added.error_m[used]
    rate = (later - earlier) / (2.0 * HALF_STEP_S) + SPEED_OF_LIGHT * CLOCK_DRIFT + added.rate_m_s[used]
    at_antenna = _line_of_sight(model.orbits, of, satellite, after_s, np.array(ecef_from_geodetic(phases.antenna)))
    sine = np.maximum(np.sin(np.radians(sky.elevation_deg[used])), MIN_SINE)
    phase_range = np.linalg.norm(at_antenna, axis=1) + PHASE_NOISE_M * phases.noise[used] / sine
    return RawMeasurements(
        gps_s + bias_s,
        satellite,
        np.array([row.gnss_id for row in model.rows])[sky.system[used]],
        sky.number[used],
        distance + clock + troposphere + ionosphere + sky.residual_m[used],
        (phase_range + clock + troposphere - ionosphere) / WAVELENGTH + 1000.0 * satellite,  # any whole number does
        -rate / WAVELENGTH,
        sky.cn0_db_hz[used],
    )


def _line_of_sight(orbits: Orbits, of: Broadcast, satellite: IntArray, after_s: float, here: FloatArray) -> FloatArray:
    """Vectors [m, ECEF at reception] from the receiver to the satellites at transmission, shape (n, 3)."""
    flight_s = np.full(len(satellite), FLIGHT_S)
    for _ in range(FLIGHT_ROUNDS):
        x, y, z = orbits.position_e(of, after_s - flight_s, satellite).T
        c, s = np.cos(EARTH_RATE * flight_s), np.sin(EARTH_RATE * flight_s)
        away: FloatArray = np.column_stack([c * x + s * y, c * y - s * x, z]) - here
        flight_s = np.linalg.norm(away, axis=1) / SPEED_OF_LIGHT
    return away


def _delays(sight_n: FloatArray, place: Geodetic, gps_s: float) -> tuple[FloatArray, FloatArray]:
    """Ionospheric and tropospheric delays [m], shape (n,) each."""
    zenith = saastamoinen_zenith_m(place.latitude, place.height)
    elevation, azimuth = np.arcsin(-sight_n[:, 2]), np.arctan2(sight_n[:, 1], sight_n[:, 0])
    ionosphere = [
        klobuchar_delay_m(IONOSPHERE, place, elevation=up, azimuth=towards, second_of_day=gps_s % SECONDS_PER_DAY)
        for up, towards in zip(elevation.tolist(), azimuth.tolist(), strict=True)
    ]
    return np.array(ionosphere), np.array([zenith * troposphere_mapping(up) for up in elevation.tolist()])

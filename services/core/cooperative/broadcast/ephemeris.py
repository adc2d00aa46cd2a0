"""Satellite position, velocity and clock from a broadcast Keplerian ephemeris (GPS LNAV and Galileo I/NAV).

References
----------
IS-GPS-200N, tables 20-III and 20-IV and sections 20.3.3.3.3 and 20.3.3.4.3; Galileo OS SIS ICD 2.1, section 5.1.
"""

from dataclasses import dataclass
from math import atan2, copysign, cos, pi, sin, sqrt
from types import MappingProxyType
from typing import NamedTuple

from shared.maths.gnss_signals import EARTH_RATE, SPEED_OF_LIGHT
from shared.maths.rotation import Vector

from ..measurements import WEEK_NS, Constellation, SatelliteId

MU = MappingProxyType(
    {
        Constellation.GPS: 3.986005e14,  # [m³/s²] IS-GPS-200N, table 20-IV
        Constellation.GALILEO: 3.986004418e14,  # [m³/s²] Galileo OS SIS ICD 2.1, table 58
    }
)
MAX_AGE_S = MappingProxyType(
    {
        Constellation.GPS: 7200.0,  # half of the 4 h fit interval: IS-GPS-200N, 20.3.4.4
        Constellation.GALILEO: 14400.0,  # Galileo OS service definition document 1.3, section 2.3.2
    }
)
KEPLER_ROUNDS = 30


@dataclass(frozen=True)
class Ephemeris:
    """Broadcast orbit and clock of one satellite; angles [rad], lengths [m], times [s] and GPS time [ns]."""

    satellite: SatelliteId
    issue: int  # IODE or IODnav
    toe_ns: int
    toc_ns: int
    sqrt_a: float
    eccentricity: float
    mean_anomaly: float
    mean_motion_difference: float
    node: float  # longitude of the ascending node at the start of the week
    node_rate: float
    inclination: float
    inclination_rate: float
    perigee: float
    cuc: float
    cus: float
    crc: float
    crs: float
    cic: float
    cis: float
    clock: tuple[float, float, float]  # af0 [s], af1 [s/s], af2 [s/s²]
    group_delay_s: float  # TGD (GPS) or BGD E1-E5b (Galileo)
    healthy: bool
    accuracy_m: float | None = None  # URA or SISA; None where the satellite predicts none


class SatelliteState(NamedTuple):
    """A satellite at its time of transmission, in the ECEF axes of that time."""

    position_e: Vector  # [m]
    velocity_e: Vector  # [m/s]
    clock_s: float  # offset for a single-frequency L1/E1 user
    clock_drift: float  # [s/s]


def eccentric_anomaly(mean_anomaly: float, eccentricity: float) -> float:
    """Solve Kepler's equation E - e sin E = M for E [rad] by Newton's method; |M| <= pi where e >= 0.8.

    Raises
    ------
    ValueError
        The eccentricity is not that of an ellipse.
    """
    if not 0.0 <= eccentricity < 1.0:
        raise ValueError(f"eccentricity {eccentricity} is not that of an ellipse")
    anomaly = mean_anomaly if eccentricity < 0.8 else copysign(pi, mean_anomaly)
    for _ in range(KEPLER_ROUNDS):
        step = (anomaly - eccentricity * sin(anomaly) - mean_anomaly) / (1.0 - eccentricity * cos(anomaly))
        anomaly -= step
        if abs(step) < 1e-14:
            break
    return anomaly


def satellite_state(ephemeris: Ephemeris, gps_time_ns: int, delay_s: float = 0.0) -> SatelliteState:
    """Compute a satellite's position, velocity and clock at a system time t = gps_time - delay.

    Parameters
    ----------
    ephemeris : Ephemeris
        Broadcast elements; their age is not judged here.
    gps_time_ns : int
        [ns] GPS time; integer, so that nothing is lost to rounding.
    delay_s : float
        [s] Time by which transmission was earlier.

    Returns
    -------
    SatelliteState
        The clock includes the relativistic correction and the group delay.

    Notes
    -----
    ::

        n = sqrt(mu/a³) + dn,  M = M0 + n t,  E - e sin E = M,  v = atan2(sqrt(1-e²) sin E, cos E - e)
        phi = v + w,  u = phi + du,  r = a (1 - e cos E) + dr,  i = i0 + di + i' t
        Omega = Omega0 + (Omega' - w_e) t - w_e toe
        clock = af0 + af1 t + af2 t² + F e sqrt(a) sin E - TGD,   F = -2 sqrt(mu)/c²

    The velocity is the exact derivative.
    """
    e, a = ephemeris.eccentricity, ephemeris.sqrt_a**2
    mu = MU[ephemeris.satellite.constellation]
    t = (gps_time_ns - ephemeris.toe_ns) * 1e-9 - delay_s
    mean_motion = sqrt(mu / a**3) + ephemeris.mean_motion_difference
    E = eccentric_anomaly(ephemeris.mean_anomaly + mean_motion * t, e)
    E_rate = mean_motion / (1.0 - e * cos(E))
    position_e, velocity_e = _orbit(ephemeris, t, E, E_rate)

    relativity = -2.0 * sqrt(mu) / SPEED_OF_LIGHT**2 * e * ephemeris.sqrt_a
    since = (gps_time_ns - ephemeris.toc_ns) * 1e-9 - delay_s
    af0, af1, af2 = ephemeris.clock
    clock = af0 + af1 * since + af2 * since**2 + relativity * sin(E) - ephemeris.group_delay_s
    drift = af1 + 2.0 * af2 * since + relativity * cos(E) * E_rate
    return SatelliteState(position_e, velocity_e, clock, drift)


def _orbit(ephemeris: Ephemeris, t: float, E: float, E_rate: float) -> tuple[Vector, Vector]:
    """ECEF position [m] and velocity [m/s] from the eccentric anomaly E [rad] and its rate."""
    e, a = ephemeris.eccentricity, ephemeris.sqrt_a**2
    phi = atan2(sqrt(1.0 - e * e) * sin(E), cos(E) - e) + ephemeris.perigee
    phi_rate = sqrt(1.0 - e * e) * E_rate / (1.0 - e * cos(E))
    c2, s2 = cos(2.0 * phi), sin(2.0 * phi)
    u = phi + ephemeris.cus * s2 + ephemeris.cuc * c2
    u_rate = phi_rate * (1.0 + 2.0 * (ephemeris.cus * c2 - ephemeris.cuc * s2))
    r = a * (1.0 - e * cos(E)) + ephemeris.crs * s2 + ephemeris.crc * c2
    r_rate = a * e * sin(E) * E_rate + 2.0 * phi_rate * (ephemeris.crs * c2 - ephemeris.crc * s2)
    i = ephemeris.inclination + ephemeris.inclination_rate * t + ephemeris.cis * s2 + ephemeris.cic * c2
    i_rate = ephemeris.inclination_rate + 2.0 * phi_rate * (ephemeris.cis * c2 - ephemeris.cic * s2)
    toe_s = ephemeris.toe_ns % WEEK_NS * 1e-9
    node_rate = ephemeris.node_rate - EARTH_RATE
    node = ephemeris.node + node_rate * t - EARTH_RATE * toe_s

    x, y = r * cos(u), r * sin(u)
    x_rate, y_rate = r_rate * cos(u) - y * u_rate, r_rate * sin(u) + x * u_rate
    cn, sn, ci, si = cos(node), sin(node), cos(i), sin(i)
    position = (x * cn - y * ci * sn, x * sn + y * ci * cn, y * si)
    across = y_rate * ci - y * si * i_rate  # derivative of y cos i
    velocity = (
        x_rate * cn - across * sn - position[1] * node_rate,
        x_rate * sn + across * cn + position[0] * node_rate,
        y_rate * si + y * ci * i_rate,
    )
    return position, velocity


def age_s(ephemeris: Ephemeris, gps_time_ns: int) -> float:
    """Time [s] between an instant and the ephemeris's reference time, never negative."""
    return abs(gps_time_ns - ephemeris.toe_ns) * 1e-9

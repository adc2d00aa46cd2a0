"""Constants of L1 and E1, and their delays: ionosphere (Klobuchar), troposphere (Saastamoinen, standard atmosphere)."""

from dataclasses import dataclass
from math import cos, exp, log1p, pi, sin, sqrt

from .earth import Geodetic

SPEED_OF_LIGHT = 299792458.0  # [m/s] exact, by definition (17th CGPM, 1983)
L1_FREQUENCY = 1575.42e6  # [Hz] GPS L1 and Galileo E1: IS-GPS-200 and Galileo OS SIS ICD
EARTH_RATE = 7.2921151467e-5  # [rad/s] IS-GPS-200N, table 20-IV; rounded like WGS-84's, an orbit would be 24 m off
NIGHT_DELAY_S = 5e-9  # IS-GPS-200N, 20.3.3.5.2.5
GEOMAGNETIC_POLE_LONGITUDE = 1.617  # [semicircles] IS-GPS-200N, figure 20-4
SECONDS_PER_DAY = 86400
RELATIVE_HUMIDITY = 0.7  # [-] of the standard atmosphere, which leaves it open


@dataclass(frozen=True)
class Klobuchar:
    """Coefficients of the broadcast ionosphere model: alpha [s/semicircle^k] and beta [s/semicircle^k]."""

    alpha: tuple[float, float, float, float]
    beta: tuple[float, float, float, float]


NO_COEFFICIENTS = Klobuchar((0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0))


def klobuchar_delay_m(
    coefficients: Klobuchar | None, place: Geodetic, *, elevation: float, azimuth: float, second_of_day: float
) -> float:
    """Compute the ionospheric delay [m] of L1, positive.

    Parameters
    ----------
    coefficients : Klobuchar or None
        Broadcast coefficients; None leaves the constant night-time delay of the model, which is the least it gives.
    place : Geodetic
        [rad, rad, m] The receiver's position.
    elevation, azimuth : float
        [rad] Of the satellite.
    second_of_day : float
        [s] GPS time modulo one day.

    Notes
    -----
    All angles in semicircles; at the pierce point (phi_i, lambda_i) with geomagnetic latitude phi_m::

        psi = 0.0137/(E + 0.11) - 0.022,  phi_i = phi + psi cos A (within ±0.416)
        lambda_i = lambda + psi sin A/cos phi_i
        phi_m = phi_i + 0.064 cos(lambda_i - 1.617),  t = 43200 lambda_i + t_gps,  F = 1 + 16 (0.53 - E)³
        x = 2 pi (t - 50400)/PER,  delay = F [5 ns + AMP (1 - x²/2 + x⁴/24)] where |x| < 1.57, else F 5 ns

    References
    ----------
    IS-GPS-200N, 20.3.3.5.2.5.
    """
    known = coefficients or NO_COEFFICIENTS
    E = elevation / pi
    psi = 0.0137 / (E + 0.11) - 0.022
    latitude = min(max(place.latitude / pi + psi * cos(azimuth), -0.416), 0.416)
    longitude = place.longitude / pi + psi * sin(azimuth) / cos(latitude * pi)
    magnetic = latitude + 0.064 * cos((longitude - GEOMAGNETIC_POLE_LONGITUDE) * pi)
    local_time = (43200.0 * longitude + second_of_day) % SECONDS_PER_DAY
    amplitude = max(0.0, sum(coefficient * magnetic**power for power, coefficient in enumerate(known.alpha)))
    period = max(72000.0, sum(coefficient * magnetic**power for power, coefficient in enumerate(known.beta)))
    x = 2.0 * pi * (local_time - 50400.0) / period
    day = amplitude * (1.0 - x**2 / 2.0 + x**4 / 24.0) if abs(x) < 1.57 else 0.0
    slant = 1.0 + 16.0 * (0.53 - E) ** 3
    return SPEED_OF_LIGHT * slant * (NIGHT_DELAY_S + day)


def saastamoinen_zenith_m(latitude: float, height_m: float) -> float:
    """Compute the tropospheric delay [m] of the standard atmosphere towards the zenith, about 2.4 m at sea level.

    Notes
    -----
    With pressure P [hPa], temperature T [K] and water vapour pressure e [hPa] of the standard atmosphere::

        delay = 0.0022768 P/(1 - 0.00266 cos 2L - 0.00028 h/km) + 0.002277 (1255/T + 0.05) e

    References
    ----------
    J. Saastamoinen, "Contributions to the theory of atmospheric refraction", Bulletin Géodésique 105-107, 1972-73;
    ISO 2533:1975.
    """
    height = min(max(height_m, -500.0), 11000.0)  # where the standard atmosphere's gradient is constant
    pressure = 1013.25 * exp(5.25588 * log1p(-2.25577e-5 * height))
    temperature = 288.15 - 0.0065 * height
    vapour = 6.108 * RELATIVE_HUMIDITY * exp((17.15 * temperature - 4684.0) / (temperature - 38.45))
    dry = 0.0022768 * pressure / (1.0 - 0.00266 * cos(2.0 * latitude) - 0.00028 * height / 1000.0)
    return dry + 0.002277 * (1255.0 / temperature + 0.05) * vapour


def troposphere_mapping(elevation: float) -> float:
    """Ratio of the slant to the zenith delay of the troposphere, valid down to 4°: RTCA DO-229D, A.4.2.4."""
    return 1.001 / sqrt(0.002001 + sin(elevation) ** 2)

"""Deterministic speed profiles in km/h over seconds, fitted so that the published break-points come about."""

from math import floor, pi, sin

import numpy as np

PERIOD_S = 10
Vertices = list[tuple[float, float]]


def triangle(start_s: float, end_s: float, half_s: float, low: float, high: float) -> Vertices:
    """Vertices of a triangular wave that starts at its lowest value, up to and including `end_s`."""
    count = floor((end_s - start_s) / half_s + 1e-9)
    return [(start_s + k * half_s, high if k % 2 else low) for k in range(count + 1)]


INTERCHANGE: Vertices = [
    (1840, 20), (1850, 20), (1895, 101), (1915, 65), (1940, 110), (1960, 74),
    (1980, 110), (2015, 119),
]  # fmt: skip
HIGHWAY = triangle(0, 1785, 35, 105, 119) + INTERCHANGE + triangle(2050, 3605, 35, 105, 119)
URBAN = triangle(0, 1822.5, 22.5, 10.5, 55.5)
PROFILES = {"highway": (HIGHWAY, 3600), "urban": (URBAN, 1800)}


class Drive:
    """A profile as GNSS and odometer measure it."""

    def __init__(self, name: str) -> None:
        vertices, self.duration_s = PROFILES[name]
        self._times, self._speeds = np.array(vertices).T
        self.times_s = range(0, self.duration_s + 1, PERIOD_S)

    def speed(self, time_s: float) -> float:
        """True speed [km/h]."""
        return float(np.interp(time_s, self._times, self._speeds))

    def odometer(self, time_s: float, scale: float = 1.0) -> float:
        """Odometer [km/h]: read 0.25 s after the sample time, rounded half up to 1 km/h."""
        return float(min(255, max(0, floor(scale * self.speed(time_s + 0.25) + 0.5))))

    def gnss(self, time_s: float) -> float:
        """GNSS speed [km/h] with a periodic error of 0.15 km/h."""
        return self.speed(time_s) + 0.15 * sin(2.0 * pi * time_s / 7.3)

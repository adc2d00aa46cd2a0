"""Yaw rate by the two wheels of an axle; track width and ratio of the wheels' radii are learned while driving."""

from math import exp, sqrt
from typing import NamedTuple

SECOND_S = 1.0  # over which wheel speeds are averaged
TRACK_M, TRACK_SD_M = 1.6, 0.25  # of cars and vans: 1.3 m of the smallest, 1.9 m of a light lorry
RATIO_SD = 0.01  # of the radii of left and right wheel: 3 mm of wear or pressure of 300 mm
# Random walks of both while driving, per root of an hour: tyres warm up by 30 K and 0.3 bar, unequally by a tenth.
TRACK_WALK_M, RATIO_WALK = 0.01, 5e-4
# [m/s] standard deviation of the difference of two wheels, mean of a second: to start with, and at the least. The rear
# wheels of comma_segment have 0.0026 by all samples at 89 Hz, 0.012 by ten of them; those of the simulator 0.009.
NOISE, LEAST_NOISE = 0.02, 0.002
# Error as a share of the turn. Load transfer of 3 m/s² changes rolling radii by some 0.4 % each (tyre of 200 kN/m, a
# third of its deflection), which is 8 % of the turn at 10 m/s; the learned track width holds the mean of it.
SLIP_SHARE = 0.05
CLIP = 3.0  # standard deviations, beyond which a residual loses weight
STRAIGHT_RAD_S = 0.03  # below it a residual is noise, and no slip
MEDIAN = 0.6745  # of the absolute value of a normal number of standard deviation 1
STEP = 0.05  # smallest relative change of the noise by one residual


class AxleSecond(NamedTuple):
    """Means over a second."""

    difference: float  # [m/s] left minus right wheel
    speed: float  # [m/s]


class AxleRate(NamedTuple):
    """Yaw rate over a number of seconds."""

    rate: float  # [rad/s] clockwise
    white: float  # [rad²/s²] variance of one second, of noise
    learned: float  # [rad²/s²] variance by what has been learned, common to all of them


class Axle:
    """Two parameters, track width T [m] and ratio k [-], by a Kalman filter: left minus right = T w + k v + noise."""

    def __init__(self) -> None:
        self.track_m, self.ratio = TRACK_M, 0.0
        self.noise = NOISE
        self._tt, self._tk, self._kk = TRACK_SD_M**2, 0.0, RATIO_SD**2
        self._seconds = 0

    def learn(self, second: AxleSecond, yaw_rate: float) -> None:
        """Use a second of which the yaw rate [rad/s] is known."""
        hour = SECOND_S / 3600.0
        self._tt = min(self._tt + TRACK_WALK_M**2 * hour, TRACK_SD_M**2)
        self._kk = min(self._kk + RATIO_WALK**2 * hour, RATIO_SD**2)
        w, v = yaw_rate, second.speed
        residual = second.difference - self.track_m * w - self.ratio * v
        own = self.noise**2 + (SLIP_SHARE * self.track_m * w) ** 2
        at, ak = self._tt * w + self._tk * v, self._tk * w + self._kk * v
        total = w * at + v * ak + own
        if abs(residual) > CLIP * sqrt(total):  # Huber's weight
            own *= abs(residual) / (CLIP * sqrt(total))
            total = w * at + v * ak + own
        gain_t, gain_k = at / total, ak / total
        self.track_m += gain_t * residual
        self.ratio += gain_k * residual
        self._tt, self._tk, self._kk = self._tt - gain_t * at, self._tk - gain_t * ak, self._kk - gain_k * ak
        if abs(w) < STRAIGHT_RAD_S:
            self._learn_noise(abs(residual))

    def _learn_noise(self, size: float) -> None:
        """Move the standard deviation towards that of which half of the residuals are smaller than 0.67 times."""
        self._seconds += 1
        step = max(STEP, 1.0 / self._seconds)
        self.noise = max(LEAST_NOISE, self.noise * exp(step if size > MEDIAN * self.noise else -step))

    def rate(self, second: AxleSecond) -> AxleRate:
        """Yaw rate of the mean of some seconds, with its variances but for slip."""
        T, v = self.track_m, second.speed
        w = (second.difference - self.ratio * v) / T
        learned = w * w * self._tt + 2.0 * w * v * self._tk + v * v * self._kk
        return AxleRate(w, (self.noise / T) ** 2, max(0.0, learned) / T**2)

    @property
    def sds(self) -> tuple[float, float]:
        """Standard deviations of track width [m] and ratio [-]."""
        return sqrt(self._tt), sqrt(self._kk)


def combined(rates: list[tuple[AxleRate, int]], turns: list[float]) -> tuple[float, float]:
    """Mean yaw rate [rad/s] of one or two axles over their seconds, and its variance.

    Parameters
    ----------
    rates : list of tuple
        Rate of each axle, and the number of seconds.
    turns : list of float
        [rad/s] Yaw rate of each second, of which slip falsifies a share: the same share in all of them, and another
        one in each.
    """
    weights = [1.0 / (axle_rate.white / seconds + axle_rate.learned) for axle_rate, seconds in rates]
    rate = sum(weight * axle_rate.rate for weight, (axle_rate, _) in zip(weights, rates, strict=True)) / sum(weights)
    n = len(turns)
    slip2 = (sum(turns) / n) ** 2 + sum(turn**2 for turn in turns) / n**2
    return rate, 1.0 / sum(weights) + SLIP_SHARE**2 * slip2

"""Errors that the covariance does not hold, by the statistics of innovations: their mean square and autocovariance.

u is the normalised innovation: of a consistent filter it is white and has a variance of one.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, sqrt
from typing import NamedTuple

MEMORY_S = 60.0  # time constant of the statistics
MEAN_S = 10.0  # time constant of the mean innovation
BREAK_S = 5.0  # longest interval of two innovations whose product is used in the autocovariance
MAX_VALUE = 5.0  # [-] limit of u, so that one outlier does not determine the statistics for minutes
WHITE_NOISE_SDS = 2.0  # standard deviations of the sample statistics of white noise that are no evidence
MAX_CORRELATED_RATIO = (
    1.25  # largest time-correlated variance over the mean square of u; the filter has followed a part of it
)
TRIAL_S = 20.0  # weight of the initial values, as a time of observation
MEAN_RATIO_SD = 0.5  # standard deviation of `Axis.mean_ratio` of white noise, averaged over three axes
NORMAL_QUANTILE_1E_3 = (
    3.3  # [-] quantile of a normal |u| at 1e-3: larger peaks show that the tails are heavier than normal
)
LAG_LIMIT = 4.0  # largest time-correlated variance over the lag-1 autocovariance


class Axis(NamedTuple):
    """Statistics of one axis; the initial values are those of a fully time-correlated error."""

    mean: float = 0.0  # of u over `MEAN_S`
    mean_ratio: float = 1.0  # mean square of `mean` over its variance if u is white
    mean_square: float = 1.0  # of u
    lag_1: float = 1.0  # autocovariance of u at a lag of one
    last: float = 0.0  # u
    variance: float = 0.0  # [m² or m²/s²] mean variance of the innovation by the filter
    newest: float = 0.0  # [m² or m²/s²] the newest of these variances
    peak: float = 0.0  # largest |u|, which decays with `MEMORY_S`


@dataclass(frozen=True)
class InnovationStatistics:
    """Statistics of the innovations of one kind of measurement: north, east and down."""

    time_ns: int = 0
    elapsed_s: float = 0.0  # since the first
    interval_s: float = 1.0  # between two of them
    mean_variance: float = 1.0  # that `Axis.mean` has if u is white
    axes: tuple[Axis, Axis, Axis] = (Axis(), Axis(), Axis())

    def after(self, time_ns: int, innovation: Sequence[float], sd: Sequence[float]) -> "InnovationStatistics":
        """Add an innovation and its standard deviations [m or m/s, NED], of two axes or of three."""
        first = self.time_ns == 0
        span_s = 1.0 if first else max(0.0, (time_ns - self.time_ns) * 1e-9)
        step_s = min(span_s, MEAN_S)
        quick = 1.0 - exp(-step_s / MEAN_S)
        slow = max(1.0 - exp(-step_s / MEMORY_S), step_s / (self.elapsed_s + TRIAL_S))
        mean_variance = quick**2 if first else (1.0 - quick) ** 2 * self.mean_variance + quick**2
        successive = not first and span_s <= BREAK_S
        interval_s = self.interval_s
        if successive:
            interval_s += 0.1 * (min(span_s, 2.0 * interval_s + 0.1) - interval_s)
        axes = [
            _updated(axis, z, s, quick, slow, mean_variance, successive, exp(-span_s / MEMORY_S))
            for axis, z, s in zip(self.axes, innovation, sd, strict=False)
        ]
        north, east, down = (*axes, *self.axes[len(axes) :])
        return InnovationStatistics(time_ns, self.elapsed_s + step_s, interval_s, mean_variance, (north, east, down))

    def correlated_variance(self, place: int) -> float:
        """Variance [m² or m²/s²] of a time-correlated error of the measurements, on one axis.

        Notes
        -----
        The white variance w of u is its mean square less its autocovariance at lag 1. What lacks to the variance of
        one, less the sampling error of n independent pairs, can be a time-correlated error that the filter has
        followed. It is capped at 1.25 times the mean square of u and at four times the autocovariance::

            w = E u² - max(0, E u_k u_k-1)       1 - w - 2 √(3/n),   n = 2 `MEMORY_S` / interval
            L = min( that,  1.25 E u²,  4 E u_k u_k-1 ) S
        """
        axis = self.axes[place]
        lag_1 = max(0.0, axis.lag_1)
        unseen = 1.0 - max(0.0, axis.mean_square - lag_1) - WHITE_NOISE_SDS * sqrt(1.5 * self.interval_s / MEMORY_S)
        share = min(unseen, MAX_CORRELATED_RATIO * axis.mean_square, LAG_LIMIT * lag_1)
        return max(0.0, share) * min(axis.variance, axis.newest)

    @property
    def scale_horizontal(self) -> float:
        """Factor by which squared horizontal innovations exceed their variance significantly; at least 1.

        By their mean square, or by the recent peak if that gives more.
        """
        mean = 0.5 * (self.axes[0].mean_square + self.axes[1].mean_square) - sqrt(0.5) * self._chance
        return max(1.0, mean, (max(self.axes[0].peak, self.axes[1].peak) / NORMAL_QUANTILE_1E_3) ** 2)

    @property
    def scale_vertical(self) -> float:
        """The same for vertical innovations."""
        return max(1.0, self.axes[2].mean_square - self._chance, (self.axes[2].peak / NORMAL_QUANTILE_1E_3) ** 2)

    @property
    def _chance(self) -> float:
        """Standard deviation of the mean of u² of n = 2 `MEMORY_S` / interval: √(2/n)."""
        return sqrt(min(self.interval_s, MEMORY_S) / MEMORY_S)

    @property
    def overstatement(self) -> float:
        """Factor by which time-correlated errors make the filter too certain; at least 1.

        The variance of the mean innovation over `MEAN_S` over that of white innovations.
        """
        return max(
            1.0, (self.axes[0].mean_ratio + self.axes[1].mean_ratio + self.axes[2].mean_ratio) / 3.0 - MEAN_RATIO_SD
        )


NO_STATISTICS = InnovationStatistics()
ESTIMATED = InnovationStatistics(axes=(Axis(lag_1=0.0),) * 3)  # the time-correlated error is a state of the filter


def _updated(
    axis: Axis,
    innovation: float,
    sd: float,
    quick: float,
    slow: float,
    mean_variance: float,
    successive: bool,
    decay: float,
) -> Axis:
    u = min(MAX_VALUE, max(-MAX_VALUE, innovation / sd))
    mean = axis.mean + quick * (u - axis.mean)
    variance = sd * sd
    return Axis(
        mean,
        axis.mean_ratio + slow * (mean * mean / mean_variance - axis.mean_ratio),
        axis.mean_square + slow * (u * u - axis.mean_square),
        axis.lag_1 + slow * (u * axis.last - axis.lag_1) if successive else axis.lag_1,
        u,
        axis.variance + slow * (variance - axis.variance) if axis.newest else variance,
        variance,
        max(abs(u), decay * axis.peak),
    )

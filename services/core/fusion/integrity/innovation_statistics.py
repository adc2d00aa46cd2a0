"""Errors outside the covariance, by the statistics of innovations: too large, too correlated, or implausibly small.

All of it is normalised: u is an innovation over its standard deviation, which a filter that knows its errors makes
white and of variance one.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, sqrt
from typing import NamedTuple

MEMORY_S = 60.0  # of what is learnt: long enough to tell chance from habit, short enough for another street
MEAN_S = 10.0  # over which innovations are averaged: white noise hardly survives it
BREAK_S = 5.0  # after it two innovations are no neighbours
LARGEST = 5.0  # [-] of an innovation, beyond which one of them would teach for minutes
CHANCE_SDS = 2.0  # by which noise may look like an error that lasts
HIDDEN = 1.25  # what innovations show of an error that lasts, and a quarter as much again that the filter has followed
TRIAL_S = 20.0  # for so long counts what was taken for granted at first
CHANCE = 0.5  # by which `Axis.habit` scatters about one, averaged over three axes
RARE = 3.3  # [-] what one u in a thousand is larger than: when larger ones come, the tails are not a normal number's
ALIKE = 4.0  # an error that lasts cannot be more than four times what neighbours have in common


class Axis(NamedTuple):
    """One axis of the innovations; at first all is taken to last, and whiteness has to be earned."""

    mean: float = 0.0  # of u over `MEAN_S`
    habit: float = 1.0  # mean of that squared, over what white u would give
    power: float = 1.0  # mean of u²
    alike: float = 1.0  # mean of u times the u before it
    last: float = 0.0
    variance: float = 0.0  # [m² or m²/s²] mean of the innovation's
    newest: float = 0.0  # [m² or m²/s²] the newest of them
    peak: float = 0.0  # largest u of late, which fades with `MEMORY_S`


@dataclass(frozen=True)
class Evidence:
    """Innovations of one kind of measurement, north, east and down, as far as they are remembered."""

    time_ns: int = 0
    elapsed_s: float = 0.0  # since the first
    interval_s: float = 1.0  # between two of them
    mean_variance: float = 1.0  # that `Axis.mean` has if u is white
    axes: tuple[Axis, Axis, Axis] = (Axis(), Axis(), Axis())

    def after(self, time_ns: int, innovation: Sequence[float], sd: Sequence[float]) -> "Evidence":
        """Learn from an innovation and its standard deviations [m or m/s, NED], of two axes or of three."""
        first = self.time_ns == 0
        span_s = 1.0 if first else max(0.0, (time_ns - self.time_ns) * 1e-9)
        step_s = min(span_s, MEAN_S)
        quick = 1.0 - exp(-step_s / MEAN_S)
        slow = max(1.0 - exp(-step_s / MEMORY_S), step_s / (self.elapsed_s + TRIAL_S))
        mean_variance = quick**2 if first else (1.0 - quick) ** 2 * self.mean_variance + quick**2
        neighbours = not first and span_s <= BREAK_S
        interval_s = self.interval_s
        if neighbours:
            interval_s += 0.1 * (min(span_s, 2.0 * interval_s + 0.1) - interval_s)
        learnt = [
            _learnt(axis, z, s, quick, slow, mean_variance, neighbours, exp(-span_s / MEMORY_S))
            for axis, z, s in zip(self.axes, innovation, sd, strict=False)
        ]
        north, east, down = (*learnt, *self.axes[len(learnt) :])
        return Evidence(time_ns, self.elapsed_s + step_s, interval_s, mean_variance, (north, east, down))

    def lasting(self, place: int) -> float:
        """Variance [m² or m²/s²] of an error of the measurements that lasts, on one axis.

        Notes
        -----
        The white part of u is what neighbours do not share. Of the variance that was expected the rest, less what
        chance may do in n independent pairs, is there and does not show, or is not there: it is taken to last, unless
        neighbours are strangers, or innovations so small that nothing of that size can be behind them::

            w = E u² - max(0, E u_k u_k-1)       1 - w - 2 √(3/n),   n = 2 `MEMORY_S` / interval
            L = min( that,  1.25 E u²,  4 E u_k u_k-1 ) S
        """
        axis = self.axes[place]
        alike = max(0.0, axis.alike)
        unseen = 1.0 - max(0.0, axis.power - alike) - CHANCE_SDS * sqrt(1.5 * self.interval_s / MEMORY_S)
        share = min(unseen, HIDDEN * axis.power, ALIKE * alike)
        return max(0.0, share) * min(axis.variance, axis.newest)

    @property
    def scale_horizontal(self) -> float:
        """How much larger than expected, and than by chance, squared horizontal innovations are; 1 if they are not.

        On average, or the largest of late if that is more.
        """
        mean = 0.5 * (self.axes[0].power + self.axes[1].power) - sqrt(0.5) * self._chance
        return max(1.0, mean, (max(self.axes[0].peak, self.axes[1].peak) / RARE) ** 2)

    @property
    def scale_vertical(self) -> float:
        """The same of vertical ones."""
        return max(1.0, self.axes[2].power - self._chance, (self.axes[2].peak / RARE) ** 2)

    @property
    def _chance(self) -> float:
        """Standard deviation of the mean of u² of n = 2 `MEMORY_S` / interval: √(2/n)."""
        return sqrt(min(self.interval_s, MEMORY_S) / MEMORY_S)

    @property
    def overstatement(self) -> float:
        """By how much the filter overstates what it has learnt from measurements that repeat each other's errors.

        The variance of the mean over `MEAN_S` over that of as many independent ones; 1 if they are.
        """
        return max(1.0, (self.axes[0].habit + self.axes[1].habit + self.axes[2].habit) / 3.0 - CHANCE)


UNKNOWN = Evidence()
ESTIMATED = Evidence(axes=(Axis(alike=0.0),) * 3)  # of errors whose lasting part is a state of the filter


def _learnt(
    axis: Axis,
    innovation: float,
    sd: float,
    quick: float,
    slow: float,
    mean_variance: float,
    neighbours: bool,
    fading: float,
) -> Axis:
    u = min(LARGEST, max(-LARGEST, innovation / sd))
    mean = axis.mean + quick * (u - axis.mean)
    variance = sd * sd
    return Axis(
        mean,
        axis.habit + slow * (mean * mean / mean_variance - axis.habit),
        axis.power + slow * (u * u - axis.power),
        axis.alike + slow * (u * axis.last - axis.alike) if neighbours else axis.alike,
        u,
        axis.variance + slow * (variance - axis.variance) if axis.newest else variance,
        variance,
        max(abs(u), fading * axis.peak),
    )

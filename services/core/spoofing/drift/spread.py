"""How far sums of innovations scatter without a fault, learned on this vehicle, and the limits that follow from it."""

from collections.abc import Sequence
from functools import lru_cache

from scipy.special import fdtri

# Blocks for which the filter's own statement counts, that normalised innovations are white of variance 1. It is exact
# in simulation (standard deviation 0.95 to 1.06, no correlation); where the grade of the sensors is not stated to be
# industrial it counts for nothing.
STATED_BLOCKS = 40
MIN_BLOCKS = 10  # learned, before a limit that rests on them alone is of use
MEMORY_BLOCKS = 100  # of which the mean is taken
# Of the variance of a sum over its number of seconds: innovations of 10 Hz are means of ten; positions of
# navmatlab_car, whose lever arm is unknown, reach 20.
LEAST, LARGEST = 0.3, 30.0


class Spread:
    """Variance of the sum over one length, over its number of seconds, for each axis.

    Innovations are correlated in time where a sensor errs for long. The sum over a block has the variance of the
    correlated process, whatever its correlation is; blocks are independent where it is shorter than they are.
    """

    def __init__(self, axes: int, *, stated: bool) -> None:
        self._squares = [float(STATED_BLOCKS if stated else 0)] * axes
        self._weight = float(STATED_BLOCKS if stated else 0)
        self._stated = stated

    def learn(self, sums: Sequence[float], seconds: int) -> None:
        """Use the sums of a block without a fault, one of each axis."""
        if self._weight >= MEMORY_BLOCKS:
            share = (MEMORY_BLOCKS - 1.0) / self._weight
            self._squares = [share * square for square in self._squares]
            self._weight *= share
        self._squares = [
            square + min(value * value / seconds, 9.0 * LARGEST)
            for square, value in zip(self._squares, sums, strict=True)
        ]
        self._weight += 1.0

    @property
    def blocks(self) -> int:
        """Number of blocks that the variances rest on."""
        return int(self._weight)

    @property
    def is_known(self) -> bool:
        """Whether there are enough blocks."""
        return self.blocks >= MIN_BLOCKS

    def variance(self, axis: int) -> float:
        """Variance of a sum over its number of seconds."""
        return min(max(self._squares[axis] / max(self._weight, 1.0), LEAST), LARGEST)

    def ratio(self, sums: Sequence[float], seconds: int, axes: Sequence[int]) -> float:
        """Mean square of the sums of some axes over their variances."""
        return sum(sums[axis] ** 2 / (seconds * self.variance(axis)) for axis in axes) / len(axes)

    def limit(self, axes: int, false_alarm_rate: float) -> float:
        """What that ratio exceeds by chance with a probability."""
        return f_limit(axes, self.blocks, false_alarm_rate)


@lru_cache(maxsize=512)
def f_limit(dimension: int, freedom: int, false_alarm_rate: float) -> float:
    """Limit of the ratio of a mean square of some numbers to a variance that was estimated from others.

    Parameters
    ----------
    dimension : int
        [-] Numbers whose mean square is tested.
    freedom : int
        [-] Numbers that the variance was estimated from.
    false_alarm_rate : float
        [-] Probability of being above.

    Returns
    -------
    float
        [-] Quantile of the F distribution, which tends to that of chi-square over `dimension` for many numbers.
    """
    return float(fdtri(dimension, freedom, 1.0 - false_alarm_rate))

"""Monitor of the lever arm from the IMU to the antenna: in turns its error shows in the innovations of GNSS.

An arm that is wrong by d (body) puts the antenna C d beside where it is taken to be. On a straight road the filter
takes that for its own error, in the direction of that time, until C turns. With C_f the mean attitude of the past
that the filter has absorbed, and likewise for the velocity C (w x d)::

    z = (C - C_f) d + noise of covariance S

of which d is estimated by weighted least squares that forget.
"""

from math import exp, hypot, sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..filter.eskf import ErrorStateFilter

FloatArray = npt.NDArray[np.float64]
Square = tuple[float, float, float, float]  # a matrix of two rows and two columns

MEMORY_S = 120.0
WRONG_M = 0.5  # the filter takes part of an error for its own, the more the more often fixes come
WRONG_SDS = 8.0  # innovations are not independent of each other


class ArmWatch(NamedTuple):
    """Sums of the least squares for the horizontal part of the error [m, body], and what the filter has absorbed."""

    information: tuple[float, float, float]  # upper half
    weighted: tuple[float, float]
    held: dict[bool, Square]  # by whether it is of positions: what the filter has taken for its own error
    time_ns: int = 0

    def after(
        self, time_ns: int, navigation: ErrorStateFilter, z: FloatArray, S: FloatArray, *, gain: float, position: bool
    ) -> "ArmWatch":
        """Add an innovation with its covariance, and the share of it that the filter will follow."""
        (a, b, e), (c, d, f), _ = navigation.ned_from_body.tolist()
        if not position:
            x, y, w = navigation.rate
            a, b, c, d = w * b - y * e, x * e - w * a, w * d - y * f, x * f - w * c
        ha, hb, hc, hd = self.held.get(position, (a, b, c, d))
        a, b, c, d = a - ha, b - hb, c - hc, d - hd
        keep = exp(-max(0, time_ns - self.time_ns) * 1e-9 / MEMORY_S) if self.time_ns else 1.0
        (nn, ne), (_, ee) = S[:2, :2].tolist()
        share, (north, east) = ne / nn, z[:2].tolist()
        left = ee - share * ne  # of the variance, positive because S is positive definite
        q, s = (c - share * a) / left, (d - share * b) / left  # rows of S^-1 A: the lower one first
        p, r = a / nn - share * q, b / nn - share * s
        (ff, fr, rr), (forward, right) = self.information, self.weighted
        return ArmWatch(
            (keep * ff + a * p + c * q, keep * fr + a * r + c * s, keep * rr + b * r + d * s),
            (keep * forward + p * north + q * east, keep * right + r * north + s * east),
            {**self.held, position: (ha + gain * a, hb + gain * b, hc + gain * c, hd + gain * d)},
            time_ns,
        )

    def error(self) -> tuple[tuple[float, float], float]:
        """Estimate of the true minus the assumed arm, forward and right [m], and its size in standard deviations."""
        (ff, fr, rr), (forward, right) = self.information, self.weighted
        ff, rr = ff + 1e-6, rr + 1e-6
        scale = 1.0 / (ff * rr - fr * fr)
        error = scale * (rr * forward - fr * right), scale * (ff * right - fr * forward)
        return error, sqrt(max(0.0, error[0] * forward + error[1] * right))

    def wrong(self) -> tuple[float, float] | None:
        """Significant error [m, forward and right] of the arm, otherwise None."""
        error, sds = self.error()
        forward, right = error
        return (forward, right) if hypot(forward, right) > WRONG_M and sds > WRONG_SDS else None


def begun() -> ArmWatch:
    """Begin with nothing."""
    return ArmWatch((0.0, 0.0, 0.0), (0.0, 0.0), {})

"""Monitor of the lever arm from the IMU to the antenna: in turns its error shows in the innovations of GNSS.

With an arm that is wrong by d (body) the antenna is C d away from its prediction. On a straight road the filter absorbs
this as an error of its state, until C changes. With C_f the part of C that it has absorbed, and likewise C sk(w) d for
velocities::

    z = (C - C_f) d + noise of covariance S

d is estimated by least squares with exponential weights.
"""

from math import exp, hypot, sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ...inertial.filter import ErrorStateFilter

FloatArray = npt.NDArray[np.float64]
Square = tuple[float, float, float, float]  # a matrix of two rows and two columns

MEMORY_S = 120.0  # time constant of the weights
MIN_ERROR_M = 0.5  # smallest significant error: the filter absorbs a part, which grows with the rate of fixes
MIN_ERROR_SDS = 8.0  # smallest significant number of standard deviations: innovations are not independent


class LeverArmMonitor(NamedTuple):
    """Sums of the least squares for the horizontal part of d [m, body]; replaced and never changed in place."""

    information: tuple[float, float, float] = (0.0, 0.0, 0.0)  # upper half
    weighted: tuple[float, float] = (0.0, 0.0)
    absorbed: dict[bool, Square] = {}  # noqa: RUF012  # C_f of positions (True) and of velocities
    time_ns: int = 0

    def after(
        self, time_ns: int, navigation: ErrorStateFilter, z: FloatArray, S: FloatArray, *, gain: float, position: bool
    ) -> "LeverArmMonitor":
        """Sums with one more innovation z of covariance S, of which the filter absorbs the share `gain`."""
        (a, b, e), (c, d, f), _ = navigation.ned_from_body.tolist()
        if not position:
            x, y, w = navigation.rate
            a, b, c, d = w * b - y * e, x * e - w * a, w * d - y * f, x * f - w * c
        ha, hb, hc, hd = self.absorbed.get(position, (a, b, c, d))
        a, b, c, d = a - ha, b - hb, c - hc, d - hd
        keep = exp(-max(0, time_ns - self.time_ns) * 1e-9 / MEMORY_S) if self.time_ns else 1.0
        (nn, ne), (_, ee) = S[:2, :2].tolist()
        share, (north, east) = ne / nn, z[:2].tolist()
        left = ee - share * ne  # variance of east given north; positive because S is positive definite
        q, s = (c - share * a) / left, (d - share * b) / left  # rows of S^-1 A: the lower one first
        p, r = a / nn - share * q, b / nn - share * s
        (ff, fr, rr), (forward, right) = self.information, self.weighted
        return LeverArmMonitor(
            (keep * ff + a * p + c * q, keep * fr + a * r + c * s, keep * rr + b * r + d * s),
            (keep * forward + p * north + q * east, keep * right + r * north + s * east),
            {**self.absorbed, position: (ha + gain * a, hb + gain * b, hc + gain * c, hd + gain * d)},
            time_ns,
        )

    def error(self) -> tuple[tuple[float, float], float]:
        """True minus assumed arm, forward and right [m], and its size in standard deviations."""
        (ff, fr, rr), (forward, right) = self.information, self.weighted
        ff, rr = ff + 1e-6, rr + 1e-6
        scale = 1.0 / (ff * rr - fr * fr)
        error = scale * (rr * forward - fr * right), scale * (ff * right - fr * forward)
        return error, sqrt(max(0.0, error[0] * forward + error[1] * right))

    def significant_error(self) -> tuple[float, float] | None:
        """Error of the arm, forward and right [m], if it is significant."""
        error, sds = self.error()
        forward, right = error
        return (forward, right) if hypot(forward, right) > MIN_ERROR_M and sds > MIN_ERROR_SDS else None

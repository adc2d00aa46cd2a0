"""Watches the lever arm from the IMU to the antenna: in turns a wrong one shows in what GNSS says against the filter.

An arm that is wrong by d (body) puts the antenna C d beside where it is taken to be. On a straight road the filter
takes that for its own error; when C turns it is held against the old direction. With C_f the mean attitude of the past
that the filter still believes, and likewise for the velocity C (w x d)::

    z = (C - C_f) d + noise of covariance S

of which d is estimated by weighted least squares that forget.
"""

from math import exp, hypot, sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shared.maths.rotation import skew

from .filter import ErrorStateFilter
from .kalman import inverse_of

FloatArray = npt.NDArray[np.float64]

MEMORY_S = 120.0
WRONG_M = 0.5  # the filter takes part of an error for its own, the more the more often fixes come
WRONG_SDS = 8.0  # innovations are not independent of each other


class ArmWatch(NamedTuple):
    """Sums of the least squares for the horizontal part of the error [m, body], and what the filter believes."""

    information: FloatArray
    weighted: FloatArray
    held: dict[bool, FloatArray]  # by whether it is of positions: what the filter has taken for its own error
    time_ns: int = 0

    def after(
        self, time_ns: int, navigation: ErrorStateFilter, z: FloatArray, S: FloatArray, *, gain: float, position: bool
    ) -> "ArmWatch":
        """Take in an innovation with its covariance, and the share of it that the filter will follow."""
        C = navigation.ned_from_body
        direction = (C if position else C @ skew(navigation.rate))[:2, :2]
        held = self.held.get(position, direction)
        A = direction - held
        keep = exp(-max(0, time_ns - self.time_ns) * 1e-9 / MEMORY_S) if self.time_ns else 1.0
        weighted = A.T @ inverse_of(S[:2, :2])
        return ArmWatch(
            keep * self.information + weighted @ A,
            keep * self.weighted + weighted @ z[:2],
            {**self.held, position: held + gain * A},
            time_ns,
        )

    def error(self) -> tuple[FloatArray, float]:
        """Estimate of the true minus the assumed arm, forward and right [m], and its size in standard deviations."""
        information = self.information + 1e-6 * np.eye(2)
        error = np.asarray(np.linalg.solve(information, self.weighted), dtype=np.float64)
        return error, sqrt(max(0.0, float(error @ self.weighted)))

    def wrong(self) -> tuple[float, float] | None:
        """Error [m, forward and right] of an arm that is wrong beyond doubt, else None."""
        error, sds = self.error()
        forward, right = error.tolist()
        return (forward, right) if hypot(forward, right) > WRONG_M and sds > WRONG_SDS else None


def begun() -> ArmWatch:
    """Begin with nothing."""
    return ArmWatch(np.zeros((2, 2)), np.zeros(2), {})

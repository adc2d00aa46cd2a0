"""Zero-velocity update (ZUPT) and zero-angular-rate update (ZARU) at standstill."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from shared.maths.earth import earth_rate_n
from shared.maths.rotation import Vector
from shared.messages.navigation import AidingKind

from ..inertial import error_model as em
from ..inertial.filter import ErrorStateFilter
from ..inertial.standstill import STANDSTILL_RATE_SD
from .base import Kind, Observation

PERIOD_S = 0.1
VELOCITY_SD = 0.02  # [m/s]
RATE_SD = 0.0015  # [rad/s] of one period, independent of the next
SETTLING_S = 10.0  # for which beside it an error of `STANDSTILL_RATE_SD` is correlated: no standstill is perfect


@dataclass(frozen=True)
class Standstill(Kind):
    """The vehicle stands still at this instant; `rate` is the mean [rad/s, body; bias removed] of the last period."""

    time_ns: int
    rate: Vector
    rate_sd: float = 0.0  # [rad/s] of the mean, by vibration
    source: str = "core.fusion"

    @property
    def received_ns(self) -> int:
        """When it became known: at once."""
        return self.time_ns

    def observers(self) -> Iterator[Callable[[ErrorStateFilter], Observation]]:
        """Zero velocity first, then zero angular rate."""
        yield observe_zero_velocity
        yield self.observe_zero_rate

    def observe_zero_rate(self, navigation: ErrorStateFilter) -> Observation:
        """ZARU: observation w - C^T w_ie of the gyroscope bias: H = -I on the gyroscope's bias.

        An error of variance l and correlation time T is as bad as an independent one of 2 l T / period in every period.
        """
        H = np.zeros((3, em.SIZE))
        H[:, em.GYROSCOPE_BIAS] = -np.eye(3)
        earth_n = np.array(earth_rate_n(navigation.position.latitude))
        z = np.array(self.rate) - navigation.ned_from_body.T @ earth_n
        variance = max(self.rate_sd, RATE_SD) ** 2 + 2.0 * STANDSTILL_RATE_SD**2 * SETTLING_S / PERIOD_S
        return Observation(AidingKind.ZERO_ANGULAR_RATE, z, H, variance * np.eye(3))


def observe_zero_velocity(navigation: ErrorStateFilter) -> Observation:
    """ZUPT: z = -v, H = -I on the velocity."""
    H = np.zeros((3, em.SIZE))
    H[:, em.VELOCITY] = -np.eye(3)
    z = -np.array(navigation.velocity)
    return Observation(AidingKind.ZERO_VELOCITY, z, H, VELOCITY_SD**2 * np.eye(3))

"""Zero-velocity update (ZUPT) and zero-angular-rate update (ZARU) at standstill."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.maths.compiled import compilable
from shared.maths.earth import earth_rate_n
from shared.maths.rotation import Quaternion, Vector, matrix_from_quaternion
from shared.messages.navigation import AidingKind

from ...inertial import error_model as em
from ...inertial.filter import ErrorStateFilter
from ...inertial.standstill import STANDSTILL_RATE_SD
from ..base import Kind, Observation

FloatArray = npt.NDArray[np.float64]

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
        state = navigation.state
        return Observation(
            AidingKind.ZERO_ANGULAR_RATE, *zero_rate(self.rate, self.rate_sd, state.quaternion, state.position[0])
        )


def observe_zero_velocity(navigation: ErrorStateFilter) -> Observation:
    """ZUPT: z = -v, H = -I on the velocity."""
    return Observation(AidingKind.ZERO_VELOCITY, *zero_velocity(navigation.velocity))


@compilable
def zero_velocity(velocity: Vector) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Innovation z, matrix H and covariance R of a ZUPT at a velocity [m/s, NED]."""
    H = np.zeros((3, em.SIZE))
    H[:, em.VELOCITY] = -em.UNIT
    return -np.array(velocity), H, VELOCITY_SD**2 * em.UNIT


@compilable
def zero_rate(
    rate: Vector, rate_sd: float, quaternion: Quaternion, latitude: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Innovation z, matrix H and covariance R of a ZARU: see `Standstill`."""
    H = np.zeros((3, em.SIZE))
    H[:, em.GYROSCOPE_BIAS] = -em.UNIT
    z = np.array(rate) - matrix_from_quaternion(quaternion).T @ np.array(earth_rate_n(latitude))
    variance = max(rate_sd, RATE_SD) ** 2 + 2.0 * STANDSTILL_RATE_SD**2 * SETTLING_S / PERIOD_S
    return z, H, variance * em.UNIT

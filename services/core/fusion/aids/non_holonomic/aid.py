"""Non-holonomic constraint (NHC): no sideways and no vertical velocity of the rear axle."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shared.maths.compiled import compilable
from shared.maths.rotation import Vector
from shared.messages.navigation import AidingKind

from ...inertial.filter import ErrorStateFilter
from ...settings import Settings
from ..base import Kind, Observation
from ..rear_axle import UNKNOWN_ARM_SD, rear_axle_of

FloatArray = npt.NDArray[np.float64]

PERIOD_S = 0.1
CORRELATION_S = 1.0  # of the wheels' sideways and vertical motion: successive zeros are no independent evidence
MIN_SPEED_M_S = 2.0  # below it a wheel goes where it is steered
SLIP = 0.006  # [rad per m/s²] by which a tyre runs askew in a bend; 0.006 in a real car


@dataclass(frozen=True)
class NonHolonomic(Kind):
    """Non-holonomic constraint: at this instant the rear axle moves neither sideways nor down."""

    time_ns: int
    settings: Settings
    source: str = "core.fusion"

    @property
    def received_ns(self) -> int:
        """When it became known: at once."""
        return self.time_ns

    def observers(self) -> Iterator[Callable[[ErrorStateFilter], Observation]]:
        """Both at once."""
        yield self.observe

    def observe(self, navigation: ErrorStateFilter) -> Observation:
        """Innovation of two zeros against the velocity of the rear axle, right and down.

        In bends tyres slip by an angle that is proportional to the acceleration, and an unknown arm swings; straight on
        they give way less than springs, on which a body pitches and heaves. These errors, as those of camber, are
        time-correlated; ten of them in their correlation time count as one.
        """
        return Observation(AidingKind.NON_HOLONOMIC, *constraint(*rear_axle_of(navigation, self.settings),
                                                                 navigation.rate, model_of(self.settings)))  # fmt: skip


class ConstraintModel(NamedTuple):
    """Standard deviations of what the constraint leaves out."""

    arm_sd: float  # [m] of the rear axle's position
    lateral_sd: float  # [m/s]
    vertical_sd: float  # [m/s]


def model_of(settings: Settings) -> ConstraintModel:
    """Model of a vehicle."""
    arm_sd = UNKNOWN_ARM_SD if settings.vehicle.rear_axle_body_m is None else 0.0
    own = settings.non_holonomic
    return ConstraintModel(arm_sd, own.lateral_sd_m_s, own.vertical_sd_m_s)


@compilable
def constraint(
    ahead: FloatArray, H: FloatArray, rate: Vector, model: ConstraintModel
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Innovation z, matrix H and covariance R of the constraint, from `rear_axle` and the rate [rad/s, body]."""
    turn, forward = abs(rate[2]), float(ahead[0])
    repeated = CORRELATION_S / PERIOD_S
    sideways = model.lateral_sd**2 + (SLIP * forward**2 * turn) ** 2 + (model.arm_sd * turn) ** 2
    R = np.zeros((2, 2))
    R[0, 0], R[1, 1] = repeated * sideways, repeated * model.vertical_sd**2
    return -ahead[1:], H[1:], R

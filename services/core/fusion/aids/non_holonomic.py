"""Non-holonomic constraint (NHC): no sideways and no vertical velocity of the rear axle."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from shared.messages.navigation import AidingKind

from ..inertial.filter import ErrorStateFilter
from ..settings import Settings
from .base import Kind, Observation
from .rear_axle import UNKNOWN_ARM_SD, rear_axle_of

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
        ahead, H = rear_axle_of(navigation, self.settings)
        turn = abs(navigation.rate[2])
        sd, vertical_sd = self.settings.non_holonomic.lateral_sd_m_s, self.settings.non_holonomic.vertical_sd_m_s
        repeated = CORRELATION_S / PERIOD_S
        arm_sd = UNKNOWN_ARM_SD if self.settings.vehicle.rear_axle_body_m is None else 0.0
        sideways = sd**2 + (SLIP * float(ahead[0]) ** 2 * turn) ** 2 + (arm_sd * turn) ** 2
        return Observation(AidingKind.NON_HOLONOMIC, -ahead[1:], H[1:], repeated * np.diag([sideways, vertical_sd**2]))

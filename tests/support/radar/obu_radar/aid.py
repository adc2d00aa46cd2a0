"""Its measurement: z = s - (1 + k) u, with u the forward velocity of the rear axle and k the error of the scale."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from services.core.fusion.aids.base import Kind, Observation
from services.core.fusion.aids.rear_axle import rear_axle_of
from services.core.fusion.inertial.filter import ErrorStateFilter
from services.core.fusion.settings import Settings
from services.core.fusion.states import LAYOUT
from shared.messages.navigation import AidingKind
from shared.messages.vehicle import VehicleSpeed

PLACE, SPEED_SD = LAYOUT.index("radar_scale"), 0.05  # [m/s]


@dataclass(frozen=True)
class RadarSpeed(Kind):
    """Speed over ground [m/s]."""

    quantity, period_ns = "radar speed", 95_000_000

    time_ns: int
    received_ns: int
    source: str
    speed: float
    settings: Settings

    def observers(self) -> Iterator[Callable[[ErrorStateFilter], Observation]]:
        yield self.observe

    def observe(self, navigation: ErrorStateFilter) -> Observation:
        ahead, rows = rear_axle_of(navigation, self.settings)
        scale, forward = 1.0 + navigation.parameter(PLACE), float(ahead[0])
        H = scale * rows[:1]
        H[0, PLACE] = -forward
        return Observation(AidingKind.EXTERNAL, np.array([self.speed - scale * forward]), H, np.array([[SPEED_SD**2]]))


def of_speed(message: VehicleSpeed, settings: Settings) -> Iterator[RadarSpeed]:
    if message.source.startswith("radar"):
        yield RadarSpeed(message.sampled_ns, message.received_ns, message.source, message.speed_m_s, settings)


KINDS = {VehicleSpeed: (of_speed,)}

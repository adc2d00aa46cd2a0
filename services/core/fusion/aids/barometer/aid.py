"""Barometric height: a height above an unknown level that the weather moves slowly."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import hypot

import numpy as np

from shared.messages.imu import ImuSamples
from shared.messages.navigation import AidingKind

from ...inertial import error_model as em
from ...inertial.filter import ErrorStateFilter
from ...settings import Settings
from ...states import LAYOUT
from ..base import Kind, Observation
from .atmosphere import pressure_height

OFFSET = LAYOUT.index("barometer_offset")  # [m]
PERIOD_NS = 1_000_000_000  # once a second is enough
CORRELATION_S = 10.0  # of the pressure of the wind: successive readings are no independent evidence
WIND = 0.002  # [m per (m/s)²] by which the air stream shifts the height: 2 % of its stagnation pressure
LOWEST_PA, HIGHEST_PA = 40_000.0, 115_000.0  # no road is higher or lower


@dataclass(frozen=True)
class BarometricHeight(Kind):
    """Height in the standard atmosphere by a static pressure; its offset to the ellipsoid is a state of the filter."""

    quantity, period_ns = "pressure", PERIOD_NS

    time_ns: int
    received_ns: int
    source: str
    pressure_pa: float
    settings: Settings

    def implausible(self) -> str | None:
        """Limits of the pressure."""
        return None if LOWEST_PA <= self.pressure_pa <= HIGHEST_PA else "implausible pressure"

    def observers(self) -> Iterator[Callable[[ErrorStateFilter], Observation]]:
        """Height alone."""
        yield self.observe

    def observe(self, navigation: ErrorStateFilter) -> Observation:
        """Innovation against the height of the filter plus the offset."""
        z = pressure_height(self.pressure_pa) - navigation.position.height - navigation.parameter(OFFSET)
        H = np.zeros((1, em.SIZE))
        H[0, em.POSITION.stop - 1] = 1.0  # down is positive in the error, up in the height
        H[0, OFFSET] = -1.0
        north, east, _ = navigation.velocity
        wind = WIND * (north * north + east * east) * CORRELATION_S**0.5
        return Observation(
            AidingKind.BAROMETRIC_HEIGHT,
            np.array([z]),
            H,
            np.array([[hypot(self.settings.barometer.height_sd_m, wind) ** 2]]),
        )


def of_samples(batch: ImuSamples, settings: Settings) -> Iterator[BarometricHeight]:
    """Height by the pressure of a batch of inertial samples, if it has one."""
    if batch.pressure_pa is not None and settings.barometer.enabled:
        yield BarometricHeight(batch.sampled_ns[-1], batch.received_ns, batch.source, batch.pressure_pa, settings)


KINDS = {ImuSamples: (of_samples,)}

"""Magnetic heading, used only while it agrees with a heading from other sources."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import atan2, degrees, hypot, radians

import numpy as np

from shared.inertial.strapdown import rotate
from shared.maths.earth import wrap_angle
from shared.maths.rotation import Vector
from shared.messages.imu import ImuSamples
from shared.messages.navigation import AidingKind

from ...inertial import error_model as em
from ...inertial.filter import ErrorStateFilter
from ...settings import Settings
from ..base import Kind, Observation

PERIOD_NS = 1_000_000_000
CORRELATION_S = 20.0  # of the disturbance by iron that the vehicle passes: readings are no independent evidence
STRENGTH = (0.8, 1.2)  # [-] of the field where it was calibrated
REFERENCE_SD = radians(2.0)  # of a heading that serves as reference for the compass
SECTORS = 8  # of the horizon
JUDGED_SECTORS = 4  # in which it must have been judged: iron of the vehicle errs by the heading
MAX_SECTOR_ERROR = radians(10.0)  # mean error of a sector up to which a compass is one
MIN_SD = radians(2.0)
MAX_FIELD = 100.0  # plausible, times that of the Earth
UPDATE_WEIGHT = 0.1  # weight of a new reading in the mean of its sector


@dataclass(frozen=True)
class CompassCheck:
    """Error of the magnetic heading in each sector of the horizon, as far as it has been seen."""

    errors: tuple[float | None, ...] = (None,) * SECTORS

    def judged(self, seen: "MagneticHeading", navigation: ErrorStateFilter) -> "CompassCheck":
        """Check after a reading, if the heading of the filter is accurate enough."""
        known = navigation.P[em.ATTITUDE.stop - 1, em.ATTITUDE.stop - 1] <= REFERENCE_SD**2
        if not (known and seen.plausible):
            return self
        C = navigation.ned_from_body
        return self.after(atan2(C[1, 0], C[0, 0]), seen.error(navigation))

    def after(self, yaw: float, error: float) -> "CompassCheck":
        """Check after an error [rad] observed at a heading."""
        sector = int((yaw % (2.0 * np.pi)) / (2.0 * np.pi) * SECTORS) % SECTORS
        old = self.errors[sector]
        mean = error if old is None else wrap_angle(old + UPDATE_WEIGHT * wrap_angle(error - old))
        return CompassCheck((*self.errors[:sector], mean, *self.errors[sector + 1 :]))

    @property
    def spread(self) -> float | None:
        """Largest error [rad] of any sector, or None while too few of them have been seen."""
        seen = [abs(error) for error in self.errors if error is not None]
        return max(seen) if len(seen) >= JUDGED_SECTORS else None


@dataclass(frozen=True)
class MagneticHeading(Kind):
    """Magnetic field in body axes, in units of its strength where the magnetometer was calibrated."""

    quantity, period_ns = "field", PERIOD_NS

    time_ns: int
    received_ns: int
    source: str
    field_b: Vector
    declination: float  # [rad] of magnetic north, positive east
    check: "CompassCheck | None" = None  # what is known of this compass when the reading is used

    @property
    def plausible(self) -> bool:
        """Whether it has about the strength of the Earth's field."""
        return STRENGTH[0] <= hypot(*self.field_b) <= STRENGTH[1]

    def implausible(self) -> str | None:
        """Limit of the field."""
        return None if hypot(*self.field_b) < MAX_FIELD else "implausible magnetic field"

    def observers(self) -> Iterator[Callable[[ErrorStateFilter], Observation]]:
        """Heading alone."""
        yield self.observe

    def error(self, navigation: ErrorStateFilter) -> float:
        """Magnetic heading minus that of the filter [rad]: the field, turned by the attitude, points off north."""
        north, east, _ = rotate(navigation.quaternion, self.field_b)
        return wrap_angle(self.declination - atan2(east, north))

    @property
    def unfit(self) -> str | None:
        """Why it may not be used, if so."""
        spread = self.check.spread if self.check else None
        if not self.plausible:
            return "field of another strength than the Earth's"
        if spread is None:
            return f"not yet judged by {JUDGED_SECTORS} known headings"
        return None if spread <= MAX_SECTOR_ERROR else f"errs by up to {degrees(spread):.0f} degrees"

    def observe(self, navigation: ErrorStateFilter) -> Observation:
        """Innovation of its horizontal direction against magnetic north; the error of the tilt is neglected."""
        H = np.zeros((1, em.SIZE))
        H[0, em.ATTITUDE.stop - 1] = -1.0
        spread = self.check.spread if self.check else None
        R = np.array([[CORRELATION_S * max(MIN_SD, spread or MAX_SECTOR_ERROR) ** 2]])
        return Observation(AidingKind.MAGNETIC_HEADING, np.array([self.error(navigation)]), H, R, self.unfit)


def of_samples(batch: ImuSamples, settings: Settings) -> Iterator[MagneticHeading]:
    """Heading by the magnetic field of a batch of inertial samples, if it has one."""
    if batch.magnetic_field_body is not None and settings.magnetometer.enabled:
        stamp = batch.sampled_ns[-1], batch.received_ns, batch.source
        yield MagneticHeading(*stamp, batch.magnetic_field_body, settings.magnetometer.declination_rad)


KINDS = {ImuSamples: (of_samples,)}

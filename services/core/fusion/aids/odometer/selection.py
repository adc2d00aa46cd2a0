"""Which of several odometers is used, and speeds prepared for many steps in one call."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...inertial.propagation import NEVER_NS
from ..base import Measurement
from ..updates import Speeds
from .aid import WheelSpeed
from .zero_speeds import ODOMETER_SILENT_NS, ZeroSpeeds

NO_TIMES, NO_READINGS = np.empty(0, np.int64), np.empty((0, 6))


class PreparedSpeed(NamedTuple):
    """A speed, and the odometer in use after it."""

    place: int  # in the list of measurements
    measurement: WheelSpeed
    odometer: WheelSpeed | None
    zeros: ZeroSpeeds
    excluded: bool
    ignored: bool = False  # of another odometer than the one in use


class PreparedSpeeds(NamedTuple):
    """Speeds up to the next other measurement."""

    speeds: list[PreparedSpeed]
    due_ns: int  # stamp of the other measurement
    next: int  # its place in the list of measurements

    @property
    def arrays(self) -> Speeds:
        """For a segment."""
        if not self.speeds:
            return Speeds(NO_TIMES, NO_READINGS, NO_TIMES, self.due_ns)
        of = [speed.measurement for speed in self.speeds]
        in_doubt = [speed.zeros.doubt is not None and not speed.excluded for speed in self.speeds]
        readings = [
            (m.speed, m.resolution, m.exact, doubt, speed.excluded, speed.ignored)
            for m, doubt, speed in zip(of, in_doubt, self.speeds, strict=True)
        ]
        return Speeds(
            np.array([m.time_ns for m in of]), np.array(readings, np.float64),
            np.array([speed.zeros.stand_until_ns for speed in self.speeds]), self.due_ns,
        )  # fmt: skip


def is_other(used: WheelSpeed, seen: WheelSpeed) -> bool:
    """Whether a speed is of another odometer than the one in use."""
    return (used.source, used.of_wheels) != (seen.source, seen.of_wheels)


def is_in_use(used: WheelSpeed, seen: WheelSpeed) -> bool:
    """Whether the odometer in use stays in use beside another one."""
    better = seen.of_wheels and not used.of_wheels
    return not better and seen.time_ns - used.time_ns <= ODOMETER_SILENT_NS


def prepared(
    measurements: Sequence[Measurement], begin: int, odometer: WheelSpeed | None, zeros: ZeroSpeeds, *, excluded: bool
) -> "PreparedSpeeds":
    """Prepare the speeds from a place in the list on: see `Aids.speeds`; `odometer` is the one in use."""
    found: list[PreparedSpeed] = []
    for place in range(begin, len(measurements)):
        measurement = measurements[place]
        if not isinstance(measurement, WheelSpeed):
            return PreparedSpeeds(found, measurement.time_ns, place)
        if not excluded:
            if odometer is not None and is_other(odometer, measurement):
                if not is_in_use(odometer, measurement):
                    return PreparedSpeeds(found, measurement.time_ns, place)
                found.append(PreparedSpeed(place, measurement, odometer, zeros, excluded=False, ignored=True))
                continue
            odometer, zeros = measurement, zeros.after(measurement.time_ns, measurement.speed)
        found.append(PreparedSpeed(place, measurement, odometer, zeros, excluded))
    return PreparedSpeeds(found, NEVER_NS, len(measurements))

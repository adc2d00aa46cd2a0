"""Heading of the line between two antennas, as a moving-base receiver measures it."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import atan2, cos, hypot, sin
from typing import Self

import numpy as np

from shared.inertial.strapdown import rotate
from shared.maths.earth import wrap_angle
from shared.maths.rotation import Quaternion, Vector
from shared.messages.gnss import GnssFix
from shared.messages.navigation import AidingKind

from ...inertial import error_model as em
from ...inertial.filter import ErrorStateFilter
from ...settings import Settings
from ..base import Kind, Observation, Sensor, Start
from ..gnss.fix import true_time_ns

MIN_SD = 1e-3  # [rad]
TILT_SD = 0.02  # [rad] error of a heading in the alignment by the tilt error


@dataclass(frozen=True)
class BaselineHeading(Kind):
    """Direction [rad, clockwise from north] from the first to the second antenna; both lie level in the vehicle."""

    sensor = Sensor.GNSS

    time_ns: int
    received_ns: int
    source: str
    heading: float
    sd: float
    yaw_body: float  # [rad] direction of the same line against forward, clockwise
    removed_s: float = 0.0  # of its age, in `time_ns`

    def corrected(self, position_s: float, velocity_s: float) -> Self:
        """As late as a position."""
        shift_ns = round((position_s - self.removed_s) * 1e9)
        return replace(self, time_ns=self.time_ns - shift_ns, removed_s=position_s)

    def align(self, start: Start) -> None:
        """Heading, whose error grows with that of the tilt."""
        start.use_heading(self, hypot(self.sd, TILT_SD))

    def observers(self) -> Iterator[Callable[[ErrorStateFilter], Observation]]:
        """Heading alone."""
        yield self.observe

    def turn_from(self, quaternion: Quaternion) -> float:
        """Angle [rad] by which a frame's x axis lies clockwise from north, its attitude being given."""
        x, y, _ = self._direction(quaternion)
        return wrap_angle(self.heading - atan2(y, x))

    def observe(self, navigation: ErrorStateFilter) -> Observation:
        """Innovation against the heading of the line by the attitude.

        Notes
        -----
        With d = C u the direction of the line, the error psi turns its heading by::

            (d_N^2 + d_E^2) dh = (psi_D (d_N^2 + d_E^2) - d_D (psi_N d_N + psi_E d_E))
        """
        north, east, down = self._direction(navigation.quaternion)
        z = wrap_angle(self.heading - atan2(east, north))
        level2 = north * north + east * east
        H = np.zeros((1, em.SIZE))
        H[0, em.ATTITUDE] = down * north / level2, down * east / level2, -1.0
        return Observation(AidingKind.BASELINE_HEADING, np.array([z]), H, np.array([[self.sd**2]]))

    def _direction(self, quaternion: Quaternion) -> Vector:
        return rotate(quaternion, (cos(self.yaw_body), sin(self.yaw_body), 0.0))


def of_fix(fix: GnssFix, settings: Settings) -> Iterator[BaselineHeading]:
    """Heading of a fix, if it has one; as late as its position."""
    if fix.baseline_heading_rad is not None and fix.baseline_heading_sd_rad:
        time_ns, sd = true_time_ns(settings, fix.sampled_ns), max(fix.baseline_heading_sd_rad, MIN_SD)
        yaw_body = settings.vehicle.gnss.baseline_yaw_body_rad
        yield BaselineHeading(time_ns, fix.received_ns, fix.source, fix.baseline_heading_rad, sd, yaw_body)


KINDS = {GnssFix: (of_fix,)}

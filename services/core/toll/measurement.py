"""What a CAM measures, in the tangent plane of the plaza."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi, radians

import numpy as np

from shared.messages.v2x import Authentication, Cam

from .trackers.observation import SIZE, Observation

SCALAR_95 = 1.96  # standard deviations of a scalar in its confidence of 95 %
ELLIPSE_95 = 2.45  # standard deviations of an axis in an ellipse of 95 %
# Standard deviations where a CAM states none, and the least that is used: heading, speed, acceleration, yaw rate.
DEFAULT_SDS = (radians(1.0), 0.15, 0.2, radians(0.4))
MIN_SD = (radians(0.2), 0.03, 0.05, radians(0.1))
MIN_POSITION_SD = 0.02  # [m]


def ticket_of(cam: Cam) -> str | None:
    """Give the authorization ticket of an authenticated CAM; None: its sender is not known."""
    return cam.signer if cam.authentication is Authentication.AUTHENTICATED else None


@dataclass(frozen=True)
class CamMeasurement:
    """One CAM with its place in the plane, its time corrected to the unit's clock."""

    cam: Cam
    clock_offset_ns: int  # was added to the CAM's time
    east: float  # [m]
    north: float  # [m]
    place: int = 0  # of a station that is used at several places at once

    @property
    def station(self) -> tuple[int, str | None]:
        """Station ID, and the ticket of an authenticated station."""
        return self.cam.station_id, ticket_of(self.cam)

    @property
    def is_authenticated(self) -> bool:
        """Whether its sender is known."""
        return self.cam.authentication is Authentication.AUTHENTICATED

    @property
    def sender(self) -> tuple[int, str | None, int]:
        """The station at its place: one vehicle."""
        return (*self.station, self.place)

    @property
    def time_ns(self) -> int:
        """Time of the measurement."""
        return self.cam.sampled_ns

    @property
    def stated_sd(self) -> float | None:
        """Larger standard deviation [m] of the position by the CAM's ellipse."""
        major = self.cam.position_semi_major_m
        return None if major is None else major / ELLIPSE_95


def observation(
    measured: Sequence[CamMeasurement], white_sd: float, inflation: Sequence[float] | None = None
) -> Observation:
    """Observation of n vehicles; R holds the white noise only, the larger part of GNSS errors is not white.

    Parameters
    ----------
    measured : sequence of Measured
        One CAM of each vehicle.
    white_sd : float
        [m] Of positions; less where the vehicle states less.
    inflation : sequence of float, optional
        Factors by which the vehicles' positions have erred more than that; 1 without them.

    Returns
    -------
    Observation
        Heading counter-clockwise from east; what a CAM calls unavailable is not available.
    """
    z, sd, available = (np.zeros((len(measured), SIZE)), np.ones((len(measured), SIZE)), [])
    for k, item in enumerate(measured):
        cam = item.cam
        values = (
            None if cam.heading_rad is None else 0.5 * pi - cam.heading_rad,
            cam.speed_m_s,
            cam.longitudinal_acceleration_m_s2,
            cam.yaw_rate_rad_s,
        )
        confidences = (
            cam.heading_confidence_rad,
            cam.speed_confidence_m_s,
            cam.longitudinal_acceleration_confidence_m_s2,
            cam.yaw_rate_confidence_rad_s,
        )
        z[k] = (item.east, item.north, *(value or 0.0 for value in values))
        position_sd = max(min(white_sd, item.stated_sd or white_sd), MIN_POSITION_SD)
        position_sd *= inflation[k] if inflation else 1.0
        sd[k] = (
            position_sd,
            position_sd,
            *(
                usual if stated is None else max(stated / SCALAR_95, least)
                for stated, usual, least in zip(confidences, DEFAULT_SDS, MIN_SD, strict=True)
            ),
        )
        available.append((True, True, *(value is not None for value in values)))
    return Observation.of(z, sd, np.array(available, dtype=bool).reshape(-1, SIZE))

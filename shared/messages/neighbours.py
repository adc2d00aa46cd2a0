"""Neighbouring vehicles as this unit's V2X radio receives them."""

from typing import Annotated

from pydantic import Field

from .base import (
    Count,
    Deviation,
    Height,
    Latitude,
    Longitude,
    Message,
    Quantity,
    Ratio,
    StampedMessage,
    Symmetric3,
    Velocity3,
)

MAX_NEIGHBOURS = 64  # in one message
MAX_STATION_ID = 2**32 - 1  # ETSI TS 102 894-2, StationID


class Neighbour(Message):
    """State that a neighbour published, and what the radio measured of the transmission that carried it.

    The carrier frequency offset (CFO) is that of the received carrier against the radio's own oscillator. The
    fractional frequency offset of an oscillator is actual over nominal frequency, minus one.
    """

    station_id: Annotated[Count, Field(ge=0, le=MAX_STATION_ID)]
    latitude_deg: Latitude
    longitude_deg: Longitude
    height_ellipsoid_m: Height
    velocity_ned_m_s: Velocity3
    position_cov_ned_m2: Symmetric3
    velocity_cov_ned_m2_s2: Symmetric3
    oscillator_offset: Ratio | None = None  # fractional frequency offset of its transmitter, as it published it
    cfo_hz: Quantity | None = None  # measured by this unit's radio
    cfo_sd_hz: Deviation | None = None
    # By the signature of its CAM, if it was received in one; None: by other means, or of an earlier release.
    authenticated: Annotated[bool | None, Field(exclude_if=lambda value: value is None)] = None


class NeighbourStates(StampedMessage):
    """Neighbours at one time, states and measurements alike; the radio's antenna is at the GNSS antenna."""

    neighbours: Annotated[tuple[Neighbour, ...], Field(max_length=MAX_NEIGHBOURS)]

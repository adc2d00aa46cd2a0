"""The GNSS receivers."""

from typing_extensions import TypedDict

from shared.messages.gnss import Constellation
from shared.page.answers import Object, Stamp, answer

from ...history.columns import Change

Tracks = dict[str, dict[str, list[tuple[int, int]]]]  # elevation and azimuth [deg] of each satellite, by receiver


@answer()
class SignalShown(TypedDict):
    """One signal of a satellite."""

    band: str
    cn0_db_hz: float | None
    used: bool | None
    reason: str | None
    """why it is not used"""


@answer()
class SatelliteShown(TypedDict):
    """One satellite."""

    name: str
    constellation: Constellation
    elevation_deg: float | None
    azimuth_deg: float | None
    cn0_db_hz: float | None
    signals: list[SignalShown]
    residual_m: float | None
    used: bool
    excluded: bool
    suspect: bool
    reason: str | None
    """why the receiver does not use it"""
    integrity: str | None
    """what the monitor of the satellites states"""


@answer()
class ReceiverShown(TypedDict):
    """One receiver."""

    source: str
    updated_ns: dict[str, Stamp]
    fix: Object | None
    satellites: list[SatelliteShown]
    quality: Object | None
    configuration: Object | None
    device: Object | None
    said: Object | None
    first_fix_s: float | None
    bands: dict[str, list[Change]]
    """kinds of fix and of corrections over time"""


@answer()
class Receivers(TypedDict):
    """The GNSS receivers, the one received last first."""

    now_ns: Stamp
    receivers: list[ReceiverShown]
    """fix, satellites with the reason why one is not used, signals, settings, bands over time"""
    corrections: Object | None
    """their source, age and kinds"""
    kinds: list[Object]
    """messages of the receivers, with how many were used"""

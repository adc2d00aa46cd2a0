"""The newest position, for programs."""

from typing import Annotated, Literal

from pydantic import Field
from typing_extensions import TypedDict

from shared.page.answers import Stamp, answer

from ..banner import Trust
from .unit import EXAMPLE_NS, SENTENCE

PROPERTIES = {
    "state": "safe", "sentence": SENTENCE, "verdict_known": True, "live": True, "age_s": 0.03,
    "sampled_ns": EXAMPLE_NS, "speed_m_s": 13.9, "heading_deg": 92.4, "ellipse_95_semi_major_m": 1.1,
    "ellipse_95_semi_minor_m": 0.8, "ellipse_95_orientation_deg": 41.0, "height_sd_m": 0.7,
    "height_msl_m": 472.9, "geoid": "grid", "geoid_sd_m": 1.5,
    "speed_sd_m_s": 0.05, "heading_sd_deg": 0.3, "protection_level_horizontal_m": 3.0,
    "protection_level_vertical_m": 4.0, "alert_limit_horizontal_m": 10.0, "alert_limit_vertical_m": 20.0,
    "gnss_age_s": 0.4, "phase": "navigating", "stationary": False,
}  # fmt: skip


@answer()
class Properties(TypedDict):
    """Uncertainty of a position and the verdict on it; what is not known is null."""

    state: Trust
    """state of the position: that of core.trust, or why none is known"""
    sentence: str
    verdict_known: bool
    """whether there is a verdict of core.trust within its deadline"""
    live: bool
    """whether the solution is within its deadline of 2 s, and newer than the last start of core.fusion"""
    age_s: float | None
    sampled_ns: Stamp | None
    height_msl_m: float | None
    """above mean sea level"""
    geoid: Literal["receiver", "grid"] | None
    """whose mean sea level: the receiver's, or a grid of EGM96 each 3 degrees"""
    geoid_sd_m: float | None
    """standard deviation of the grid; null of a receiver, which states none"""
    speed_m_s: float | None
    heading_deg: float | None
    """from true north, clockwise"""
    ellipse_95_semi_major_m: float | None
    ellipse_95_semi_minor_m: float | None
    ellipse_95_orientation_deg: float | None
    """of the major axis, from true north, clockwise"""
    height_sd_m: float | None
    speed_sd_m_s: float | None
    heading_sd_deg: float | None
    protection_level_horizontal_m: float | None
    protection_level_vertical_m: float | None
    alert_limit_horizontal_m: float | None
    alert_limit_vertical_m: float | None
    gnss_age_s: float | None
    """since the last GNSS fix that was used"""
    phase: str | None
    stationary: bool | None


@answer({**PROPERTIES, "latitude_deg": 48.135124, "longitude_deg": 11.582044, "height_ellipsoid_m": 519.2})
class Solution(Properties):
    """The newest position with its uncertainty and the verdict on it; what is not known is null."""

    latitude_deg: Annotated[float, Field(ge=-90, le=90)] | None
    longitude_deg: Annotated[float, Field(ge=-180, le=180)] | None
    height_ellipsoid_m: float | None


@answer()
class Point(TypedDict):
    """Longitude, latitude [deg] and height above the ellipsoid [m] in WGS 84."""

    type: Literal["Point"]
    coordinates: tuple[float, float, float]


@answer({
    "type": "Feature",
    "geometry": {"type": "Point", "coordinates": [11.582044, 48.135124, 519.2]},
    "properties": PROPERTIES,
})  # fmt: skip
class Feature(TypedDict):
    """GeoJSON (RFC 7946); without any solution the geometry is null."""

    type: Literal["Feature"]
    geometry: Point | None
    properties: Properties

"""States of the barometer: the offset of its height to the ellipsoid."""

from math import degrees, hypot

from shared.maths.earth import Geodetic
from shared.maths.geoid.geoid import SD_M, separation_m

from ...blocks import Block
from ...settings import Settings
from .atmosphere import pressure_height

UNKNOWN_OFFSET_SD = 300.0  # [m] of barometric height: weather and geoid

TEMPERATURE = 0.035  # [-] of the height above the sea: 10 K beside the standard atmosphere's 288 K


def offset_by_qnh(settings: Settings, position: Geodetic) -> tuple[float, float] | None:
    """Offset [m] and its standard deviation by a configured QNH: both heights of sea level, on top of the geoid."""
    qnh_hpa, enabled = settings.barometer.qnh_hpa, settings.barometer.enabled
    if qnh_hpa is None or not enabled:
        return None
    separation = separation_m(degrees(position.latitude), degrees(position.longitude))
    above_sea = TEMPERATURE * (position.height - separation)
    sd = hypot(settings.barometer.qnh_sd_m, above_sea, SD_M)
    return pressure_height(100.0 * qnh_hpa) - separation, sd


BLOCKS = (
    Block(
        "barometer_offset", 1, "m",
        sd=lambda s: UNKNOWN_OFFSET_SD if s.barometer.enabled else 0.0,
        known=offset_by_qnh,
        psd=lambda s: s.barometer.offset_random_walk_m_sqrt_s**2 if s.barometer.enabled else 0.0,
    ),
)  # fmt: skip

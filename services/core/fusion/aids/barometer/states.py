"""States of the barometer: the offset of its height to the ellipsoid."""

from ...blocks import Block

UNKNOWN_OFFSET_SD = 300.0  # [m] of barometric height: weather and geoid

BLOCKS = (
    Block(
        "barometer_offset", 1, "m",
        sd=lambda s: UNKNOWN_OFFSET_SD if s.barometer.enabled else 0.0,
        psd=lambda s: s.barometer.offset_random_walk_m_sqrt_s**2 if s.barometer.enabled else 0.0,
    ),
)  # fmt: skip

"""Settings of the barometer."""

from pydantic import Field

from shared.runtime.config import Section


class BarometerSettings(Section):
    """Height from the air pressure that some IMUs measure."""

    enabled: bool = Field(default=True, description="aid the filter by the barometric height, if the IMU measures it")
    height_sd_m: float = Field(
        default=0.5, gt=0.0, description="standard deviation of the barometric height, apart from its offset"
    )
    offset_random_walk_m_sqrt_s: float = Field(
        default=0.1,
        gt=0.0,
        description="random walk of the offset of the barometric height, by weather and open windows",
    )
    qnh_hpa: float | None = Field(
        default=None,
        ge=850.0,
        le=1100.0,
        description="air pressure at sea level (QNH) at the start; without it the offset is found by heights of GNSS",
    )
    qnh_sd_m: float = Field(
        default=5.0,
        gt=0.0,
        le=100.0,
        description="standard deviation of the height by that pressure: a whole hPa is 8 m; that of the temperature, "
        "3.5 % of the height above the sea, is added",
    )

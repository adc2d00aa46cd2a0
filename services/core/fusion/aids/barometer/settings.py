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

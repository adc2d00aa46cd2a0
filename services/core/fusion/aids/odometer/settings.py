"""Settings of the odometer."""

from pydantic import Field

from shared.runtime.config import Section


class OdometerSettings(Section):
    """Speed of the wheels."""

    enabled: bool = Field(default=True, description="aid the filter by the speed of the wheels")
    speed_sd_m_s: float = Field(
        default=0.05, gt=0.0, description="standard deviation of a wheel speed, apart from its resolution"
    )
    scale: float = Field(default=1.0, gt=0.0, le=10.0, description="ratio of the true speed to the indicated speed")
    scale_sd: float = Field(
        default=0.02,
        gt=0.0,
        description="standard deviation of the scale error of the odometer at switch-on; the error is estimated",
    )

"""Settings of the non-holonomic constraint."""

from math import radians

from pydantic import Field

from shared.runtime.config import Section


class NonHolonomicSettings(Section):
    """Non-holonomic constraint (NHC): `[vehicle] rear_axle_body_m` moves neither sideways nor vertically."""

    enabled: bool = Field(default=True, description="aid the filter by the non-holonomic constraint")
    lateral_sd_m_s: float = Field(
        default=0.05, gt=0.0, description="standard deviation of the lateral speed, apart from slip in bends"
    )
    vertical_sd_m_s: float = Field(
        default=0.1,
        gt=0.0,
        description="standard deviation of the vertical speed, by pitch and heave of the suspension",
    )
    mounting_sd_rad: float = Field(
        default=radians(3.0),
        gt=0.0,
        description="standard deviation of the mounting angles (pitch and yaw of the IMU in the vehicle) at switch-on; "
        "they are estimated",
    )

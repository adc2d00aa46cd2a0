"""Settings of the displacement by carrier phases."""

from pydantic import Field

from shared.runtime.config import Section


class CarrierSettings(Section):
    """Displacement of the antenna by carrier phases, from receivers that send them."""

    enabled: bool = Field(
        default=False,
        description="aid the filter by checked displacements of carrier phases, in place of the receiver's velocity",
    )
    drift_sd_floor_m_s: float = Field(
        default=0.003,
        gt=0.0,
        le=1.0,
        description="lower limit of the standard deviation, each axis, of the drift of integrated displacements, by "
        "orbits, satellite clocks and ionosphere",
    )
    drift_correlation_s: float = Field(default=300.0, ge=10.0, le=1e5, description="correlation time of that drift")

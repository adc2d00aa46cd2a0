"""Settings of the magnetometer."""

from math import pi

from pydantic import Field

from shared.runtime.config import Section


class MagnetometerSettings(Section):
    """Heading from the magnetic field."""

    enabled: bool = Field(
        default=False, description="aid the filter by the magnetic heading after it has agreed with known headings"
    )
    declination_rad: float = Field(
        default=0.0, ge=-pi, le=pi, description="declination of magnetic north from true north, positive to the east"
    )

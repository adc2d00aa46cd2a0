"""Settings of updates at standstill."""

from pydantic import Field

from shared.runtime.config import Section


class StandstillSettings(Section):
    """Zero-velocity and zero-angular-rate updates (ZUPT, ZARU)."""

    enabled: bool = Field(default=True, description="aid the filter by zero velocity and zero rate at standstill")

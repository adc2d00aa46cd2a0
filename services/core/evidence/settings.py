"""Thresholds of the evidence; each description says what it was chosen from."""

from pydantic import Field

from shared.runtime.config import Section


class Settings(Section):
    """Thresholds, windows and deadlines."""

    gain_drop_ratio: float = Field(
        default=0.10, gt=0.0, lt=1.0,
        description="fall of the gain control below its mean that accuses: interference adds power, weather and "
        "temperature change the gain by a few per cent in minutes",
    )  # fmt: skip
    level_limit_db_hz: float = Field(
        default=52.0, gt=30.0, le=70.0,
        description="median C/N0 of the used satellites that no signal from orbit reaches with a vehicle's antenna; "
        "recorded receivers have at most 47",
    )  # fmt: skip
    level_rise_db: float = Field(
        default=10.0, gt=0.0, description="rise of the median C/N0 above its mean that accuses: open sky after a street"
    )
    least_spread_db: float = Field(
        default=2.0, gt=0.0,
        description="standard deviation of C/N0 over the used satellites below which they come from one transmitter; "
        "recorded receivers have 2.9 to 11.7",
    )  # fmt: skip
    least_satellites: int = Field(default=6, ge=3, description="used satellites of which C/N0 is judged")
    least_elevation_range_deg: float = Field(
        default=40.0, ge=0.0, le=90.0,
        description="range of their elevations below which the spread is not judged: signals from one height are alike",
    )  # fmt: skip
    clock_step_s: float = Field(
        default=2e-7, gt=0.0,
        description="departure of the receiver's clock from its own drift within one epoch that accuses: 60 m; a "
        "recorded ZED-F9R has 1e-9",
    )  # fmt: skip
    clock_sd_factor: float = Field(
        default=6.0, gt=0.0, description="number of stated standard deviations that such a departure has at least"
    )
    drift_step_ratio: float = Field(
        default=1e-7, gt=0.0, description="change of the clock's drift within one epoch that accuses: 30 m/s"
    )
    time_step_s: float = Field(
        default=0.3, gt=0.0,
        description="jump of GNSS time against the OBU time line that accuses: arrivals vary by 0.1 s with the number "
        "of messages",
    )  # fmt: skip
    host_time_s: float = Field(
        default=2.0, gt=0.0,
        description="distance of GNSS time from a host's clock that NTP holds which accuses, beside the error that the "
        "host states: a receiver's message is up to 1 s late",
    )  # fmt: skip
    host_clock_age_s: float = Field(
        default=60.0, gt=0.0, description="age from which a reading of the host's clock no longer counts"
    )
    velocities_m_s: float = Field(
        default=0.5, gt=0.0,
        description="distance of the receiver's velocity, that by Doppler or that by carrier phases from the other two "
        "which accuses, as a mean of 5 s, beside three stated standard deviations and a lag of 0.3 s",
    )  # fmt: skip
    baseline_s: float = Field(default=300.0, gt=0.0, description="time constant of the means of gain and C/N0")
    learning_s: float = Field(default=60.0, gt=0.0, description="time until these means are used")
    hold_s: float = Field(default=10.0, ge=0.0, description="time for which an accusation lasts after its last cause")
    stale_after_s: float = Field(default=3.0, gt=0.0, description="age from which a message no longer counts")

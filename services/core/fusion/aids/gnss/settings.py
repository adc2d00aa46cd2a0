"""Settings of GNSS."""

from pydantic import Field

from shared.messages.base import Vector3
from shared.runtime.config import Section


class GnssSettings(Section):
    """Delays and error model of the GNSS receiver; its antenna is `[vehicle.gnss]`."""

    delay_s: float = Field(
        default=0.0,
        ge=-2.0,
        le=2.0,
        description="delay of fixes: by how much they are older than their stamps, on the clock of the IMU",
    )
    delay_sd_s: float | None = Field(
        default=None,
        ge=0.0,
        le=2.0,
        description="standard deviation of the delay of fixes, which the protection levels hold, times the speed, "
        "until the check of the set-up agrees; if not given, 0.12 s, or 0.05 s where `delay_s` is not zero",
    )
    stamps_exact: bool = Field(
        default=False,
        description="the stamps of fixes are those of GNSS time: a delay that the check of the set-up finds is that of "
        "the inertial samples, and positions are published for the receiver's time",
    )
    velocity_delay_s: float = Field(
        default=0.0,
        ge=-1.0,
        le=1.0,
        description="delay of the velocity beyond that of the position of the same fix, where a receiver smooths it",
    )
    time_sd_s: float = Field(
        default=0.002,
        ge=0.0,
        le=1.0,
        description="standard deviation of the stamps of fixes; times the speed it adds to the position error",
    )
    position_only: bool = Field(default=False, description="do not use the velocity that the receiver measures")
    coasting_after_s: float = Field(
        default=3.0, gt=0.0, description="time without an accepted position after which the phase is `coasting`"
    )
    position_sd_ned_m: Vector3 = Field(
        default=(2.5, 2.5, 5.0), description="standard deviation of positions, NED, where the receiver states none"
    )
    velocity_sd_ned_m_s: Vector3 = Field(
        default=(0.2, 0.2, 0.4), description="standard deviation of velocities, NED, where the receiver states none"
    )
    position_sd_floor_m: float = Field(
        default=0.01, gt=0.0, description="lower limit of the standard deviation of a position"
    )
    velocity_sd_floor_m_s: float = Field(
        default=0.03, gt=0.0, description="lower limit of the standard deviation of a velocity"
    )
    position_sd_factor: float = Field(
        default=1.0, gt=0.0, description="factor on the standard deviations of positions that the receiver states"
    )
    time_correlated_errors: bool = Field(
        default=True,
        description="estimate the time-correlated part of position errors where the receiver states more than 0.1 m",
    )
    correlation_time_s: float | None = Field(
        default=None,
        ge=0.1,
        le=1e6,
        description="correlation time of position errors, if known, as from an Allan plot; otherwise it is estimated",
    )
    white_noise_share: float = Field(
        default=0.01,
        ge=1e-6,
        lt=1.0,
        description="share of white noise in the variance of positions, used if `correlation_time_s` is given",
    )
    zero_error_at_start: bool = Field(
        default=False,
        description="set the time-correlated error to zero at the first fix: the start is a known point or the origin",
    )

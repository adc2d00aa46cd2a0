"""Settings of the motion monitor."""

from pydantic import Field

from shared.runtime.config import VehicleSettings

from .tachograph import KM_H, WindowMode


class Settings(VehicleSettings):
    """Windows, noise, limits of what is learned, and plausibility limits."""

    odometer: bool = Field(
        default=True, description="compare the odometer; false as well where core.fusion.odometer.enabled is false"
    )
    window: WindowMode = Field(default=WindowMode.MOVING, description="samples that count for the tachograph's tests")
    still_m_s: float = Field(default=1.0 * KM_H, ge=0.0, le=1.0, description="GNSS speed that counts as standstill")
    pairing_s: float = Field(
        default=2.0, gt=0.0, le=5.0, description="longest time between the two speeds of a sample, and of interpolation"
    )
    stale_after_s: float = Field(
        default=15.0, gt=0.0, description="age of a speed at which the tachograph's tests are no longer evaluated"
    )
    fast_stale_after_s: float = Field(
        default=6.0, gt=0.0, description="age of the newest window at which the fast test is no longer evaluated"
    )
    fast_false_alarm_rate: float = Field(
        default=1e-5, gt=0.0, lt=0.5, description="false-alarm rate of the fast test, per window"
    )
    scale_false_alarm_rate: float = Field(
        default=1e-4, gt=0.0, lt=0.5, description="false-alarm rate of the tests of the scale"
    )
    gnss_sd_m_s: float = Field(
        default=0.2, gt=0.0, description="standard deviation of a GNSS speed without stated accuracy"
    )
    gnss_sd_floor_m_s: float = Field(default=0.05, gt=0.0, description="least standard deviation of a GNSS speed")
    gnss_correlation_s: float = Field(default=2.0, gt=0.0, description="correlation time of GNSS speed errors")
    dead_zone_m_s: float = Field(default=3.0 * KM_H, ge=0.0, description="speed below which the odometer may read zero")
    delay_limits_s: tuple[float, float] = Field(
        default=(-1.0, 1.0), description="smallest and largest delay of the odometer's stamps that is learned"
    )
    motion_sensor_moving_m_s: float = Field(
        default=5.0 * KM_H, gt=0.0, description="GNSS speed that contradicts an odometer at zero"
    )
    motion_sensor_s: float = Field(
        default=60.0, gt=0.0, description="time of contradiction within three hours that accuses the odometer"
    )
    largest_gnss_m_s: float = Field(default=150.0, gt=0.0, description="GNSS speeds above it are rejected")
    largest_odometer_m_s: float = Field(
        default=254.5 * KM_H, gt=0.0, description="odometer speeds above it are rejected: OBD 255 km/h means no value"
    )
    velocity_delay_s: float = Field(
        default=0.0, ge=-5.0, le=5.0, description="age of a GNSS velocity at its stamp; that of core.fusion by default"
    )
    inertial_scale_sd: float = Field(
        default=0.02,
        gt=0.0,
        le=0.1,
        description="standard deviation of the scale of accelerometer and gyroscope together, before the vehicle's own "
        "has been learned in bends",
    )

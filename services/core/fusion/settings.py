"""Settings of the navigation filter; the defaults suit an MTi-630 in a car."""

from math import radians

from pydantic import Field

from shared.config import Section
from shared.messages import Vector3

_GYROSCOPE_INSTABILITY = radians(8.0 / 3600.0)  # [rad/s] MTi-630 data sheet
_ACCELEROMETER_INSTABILITY = 15e-6 * 9.80665  # [m/s²] MTi-630 data sheet
_CORRELATION_S = 200.0


class Settings(Section):
    """Lever arm, noise, start, gates and switches."""

    lever_arm_body_m: Vector3 = (0.0, 0.0, 0.0)  # from the IMU to the GNSS antenna
    gnss_delay_s: float = Field(
        default=0.0, ge=-1.0, le=1.0
    )  # how much older a fix is, on the IMU's clock, than its stamp
    gnss_velocity_delay_s: float = Field(default=0.0, ge=-1.0, le=1.0)  # and how much older still is its velocity
    gnss_time_sd_s: float = Field(default=0.002, ge=0.0, le=1.0)  # of what is left of the stamps' errors
    merge_delay_s: float = Field(default=0.05, ge=0.0, le=1.0)  # how long a slow measurement waits for the bus
    history_s: float = Field(default=1.5, ge=0.2, le=10.0)  # how late a measurement may be
    solution_period_s: float = Field(default=0.1, gt=0.0, le=10.0)
    covariance_period_s: float = Field(default=0.05, gt=0.0, le=1.0)

    angle_random_walk_rad_sqrt_s: float = Field(default=1.222e-4, gt=0.0)
    velocity_random_walk_m_s_sqrt_s: float = Field(default=5.884e-4, gt=0.0)
    vibration_factor: float = Field(default=1.0, ge=0.0)  # share of the shaking of samples that counts as white noise
    gyroscope_bias_psd_rad2_s3: float = Field(default=2.0 * _GYROSCOPE_INSTABILITY**2 / _CORRELATION_S, ge=0.0)
    accelerometer_bias_psd_m2_s5: float = Field(default=2.0 * _ACCELEROMETER_INSTABILITY**2 / _CORRELATION_S, ge=0.0)
    gyroscope_bias_sd_rad_s: float = Field(default=radians(0.2), gt=0.0)  # at switch-on
    accelerometer_bias_sd_m_s2: float = Field(default=0.03, gt=0.0)  # at switch-on

    levelling_s: float = Field(default=15.0, ge=1.0)  # of standstill; a vehicle that drives off is not waited for
    course_speed_m_s: float = Field(default=2.0, gt=0.0)  # above it the course over ground gives the heading
    course_yaw_sd_rad: float = Field(default=radians(5.0), gt=0.0)  # sideslip and mounting
    coasting_after_s: float = Field(default=3.0, gt=0.0)

    position_only: bool = False
    zero_velocity: bool = True
    gnss_position_sd_m: Vector3 = (2.5, 2.5, 5.0)  # NED, of a receiver that does not say
    gnss_velocity_sd_m_s: Vector3 = (0.2, 0.2, 0.4)  # NED, of a receiver that does not say
    gnss_position_sd_floor_m: float = Field(default=0.01, gt=0.0)
    gnss_velocity_sd_floor_m_s: float = Field(default=0.03, gt=0.0)
    gnss_sd_factor: float = Field(default=1.0, gt=0.0)  # on what the receiver says, against correlated errors
    gate_false_alarm: float = Field(default=0.001, gt=0.0, lt=0.5)
    reset_after_rejections: int = Field(default=10, ge=1)  # successive positions
    reset_after_s: float = Field(default=5.0, ge=0.0)  # and at least so long since the last accepted one

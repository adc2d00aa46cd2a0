"""Settings of the navigation filter; the defaults suit an MTi-630 in a car."""

from math import pi, radians

from pydantic import Field

from shared.messages.base import Vector3
from shared.runtime.config import Section

_GYROSCOPE_INSTABILITY = radians(8.0 / 3600.0)  # [rad/s] MTi-630 data sheet
_ACCELEROMETER_INSTABILITY = 15e-6 * 9.80665  # [m/s²] MTi-630 data sheet
_CORRELATION_S = 200.0


class Settings(Section):
    """Lever arm, noise, start, gates and switches."""

    lever_arm_body_m: Vector3 = Field(
        default=(0.0, 0.0, 0.0), description="from the IMU to the GNSS antenna: forward, right, down"
    )
    gnss_delay_s: float = Field(
        default=0.0,
        ge=-2.0,
        le=2.0,
        description="how much older a fix is, on the clock of the IMU, than its stamp says",
    )
    gnss_velocity_delay_s: float = Field(
        default=0.0, ge=-1.0, le=1.0, description="how much older still its velocity is: some receivers smooth it"
    )
    gnss_time_sd_s: float = Field(
        default=0.002, ge=0.0, le=1.0, description="error of the stamps, which at speed is an error of position"
    )
    estimate_delays: bool = Field(
        default=False,
        description="estimate how much older GNSS, its velocity and the odometer are than the settings say",
    )
    merge_delay_s: float = Field(
        default=0.2, ge=0.0, le=1.0, description="how long a measurement waits for what the bus may have delayed"
    )
    history_s: float = Field(default=2.5, ge=0.2, le=10.0, description="how late a measurement may be")
    solution_period_s: float = Field(default=0.1, gt=0.0, le=10.0, description="between two solutions on the bus")
    covariance_period_s: float = Field(default=0.05, gt=0.0, le=1.0, description="between two steps of the covariance")

    angle_random_walk_rad_sqrt_s: float = Field(default=1.222e-4, gt=0.0, description="white noise of the gyroscope")
    velocity_random_walk_m_s_sqrt_s: float = Field(
        default=5.884e-4, gt=0.0, description="white noise of the accelerometer"
    )
    vibration_factor: float = Field(
        default=1.0, ge=0.0, description="share of the measured shaking of samples that counts as white noise"
    )
    gyroscope_bias_psd_rad2_s3: float = Field(
        default=2.0 * _GYROSCOPE_INSTABILITY**2 / _CORRELATION_S, ge=0.0, description="how the bias wanders"
    )
    accelerometer_bias_psd_m2_s5: float = Field(
        default=2.0 * _ACCELEROMETER_INSTABILITY**2 / _CORRELATION_S, ge=0.0, description="how the bias wanders"
    )
    gyroscope_bias_sd_rad_s: float = Field(default=radians(0.2), gt=0.0, description="of the bias at switch-on")
    accelerometer_bias_sd_m_s2: float = Field(default=0.03, gt=0.0, description="of the bias at switch-on")
    gyroscope_scale_sd: float = Field(
        default=0.0, ge=0.0, le=0.1, description="of the scale of each axis at switch-on; 0: it is not estimated"
    )
    accelerometer_scale_sd: float = Field(
        default=0.0, ge=0.0, le=0.1, description="of the scale of each axis at switch-on; 0: it is not estimated"
    )

    levelling_s: float = Field(
        default=15.0, ge=1.0, description="standstill for levelling; a vehicle that drives off is not waited for"
    )
    course_speed_m_s: float = Field(default=2.0, gt=0.0, description="above it a velocity gives the heading")
    course_yaw_sd_rad: float = Field(
        default=radians(5.0), gt=0.0, description="of heading against course: sideslip and mounting"
    )
    coasting_after_s: float = Field(default=3.0, gt=0.0, description="without an accepted position")

    position_only: bool = Field(default=False, description="leave the receiver's velocity unused")
    zero_velocity: bool = Field(default=True, description="aid the filter at standstill")
    odometer: bool = Field(default=True, description="aid the filter by the speed of the wheels")
    non_holonomic: bool = Field(default=True, description="wheels neither slide sideways nor leave the road")
    rear_axle_body_m: Vector3 | None = Field(
        default=None,
        description="from the IMU to the middle of the rear axle; unknown, the wheels are trusted less in bends",
    )
    odometer_sd_m_s: float = Field(default=0.05, gt=0.0, description="of a speed, apart from its resolution")
    odometer_scale_sd: float = Field(default=0.02, gt=0.0, description="of the scale at switch-on, which is estimated")
    non_holonomic_sd_m_s: float = Field(default=0.05, gt=0.0, description="of sideways speed, apart from slip in bends")
    non_holonomic_vertical_sd_m_s: float = Field(
        default=0.1, gt=0.0, description="of vertical speed: on its springs a body pitches and heaves"
    )
    mounting_sd_rad: float = Field(
        default=radians(3.0), gt=0.0, description="of the IMU against the vehicle: pitch and yaw, which are estimated"
    )
    barometer: bool = Field(default=True, description="aid the filter by the pressure, if the IMU tells it")
    barometer_sd_m: float = Field(default=0.5, gt=0.0, description="of barometric height, apart from its offset")
    barometer_walk_m_sqrt_s: float = Field(default=0.1, gt=0.0, description="how its offset wanders: weather, windows")
    baseline_yaw_body_rad: float = Field(
        default=0.0, ge=-pi, le=pi, description="direction from the first to the second antenna, clockwise from forward"
    )
    compass: bool = Field(
        default=False, description="aid the filter by the magnetometer as far as it agrees with headings that are known"
    )
    magnetic_declination_rad: float = Field(
        default=0.0, ge=-pi, le=pi, description="of magnetic north from true north, positive to the east"
    )
    gnss_position_sd_m: Vector3 = Field(default=(2.5, 2.5, 5.0), description="NED, of a receiver that states none")
    gnss_velocity_sd_m_s: Vector3 = Field(default=(0.2, 0.2, 0.4), description="NED, of a receiver that states none")
    gnss_position_sd_floor_m: float = Field(default=0.01, gt=0.0, description="least that is believed of a receiver")
    gnss_velocity_sd_floor_m_s: float = Field(default=0.03, gt=0.0, description="least that is believed of a receiver")
    gnss_sd_factor: float = Field(
        default=1.0, gt=0.0, description="on what a receiver states of positions, against correlated errors"
    )
    gnss_lasting_errors: bool = Field(
        default=True,
        description="estimate the part of GNSS position errors that lasts, where corrections leave more than 0.1 m",
    )
    gnss_error_correlation_s: float | None = Field(
        default=None,
        ge=0.1,
        le=1e6,
        description="correlation time of that part, if it is known, as from an Allan plot; learned if not given",
    )
    gnss_error_white_share: float = Field(
        default=0.01, ge=1e-6, lt=1.0, description="of the variance, where that time is given; the rest lasts"
    )
    gnss_error_from_zero: bool = Field(
        default=False,
        description="at the first fix nothing lasts yet: it is a known point, or positions count from there",
    )
    gate_false_alarm: float = Field(
        default=0.001, gt=0.0, lt=0.5, description="probability with which a good measurement is refused"
    )
    robust_limit: float = Field(
        default=2.0,
        ge=1.0,
        description="times the gate, in d²: up to it GNSS is used with less weight",
    )
    fault_after_s: float = Field(
        default=2.0,
        ge=0.0,
        description="GNSS that is refused for so long is at fault and has to prove itself",
    )
    healthy_s: float = Field(
        default=1.0, ge=0.0, description="how long all that it says must agree again; doubled by each further fault"
    )
    healthy_max_s: float = Field(default=8.0, ge=0.0, description="longest time of that kind")
    reset_after_rejections: int = Field(default=10, ge=1, description="successive refused positions, and")
    reset_after_s: float = Field(default=5.0, ge=0.0, description="so long without an accepted one, begin again")
    integrity_risk: float = Field(
        default=1e-3, ge=1e-9, le=0.1, description="probability with which the error is beyond a protection level"
    )
    alert_limit_horizontal_m: float = Field(
        default=10.0, gt=0.0, description="horizontal error up to which a position is of use; reports judge by it"
    )
    alert_limit_vertical_m: float = Field(default=20.0, gt=0.0, description="the same of the height")
    machine_code: bool = Field(
        default=False,
        description="compile what runs for every sample, where Numba is installed: a third of the time without wheels, "
        "two thirds with them, 50 MB more memory, and results that agree to 1e-9 but not to the byte",
    )

"""Settings of the navigation filter in sections; the defaults suit an MTi-630 in a car."""

from math import radians

from pydantic import Field

from shared.runtime.config import Section, VehicleSettings

from .aids.barometer.settings import BarometerSettings
from .aids.carrier.settings import CarrierSettings
from .aids.gnss.settings import GnssSettings
from .aids.magnetometer.settings import MagnetometerSettings
from .aids.non_holonomic.settings import NonHolonomicSettings
from .aids.odometer.settings import OdometerSettings
from .aids.standstill.settings import StandstillSettings

_GYROSCOPE_INSTABILITY = radians(8.0 / 3600.0)  # [rad/s] MTi-630 data sheet
_ACCELEROMETER_INSTABILITY = 15e-6 * 9.80665  # [m/s²] MTi-630 data sheet
_CORRELATION_S = 200.0


class ImuSettings(Section):
    """Noise, biases and scale errors of the inertial sensors; their mounting is `[vehicle.imu] body_from_sensor`."""

    angle_random_walk_rad_sqrt_s: float = Field(
        default=1.222e-4, gt=0.0, description="angle random walk: root of the PSD of the gyroscopes' white noise"
    )
    velocity_random_walk_m_s_sqrt_s: float = Field(
        default=5.884e-4, gt=0.0, description="velocity random walk: root of the PSD of the accelerometers' white noise"
    )
    vibration_factor: float = Field(
        default=1.0,
        ge=0.0,
        description="factor on the measured vibration PSD of the samples, which is used as white noise",
    )
    gyroscope_bias_psd_rad2_s3: float = Field(
        default=2.0 * _GYROSCOPE_INSTABILITY**2 / _CORRELATION_S,
        ge=0.0,
        description="PSD of the white noise that drives the random walk of the gyroscope biases",
    )
    accelerometer_bias_psd_m2_s5: float = Field(
        default=2.0 * _ACCELEROMETER_INSTABILITY**2 / _CORRELATION_S,
        ge=0.0,
        description="PSD of the white noise that drives the random walk of the accelerometer biases",
    )
    gyroscope_bias_sd_rad_s: float = Field(
        default=radians(2.5),
        gt=0.0,
        description="standard deviation of the gyroscope biases at switch-on; a start at standstill measures them",
    )
    accelerometer_bias_sd_m_s2: float = Field(
        default=0.03, gt=0.0, description="standard deviation of the accelerometer biases at switch-on"
    )
    gyroscope_scale_sd: float = Field(
        default=0.0,
        ge=0.0,
        le=0.1,
        description="standard deviation of the scale error of each gyroscope at switch-on; 0: not estimated",
    )
    accelerometer_scale_sd: float = Field(
        default=0.0,
        ge=0.0,
        le=0.1,
        description="standard deviation of the scale error of each accelerometer at switch-on; 0: not estimated",
    )


class AlignmentSettings(Section):
    """Start of the filter: levelling and heading."""

    levelling_s: float = Field(
        default=15.0,
        ge=1.0,
        description="longest time of levelling at standstill; it ends earlier when the vehicle moves",
    )
    without_gnss_s: float = Field(
        default=30.0,
        ge=0.0,
        description="time after switch-on without a GNSS position from which the filter starts at the saved position, "
        "if the vehicle was parked there and has not moved since: dead reckoning from it",
    )
    course_speed_m_s: float = Field(
        default=2.0, gt=0.0, description="lowest speed at which the course over ground gives the initial heading"
    )
    course_yaw_sd_rad: float = Field(
        default=radians(5.0),
        gt=0.0,
        description="standard deviation of heading minus course over ground, by sideslip and mounting",
    )


class GatingSettings(Section):
    """Acceptance of measurements by the normalised innovation squared (NIS), and faults of GNSS."""

    false_alarm_probability: float = Field(
        default=0.001, gt=0.0, lt=0.5, description="probability that the chi-square gate rejects a valid measurement"
    )
    robust_limit: float = Field(
        default=2.0,
        ge=1.0,
        description="multiple of the gate's limit up to which a GNSS measurement is used with less weight",
    )
    fault_after_s: float = Field(
        default=2.0, ge=0.0, description="time of continued rejection after which GNSS is excluded as faulty"
    )
    readmission_s: float = Field(
        default=1.0,
        ge=0.0,
        description="time for which all measurements of an excluded receiver must pass the gate before it is used "
        "again; doubled for each further fault",
    )
    readmission_max_s: float = Field(default=8.0, ge=0.0, description="upper limit of the time until readmission")
    reset_after_rejections: int = Field(
        default=10,
        ge=1,
        description="number of consecutive rejected positions that triggers a filter reset (with `reset_after_s`)",
    )
    reset_after_s: float = Field(
        default=5.0,
        ge=0.0,
        description="time without an accepted position that triggers a filter reset (with `reset_after_rejections`)",
    )


class IntegritySettings(Section):
    """Protection levels; the alert limits that they are compared with are those of `[vehicle]`."""

    risk: float = Field(
        default=1e-3, ge=1e-9, le=0.1, description="probability that the position error exceeds a protection level"
    )


class Settings(VehicleSettings):
    """Settings of the filter as a whole, and one section for each sensor or function."""

    solution_period_s: float = Field(default=0.1, gt=0.0, le=10.0, description="time between two published solutions")
    covariance_period_s: float = Field(
        default=0.05, gt=0.0, le=1.0, description="longest time between two propagations of the covariance"
    )
    merge_delay_s: float = Field(
        default=0.05,
        ge=0.0,
        le=1.0,
        description="time after its arrival within which a measurement reaches the filter: the filter runs so far "
        "behind the newest sample, beyond the largest delay of a measurement",
    )
    history_s: float = Field(
        default=2.5, ge=0.2, le=10.0, description="largest age at which an out-of-sequence measurement is still used"
    )
    imu: ImuSettings = ImuSettings()
    gnss: GnssSettings = GnssSettings()
    carrier: CarrierSettings = CarrierSettings()
    odometer: OdometerSettings = OdometerSettings()
    non_holonomic: NonHolonomicSettings = NonHolonomicSettings()
    standstill: StandstillSettings = StandstillSettings()
    barometer: BarometerSettings = BarometerSettings()
    magnetometer: MagnetometerSettings = MagnetometerSettings()
    alignment: AlignmentSettings = AlignmentSettings()
    gating: GatingSettings = GatingSettings()
    integrity: IntegritySettings = IntegritySettings()

"""Settings of the inertial monitors."""

from hashlib import sha256
from math import hypot, radians

from pydantic import Field

from shared.runtime.config import Section, VehicleSettings
from shared.trust.budget import rate_of

from .grade import Grade
from .profile import UNIT_IMU, Profile

UNKNOWN_AXLE_M = 1.5  # between IMU and rear axle, where the vehicle's file does not state it


class GnssSettings(Section):
    """Velocity of the GNSS receiver; its antenna is `[vehicle.gnss]`."""

    velocity_delay_s: float = Field(
        default=0.0, ge=-2.0, le=2.0, description="age of the velocity beyond what the stamp of its fix says"
    )
    position_delay_s: float = Field(
        default=0.0, ge=-2.0, le=2.0, description="age of the position beyond what the stamp of its fix says"
    )
    velocity_sd_m_s: float = Field(
        default=0.2, gt=0.0, description="standard deviation of a velocity of a receiver that states none"
    )
    velocity_sd_floor_m_s: float = Field(
        default=0.05, gt=0.0, description="least standard deviation of a velocity, whatever the receiver states"
    )
    largest_velocity_sd_m_s: float = Field(
        default=1.0,
        gt=0.0,
        description="changes of position are compared in place of velocities with a larger standard deviation",
    )
    velocity_correlation_s: float = Field(default=2.0, gt=0.0, description="correlation time of velocity errors")
    time_sd_s: float = Field(
        default=0.02, ge=0.0, description="standard deviation of the stamps; times the acceleration it is a velocity"
    )
    largest_speed_m_s: float = Field(default=150.0, gt=0.0, description="faster velocities are rejected")


class LongSettings(Section):
    """Free propagation over 30 and 60 s."""

    false_alarm_rate: float = Field(
        default=rate_of("long"),
        gt=0.0,
        lt=0.5,
        description="false-alarm rate of each window, per evaluation: its share of one false alarm in ten hours",
    )
    doubt_rate: float = Field(
        default=3e-3,
        gt=0.0,
        lt=0.5,
        description="false-alarm rate of the doubt about the way since 60 and 120 s, which makes the verdict CAUTION",
    )
    velocity_random_walk_m_s_sqrt_s: float = Field(
        default=0.006, gt=0.0, description="root of the PSD of the accelerometers' noise, vibration included"
    )
    angle_random_walk_rad_sqrt_s: float = Field(
        default=2e-4, gt=0.0, description="root of the PSD of the gyroscopes' noise, vibration included"
    )
    accelerometer_bias_sd_m_s2: float = Field(
        default=0.002,
        ge=0.0,
        description="standard deviation of the accelerometer biases, added to the covariance of fusion's filter",
    )
    gyroscope_bias_sd_rad_s: float = Field(
        default=2e-5,
        ge=0.0,
        description="standard deviation of the gyroscope biases, added to the covariance of fusion's filter",
    )
    scale_sd: float = Field(
        default=0.002, ge=0.0, description="standard deviation of scale and cross-axis errors of the accelerometers"
    )
    gyroscope_scale_sd: float = Field(
        default=0.002, ge=0.0, description="standard deviation of the scale error of each gyroscope"
    )
    attitude_sd_rad: float = Field(
        default=2e-4,
        ge=0.0,
        description="standard deviation of the attitude per axis, added to the covariance of fusion's filter",
    )
    velocity_sd_m_s: float = Field(
        default=0.02,
        ge=0.0,
        description="standard deviation of the velocity per axis, added to the covariance of fusion's filter",
    )
    odometer: bool = Field(
        default=True, description="aid by the odometer; false as well where core.fusion.odometer.enabled is false"
    )
    odometer_sd_m_s: float = Field(default=0.05, gt=0.0, description="standard deviation of the odometer's speed")
    odometer_scale_sd: float = Field(
        default=0.002,
        ge=0.0,
        description="standard deviation of the odometer's scale, added to the covariance of fusion's filter",
    )
    position_time_sd_s: float = Field(
        default=0.05,
        ge=0.0,
        description="standard deviation of the age of positions; times a change of velocity, a way",
    )
    odometer_delay_s: float = Field(default=0.0, ge=-2.0, le=3.0, description="age of odometer speeds at their stamps")
    odometer_time_sd_s: float = Field(default=0.05, ge=0.0, description="standard deviation of that age")
    odometer_dead_zone_m_s: float = Field(
        default=3.0 / 3.6, ge=0.0, description="speed below which an odometer with steps may read zero"
    )
    odometer_gate: float = Field(
        default=1e-5, gt=0.0, lt=0.5, description="false-alarm rate of the gate on a single odometer speed"
    )
    non_holonomic: bool = Field(default=True, description="the vehicle moves along its forward axis: no lateral slip")
    lateral_sd_m_s: float = Field(default=0.1, gt=0.0, description="standard deviation of the lateral velocity")
    vertical_sd_m_s: float = Field(default=0.1, gt=0.0, description="standard deviation of the velocity along body z")
    mounting_sd_rad: float = Field(
        default=radians(0.1),
        ge=0.0,
        description="standard deviation of the mounting angles, added to the covariance of fusion's filter",
    )
    correlation_s: float = Field(
        default=3.0, ge=1.0, description="correlation time of the errors of odometer and non-holonomic constraint"
    )


class GyroscopeSettings(Section):
    """Yaw rate of the gyroscope against wheels, GNSS course and headings."""

    false_alarm_rate: float = Field(
        default=rate_of("gyroscope"), gt=0.0, lt=0.5, description="false-alarm rate of each window, per evaluation"
    )


class ObserverSettings(Section):
    """Yaw and gyroscope bias of standstills, which GNSS never touches."""

    gyroscope_instability_rad_s: float = Field(
        default=4e-5, ge=0.0, description="in-run instability of the gyroscope biases: 8 deg/h of an industrial sensor"
    )
    gyroscope_moving_sd_rad_s: float = Field(
        default=1e-4, ge=0.0,
        description="difference of the gyroscope biases of a moving vehicle from those at standstill: vibration that a "
        "sensor rectifies, 0.09 deg/s on a recorded drive with a low-cost one",
    )  # fmt: skip
    gyroscope_bias_walk_rad_s_sqrt_s: float = Field(
        default=1e-6,
        ge=0.0,
        description="random walk of the gyroscope biases since the last standstill, changes of temperature included",
    )


class DriftSettings(Section):
    """Sums of GNSS innovations over 30, 100 and 300 s."""

    false_alarm_rate: float = Field(
        default=rate_of("drift"),
        gt=0.0,
        lt=0.5,
        description="false-alarm rate of each test of each window, per evaluation",
    )


class Settings(VehicleSettings):
    """Settings of all monitors."""

    grade: Grade | None = Field(
        default=None,
        description="grade of the inertial sensors, which thresholds follow until they are learned on this vehicle: "
        "consumer, automotive, industrial or tactical; without it nothing is evaluated until then",
    )
    warm_up_s: float = Field(
        default=60.0,
        ge=0.0,
        description="after the alignment, before which no free propagation starts: the filter converges",
    )
    gnss: GnssSettings = GnssSettings()
    long: LongSettings = LongSettings()
    gyroscope: GyroscopeSettings = GyroscopeSettings()
    observer: ObserverSettings = ObserverSettings()
    drift: DriftSettings = DriftSettings()
    profile: Profile = Field(default=UNIT_IMU, description="standard deviations of the 5 s metrics, and their origin")
    stale_after_s: float = Field(default=3.0, gt=0.0, description="age of GNSS or inertial data that ends a comparison")
    largest_force_m_s2: float = Field(default=80.0, gt=0.0, description="larger specific forces are rejected")
    largest_rate_rad_s: float = Field(default=20.0, gt=0.0, description="larger angular rates are rejected")

    @property
    def rear_axle_distance_m(self) -> float:
        """Distance on the ground between IMU and rear axle; times the yaw rate it is a lateral velocity."""
        axle = self.vehicle.rear_axle_body_m
        return UNKNOWN_AXLE_M if axle is None else hypot(*axle[:2])

    def digest(self) -> str:
        """Identify the settings that the 5 s metrics depend on, those of GNSS."""
        arm, gnss = self.vehicle.gnss.model_dump_json(include={"lever_arm_body_m"}), self.gnss.model_dump_json()
        text = f"{arm[:-1]},{gnss[1:]}"  # one object, as of profiles that were learned while one section held both
        return sha256(text.encode()).hexdigest()[:16]

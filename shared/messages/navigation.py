"""What the fusion core says, and the truth that only the simulator knows."""

from enum import StrEnum
from typing import Annotated

from pydantic import Field

from .base import (
    Count,
    Deviation,
    Deviation3,
    Height,
    Latitude,
    Longitude,
    Message,
    Name,
    Nanoseconds,
    Persistent,
    Quantity,
    Ratio,
    Reason,
    Seconds,
    Square,
    Statistic,
    Symmetric3,
    Vector3,
    Velocity3,
    unit,
)
from .explanation import Explanation, Explanations

Innovation = Annotated[Statistic, unit("of the kind: m, m/s, rad/s or rad")]
Parameter = Annotated[Quantity, unit("of the parameter: 1, rad, s or m")]
Covariance = Annotated[Square, unit("of its two states: 1, rad, m, m/s, m/s2, rad/s or s")]


class NavigationPhase(StrEnum):
    """How far the navigation filter has come."""

    WAITING_FOR_IMU = "waiting_for_imu"
    LEVELLING = "levelling"
    WAITING_FOR_GNSS = "waiting_for_gnss"
    WAITING_FOR_HEADING = "waiting_for_heading"
    NAVIGATING = "navigating"
    COASTING = "coasting"
    GNSS_ONLY = "gnss_only"  # no inertial samples: each fix is published, attitude and rates are not measured


class NavigationSolution(Message):
    """Position, velocity and attitude of the IMU with their uncertainty (1 sigma)."""

    sampled_ns: Nanoseconds
    phase: NavigationPhase
    latitude_deg: Latitude
    longitude_deg: Longitude
    height_ellipsoid_m: Height
    velocity_ned_m_s: Velocity3
    roll_rad: Quantity
    pitch_rad: Quantity
    yaw_rad: Quantity
    position_cov_ned_m2: Symmetric3
    velocity_cov_ned_m2_s2: Symmetric3
    attitude_cov_ned_rad2: Symmetric3
    angular_rate_body_rad_s: Vector3  # bias removed
    accelerometer_bias_m_s2: Vector3
    gyroscope_bias_rad_s: Vector3
    stationary: bool
    gnss_age_s: Seconds | None = None  # since the stamp of the last fix that was used
    # Error beyond which the position is with probability `integrity_risk` only; absent in recordings of older units.
    protection_level_horizontal_m: Deviation | None = None
    protection_level_vertical_m: Deviation | None = None
    integrity_risk: Ratio | None = None
    gyroscope_bias_sd_rad_s: Deviation3 | None = None
    # No GNSS with a later stamp is part of this solution, because core.trust excludes it; None while GNSS is used.
    gnss_excluded_since_ns: Nanoseconds | None = None
    # Turn of attitude and heading about the axis down against the inertial sensors, whose axes are not the vehicle's
    # by a check of the set-up; None while no check says so. Rates and biases are of the sensors' axes.
    heading_turn_rad: Quantity | None = None


class NavigationState(Message):
    """What the filter is doing and why; published when it changes and once a second."""

    sampled_ns: Nanoseconds
    phase: NavigationPhase
    since_ns: Nanoseconds
    reason: Reason
    reason_codes: Explanations = ()  # of `reason`: why the phase began, then what explains it further
    fixes_used: Count
    fixes_rejected: Count
    samples_used: Count
    samples_rejected: Count
    imu_gaps: Count
    resets: Count
    epochs_repeated: Count = 0  # by a receiver that tells one twice, or holds a value while the vehicle drives
    measurements_late: Count = 0  # that came behind the horizon, and were used at their own time by a replay
    # by how much GNSS is older than its stamps and the settings say, as the check of the set-up has found; None if not
    gnss_delay_s: Seconds | None = None  # of positions
    gnss_velocity_delay_s: Seconds | None = None  # of the velocity, beyond that of its position
    # present in recordings of older units alone, whose filter estimated delays
    gnss_delay_sd_s: Seconds | None = None
    gnss_velocity_delay_sd_s: Seconds | None = None
    odometer_delay_s: Seconds | None = None
    odometer_delay_sd_s: Seconds | None = None
    lever_arm_error_body_m: tuple[Quantity, Quantity] | None = None  # forward, right: true minus set, if that is wrong
    # error up to which the position is of use, as configured; absent in recordings of older units
    alert_limit_horizontal_m: Deviation | None = None
    alert_limit_vertical_m: Deviation | None = None
    # what core.trust excludes, as far as it has taken effect
    gnss_excluded_since_ns: Nanoseconds | None = None
    fixes_excluded: Count = 0  # not used because GNSS was excluded
    # of the newest excluded position against the solution without GNSS: normalised innovation squared over its limit
    excluded_test_ratio: Annotated[Statistic, unit("1")] | None = None
    odometer_excluded: bool = False
    imu_excluded: bool = False  # the position is that of GNSS and odometer alone
    odometer_age_s: Seconds | None = None  # since the last speed of the odometer that was used
    merge_lag_s: Seconds | None = None  # by which the filter waits for late measurements
    fixes_late_s: Seconds | None = None  # by which fixes arrive later than they did, which their stamps take account of
    # while GNSS contradicts the other sensors there are two solutions, with GNSS and without it since the suspect time
    conflict_since_ns: Nanoseconds | None = None
    other_distance_m: Deviation | None = (
        None  # horizontal, of the solution that is not published from the published one
    )
    other_level_m: Deviation | None = None  # horizontal protection level of the solution that is not published
    without_gnss_level_m: Deviation | None = None  # horizontal protection level of the solution without GNSS
    exclusion_declined_code: Explanation | None = None
    exclusion_declined: Reason | None = None  # why the solution without GNSS is not published, or was given up
    # difference of positions that no evidence has decided: part of the protection level until it ends
    held_horizontal_m: Deviation = 0.0
    held_vertical_m: Deviation = 0.0
    held_code: Explanation | None = None
    held_reason: Reason | None = None  # what differed
    # what would end it, each by itself
    held_end_codes: Annotated[tuple[Explanation, ...], Field(max_length=8)] | None = None
    satellites_left_out: Annotated[tuple[Name, ...], Field(max_length=128)] = ()  # of the newest position that was used
    # first filter of this process, unless it goes on from the state of an earlier one
    started_ns: Nanoseconds | None = None
    started_in_motion: bool = False  # without a standstill before it


class SetUpVerdict(StrEnum):
    """What a check of the set-up has found."""

    UNKNOWN = "unknown"  # the drive has not shown enough
    AGREES = "agrees"
    CONTRADICTS = "contradicts"


class SetUpCheck(Message):
    """One property of the set-up against independent measurements."""

    name: Name
    verdict: SetUpVerdict
    since_ns: Nanoseconds  # of this verdict
    sentence: Reason = ""  # what was compared, and what came out
    code: Explanation | None = None  # of `sentence`
    statistic: Annotated[Statistic, unit("of the check")] | None = None
    statistic_sd: Annotated[Statistic, unit("of the check")] | None = None
    expected: Annotated[Statistic, unit("of the check")] | None = None
    limit: Annotated[Statistic, unit("of the check")] | None = None  # of the difference from the expected value
    unit: Name = "-"
    setting: Reason | None = None  # that corrects it, to paste into the vehicle's file


class SetUpState(Message):
    """How sensors are mounted, connected and stamped, as far as driving has shown it."""

    sampled_ns: Nanoseconds
    checks: Annotated[tuple[SetUpCheck, ...], Field(max_length=32)] = ()


class AidingKind(StrEnum):
    """What a measurement that aids the filter is made of."""

    GNSS_POSITION = "gnss_position"
    GNSS_VELOCITY = "gnss_velocity"
    ZERO_VELOCITY = "zero_velocity"
    ZERO_ANGULAR_RATE = "zero_angular_rate"
    ODOMETER = "odometer"
    NON_HOLONOMIC = "non_holonomic"
    BAROMETRIC_HEIGHT = "barometric_height"
    BASELINE_HEADING = "baseline_heading"
    MAGNETIC_HEADING = "magnetic_heading"
    CARRIER_DISPLACEMENT = "carrier_displacement"
    EXTERNAL = "external"  # of a package that is installed beside the unit


class AidingUpdate(Message):
    """One measurement as the filter saw it: innovation, its size, and whether it was used."""

    sampled_ns: Nanoseconds
    source: Name
    kind: AidingKind
    innovation: tuple[Innovation, ...]  # measured - predicted
    innovation_sd: tuple[Innovation, ...]
    # normalised innovation squared over its limit: above 1 the gate rejects
    test_ratio: Annotated[Statistic, unit("1")]
    used: bool
    weight_ratio: Ratio = (
        1.0  # less than 1 of one that was used although it is beyond the gate, 0 of one that was not used
    )
    reason: Reason | None = None


class LastPosition(Persistent):
    """Where the vehicle was last known to be, kept over a power-off."""

    sampled_ns: Nanoseconds
    utc_ns: Nanoseconds | None = None
    latitude_deg: Latitude
    longitude_deg: Longitude
    height_ellipsoid_m: Height
    yaw_rad: Quantity
    position_sd_ned_m: Deviation3
    yaw_sd_rad: Deviation
    stationary: bool = False  # it stood there: the vehicle may be there still when the unit is switched on again
    protection_level_horizontal_m: Deviation | None = None  # which holds what was in doubt then


Metres = Annotated[float, Field(ge=-1e8, le=1e8)]
Rate = Annotated[float, Field(ge=0.0, le=1e4)]


class ConflictRecord(Persistent):
    """What the protection level holds of a contradiction of GNSS, for a start after a power cut."""

    sampled_ns: Nanoseconds
    # difference of positions that the level holds: north, east, down, then standard deviation and slack, each of them
    # horizontal and vertical; empty without one
    held_m: Annotated[tuple[Metres, ...], Field(max_length=7)] = ()
    held_grew: bool = False  # without a step
    held_at_start: bool = False  # between the saved position of a parked vehicle and the first fix
    growth_m_s: tuple[Rate, Rate] = (0.0, 0.0)  # largest rate of the difference, horizontal and vertical
    conflict_since_ns: Nanoseconds | None = None  # while there is a conflict


class FilterState(Message):
    """State and covariance of the navigation filter, from which a restarted core.fusion goes on.

    Only a filter of the same `fingerprint` goes on from it. The covariance is that of the errors of attitude, velocity
    and position (NED), bias of accelerometers and gyroscopes, their scale (body), then of `parameters`,
    which begin with the scale of the odometer and with pitch and yaw of the mounting.
    """

    sampled_ns: Nanoseconds  # stamp of the inertial sample of this state
    fingerprint: Name  # of the settings and of the layout of the state
    imu: Name  # source of the inertial samples
    quaternion_ned_from_body: tuple[Ratio, Ratio, Ratio, Ratio]  # w, x, y, z
    velocity_ned_m_s: Velocity3
    latitude_deg: Latitude
    longitude_deg: Longitude
    height_ellipsoid_m: Height
    accelerometer_bias_m_s2: Vector3
    gyroscope_bias_rad_s: Vector3
    accelerometer_scale: tuple[Ratio, Ratio, Ratio]
    gyroscope_scale: tuple[Ratio, Ratio, Ratio]
    parameters: Annotated[tuple[Parameter, ...], Field(max_length=64)]  # of the sensors that aid the filter
    specific_force_body_m_s2: Vector3  # of the sample, as measured
    angular_rate_body_rad_s: Vector3
    covariance: Annotated[tuple[Covariance, ...], Field(max_length=2048)]  # upper triangle, row by row
    position_used_ns: Nanoseconds | None = None  # stamp of the last GNSS position that was used
    gnss_excluded_since_ns: Nanoseconds | None = None  # no GNSS with a later stamp is part of the state
    # difference of positions that the level holds: north, east, down, then standard deviation and slack, each of them
    # horizontal and vertical; empty without one
    held_m: Annotated[tuple[Annotated[float, Field(ge=-1e8, le=1e8)], ...], Field(max_length=7)] = ()
    held_grew: bool = False  # without a step
    held_at_start: bool = False  # between the saved position of a parked vehicle and the first fix


class TruthState(Message):
    """Where the vehicle really is, of the simulator or a reference; never for layers 2 to 4."""

    sampled_ns: Nanoseconds
    latitude_deg: Latitude
    longitude_deg: Longitude
    height_ellipsoid_m: Height
    velocity_ned_m_s: Velocity3 | None = None  # None: the reference does not hold it
    roll_rad: Quantity | None = None
    pitch_rad: Quantity | None = None
    yaw_rad: Quantity | None = None
    angular_rate_body_rad_s: Vector3 | None = None

    @property
    def attitude_rad(self) -> Vector3 | None:
        """Roll, pitch and yaw."""
        if self.roll_rad is None or self.pitch_rad is None or self.yaw_rad is None:
            return None
        return self.roll_rad, self.pitch_rad, self.yaw_rad

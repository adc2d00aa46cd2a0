"""Conversion of messages to measurements of the navigator, and of its results to messages."""

from collections.abc import Iterator
from math import cos, degrees, hypot, radians, sin

import numpy as np
import numpy.typing as npt

from shared.maths.earth import Geodetic
from shared.maths.rotation import ned_from_body, quaternion_from_matrix, roll_pitch_yaw_of_quaternion
from shared.messages.base import Symmetric3, Vector3
from shared.messages.gnss import CarrierSolution, FaultFreeFix, FixType, GnssFix
from shared.messages.imu import ImuSamples
from shared.messages.navigation import (
    AidingUpdate,
    FilterState,
    LastPosition,
    NavigationPhase,
    NavigationSolution,
    NavigationState,
    SetUpCheck,
    SetUpState,
)
from shared.messages.trust import TrustState
from shared.messages.vehicle import VehicleSpeed, WheelSpeeds

from .aids.base import Measurement, Outcome
from .aids.dual_antenna import BaselineHeading
from .aids.gnss.fix import Reading, Stamp, gnss_measurements, true_time_ns
from .aids.odometer import WheelSpeed
from .inertial.strapdown import InertialState
from .integrity.disagreement import NOTHING, Disagreement
from .navigator import Navigator
from .set_up.monitor import ArmError, SetUpMonitor
from .settings import Settings
from .solution import Solution
from .start.heading import Prior
from .start.warm_start import SavedState, fingerprint

FloatArray = npt.NDArray[np.float64]

USABLE = (FixType.TWO_D, FixType.THREE_D, FixType.GNSS_DEAD_RECKONING)
COURSE_SPEED_M_S = 0.5  # lowest speed at which the course of a receiver is used
GROUND_SPEED_SD = 0.3  # [m/s] of speed over ground and course, which receivers smooth
LEAST_BASELINE_SD = 1e-3  # [rad]
HELD_NUMBERS = 7  # of a disagreement in a saved state
REASON_LENGTH = 400  # of a message
WORST_DOP = 1000.0  # upper limit of a stated dilution of precision
UERE_M = 2.5  # [m] user-equivalent range error of a receiver that states no covariance


def measurements_from_fix(fix: GnssFix, settings: Settings) -> list[Measurement]:
    """Measurements of a fix; none if it has no position from GNSS."""
    if fix.fix_type not in USABLE or fix.latitude_deg is None or fix.longitude_deg is None:
        return []
    height = fix.height_ellipsoid_m
    has_height = height is not None and fix.fix_type is not FixType.TWO_D
    position = Geodetic(radians(fix.latitude_deg), radians(fix.longitude_deg), height or 0.0)
    reading = Reading((0.0, 0.0, 0.0), _position_cov(fix), 3 if has_height else 2)
    fixed = fix.carrier_solution is CarrierSolution.FIXED
    stamp = Stamp(fix.sampled_ns, fix.received_ns, fix.source)
    return gnss_measurements(settings, stamp, position, reading, _velocity(fix), fixed=fixed)


Aiding = GnssFix | VehicleSpeed | WheelSpeeds | LastPosition
InertialSample = tuple[int, Vector3, Vector3]


def samples_of(batch: ImuSamples) -> Iterator[InertialSample]:
    """Stamp, specific force [m/s², body] and angular rate [rad/s, body] of each sample of a batch."""
    return zip(batch.sampled_ns, batch.specific_force_body_m_s2, batch.angular_rate_body_rad_s, strict=True)


def use(navigator: Navigator, message: Aiding, set_up: SetUpMonitor | None = None) -> bool:
    """Use an aiding message in the navigator, and in the checks of the set-up; False for a fix without position."""
    match message:
        case GnssFix():
            return use_fix(navigator, message, set_up)
        case LastPosition():
            navigator.use_prior(prior_from_last_position(message))
        case _:
            use_speed(navigator, message, set_up)
    return True


def use_fix(navigator: Navigator, fix: GnssFix, set_up: SetUpMonitor | None = None) -> bool:
    """Use a fix in the navigator, and in the checks of the set-up even if it is rejected; False without a position."""
    settings = navigator.settings
    measurements = measurements_from_fix(fix, settings)
    if set_up is not None:
        for measurement in measurements:
            set_up.see(measurement)
    if fix.baseline_heading_rad is not None and fix.baseline_heading_sd_rad:
        measurements.append(
            BaselineHeading(
                true_time_ns(settings, fix.sampled_ns),
                fix.received_ns,
                fix.source,
                fix.baseline_heading_rad,
                max(fix.baseline_heading_sd_rad, LEAST_BASELINE_SD),
                settings.vehicle.gnss.baseline_yaw_body_rad,
            )
        )
    for measurement in measurements:
        navigator.measure(measurement)
    return bool(measurements)


def use_fault_free_fix(navigator: Navigator, fix: FaultFreeFix) -> None:
    """Use a fix without the excluded satellites in place of the receiver's own."""
    stamp = Stamp(fix.sampled_ns, fix.received_ns, fix.source)
    position = Geodetic(radians(fix.latitude_deg), radians(fix.longitude_deg), fix.height_ellipsoid_m)
    velocity = fix.velocity_ned_m_s
    moving = None if velocity is None else Reading(velocity, _cov(fix.velocity_cov_ned_m2_s2, None))
    reading = Reading((0.0, 0.0, 0.0), _cov(fix.position_cov_ned_m2, None))
    left_out = fix.satellites_left_out
    for measurement in gnss_measurements(navigator.settings, stamp, position, reading, moving, left_out=left_out):
        navigator.measure(measurement)


def use_trust_state(navigator: Navigator, state: TrustState) -> None:
    """Apply conflict and exclusions of core.trust in the navigator."""
    since_ns = state.suspect_since_ns
    if since_ns is None and state.gnss_excluded:
        since_ns = state.sampled_ns
    navigator.apply_exclusions(since_ns, exclude=state.gnss_excluded, odometer_excluded=state.odometer_excluded)


def use_environment(navigator: Navigator, batch: ImuSamples) -> None:
    """Use pressure and magnetic field of a batch of samples in the navigator."""
    sampled_ns, received_ns, source = batch.sampled_ns[-1], batch.received_ns, batch.source
    if batch.pressure_pa is not None:
        navigator.pressure(sampled_ns, batch.pressure_pa, received_ns=received_ns, source=source)
    if batch.magnetic_field_body is not None:
        navigator.magnetic_field(sampled_ns, batch.magnetic_field_body, received_ns=received_ns, source=source)


def use_speed(navigator: Navigator, message: VehicleSpeed | WheelSpeeds, set_up: SetUpMonitor | None = None) -> None:
    """Use a speed in the navigator."""
    if (measured := speed_of(message, navigator.settings)) is not None:
        if set_up is not None and navigator.settings.odometer.enabled:
            set_up.see(measured)
        navigator.speed(
            measured.time_ns,
            measured.speed,
            resolution=measured.resolution,
            of_wheels=measured.of_wheels,
            exact=measured.exact,
            received_ns=measured.received_ns,
            source=measured.source,
        )


def speed_of(message: VehicleSpeed | WheelSpeeds, settings: Settings) -> WheelSpeed | None:
    """Measurement of a speed: the mean of the rear wheels, or of the front wheels if there is no rear wheel."""
    if isinstance(message, VehicleSpeed):
        value, resolution, of_wheels, exact = message.speed_m_s, message.resolution_m_s or 0.0, False, False
    else:
        rear = [wheel for wheel in (message.rear_left_m_s, message.rear_right_m_s) if wheel is not None]
        wheels = rear or [wheel for wheel in (message.front_left_m_s, message.front_right_m_s) if wheel is not None]
        if not wheels:
            return None
        value, resolution, of_wheels, exact = sum(wheels) / len(wheels), 0.0, True, len(rear) == 2
    scale, stamp = settings.odometer.scale, (message.sampled_ns, message.received_ns, message.source)
    return WheelSpeed(*stamp, scale * value, scale * resolution, of_wheels, exact, settings)


def arm_error(navigator: Navigator) -> ArmError:
    """Error of the lever arm from the innovations of the filter."""
    arm = navigator.engine.aids.gate.lever_arm
    return ArmError(*arm.error(), arm.significant_error() is not None)


def set_up_message(set_up: SetUpMonitor, sampled_ns: int) -> SetUpState:
    """Results of the checks of the set-up."""
    checks = (
        SetUpCheck(
            name=check.name,
            verdict=check.verdict,
            since_ns=since_ns,
            sentence=check.sentence,
            statistic=check.statistic,
            statistic_sd=check.sd,
            expected=check.expected,
            limit=check.limit,
            unit=check.unit,
            setting=check.setting,
        )
        for check, since_ns in set_up.checks.values()
    )
    return SetUpState(sampled_ns=sampled_ns, checks=tuple(checks))


def _position_cov(fix: GnssFix) -> FloatArray | None:
    cov = _cov(fix.position_cov_ned_m2, fix.position_sd_ned_m)
    if cov is None and fix.hdop is not None:
        horizontal = UERE_M * min(abs(fix.hdop), WORST_DOP)
        vertical = UERE_M * min(abs(fix.vdop or 2.0 * fix.hdop), WORST_DOP)
        return np.diag(np.square([horizontal, horizontal, vertical]))
    return cov


def _velocity(fix: GnssFix) -> Reading | None:
    if fix.velocity_ned_m_s is not None:
        return Reading(fix.velocity_ned_m_s, _cov(fix.velocity_cov_ned_m2_s2, fix.velocity_sd_ned_m_s))
    speed, course = fix.ground_speed_m_s, fix.course_rad
    if speed is None or course is None or speed < COURSE_SPEED_M_S:
        return None
    cov = np.eye(3) * GROUND_SPEED_SD**2
    return Reading((speed * cos(course), speed * sin(course), 0.0), cov, axes=2)


def _cov(cov: Symmetric3 | None, sd: Vector3 | None) -> FloatArray | None:
    if cov is not None:
        nn, ne, nd, ee, ed, dd = cov
        return np.array([[nn, ne, nd], [ne, ee, ed], [nd, ed, dd]])
    return None if sd is None else np.diag(np.square(sd))


def prior_from_last_position(last: LastPosition) -> Prior:
    """Prior from the saved position and heading."""
    position = Geodetic(radians(last.latitude_deg), radians(last.longitude_deg), last.height_ellipsoid_m)
    return Prior(position, last.position_sd_ned_m, last.yaw_rad, last.yaw_sd_rad)


def turned(solution: Solution, turn: tuple[float, float]) -> Solution:
    """Solution with the attitude of the vehicle, whose axes are turned about the axis down against the published ones.

    Parameters
    ----------
    solution : Solution
        With the attitude of the published axes.
    turn : tuple of float
        [rad] Turn and its standard deviation, which the variance about the vertical holds.
    """
    attitude = ned_from_body(solution.roll, solution.pitch, solution.yaw) @ ned_from_body(0.0, 0.0, turn[0])
    roll, pitch, yaw = roll_pitch_yaw_of_quaternion(quaternion_from_matrix(attitude))
    cov = solution.attitude_cov + np.diag([0.0, 0.0, turn[1] ** 2])
    position_cov, velocity_cov, (*others, dd) = solution.triangles
    nn, ne, nd, ee, ed = others
    triangles = position_cov, velocity_cov, (nn, ne, nd, ee, ed, dd + turn[1] ** 2)
    return solution._replace(roll=roll, pitch=pitch, yaw=yaw, attitude_cov=cov, triangles=triangles)


def solution_message(solution: Solution, turn: tuple[float, float] | None = None) -> NavigationSolution:
    """Solution as a message, turned where a check of the set-up has found a turn of the axes and its 1 σ [rad]."""
    solution = turned(solution, turn) if turn is not None else solution
    position_cov, velocity_cov, attitude_cov = solution.triangles
    return NavigationSolution(
        sampled_ns=solution.time_ns,
        phase=solution.phase,
        latitude_deg=degrees(solution.position.latitude),
        longitude_deg=degrees(solution.position.longitude),
        height_ellipsoid_m=solution.position.height,
        velocity_ned_m_s=solution.velocity,
        roll_rad=solution.roll,
        pitch_rad=solution.pitch,
        yaw_rad=solution.yaw,
        position_cov_ned_m2=position_cov,
        velocity_cov_ned_m2_s2=velocity_cov,
        attitude_cov_ned_rad2=attitude_cov,
        angular_rate_body_rad_s=solution.rate,
        accelerometer_bias_m_s2=solution.accelerometer_bias,
        gyroscope_bias_rad_s=solution.gyroscope_bias,
        stationary=solution.stationary,
        gnss_age_s=solution.gnss_age_s,
        protection_level_horizontal_m=solution.protection_level_horizontal,
        protection_level_vertical_m=solution.protection_level_vertical,
        integrity_risk=solution.integrity_risk,
        gyroscope_bias_sd_rad_s=solution.gyroscope_bias_sd,
        gnss_excluded_since_ns=solution.gnss_excluded_since_ns,
        heading_turn_rad=None if turn is None else turn[0],
    )


def filter_state_message(saved: SavedState, settings: Settings, imu: str) -> FilterState:
    """State of the filter for a later process."""
    time_ns, quaternion, velocity, position = saved.inertial
    return FilterState(
        sampled_ns=time_ns,
        fingerprint=fingerprint(settings),
        imu=imu,
        quaternion_ned_from_body=quaternion,
        velocity_ned_m_s=velocity,
        latitude_deg=degrees(position.latitude),
        longitude_deg=degrees(position.longitude),
        height_ellipsoid_m=position.height,
        accelerometer_bias_m_s2=saved.accelerometer_bias,
        gyroscope_bias_rad_s=saved.gyroscope_bias,
        accelerometer_scale=saved.accelerometer_scale,
        gyroscope_scale=saved.gyroscope_scale,
        parameters=saved.parameters,
        specific_force_body_m_s2=saved.sample[0],
        angular_rate_body_rad_s=saved.sample[1],
        covariance=saved.covariance,
        position_used_ns=saved.accepted_ns,
        gnss_excluded_since_ns=saved.gnss_excluded_since_ns,
        held_m=(*saved.held.vector_n, *saved.held.spread, *saved.held.slack) if saved.held.is_open else (),
        held_grew=saved.held.grew,
        held_at_start=saved.held.at_start,
    )


def _held(state: FilterState) -> Disagreement:
    if len(state.held_m) != HELD_NUMBERS:
        return NOTHING
    north, east, down, spread_h, spread_v, slack_h, slack_v = state.held_m
    return Disagreement(
        (north, east, down), (abs(spread_h), abs(spread_v)), state.held_grew, (abs(slack_h), abs(slack_v)),
        at_start=state.held_at_start,
    )  # fmt: skip


def restore(navigator: Navigator, state: FilterState, first: ImuSamples) -> None:
    """Restore the state of an earlier process with the first samples, if settings and IMU are the same."""
    position = Geodetic(radians(state.latitude_deg), radians(state.longitude_deg), state.height_ellipsoid_m)
    if state.fingerprint != fingerprint(navigator.settings):
        navigator.rejects["saved state of other settings"] += 1
    elif state.imu != first.source:
        navigator.rejects["saved state of another imu"] += 1
    else:
        saved = SavedState(
            InertialState(state.sampled_ns, state.quaternion_ned_from_body, state.velocity_ned_m_s, position),
            state.accelerometer_bias_m_s2,
            state.gyroscope_bias_rad_s,
            state.accelerometer_scale,
            state.gyroscope_scale,
            state.parameters,
            (state.specific_force_body_m_s2, state.angular_rate_body_rad_s),
            state.covariance,
            state.position_used_ns,
            state.gnss_excluded_since_ns,
            _held(state),
        )
        navigator.restore(saved, first.sampled_ns[0])


def aiding_message(outcome: Outcome) -> AidingUpdate:
    """Outcome of an observation as a message."""
    return AidingUpdate(
        sampled_ns=outcome.time_ns,
        source=outcome.source,
        kind=outcome.kind,
        innovation=outcome.innovation,
        innovation_sd=outcome.innovation_sd,
        test_ratio=outcome.test_ratio,
        used=outcome.used,
        weight_ratio=outcome.weight,
        reason=outcome.reason,
    )


def state_message(
    navigator: Navigator, sampled_ns: int, silent_since_ns: int | None = None, *, delay_known: bool
) -> NavigationState:
    """State of the navigator as a message, or, with `silent_since_ns`, that inertial samples are missing since then.

    While the delay of GNSS is not known, what turns show is no error of the lever arm.
    """
    counts, exclusions, verdicts = navigator.counts, navigator.engine.exclusions, navigator.verdicts
    conflict, difference, held = verdicts.conflict, verdicts.difference(), navigator.engine.aids.error_monitor.held
    position_s, velocity_s = navigator.found_delays
    declined = verdicts.unresolved or (conflict.declined if conflict else "")
    silent = silent_since_ns is not None
    return NavigationState(
        sampled_ns=sampled_ns,
        phase=NavigationPhase.WAITING_FOR_IMU if silent else navigator.phase,
        since_ns=silent_since_ns if silent_since_ns is not None else navigator.since_ns,
        reason="no inertial samples" if silent else navigator.reason,
        fixes_used=counts.fixes_used,
        fixes_rejected=counts.fixes_rejected,
        samples_used=navigator.samples_used,
        samples_rejected=navigator.samples_rejected,
        imu_gaps=counts.imu_gaps,
        resets=counts.resets,
        epochs_repeated=counts.epochs_repeated,
        measurements_late=navigator.measurements_late,
        gnss_delay_s=position_s or None,
        gnss_velocity_delay_s=(velocity_s - position_s) or None,
        lever_arm_error_body_m=navigator.lever_arm_error if delay_known else None,
        alert_limit_horizontal_m=navigator.settings.vehicle.alert_limit_horizontal_m,
        alert_limit_vertical_m=navigator.settings.vehicle.alert_limit_vertical_m,
        gnss_excluded_since_ns=exclusions.gnss_since_ns,
        fixes_excluded=exclusions.fixes,
        excluded_test_ratio=verdicts.excluded_test_ratio,
        odometer_excluded=exclusions.odometer,
        odometer_age_s=navigator.engine.odometer_age_s,
        conflict_since_ns=None if conflict is None else conflict.since_ns,
        other_distance_m=None if difference is None else hypot(*difference[0][:2]),
        other_level_m=None if difference is None else difference[1][0],
        without_gnss_level_m=None if verdicts.without_gnss_m is None else verdicts.without_gnss_m[0],
        exclusion_declined=declined[:REASON_LENGTH] or None,
        held_horizontal_m=held.bound[0],
        held_vertical_m=held.bound[1],
        held_reason=held.reason or None,
        satellites_left_out=exclusions.satellites,
    )

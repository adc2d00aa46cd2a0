"""Conversion of the navigator's results to messages, and of messages that are no measurements.

Measurements are made by the aids: `aids.kinds`.
"""

from collections.abc import Iterator
from math import degrees, hypot, radians

import numpy as np
import numpy.typing as npt

from shared.inertial.strapdown import InertialState
from shared.maths.earth import Geodetic
from shared.maths.rotation import ned_from_body, quaternion_from_matrix, roll_pitch_yaw_of_quaternion
from shared.messages.base import Vector3
from shared.messages.explanation import Explanation, explain
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
from shared.messages.trust import Hypothesis, HypothesisSolution, TrustHypotheses, TrustState
from shared.words.words import reason

from .aids.base import Outcome
from .codes import Code
from .conflict_record import held_numbers, held_of
from .hypotheses.bank import SEPARATION_LIMIT, Alternative
from .navigator import Navigator
from .set_up.monitor import ArmError, SetUpMonitor
from .settings import Settings
from .solution import Solution
from .start.heading import Prior
from .start.warm_start import SavedState, fingerprint
from .timeline.conflict import EARLIER_NS
from .without_imu import ImuOutage

FloatArray = npt.NDArray[np.float64]

# Hypotheses under which positions of GNSS may be off.
OF_GNSS = frozenset({Hypothesis.GNSS, Hypothesis.GNSS_AND_ODOMETER, Hypothesis.SATELLITES, Hypothesis.RECEIVER_TIME})
ALIGNING = (NavigationPhase.LEVELLING, NavigationPhase.WAITING_FOR_GNSS, NavigationPhase.WAITING_FOR_HEADING)


InertialSample = tuple[int, Vector3, Vector3]


def samples_of(batch: ImuSamples) -> Iterator[InertialSample]:
    """Stamp, specific force [m/s², body] and angular rate [rad/s, body] of each sample of a batch."""
    return zip(batch.sampled_ns, batch.specific_force_body_m_s2, batch.angular_rate_body_rad_s, strict=True)


def use_trust_state(navigator: Navigator, state: TrustState) -> None:
    """Apply conflict and exclusions of core.trust in the navigator."""
    since_ns = state.suspect_since_ns
    if since_ns is None and state.gnss_excluded:
        since_ns = state.sampled_ns
    if since_ns is not None and since_ns == state.gnss_disturbed_since_ns:
        since_ns += EARLIER_NS  # the last position before a loss was right: nothing earlier is suspect
    navigator.apply_exclusions(since_ns, exclude=state.gnss_excluded, odometer_excluded=state.odometer_excluded)
    navigator.disturbed_since(state.gnss_disturbed_since_ns)
    surviving = [belief for belief in state.beliefs if belief.survives and belief.hypothesis is not Hypothesis.NOTHING]
    suspect = [belief.since_ns for belief in surviving if belief.since_ns is not None]
    navigator.believe(
        [belief.hypothesis for belief in surviving], min(suspect, default=since_ns), imu_excluded=state.imu_excluded,
        of_gnss=sum(belief.probability for belief in surviving if belief.hypothesis in OF_GNSS)
        if state.beliefs else 1.0,
    )  # fmt: skip


def hypotheses_message(navigator: Navigator) -> TrustHypotheses:
    """Solutions of the bank at the horizon."""
    solutions: list[HypothesisSolution] = []
    missing: list[tuple[Hypothesis, Explanation]] = []
    for alternative in navigator.bank.alternatives():
        if not isinstance(alternative, Alternative):
            missing.append(alternative)
            continue
        solutions.append(
            HypothesisSolution(
                hypothesis=alternative.hypothesis,
                left_out=alternative.left_out,
                since_ns=alternative.since_ns,
                latitude_deg=degrees(alternative.position.latitude),
                longitude_deg=degrees(alternative.position.longitude),
                height_ellipsoid_m=alternative.position.height,
                velocity_ned_m_s=alternative.velocity,
                position_cov_ned_m2=alternative.position_cov,
                protection_level_horizontal_m=alternative.levels[0],
                protection_level_vertical_m=alternative.levels[1],
                apart_ned_m=alternative.apart_n,
                separation=alternative.separation,
                separation_limit=SEPARATION_LIMIT,
                innovations=alternative.innovations,
                odometer_innovations=alternative.odometer_innovations,
            )
        )
    return TrustHypotheses(
        sampled_ns=navigator.engine.time_ns,
        source="core.fusion",
        solutions=tuple(solutions),
        missing_codes=tuple(missing),
        missing=tuple((hypothesis, reason(why)) for hypothesis, why in missing),
    )


def arm_error(navigator: Navigator) -> ArmError:
    """Error of the lever arm from the innovations of the filter."""
    arm = navigator.engine.aids.gnss.lever_arm
    return ArmError(*arm.error(), arm.significant_error() is not None)


def set_up_message(set_up: SetUpMonitor, sampled_ns: int) -> SetUpState:
    """Results of the checks of the set-up."""
    checks = (
        SetUpCheck(
            name=check.name,
            verdict=check.verdict,
            since_ns=since_ns,
            code=check.why,
            sentence="" if check.why is None else reason(check.why),
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


def prior_from_last_position(last: LastPosition) -> Prior:
    """Prior from the saved position and heading."""
    position = Geodetic(radians(last.latitude_deg), radians(last.longitude_deg), last.height_ellipsoid_m)
    parked = last.stationary and last.earlier_life
    return Prior(
        position, last.position_sd_ned_m, last.yaw_rad, last.yaw_sd_rad, parked, last.protection_level_horizontal_m
    )


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
        held_m=held_numbers(saved.held),
        held_grew=saved.held.grew,
        held_at_start=saved.held.at_start,
    )


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
            held_of(state),
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


def waiting_for_imu(state: NavigationState, since_ns: int) -> NavigationState:
    """State while inertial samples are missing since a time, and nothing is published in their place."""
    phase = NavigationPhase.WAITING_FOR_IMU
    return _in_phase(state, phase, since_ns, explain(Code.NO_SAMPLES))


def without_imu(state: NavigationState, missing: ImuOutage, *, excluded: bool) -> NavigationState:
    """State while fixes alone are published, and what the alignment of the filter waits for."""
    if excluded:
        phase = NavigationPhase.WAITING_FOR_IMU
        return _in_phase(state, phase, missing.since_ns, missing.why, explain(Code.NOTHING_LEFT))
    waiting = state.reason_codes if state.phase in ALIGNING else ()
    phase = NavigationPhase.GNSS_ONLY
    return _in_phase(state, phase, missing.since_ns, missing.why, explain(Code.GNSS_ALONE), *waiting)


def _in_phase(state: NavigationState, phase: NavigationPhase, since_ns: int, *why: Explanation) -> NavigationState:
    return state.model_copy(update={"phase": phase, "since_ns": since_ns, "reason": reason(*why), "reason_codes": why})


def state_message(
    navigator: Navigator, sampled_ns: int, *, delay_known: bool, fixes_late_s: float | None = None
) -> NavigationState:
    """State of the navigator as a message.

    While the delay of GNSS is not known, what turns show is no error of the lever arm.
    """
    counts, exclusions, verdicts = navigator.counts, navigator.engine.exclusions, navigator.verdicts
    conflict, difference, monitor = verdicts.conflict, verdicts.difference(), navigator.engine.aids.error_monitor
    held, loss = monitor.held, monitor.loss
    position_s, velocity_s = navigator.found_delays
    declined, held_code = verdicts.unresolved or (conflict.declined if conflict else None), held.why or loss.why
    return NavigationState(
        sampled_ns=sampled_ns,
        phase=navigator.phase,
        since_ns=navigator.since_ns,
        reason=reason(*navigator.why),
        reason_codes=navigator.why,
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
        imu_excluded=navigator.imu_excluded,
        odometer_age_s=navigator.engine.odometer_age_s,
        merge_lag_s=navigator.merge_lag_s,
        fixes_late_s=fixes_late_s,
        conflict_since_ns=None if conflict is None else conflict.since_ns,
        other_distance_m=None if difference is None else hypot(*difference[0][:2]),
        other_level_m=None if difference is None else difference[1][0],
        without_gnss_level_m=None if verdicts.without_gnss_m is None else verdicts.without_gnss_m[0],
        exclusion_declined_code=declined,
        exclusion_declined=None if declined is None else reason(declined),
        held_horizontal_m=held.bound[0] + loss.bound[0],
        held_vertical_m=held.bound[1] + loss.bound[1],
        held_code=held_code,
        held_reason=None if held_code is None else reason(held_code),
        held_end_codes=navigator.what_ends_the_held or None,
        satellites_left_out=exclusions.satellites,
        started_ns=navigator.engine.first_start[0] or None,
        started_in_motion=navigator.engine.first_start[1],
    )

"""The propagation loop over IMU samples.

Each sample is mechanised, added to the integrals of specific force and rate that the covariance step needs, compared
with the sample before (vibration PSD), and passed to the standstill detector. When something else is due the loop ends
before the next sample and returns a `Stop`, which the engine handles then; so no solution waits for it.
"""

from collections.abc import Mapping, Sequence
from enum import IntEnum
from math import inf, pi
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shared.inertial.strapdown import InertialState, LocalEarth, local_earth, mechanise
from shared.maths.compiled import COMPILED, compilable, compiled
from shared.maths.rotation import Quaternion, Vector

from .standstill import UNSETTLED, Limits, StandstillState, detect, is_standstill, norm

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

ZERO: Vector = (0.0, 0.0, 0.0)
GAP_S = 0.05  # longest step between two samples; a longer one is a gap
VIBRATION_S = 1.0  # time constant of the measured vibration
NEVER_NS = 2**62
INTERVAL_SHARE = 0.99  # share of an interval after which it has ended: sums of sampling periods jitter
MAX_SPEED_M_S = 500.0  # plausible speed
HIGHEST_LATITUDE = 0.4999 * pi  # [rad] 2 km from the pole, where NED is singular


class Stop(IntEnum):
    """Why the propagation loop ended."""

    END_OF_SAMPLES = 0
    GAP = 1  # the next sample comes more than `Intervals.gap_s` after the one before
    COVARIANCE_DUE = 2
    ZERO_VELOCITY_DUE = 3
    NON_HOLONOMIC_DUE = 4
    MEASUREMENT_DUE = 5  # the state is at the stamp of the next measurement
    DIVERGED = 6  # in an update


class Intervals(NamedTuple):
    """Times [s] after which the loop ends; infinite for an update that is switched off."""

    covariance_s: float
    zero_velocity_s: float = inf
    non_holonomic_s: float = inf
    gap_s: float = GAP_S
    covariance_at_end: bool = False  # it is propagated to the last sample as well


class ImuErrors(NamedTuple):
    """Estimated errors of the IMU: biases [m/s², rad/s] and scale factors [-], body axes."""

    accelerometer_bias: Vector = ZERO
    gyroscope_bias: Vector = ZERO
    accelerometer_scale: Vector = ZERO
    gyroscope_scale: Vector = ZERO


class State(NamedTuple):
    """State of the propagation loop between two samples."""

    time_ns: int
    quaternion: Quaternion  # NED from body
    velocity: Vector  # [m/s, NED]
    position: Vector  # [rad, rad, m] latitude, longitude, ellipsoidal height
    earth: LocalEarth  # at this latitude
    force: Vector  # [m/s², body] of the last sample, as measured
    rate: Vector  # [rad/s, body] of the last sample, as measured
    rate_b: Vector = ZERO  # [rad/s, body] of the last sample, IMU errors removed
    acceleration_n: Vector = ZERO  # [m/s², NED] of the last sample
    force_vibration_psd: float = 0.0  # [m²/s³]
    rate_vibration_psd: float = 0.0  # [rad²/s]
    span_s: float = 0.0  # time since the last covariance step, and over it:
    velocity_gain_n: Vector = ZERO  # [m/s, NED] integral of the specific force
    rotation_b: Vector = ZERO  # [rad, body] integral of the rate
    quiet: StandstillState = UNSETTLED  # of the standstill detector
    standstill_s: float = 0.0  # standstill since the last zero-velocity update, and over it:
    standstill_rotation_b: Vector = ZERO  # [rad, body] integral of the rate
    since_non_holonomic_s: float = 0.0


class Samples(NamedTuple):
    """Contiguous IMU samples: arrays for compiled code, lists for Python, which reads them faster."""

    times_ns: Sequence[int] | IntArray  # ends of the sampling intervals, shape (n,)
    rows: Sequence[Sequence[float]] | FloatArray  # [m/s², rad/s, body] mean force and rate, shape (n, 6)
    faults: Mapping[int, str]  # fault of each suspect sample, by row

    def part(self, begin: int, end: int) -> "Samples":
        """Samples from row `begin` to before row `end`."""
        faults = {k - begin: self.faults[k] for k in range(begin, end) if k in self.faults} if self.faults else {}
        return Samples(self.times_ns[begin:end], self.rows[begin:end], faults)


def samples_of(times_ns: Sequence[int] | IntArray, rows: npt.ArrayLike, faults: Mapping[int, str]) -> Samples:
    """Samples as arrays for compiled code, or as lists where there is none."""
    if COMPILED:
        return Samples(np.asarray(times_ns, np.int64), np.ascontiguousarray(rows, np.float64), faults)
    times_ns = times_ns.tolist() if isinstance(times_ns, np.ndarray) else times_ns
    return Samples(times_ns, rows.tolist() if isinstance(rows, np.ndarray) else rows, faults)  # type: ignore[arg-type]


def initial_state(inertial: InertialState, force: Vector, rate: Vector) -> State:
    """State at the start of a filter, with the newest sample [m/s², rad/s, body; as measured]."""
    time_ns, quaternion, velocity, (latitude, longitude, height) = inertial
    return State(time_ns, quaternion, velocity, (latitude, longitude, height), local_earth(latitude), force, rate)


@compilable
def propagate(  # noqa: PLR0913, PLR0915, PLR0917  # one loop, and compiled code takes numbers and arrays
    state: State,
    times_ns: Sequence[int] | IntArray,
    rows: Sequence[Sequence[float]] | FloatArray,
    begin: int,
    end: int,
    errors: ImuErrors,
    limits: Limits,
    intervals: Intervals,
    due_ns: int = NEVER_NS,
) -> tuple[State, int, int]:
    """Propagate over samples until all are taken, or something else is due.

    Parameters
    ----------
    state : State
        At the end of the sample before.
    times_ns : ndarray of int64, shape (n,), or list
        Ends of the samples; a sample that is not newer than the state is skipped.
    rows : ndarray, shape (n, 6), or list
        [m/s², rad/s, body] Mean specific force and angular rate over the samples, as measured.
    begin, end : int
        Rows to propagate over: from `begin` to before `end`.
    errors : ImuErrors
        Subtracted from the samples.
    limits : Limits
        Of the standstill detector.
    intervals : Intervals
        Intervals of the updates.
    due_ns : int
        Stamp of the next measurement; of a sample that ends at it or later only the part up to it is used.

    Returns
    -------
    State
        At the end of the last sample that was taken, or at the stamp of the measurement.
    int
        Number of samples that were used in full.
    int
        The `Stop`, as a number: compiled code is slow at making members of an enumeration.

    Notes
    -----
    The vibration PSD is measured by differences of successive samples, whose variance is twice that of white noise;
    the mean of three axes, smoothed over T = 1 s: S+ = S + t/T (t/6 |f - f_last|² - S).
    """
    time_ns, earth, quiet = state.time_ns, state.earth, state.quiet
    quaternion, velocity, position = state.quaternion, state.velocity, state.position
    lfx, lfy, lfz = state.force
    lwx, lwy, lwz = state.rate
    rate_b, acceleration_n = state.rate_b, state.acceleration_n
    force_psd, rate_psd = state.force_vibration_psd, state.rate_vibration_psd
    span_s, (vn, ve, vd), (rx, ry, rz) = state.span_s, state.velocity_gain_n, state.rotation_b
    standstill_s, (zx, zy, zz) = state.standstill_s, state.standstill_rotation_b
    non_holonomic_s = state.since_non_holonomic_s
    (abx, aby, abz), (gbx, gby, gbz), (asx, asy, asz), (gsx, gsy, gsz) = errors
    covariance_s, zero_velocity_s = INTERVAL_SHARE * intervals.covariance_s, INTERVAL_SHARE * intervals.zero_velocity_s
    constraint_s, gap_s = INTERVAL_SHARE * intervals.non_holonomic_s, intervals.gap_s
    stop, k = Stop.END_OF_SAMPLES, begin
    while k < end:
        step = (times_ns[k] - time_ns) * 1e-9
        if step > gap_s:
            stop = Stop.GAP
            break
        if time_ns >= due_ns:
            stop = Stop.MEASUREMENT_DUE
            break
        if span_s >= covariance_s:
            stop = Stop.COVARIANCE_DUE
            break
        if standstill_s >= zero_velocity_s:
            stop = Stop.ZERO_VELOCITY_DUE
            break
        if non_holonomic_s >= constraint_s:
            stop = Stop.NON_HOLONOMIC_DUE
            break
        row, end_ns = rows[k], times_ns[k]
        if end_ns < due_ns:
            k += 1
        else:
            end_ns = due_ns
            step = (end_ns - time_ns) * 1e-9
        if step <= 0.0:
            continue
        fx, fy, fz, wx, wy, wz = row[0], row[1], row[2], row[3], row[4], row[5]
        force_b = fx - abx - asx * fx, fy - aby - asy * fy, fz - abz - asz * fz
        rate_b = wx - gbx - gsx * wx, wy - gby - gsy * wy, wz - gbz - gsz * wz
        quaternion, velocity, position, earth, force_n, acceleration_n = mechanise(
            quaternion, velocity, position, earth, force_b, rate_b, step
        )
        time_ns = end_ns

        span_s += step
        vn, ve, vd = vn + force_n[0] * step, ve + force_n[1] * step, vd + force_n[2] * step
        rx, ry, rz = rx + rate_b[0] * step, ry + rate_b[1] * step, rz + rate_b[2] * step

        share, scale = min(1.0, step / VIBRATION_S), step / 6.0
        dx, dy, dz = fx - lfx, fy - lfy, fz - lfz
        force_psd += share * (scale * (dx * dx + dy * dy + dz * dz) - force_psd)
        dx, dy, dz = wx - lwx, wy - lwy, wz - lwz
        rate_psd += share * (scale * (dx * dx + dy * dy + dz * dz) - rate_psd)
        lfx, lfy, lfz, lwx, lwy, lwz = fx, fy, fz, wx, wy, wz

        quiet = detect(quiet, rate_b, acceleration_n, norm(velocity), step, limits)
        if is_standstill(quiet):
            standstill_s += step
            zx, zy, zz = zx + rate_b[0] * step, zy + rate_b[1] * step, zz + rate_b[2] * step
        else:
            standstill_s, zx, zy, zz = 0.0, 0.0, 0.0, 0.0
        non_holonomic_s += step
    after = State(
        time_ns,
        quaternion,
        velocity,
        position,
        earth,
        (lfx, lfy, lfz),
        (lwx, lwy, lwz),
        rate_b,
        acceleration_n,
        force_psd,
        rate_psd,
        span_s,
        (vn, ve, vd),
        (rx, ry, rz),
        quiet,
        standstill_s,
        (zx, zy, zz),
        non_holonomic_s,
    )
    return after, k - begin, stop.value


propagate_arrays = compiled(propagate)  # for arrays

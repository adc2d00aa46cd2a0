"""Warm start: the saved state of a filter, and the filter that a later process continues from it after a gap.

Over the gap between the last sample of one process and the first sample of the next, the filter is propagated with the
mean of the two samples in body axes, of whose rotation only the yaw rate is used. True yaw rate and acceleration
differ from that mean by w(t) and a(t), random walks that are zero at both ends (Brownian bridges), and by the vibration
of the two samples, constant over the gap. A turn rotates the velocity as well::

    psi_D' = w,    v' = g w + a,    p' = v,    g = d v / d psi_D = (-v_E, v_N, 0)
"""

from hashlib import sha256
from math import inf
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shared.inertial.strapdown import InertialState
from shared.maths.rotation import Vector

from ..aids.gnss.correlated import GNSS_ERROR, POSITION, position_errors_at_start, position_errors_of
from ..inertial import error_model as em
from ..inertial.filter import ErrorStateFilter
from ..inertial.imu_faults import Sample, credible, mean
from ..inertial.propagation import ZERO, ImuErrors, Intervals, initial_state, samples_of
from ..inertial.row import implausible
from ..inertial.standstill import CERTAIN_LIMITS, UNSETTLED
from ..integrity.disagreement import NO_DISAGREEMENT, Disagreement
from ..settings import Settings
from ..states import LAYOUT

FloatArray = npt.NDArray[np.float64]

VERSION = 5  # version of the saved state; increased when the meaning of its elements changes
MAX_GAP_S = 5.0
STEP_S = 0.05  # of the propagation over the gap
# Unmeasured motion: power spectral densities of the noise that drives the random walks,
YAW_PSD = 0.05  # [rad²/s³]
TILT_PSD = 1e-4  # [rad²/s³] road and springs
JERK_PSD = np.diag([1.0, 1.0, 0.03])  # [m²/s⁵, NED]
# and variances of the vibration in the mean of two samples.
RATE_VARIANCE = 0.02**2  # [rad²/s²] about the vertical
TILT_VARIANCE = 0.01**2  # [rad²/s²] about the horizontal axes, whose rate is not used
FORCE_VARIANCE = np.diag(np.square([0.5, 0.5, 0.5]))  # [m²/s⁴, NED]
MAX_VALUE = 1e12  # [mixed] largest valid variance


class SavedState(NamedTuple):
    """State of a filter that is saved for a later process; errors and units as in `error_model`."""

    inertial: InertialState
    accelerometer_bias: Vector
    gyroscope_bias: Vector
    accelerometer_scale: Vector
    gyroscope_scale: Vector
    parameters: tuple[float, ...]  # with the time-correlated GNSS error in units of the stated standard deviation
    sample: tuple[Vector, Vector]  # [m/s², rad/s, body] newest sample, as measured
    covariance: tuple[float, ...]  # upper triangle, row by row
    accepted_ns: int | None  # stamp of the last GNSS position that was used
    gnss_excluded_since_ns: int | None = None  # no GNSS with a later stamp is part of it
    held: Disagreement = NO_DISAGREEMENT  # what the level holds


def fingerprint(settings: Settings) -> str:
    """Hash of the settings and the layout; a saved state is used only if both are the same."""
    text = f"{VERSION} {LAYOUT.text_by(settings)} {settings.model_dump_json()}"
    return sha256(text.encode()).hexdigest()[:16]


def saved_state(
    navigation: ErrorStateFilter,
    sample: Sample,
    accepted_ns: int | None,
    gnss_excluded_since_ns: int | None = None,
    held: Disagreement = NO_DISAGREEMENT,
) -> SavedState:
    """State of a filter, whose covariance is of its time, for saving."""
    units = np.ones(navigation.size)
    units[GNSS_ERROR] = position_errors_of(navigation).unit
    return SavedState(
        inertial=navigation.inertial,
        accelerometer_bias=navigation.imu.accelerometer_bias,
        gyroscope_bias=navigation.imu.gyroscope_bias,
        accelerometer_scale=navigation.imu.accelerometer_scale,
        gyroscope_scale=navigation.imu.gyroscope_scale,
        parameters=tuple((np.array(navigation.parameters) * units[em.PARAMETERS]).tolist()),
        sample=(sample.force, sample.rate),
        covariance=tuple((navigation.P * np.outer(units, units))[np.triu_indices(navigation.size)].tolist()),
        accepted_ns=accepted_ns,
        gnss_excluded_since_ns=gnss_excluded_since_ns,
        held=held,
    )


def fault(saved: SavedState, settings: Settings, time_ns: int) -> str | None:
    """Reason why a saved state cannot be used at the stamp of the first sample; None if it can."""
    size = LAYOUT.size_by(settings)
    gap_s = (time_ns - saved.inertial.time_ns) * 1e-9
    if not 0.0 < gap_s <= MAX_GAP_S:
        return "saved state too old" if gap_s > 0.0 else "saved state from the future"
    if (len(saved.parameters), len(saved.covariance)) != (size - em.DRIVING, size * (size + 1) // 2):
        return "saved state of another layout"
    w, x, y, z = saved.inertial.quaternion
    unit = abs(w * w + x * x + y * y + z * z - 1.0) < 1e-6
    if not unit or implausible(initial_state(saved.inertial, ZERO, ZERO)) or not credible(*saved.sample):
        return "implausible saved state"
    return None if _is_positive(covariance_of(saved)) else "saved state without a positive covariance"


def covariance_of(saved: SavedState) -> FloatArray:
    """Covariance of a saved state, shape (n, n)."""
    size = em.DRIVING + len(saved.parameters)
    P = np.zeros((size, size))
    P[np.triu_indices(size)] = saved.covariance
    return P + np.triu(P, 1).T


def _is_positive(P: FloatArray) -> bool:
    """Whether a covariance is positive definite for the estimated states, and zero for all others."""
    variances = P.diagonal()
    estimated = variances > 0.0
    if not (
        estimated[: em.ACCELEROMETER_SCALE.start].all() and (np.abs(P) < MAX_VALUE).all() and not P[~estimated].any()
    ):
        return False
    sd = np.sqrt(variances[estimated])
    try:
        np.linalg.cholesky(P[np.ix_(estimated, estimated)] / np.outer(sd, sd))
    except np.linalg.LinAlgError:
        return False
    return True


def restored(settings: Settings, saved: SavedState, sample: Sample) -> ErrorStateFilter:
    """Filter of a saved state, propagated over the gap to the first sample.

    Parameters
    ----------
    settings : Settings
        The settings with which the state was saved.
    saved : SavedState
        A state without a `fault`.
    sample : Sample
        First sample after the gap.

    Returns
    -------
    ErrorStateFilter
        At the stamp of the sample.

    Raises
    ------
    FilterDiverged
        The state after the gap is implausible.
    """
    gnss_errors = position_errors_at_start(settings)
    units = np.ones(LAYOUT.size_by(settings))
    units[GNSS_ERROR] = gnss_errors.unit
    navigation = ErrorStateFilter(
        settings,
        saved.inertial,
        covariance_of(saved) / np.outer(units, units),
        ImuErrors(saved.accelerometer_bias, saved.gyroscope_bias, saved.accelerometer_scale, saved.gyroscope_scale),
        tuple((np.array(saved.parameters) / units[em.PARAMETERS]).tolist()),
        {POSITION: gnss_errors},
    )
    force, rate = mean(saved.sample[0], sample.force), mean(saved.sample[1], sample.rate)
    bias, down = np.array(saved.gyroscope_bias), navigation.ned_from_body[2]
    x, y, z = (bias + (np.array(rate) - bias) @ down * down).tolist()  # rate about the vertical only
    begin_ns, gap_ns = saved.inertial.time_ns, sample.time_ns - saved.inertial.time_ns
    steps = max(1, round(gap_ns * 1e-9 / STEP_S))
    times_ns = [begin_ns + gap_ns * step // steps for step in range(1, steps + 1)]
    samples = samples_of(times_ns, [[*force, x, y, z]] * steps, {})
    for k in range(steps):
        navigation.propagate(samples, k, k + 1, CERTAIN_LIMITS, Intervals(inf, gap_s=inf))
        navigation.propagate_covariance()
    navigation.state = navigation.state._replace(
        quiet=UNSETTLED, standstill_s=0.0, standstill_rotation_b=ZERO, since_non_holonomic_s=0.0
    )
    moving = slice(0, em.MOVING)
    P = navigation.P.copy()
    P[moving, moving] += unmeasured_motion(navigation.velocity, gap_ns * 1e-9)
    navigation.P = P
    return navigation


def unmeasured_motion(velocity: Vector, span_s: float) -> FloatArray:
    """Covariance added over a time [s] without samples, to that of attitude, velocity and position, shape (9, 9).

    Notes
    -----
    The first and the second integral over a time T have the covariance N q with::

        N = [[T³/12, T⁴/24], [T⁴/24, T⁵/45]]    of a Brownian bridge of density q
        N = [[T², T³/2], [T³/2, T⁴/4]]          of a constant of variance q

    Yaw is the first integral of w; velocity and position are the first and second integral of g w + a.
    """
    north, east, _ = velocity
    g, T, yaw = np.array([-east, north, 0.0]), span_s, em.ATTITUDE.stop - 1
    moving = slice(em.VELOCITY.start, em.POSITION.stop)
    Q = np.zeros((em.MOVING, em.MOVING))
    for N, turn, tilt, acceleration in (
        (np.array([[T**3 / 12, T**4 / 24], [T**4 / 24, T**5 / 45]]), YAW_PSD, TILT_PSD, JERK_PSD),
        (np.array([[T**2, T**3 / 2], [T**3 / 2, T**4 / 4]]), RATE_VARIANCE, TILT_VARIANCE, FORCE_VARIANCE),
    ):
        cross = np.kron(N[0], turn * g)
        Q[em.ATTITUDE, em.ATTITUDE] += np.diag([tilt, tilt, turn]) * N[0, 0]
        Q[yaw, moving] += cross
        Q[moving, yaw] += cross
        Q[moving, moving] += np.kron(N, turn * np.outer(g, g) + acceleration)
    return Q

"""Displacement of an antenna between two epochs, from the change of carrier phases.

The phase of one satellite is its range, but for a whole number of cycles that stays while the receiver tracks it. So
the change between two epochs has no ambiguity, and millimetres of noise where a pseudorange has decimetres::

    lambda (phi_2 - phi_1) + c (dt_s2 - dt_s1) - (T_2 - T_1) + (I_2 - I_1) - [rho_2(r_1) - rho_1(r_1)]
        = -u_2' d + c (dt_r2 - dt_r1) + v

with the satellites at their times of transmission, d the displacement and u_2 the line of sight at the second epoch.
One clock is enough: what separates the constellations does not change. It absorbs jumps of the receiver's clock as
well.
"""

from dataclasses import dataclass, replace
from math import exp, pi, radians, sqrt

import numpy as np

from shared.maths.gnss_signals import SPEED_OF_LIGHT, Klobuchar
from shared.maths.quantiles import chi_square_limit

from ..broadcast.ephemeris import Ephemeris
from ..broadcast.store import EphemerisStore
from ..detection import Fit, minimal_identifiable_biases, noncentrality, weighted_fit
from ..measurements import FloatArray, Measurement, RawEpoch, SatelliteId
from ..satellites.model import (
    MAX_PSEUDORANGE,
    MIN_PSEUDORANGE,
    WAVELENGTH,
    ErrorModel,
    Geometry,
    SatelliteMeasurement,
    Sky,
    at_transmission,
    noise_factor,
)

MIN_INTERVAL_S, MAX_INTERVAL_S = 0.03, 35.0
LONGEST_LOCK_S = 60.0  # u-blox receivers count the lock of a carrier up to 64.5 s
ROUNDS = 4  # of the linearisation: after a kilometre the first step is off by centimetres
CONVERGED_M = 1e-4
FALSE_ALARM_RATE, MISSED_DETECTION_RATE = 1e-4, 1e-3  # of one cycle slip; a false alarm costs a satellite
UNSEEN_SDS = 2.5  # of the result, by which a slip that is not seen may move it: with its noise it is below five
TESTED_REDUNDANCY = 2  # below it a slip is found at best, and not attributed
SLIP_M = 0.5 * WAVELENGTH  # the smallest: half a cycle
SHARP_M = 0.8 * SLIP_M  # error of the change by Doppler at most, for a verdict of its own
JERK_M_S3 = 5.0  # of a road vehicle: by which the mean of two range-rates is no range difference


@dataclass(frozen=True)
class CarrierModel:
    """Standard deviations of the change of a carrier phase.

    The thermal noise is that of a phase-locked loop of bandwidth B: lambda/(2 pi) sqrt(B / (C/N0)).
    """

    loop_bandwidth_hz: float = 15.0
    usual_cn0_db_hz: float = 40.0  # where the receiver states none
    noise_m: float = 0.0015  # other white noise of one epoch at the zenith; grows as 1/sin(elevation)
    multipath_m: float = 0.003  # of one epoch at the zenith; grows as 1/sin(elevation)
    multipath_s: float = 5.0  # correlation time: two epochs that follow each other share it
    slow_m_s: float = 0.001  # orbits, clocks of satellites and ionosphere: the same for minutes
    elevation_mask_rad: float = radians(15.0)  # below it a phase adds little, and its slips are hard to see
    common_m_s: float = 0.003  # the same, as far as residuals cannot show it: of the displacement, each axis


@dataclass(frozen=True)
class Displacement:
    """Displacement from the first epoch to the second."""

    displacement_n: FloatArray  # [m, NED at the first epoch] shape (3,)
    cov: FloatArray  # [m², NED] shape (3, 3)
    slow_cov: FloatArray  # [m², NED] shape (3, 3), the part of it that successive displacements share
    clock_m: float  # [m] change of the receiver's clock
    position_e: FloatArray  # [m, ECEF] shape (3,), at the second epoch
    used: tuple[SatelliteId, ...]
    slipped: tuple[SatelliteId, ...]  # left out, because their phase has jumped
    redundancy: int
    statistic: float  # of the residuals, chi-square of so many degrees of freedom
    checked: bool  # one slip of any satellite that is used would have been found, or moves it by less than its noise
    doppler_velocity_n: FloatArray | None = None  # [m/s, NED] mean of both epochs, of the same satellites
    doppler_sd: FloatArray | None = None  # [m/s, NED] shape (3,)


@dataclass(frozen=True)
class PhaseChange:
    """Change of one satellite's phase, freed of what its clock has done."""

    first: SatelliteMeasurement
    second: SatelliteMeasurement
    range_m: float  # by the carrier, satellite clock removed
    phase_m: float  # the same as measured
    rate_m_s: float | None  # by the mean Doppler
    rate_sd_m_s: float

    @property
    def satellite(self) -> SatelliteId:
        """Which it is."""
        return self.second.satellite


def carrier_displacement(
    first: RawEpoch,
    second: RawEpoch,
    store: EphemerisStore,
    position_e: FloatArray,
    model: CarrierModel | None = None,
    errors: ErrorModel | None = None,
) -> Displacement | None:
    """Displacement between two epochs of one receiver.

    Parameters
    ----------
    first, second : RawEpoch
        With carrier phases; `MIN_INTERVAL_S` to `MAX_INTERVAL_S` apart.
    store : EphemerisStore
        Broadcast ephemerides; that of the second epoch is used for both, for issues differ by decimetres.
    position_e : ndarray, shape (3,)
        [m, ECEF] At the first epoch. An error of 10 m is one of some 2 mm in a second.
    model, errors : CarrierModel, ErrorModel
        Standard deviations; elevation mask and growth of noise with weak signals.

    Returns
    -------
    Displacement or None
        None where fewer than four satellites have a phase without a slip at both epochs.

    Notes
    -----
    Slips: by the receiver's flags, by Doppler where it is sharp enough, and by the residuals, of which the largest is
    left out until the others agree. The covariance is that of three parts (white noise, multipath of seconds, slow
    errors of minutes), and residuals only inflate it.
    """
    model, errors = model or CarrierModel(), errors or ErrorModel()
    span_s = (second.gps_time_ns - first.gps_time_ns) * 1e-9
    if not MIN_INTERVAL_S <= span_s <= MAX_INTERVAL_S:
        return None
    changes, slipped = _changes(first, second, store, span_s, errors)
    if len(changes) < 4:
        return None
    try:
        times_ns = first.gps_time_ns, second.gps_time_ns
        return displacement_by(changes, slipped, times_ns, store.ionosphere, position_e, model, errors)
    except np.linalg.LinAlgError:
        return None


def _changes(
    first: RawEpoch, second: RawEpoch, store: EphemerisStore, span_s: float, errors: ErrorModel
) -> tuple[list[PhaseChange], list[SatelliteId]]:
    """Changes of the phases that go on, and satellites whose phase has jumped by the receiver's flags or by Doppler."""
    before = {measurement.satellite: measurement for measurement in first.measurements}
    changes: list[PhaseChange] = []
    slipped: list[SatelliteId] = []
    for now in second.measurements:
        then = before.pop(now.satellite, None)
        if then is None or then.carrier_cycles is None or now.carrier_cycles is None:
            continue
        if not all(MIN_PSEUDORANGE < one.pseudorange_m < MAX_PSEUDORANGE for one in (then, now)):
            continue
        if any(one.cn0_db_hz is not None and one.cn0_db_hz < errors.min_cn0_db_hz for one in (then, now)):
            continue
        ephemeris = store.select(now.satellite, second.gps_time_ns)
        if isinstance(ephemeris, str):
            continue
        if _is_interrupted(then, now, span_s):
            slipped.append(now.satellite)
            continue
        changes.append(_change(then, now, first.gps_time_ns, second.gps_time_ns, ephemeris, errors))
    jumped = _jumped_by_doppler(changes, span_s)
    slipped += [change.satellite for change in jumped]
    return [change for change in changes if change not in jumped], slipped


def _is_interrupted(then: Measurement, now: Measurement, span_s: float) -> bool:
    """Whether the receiver says that it has not tracked the carrier throughout, or has moved it by half a cycle."""
    if now.slipped or then.half_cycle_resolved != now.half_cycle_resolved:
        return True
    return now.lock_time_s is not None and now.lock_time_s < min(span_s, LONGEST_LOCK_S)


def _change(
    then: Measurement, now: Measurement, then_ns: int, now_ns: int, ephemeris: Ephemeris, errors: ErrorModel
) -> PhaseChange:
    states = [
        at_transmission(ephemeris, one.pseudorange_m, time_ns) for one, time_ns in ((then, then_ns), (now, now_ns))
    ]
    assert then.carrier_cycles is not None and now.carrier_cycles is not None
    by_carrier = WAVELENGTH * (now.carrier_cycles - then.carrier_cycles)
    rate = None
    if then.doppler_hz is not None and now.doppler_hz is not None:
        rate = -0.5 * WAVELENGTH * (then.doppler_hz + now.doppler_hz)
    rate_sd = errors.range_rate_sd_m_s * noise_factor(now.cn0_db_hz, errors) / sqrt(2.0)
    clock_m = SPEED_OF_LIGHT * (states[1].clock_s - states[0].clock_s)
    first, second = (
        SatelliteMeasurement(
            one.satellite, one.pseudorange_m + SPEED_OF_LIGHT * state.clock_s, None, one.cn0_db_hz,
            state.position_e, state.velocity_e,
        )
        for one, state in zip((then, now), states, strict=True)
    )  # fmt: skip
    return PhaseChange(first, second, by_carrier + clock_m, by_carrier, rate, rate_sd)


def _jumped_by_doppler(changes: list[PhaseChange], span_s: float) -> list[PhaseChange]:
    """Changes that contradict their own Doppler, beside the median of all: what the clock does is common.

    A jump of the clock is one of the interval by the clock as well, over which the ranges have changed less.
    """
    tested = [(change, change.rate_m_s) for change in changes if change.rate_m_s is not None]
    if len(tested) < 3:
        return []
    jump_s = 0.0
    for _ in range(2):
        apart = [change.phase_m - rate * (span_s - jump_s) for change, rate in tested]
        common = float(np.median(apart))
        jump_s = common / SPEED_OF_LIGHT
    bend = JERK_M_S3 * span_s**3 / 12.0  # error of the trapezoidal rule
    return [
        change
        for (change, _), off in zip(tested, apart, strict=True)
        if abs(off - common) > max(SHARP_M, 5.0 * change.rate_sd_m_s * span_s + bend)
    ]


def displacement_by(
    changes: list[PhaseChange],
    slipped: list[SatelliteId],
    times_ns: tuple[int, int],
    ionosphere: Klobuchar | None,
    position_e: FloatArray,
    model: CarrierModel,
    errors: ErrorModel,
) -> Displacement | None:
    """Displacement of `carrier_displacement` by changes of phases, with satellites that are known already."""
    span_s = (times_ns[1] - times_ns[0]) * 1e-9
    first = Sky(tuple(change.first for change in changes), times_ns[0], ionosphere, errors).geometry(position_e)
    second = Sky(tuple(change.second for change in changes), times_ns[1], ionosphere, errors)
    # Phase ranges at the second epoch, but for the change of the clock: to be compared with predicted ones.
    measured = np.array([change.range_m for change in changes]) + _phase_range(first)
    mask = max(errors.elevation_mask_rad, model.elevation_mask_rad)
    rows = np.flatnonzero(second.geometry(position_e).elevation > mask).tolist()
    while len(rows) >= 4:
        kept = replace(second, sights=tuple(second.sights[row] for row in rows))
        found = _converged(kept, measured[rows], first, span_s, model)
        if found is None:
            return None
        fit, here_e, slow = found
        used = tuple(sight.satellite for sight in kept.sights)
        if fit.dof == 0 or fit.statistic <= chi_square_limit(fit.dof, FALSE_ALARM_RATE):
            displaced = _displacement(used, slipped, fit, here_e, first, slow, model.common_m_s * span_s)
            return _with_doppler(displaced, [changes[row] for row in rows], kept.geometry(here_e), first, span_s)
        if fit.dof < TESTED_REDUNDANCY:
            return None
        worst = int(fit.w.argmax())
        slipped = [*slipped, used[worst]]
        rows.pop(worst)
    return None


def _converged(
    sky: Sky, measured: FloatArray, first: Geometry, span_s: float, model: CarrierModel
) -> tuple[Fit, FloatArray, FloatArray] | None:
    """Fit, second position [m, ECEF], and the slow part of the deviations [m].

    `sky` is that of the second epoch, and `measured` its phase ranges [m] by those of the first and their change.
    """
    here_e, to_ned = first.position_e, first.ned_from_ecef
    for _ in range(ROUNDS):
        geometry = sky.geometry(here_e)
        grown = 1.0 / np.sin(np.maximum(geometry.elevation, sky.model.elevation_mask_rad))
        cn0 = np.array([model.usual_cn0_db_hz if sight.cn0 is None else sight.cn0 for sight in sky.sights])
        thermal = WAVELENGTH / (2.0 * pi) * np.sqrt(model.loop_bandwidth_hz / 10.0 ** (cn0 / 10.0))
        shared = 1.0 - exp(-span_s / model.multipath_s)
        white = sqrt(2.0) * np.hypot(thermal, model.noise_m * grown)
        slow = np.full(len(sky.sights), model.slow_m_s * span_s)
        sd = np.sqrt(white**2 + 2.0 * shared * (model.multipath_m * grown) ** 2 + slow**2)
        sight_n = geometry.line_of_sight_n @ geometry.ned_from_ecef @ to_ned.T  # in the axes of the first epoch
        H = np.hstack([-sight_n, np.ones((len(sky.sights), 1))])
        fit = weighted_fit(H, measured - _phase_range(geometry), sd)
        if fit is None:
            return None
        step_e = to_ned.T @ fit.parameters[:3]
        here_e = here_e + step_e
        if np.linalg.norm(step_e) < CONVERGED_M:
            return fit, here_e, slow
    return None


def _phase_range(geometry: Geometry) -> FloatArray:
    """Range [m] that a phase has: the ionosphere shortens it by as much as it lengthens that of the code."""
    return geometry.distance + geometry.delay - 2.0 * geometry.ionosphere


def _with_doppler(
    displaced: Displacement, changes: list[PhaseChange], geometry: Geometry, first: Geometry, span_s: float
) -> Displacement:
    """With the velocity that the mean Doppler of the same satellites gives, if enough of them have one.

    What Doppler and phase differ by has the same geometry: -u_2' (d_D - d) + c (dt_D - dt).
    """
    tested = [(row, change.rate_m_s) for row, change in enumerate(changes) if change.rate_m_s is not None]
    rows = [row for row, _ in tested]
    if len(rows) < 4:
        return displaced
    sight_n = geometry.line_of_sight_n[rows] @ geometry.ned_from_ecef @ first.ned_from_ecef.T
    H = np.hstack([-sight_n, np.ones((len(rows), 1))])
    apart = np.array([rate * span_s - changes[row].phase_m for row, rate in tested])
    fit = weighted_fit(H, apart, np.array([changes[row].rate_sd_m_s * span_s for row in rows]))
    if fit is None:
        return displaced
    velocity_n = (displaced.displacement_n + fit.parameters[:3]) / span_s
    return replace(displaced, doppler_velocity_n=velocity_n, doppler_sd=np.sqrt(fit.cov.diagonal()[:3]) / span_s)


def _is_checked(fit: Fit, cov: FloatArray) -> bool:
    """Whether no slip of one satellite, in half cycles, is both unseen and of weight.

    The largest slip s that may be missed, or taken for one of another satellite, moves the result by so many standard
    deviations, with g_i its gain and P the covariance of the result::

        s_i = floor(MIB_i / (lambda/2)) (lambda/2),    s_i sqrt(g_i' P^-1 g_i)
    """
    if fit.dof < TESTED_REDUNDANCY:
        return False
    lambda_ = noncentrality(fit.dof, FALSE_ALARM_RATE, MISSED_DETECTION_RATE)
    unseen = SLIP_M * np.floor(minimal_identifiable_biases(fit, lambda_, MISSED_DETECTION_RATE) / SLIP_M)
    moved = fit.gain[:3] * unseen
    return bool((moved * np.linalg.solve(cov, moved)).sum(axis=0).max() < UNSEEN_SDS**2)


def _displacement(
    used: tuple[SatelliteId, ...],
    slipped: list[SatelliteId],
    fit: Fit,
    here_e: FloatArray,
    first: Geometry,
    slow: FloatArray,
    common_m: float,
) -> Displacement:
    inflation = max(1.0, fit.statistic / fit.dof) if fit.dof else 1.0
    gain, common = fit.gain[:3], common_m**2 * np.eye(3)
    cov = inflation * fit.cov[:3, :3] + common
    return Displacement(
        displacement_n=first.ned_from_ecef @ (here_e - first.position_e),
        cov=cov,
        slow_cov=inflation * (gain * slow**2) @ gain.T + common,
        clock_m=float(fit.parameters[3]),
        position_e=here_e,
        used=used,
        slipped=tuple(slipped),
        redundancy=fit.dof,
        statistic=fit.statistic,
        checked=_is_checked(fit, cov),
    )

"""Displacement of an antenna between two epochs, from the change of carrier phases.

The phase of one satellite is its range, but for a whole number of cycles that stays while the receiver tracks it. So
the change between two epochs has no ambiguity, and millimetres of noise where a pseudorange has decimetres::

    lambda (phi_2 - phi_1) + c (dt_s2 - dt_s1) - (T_2 - T_1) + (I_2 - I_1) - [rho_2(r_1) - rho_1(r_1)]
        = -u_2' d + c (dt_r2 - dt_r1) + v

with the satellites at their times of transmission, d the displacement and u_2 the line of sight at the second epoch.
One clock is enough: what separates the constellations does not change. It absorbs jumps of the receiver's clock as
well.
"""

from dataclasses import dataclass
from math import exp, pi, radians, sqrt

import numpy as np

from shared.maths.earth import Geodetic, geodetic_from_ecef, ned_from_ecef
from shared.maths.gnss_signals import (
    EARTH_RATE,
    SECONDS_PER_DAY,
    SPEED_OF_LIGHT,
    klobuchar_delay_m,
    saastamoinen_zenith_m,
    troposphere_mapping,
)
from shared.maths.quantiles import chi_square_limit

from ..broadcast.ephemeris import Ephemeris, satellite_state
from ..broadcast.store import EphemerisStore
from ..detection import Fit, minimal_identifiable_biases, noncentrality, weighted_fit
from ..measurements import FloatArray, Measurement, RawEpoch, SatelliteId
from ..satellites.model import (
    HIGHEST,
    LOWEST,
    MAX_PSEUDORANGE,
    MIN_PSEUDORANGE,
    WAVELENGTH,
    ErrorModel,
    noise_factor,
    turned,
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
LOWEST_RAD = 0.05  # elevation at which delays are evaluated at least; what is below the mask is not used
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


@dataclass(frozen=True)
class _Change:
    """Change of one satellite's phase, freed of what its clock has done."""

    satellite: SatelliteId
    first_e: FloatArray  # [m, ECEF at transmission] shape (3,)
    second_e: FloatArray
    range_m: float  # by the carrier, satellite clock removed
    phase_m: float  # the same as measured
    rate_m_s: float | None  # by the mean Doppler
    rate_sd_m_s: float
    cn0: float | None


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
        return _fitted(changes, slipped, times_ns, store, position_e, model, errors)
    except np.linalg.LinAlgError:
        return None


def _changes(
    first: RawEpoch, second: RawEpoch, store: EphemerisStore, span_s: float, errors: ErrorModel
) -> tuple[list[_Change], list[SatelliteId]]:
    """Changes of the phases that go on, and satellites whose phase has jumped by the receiver's flags or by Doppler."""
    before = {measurement.satellite: measurement for measurement in first.measurements}
    changes: list[_Change] = []
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
) -> _Change:
    states = []
    for one, time_ns in ((then, then_ns), (now, now_ns)):
        flight_s = one.pseudorange_m / SPEED_OF_LIGHT
        clock_s = satellite_state(ephemeris, time_ns, flight_s).clock_s
        states.append(satellite_state(ephemeris, time_ns, flight_s + clock_s))
    assert then.carrier_cycles is not None and now.carrier_cycles is not None
    by_carrier = WAVELENGTH * (now.carrier_cycles - then.carrier_cycles)
    rate = None
    if then.doppler_hz is not None and now.doppler_hz is not None:
        rate = -0.5 * WAVELENGTH * (then.doppler_hz + now.doppler_hz)
    rate_sd = errors.range_rate_sd_m_s * noise_factor(now.cn0_db_hz, errors) / sqrt(2.0)
    clock_m = SPEED_OF_LIGHT * (states[1].clock_s - states[0].clock_s)
    first_e, second_e = (np.array(state.position_e) for state in states)
    return _Change(now.satellite, first_e, second_e, by_carrier + clock_m, by_carrier, rate, rate_sd, now.cn0_db_hz)


def _jumped_by_doppler(changes: list[_Change], span_s: float) -> list[_Change]:
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


def _fitted(
    changes: list[_Change],
    slipped: list[SatelliteId],
    times_ns: tuple[int, int],
    store: EphemerisStore,
    position_e: FloatArray,
    model: CarrierModel,
    errors: ErrorModel,
) -> Displacement | None:
    here, span_s = position_e, (times_ns[1] - times_ns[0]) * 1e-9
    elevation, _, _ = _ranges(changes, times_ns, store, here, here)
    mask = max(errors.elevation_mask_rad, model.elevation_mask_rad)
    changes = [change for change, up in zip(changes, elevation.tolist(), strict=True) if up > mask]
    while len(changes) >= 4:
        found = _converged(changes, times_ns, store, position_e, model, errors)
        if found is None:
            return None
        fit, here, to_ned, slow = found
        if fit.dof == 0 or fit.statistic <= chi_square_limit(fit.dof, FALSE_ALARM_RATE):
            common_m = model.common_m_s * span_s
            return _displacement(changes, slipped, fit, here, position_e, to_ned, slow, common_m)
        if fit.dof < TESTED_REDUNDANCY:
            return None
        worst = int(fit.w.argmax())
        slipped = [*slipped, changes[worst].satellite]
        changes = [*changes[:worst], *changes[worst + 1 :]]
    return None


def _converged(
    changes: list[_Change],
    times_ns: tuple[int, int],
    store: EphemerisStore,
    position_e: FloatArray,
    model: CarrierModel,
    errors: ErrorModel,
) -> tuple[Fit, FloatArray, FloatArray, FloatArray] | None:
    """Fit, second position [m, ECEF], axes NED from ECEF at the first, and the slow part of the deviations [m]."""
    here, measured = position_e, np.array([change.range_m for change in changes])
    span_s, (_, to_ned) = (times_ns[1] - times_ns[0]) * 1e-9, _axes(position_e)
    for _ in range(ROUNDS):
        elevation, sight_e, predicted = _ranges(changes, times_ns, store, position_e, here)
        grown = 1.0 / np.sin(np.maximum(elevation, errors.elevation_mask_rad))
        cn0 = np.array([model.usual_cn0_db_hz if change.cn0 is None else change.cn0 for change in changes])
        thermal = WAVELENGTH / (2.0 * pi) * np.sqrt(model.loop_bandwidth_hz / 10.0 ** (cn0 / 10.0))
        shared = 1.0 - exp(-span_s / model.multipath_s)
        white = sqrt(2.0) * np.hypot(thermal, model.noise_m * grown)
        slow = np.full(len(changes), model.slow_m_s * span_s)
        sd = np.sqrt(white**2 + 2.0 * shared * (model.multipath_m * grown) ** 2 + slow**2)
        fit = weighted_fit(np.hstack([-sight_e @ to_ned.T, np.ones((len(changes), 1))]), measured - predicted, sd)
        if fit is None:
            return None
        step_e = to_ned.T @ fit.parameters[:3]
        here = here + step_e
        if np.linalg.norm(step_e) < CONVERGED_M:
            return fit, here, to_ned, slow
    return None


def _ranges(
    changes: list[_Change], times_ns: tuple[int, int], store: EphemerisStore, first_e: FloatArray, second_e: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Elevations [rad] and lines of sight [ECEF] at the second epoch, and predicted changes of the phase range [m]."""
    rows = []
    for time_ns, place_e, satellites in (
        (times_ns[0], first_e, np.array([change.first_e for change in changes])),
        (times_ns[1], second_e, np.array([change.second_e for change in changes])),
    ):
        flight_s = np.linalg.norm(satellites - place_e, axis=1) / SPEED_OF_LIGHT
        away = turned(satellites, EARTH_RATE * flight_s) - place_e
        distance = np.linalg.norm(away, axis=1)
        place, to_ned = _axes(place_e)
        sight_e = away / distance[:, np.newaxis]
        sight_n = sight_e @ to_ned.T
        elevation = np.arcsin(np.clip(-sight_n[:, 2], -1.0, 1.0))
        azimuth = np.arctan2(sight_n[:, 1], sight_n[:, 0])
        zenith, second_of_day = saastamoinen_zenith_m(place.latitude, place.height), time_ns * 1e-9 % SECONDS_PER_DAY
        delay = [
            zenith * troposphere_mapping(up)
            - klobuchar_delay_m(store.ionosphere, place, elevation=up, azimuth=towards, second_of_day=second_of_day)
            for up, towards in zip(np.maximum(elevation, LOWEST_RAD).tolist(), azimuth.tolist(), strict=True)
        ]
        rows.append((elevation, sight_e, distance + np.array(delay)))
    return rows[1][0], rows[1][1], rows[1][2] - rows[0][2]


def _axes(position_e: FloatArray) -> tuple[Geodetic, FloatArray]:
    """Place of a position [m, ECEF], and its axes NED from ECEF; the delays are evaluated near the ground."""
    x, y, z = position_e.tolist()
    place = geodetic_from_ecef((x, y, z))
    near = Geodetic(place.latitude, place.longitude, min(max(place.height, LOWEST), HIGHEST))
    return near, ned_from_ecef(place.latitude, place.longitude)


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
    changes: list[_Change],
    slipped: list[SatelliteId],
    fit: Fit,
    here: FloatArray,
    position_e: FloatArray,
    to_ned: FloatArray,
    slow: FloatArray,
    common_m: float,
) -> Displacement:
    inflation = max(1.0, fit.statistic / fit.dof) if fit.dof else 1.0
    gain, common = fit.gain[:3], common_m**2 * np.eye(3)
    cov = inflation * fit.cov[:3, :3] + common
    return Displacement(
        displacement_n=to_ned @ (here - position_e),
        cov=cov,
        slow_cov=inflation * (gain * slow**2) @ gain.T + common,
        clock_m=float(fit.parameters[3]),
        position_e=here,
        used=tuple(change.satellite for change in changes),
        slipped=tuple(slipped),
        redundancy=fit.dof,
        statistic=fit.statistic,
        checked=_is_checked(fit, cov),
    )

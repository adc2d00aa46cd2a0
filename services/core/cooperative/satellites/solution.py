"""Least-squares position, one clock per constellation, and velocity from a set of satellites."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from shared.maths.quantiles import chi_square_limit
from shared.maths.rotation import Vector

from ..detection import Fit, weighted_fit
from ..measurements import Constellation, FloatArray, SatelliteId, SatelliteSolution
from .model import Geometry, Sky, clock_columns, noise_factor, rough_position

ROUNDS = 12  # of the linearisation; from the far side of the Earth seven are needed
CONVERGED = 1e-3  # [m]
MAX_RADIUS_M = 1e8  # [m] from the Earth's centre; a solution beyond is a breakdown
MIN_RADIUS_M = 1e6


@dataclass(frozen=True)
class PositionFit:
    """A converged position: the sights used, the geometry there, and the fit of the last step.

    Parameters of the fit: north, east, down [m] relative to the linearisation point (nearly 0), then the clocks [m].
    """

    sky: Sky
    geometry: Geometry
    fit: Fit
    H: FloatArray  # shape (n, 3 + c)
    clocks: Mapping[str, int]  # column of each constellation behind the three of the position

    @property
    def satellites(self) -> tuple[SatelliteId, ...]:
        """The satellites in the order of the rows."""
        return tuple(sight.satellite for sight in self.sky.sights)


def fit_position(sky: Sky, start_e: FloatArray | None) -> PositionFit | None:
    """Solve for position and clocks by Gauss-Newton steps.

    Parameters
    ----------
    sky : Sky
        All its sights are used.
    start_e : ndarray, shape (3,) or None
        [m, ECEF] Where to linearise first; None starts below the satellites.

    Returns
    -------
    PositionFit or None
        None where there are too few satellites, their geometry is singular or the steps do not converge.

    Notes
    -----
    ::

        rho_i - |s_i - r| - delay_i = -u_i' dr + c dt_k + v_i,    u_i the line of sight
    """
    design, clocks = clock_columns(sky.sights)
    if len(sky.sights) < 3 + len(clocks):
        return None
    position = rough_position(sky.sights) if start_e is None else start_e
    pseudorange = np.array([sight.pseudorange for sight in sky.sights])
    for _ in range(ROUNDS):
        geometry = sky.geometry(position)
        H = np.hstack([-geometry.line_of_sight_n, design])
        fit = weighted_fit(H, pseudorange - geometry.distance - geometry.delay, geometry.sd)
        if fit is None:
            return None
        step_e = geometry.ned_from_ecef.T @ fit.parameters[:3]
        if np.linalg.norm(step_e) < CONVERGED:
            return PositionFit(sky, geometry, fit, H, clocks)
        position = position + step_e
        if not MIN_RADIUS_M < np.linalg.norm(position) < MAX_RADIUS_M:
            return None
    return None


def masked(sky: Sky, start_e: FloatArray | None) -> tuple[PositionFit | None, dict[str, int]]:
    """Solve with the satellites above the elevation mask that another one's clock can be compared with.

    Returns
    -------
    PositionFit or None, dict of str to int
        The solution, and how many sights were left out, by reason.
    """
    found = fit_position(sky, start_e)
    rejected: dict[str, int] = {}
    if found is None:
        return None, rejected
    kept = []
    for sight, elevation in zip(sky.sights, found.geometry.elevation.tolist(), strict=True):
        if elevation >= sky.model.elevation_mask_rad:
            kept.append(sight)
        else:
            reason = "below_horizon" if elevation < 0.0 else "below_elevation_mask"
            rejected[reason] = rejected.get(reason, 0) + 1
    counts = [sight.satellite.constellation for sight in kept]
    alone = [sight for sight in kept if counts.count(sight.satellite.constellation) == 1]
    if alone:
        rejected["alone_in_constellation"] = len(alone)
        kept = [sight for sight in kept if sight not in alone]
    if not rejected:
        return found, rejected
    if not kept:
        return None, rejected
    return fit_position(replace(sky, sights=tuple(kept)), found.geometry.position_e), rejected


@dataclass(frozen=True)
class VelocityFit:
    """Velocity [m/s, ECEF], its covariance, the receiver's clock drift [m/s] and the Doppler that disagreed."""

    velocity_e: Vector
    cov_e: FloatArray
    drift: float
    excluded: tuple[SatelliteId, ...]


def fit_velocity(position: PositionFit, false_alarm_rate: float) -> VelocityFit | None:
    """Solve for velocity and one clock drift from the Doppler of the satellites of a position.

    Parameters
    ----------
    position : PositionFit
        With the satellites under test excluded already.
    false_alarm_rate : float
        [-] Of the global test; while it fails, the Doppler with the largest w is left out.

    Returns
    -------
    VelocityFit or None
        None without four range-rates, or where they contradict each other and none can be singled out.

    Notes
    -----
    ::

        rdot_i - u_i' v_i = -u_i' v + c dt' + v_i

    The receiver has one oscillator: its drift is the same against all constellations.
    """
    found = doppler_fit(position, false_alarm_rate)
    if found is None:
        return None
    fit, rows = found
    sights, to_ned = position.sky.sights, position.geometry.ned_from_ecef
    excluded = (sight.satellite for row, sight in enumerate(sights) if sight.range_rate is not None and row not in rows)
    x, y, z = (to_ned.T @ fit.parameters[:3]).tolist()
    return VelocityFit((x, y, z), to_ned.T @ fit.cov[:3, :3] @ to_ned, float(fit.parameters[3]), tuple(excluded))


def doppler_fit(position: PositionFit, false_alarm_rate: float) -> tuple[Fit, tuple[int, ...]] | None:
    """Fit velocity [m/s, NED] and clock drift [m/s] as `fit_velocity` does.

    Returns
    -------
    Fit and tuple of int, or None
        The rows of the position whose Doppler is used.
    """
    model, sights = position.sky.model, position.sky.sights
    rows = [row for row, sight in enumerate(sights) if sight.range_rate is not None]
    sight_n, velocity_n = position.geometry.line_of_sight_n, position.geometry.satellite_velocity_n
    while len(rows) >= 4:
        H = np.hstack([-sight_n[rows], np.ones((len(rows), 1))])
        measured = np.array([sights[row].range_rate for row in rows], dtype=np.float64)
        sd = np.array([model.range_rate_sd_m_s * noise_factor(sights[row].cn0, model) for row in rows])
        fit = weighted_fit(H, measured - (sight_n[rows] * velocity_n[rows]).sum(axis=1), sd)
        if fit is None:
            return None
        if fit.dof == 0 or fit.statistic <= chi_square_limit(fit.dof, false_alarm_rate):
            return fit, tuple(rows)
        if fit.dof < 2:
            return None
        rows.pop(int(fit.w.argmax()))
    return None


def solution_of(position: PositionFit, velocity: VelocityFit | None) -> SatelliteSolution:
    """Collect position, clocks and velocity for publication."""
    to_ned, parameters = position.geometry.ned_from_ecef, position.fit.parameters
    x, y, z = (position.geometry.position_e + to_ned.T @ parameters[:3]).tolist()
    clocks = {Constellation(name): float(parameters[3 + column]) for name, column in position.clocks.items()}
    cov = to_ned.T @ position.fit.cov[:3, :3] @ to_ned
    if velocity is None:
        return SatelliteSolution((x, y, z), cov, clocks)
    return SatelliteSolution(
        (x, y, z), cov, clocks, velocity.velocity_e, velocity.cov_e, velocity.drift, velocity.excluded
    )

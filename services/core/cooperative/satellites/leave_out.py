"""Least-squares solutions of an epoch without one satellite, or without one constellation, against all in view.

Leaving out measurement i of a fit y = H x + v with the weights 1/sd² replaces it by its prediction::

    x - x_(i) = g_i r_i / S_ii,    P_(i) - P = g_i g_i' sd_i² / S_ii

with g_i the column of the gain, r_i the residual and S_ii the redundancy of i. The difference of two least-squares
solutions of nested sets has the covariance P_(i) - P exactly, so that the separation of one satellite is its w²; a
constellation is left out by a fit of the others at the same point of linearisation.

References
----------
J. Blanch et al., "Baseline advanced RAIM user algorithm and possible improvements", IEEE Transactions on Aerospace and
Electronic Systems 51(1), 2015: solution separation.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..detection import MIN_REDUNDANCY, Fit, weighted_fit
from ..measurements import FloatArray, SatelliteId
from .solution import PositionFit, doppler_fit, fit_position

# [m] Difference d up to which one linearisation serves both positions: d²/2ρ is 25 mm at the distance ρ = 2e7 m of a
# satellite. Beyond, the rest of the satellites are solved by iteration.
LINEAR_M = 1000.0
RANK = 1e-6  # [-] of the largest eigenvalue, below which a covariance of a difference has no extent


@dataclass(frozen=True)
class SubsetSolution:
    """A solution without some satellites; NED axes and zero are those of the fit of all in view."""

    satellites: tuple[SatelliteId, ...]
    apart_n: FloatArray  # [m] shape (3,), position of all in view minus this one
    cov_n: FloatArray  # [m²] shape (3, 3), of this position
    velocity_n: FloatArray  # [m/s] shape (3,)
    separation: float | None  # of the horizontal difference against its covariance; None where that has no extent
    separation_dof: int
    innovations: float | None  # [-] residual chi-square over its degrees of freedom; None without redundancy


def solutions_without(position: PositionFit, false_alarm_rate: float) -> tuple[SubsetSolution, ...]:
    """Solve without each satellite and without each constellation.

    Parameters
    ----------
    position : PositionFit
        All in view, suspected satellites included.
    false_alarm_rate : float
        [-] Of the test of the Doppler, by which a wrong one is left out of all velocities.

    Returns
    -------
    tuple of LeftOut
        Those that are determined: empty where too few range-rates give no velocity.
    """
    found = doppler_fit(position, false_alarm_rate)
    if found is None:
        return ()
    velocity, rows = found
    linear = (*_without_each(position, velocity, rows), *_without_constellations(position, velocity, rows))
    return tuple(exact for left_out in linear if (exact := _exact(position, left_out)) is not None)


def _exact(position: PositionFit, one: SubsetSolution) -> SubsetSolution | None:
    """Solve by iteration where the linearisation of all in view is too far away; None where that does not converge."""
    if float(np.linalg.norm(one.apart_n)) <= LINEAR_M:
        return one
    geometry = position.geometry
    all_in_view_e = geometry.position_e + geometry.ned_from_ecef.T @ position.fit.parameters[:3]
    sights = tuple(sight for sight in position.sky.sights if sight.satellite not in one.satellites)
    start_e = all_in_view_e - geometry.ned_from_ecef.T @ one.apart_n
    found = fit_position(replace(position.sky, sights=sights), start_e)
    if found is None:
        return None
    turn = geometry.ned_from_ecef @ found.geometry.ned_from_ecef.T
    position_e = found.geometry.position_e + found.geometry.ned_from_ecef.T @ found.fit.parameters[:3]
    return replace(
        one,
        apart_n=geometry.ned_from_ecef @ (all_in_view_e - position_e),
        cov_n=turn @ found.fit.cov[:3, :3] @ turn.T,
        innovations=found.fit.statistic / found.fit.dof if found.fit.dof > 0 else None,
    )


def _without_each(position: PositionFit, velocity: Fit, rows: tuple[int, ...]) -> Iterator[SubsetSolution]:
    fit = position.fit
    for row, satellite in enumerate(position.satellites):
        redundancy = float(fit.redundancy[row])
        velocity_n = _velocity_without(velocity, rows, row)
        if redundancy <= MIN_REDUNDANCY or velocity_n is None:
            continue
        gain, residual, sd = fit.gain[:3, row], float(fit.residuals[row]), float(fit.sd[row])
        w2 = residual**2 / (sd**2 * redundancy)
        yield SubsetSolution(
            (satellite,),
            gain * (residual / redundancy),
            fit.cov[:3, :3] + np.outer(gain, gain) * (sd**2 / redundancy),
            velocity_n,
            w2 if float(gain[:2] @ gain[:2]) > 0.0 else None,
            1,
            max(fit.statistic - w2, 0.0) / (fit.dof - 1) if fit.dof > 1 else None,
        )


def _velocity_without(velocity: Fit, rows: tuple[int, ...], row: int) -> FloatArray | None:
    """Velocity without the Doppler of a row of the position; None where the others do not determine it."""
    all_of_it: FloatArray = velocity.parameters[:3]
    if row not in rows:
        return all_of_it
    k = rows.index(row)
    if velocity.redundancy[k] <= MIN_REDUNDANCY:
        return None
    without: FloatArray = all_of_it - velocity.gain[:3, k] * (velocity.residuals[k] / velocity.redundancy[k])
    return without


def _without_constellations(position: PositionFit, velocity: Fit, rows: tuple[int, ...]) -> Iterator[SubsetSolution]:
    systems = [satellite.constellation for satellite in position.satellites]
    for system, column in position.clocks.items() if len(position.clocks) > 1 else ():
        kept = [row for row, name in enumerate(systems) if name != system]
        fit, velocity_n = _refit(position, kept, 3 + column), _refit_velocity(velocity, rows, kept)
        if fit is None or velocity_n is None:
            continue
        apart_n = position.fit.parameters[:3] - fit.parameters[:3]
        separation, dof = _separation(apart_n[:2], fit.cov[:2, :2] - position.fit.cov[:2, :2])
        yield SubsetSolution(
            tuple(satellite for satellite in position.satellites if satellite.constellation == system),
            apart_n,
            fit.cov[:3, :3],
            velocity_n,
            separation,
            dof,
            fit.statistic / fit.dof if fit.dof > 0 else None,
        )


def _refit(position: PositionFit, kept: list[int], clock: int) -> Fit | None:
    """Fit some rows of a position without the column of a clock that they do not have."""
    y = position.fit.residuals + position.H @ position.fit.parameters
    return weighted_fit(np.delete(position.H[kept], clock, axis=1), y[kept], position.fit.sd[kept])


def _refit_velocity(velocity: Fit, rows: tuple[int, ...], kept: list[int]) -> FloatArray | None:
    """Velocity without the Doppler of other rows than these: the block form of the equation of one row."""
    out = [k for k, row in enumerate(rows) if row not in kept]
    if not out:
        all_of_it: FloatArray = velocity.parameters[:3]
        return all_of_it
    # Residuals over sd, and S of these rows: replacing measurements by their predictions without them.
    S = np.eye(len(out)) - velocity.hat[np.ix_(out, out)]
    if np.linalg.eigvalsh(S)[0] <= MIN_REDUNDANCY:
        return None
    weighted = velocity.gain[:3, out] * velocity.sd[out]
    without: FloatArray = velocity.parameters[:3] - weighted @ np.linalg.solve(
        S, velocity.residuals[out] / velocity.sd[out]
    )
    return without


def _separation(apart: FloatArray, cov: FloatArray) -> tuple[float | None, int]:
    """Chi-square of a difference over the directions in which its covariance has an extent, and how many they are."""
    variances, axes = np.linalg.eigh(cov)
    real = variances > RANK * max(float(variances[-1]), 0.0)
    if variances[-1] <= 0.0:
        return None, 0
    along = axes[:, real].T @ apart
    return float((along**2 / variances[real]).sum()), int(real.sum())

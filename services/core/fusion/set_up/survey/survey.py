"""Everything that a drive shows of an installation: first coarsely at any angle, then by least squares over arcs."""

from dataclasses import dataclass

import numpy as np

from ...settings import Settings
from ..axes import AxesFit, fit_axes, forward_of, mounting_of
from ..delay import lag_of, lag_of_positions
from ..motion import Motion, Velocities, intervals_of
from ..regression import FloatArray
from .adjust import Adjusted, adjust
from .arcs import begins_of, increments_of, starts_of
from .rows import Unknowns

MIN_VELOCITIES = 20


@dataclass(frozen=True)
class Survey:
    """What a drive has shown; None of what it has not.

    Attributes
    ----------
    fit : AxesFit or None
        Gravity and axes, coarsely.
    lag : tuple of float or None
        [s] Delay and its standard deviation, coarsely.
    adjusted : Adjusted or None
        Over arcs; its axes are those after `coarse`.
    coarse : ndarray, shape (3, 3)
        Columns are the vehicle's axes in the published ones, by `fit`.
    """

    fit: AxesFit | None
    lag: tuple[float, float] | None
    adjusted: Adjusted | None
    coarse: FloatArray

    @property
    def matrix(self) -> FloatArray | None:
        """Columns are the vehicle's axes in the published ones, shape (3, 3); None while forward is not known."""
        return None if self.adjusted is None else self.coarse @ self.adjusted.of.matrix


def survey(motion: Motion, settings: Settings) -> Survey:
    """Survey an installation by a whole drive.

    Parameters
    ----------
    motion : Motion
        Of the drive, in published axes, with stamps and speeds by the settings.
    settings : Settings
        With which the motion was recorded.
    """
    velocities = motion.of_receiver() if len(motion.velocities) >= MIN_VELOCITIES else motion.of_positions()
    found = lag_of(motion, velocities) if len(velocities.begin) >= MIN_VELOCITIES else None
    if found is None and len(motion.positions) >= MIN_VELOCITIES:
        found = lag_of_positions(motion)
    lag = None if found is None else found[:2]
    lag_s = 0.0 if lag is None else lag[0]
    intervals = intervals_of(motion, velocities, lag_s) if len(velocities.begin) >= MIN_VELOCITIES else None
    fit = fit_axes(motion, intervals, settings.vehicle.imu.body_from_sensor)
    if fit is None or fit.columns is None or forward_of(fit) is None:
        return Survey(fit, lag, None, np.eye(3))
    coarse = mounting_of(fit.columns)
    return Survey(fit, lag, _adjusted(motion, settings, velocities, fit, coarse, lag_s), coarse)


def _adjusted(
    motion: Motion, settings: Settings, velocities: Velocities, fit: AxesFit, coarse: FloatArray, lag_s: float
) -> Adjusted | None:
    begins = begins_of(motion, velocities)
    if not len(begins):
        return None
    arcs = increments_of(motion, begins).turned(coarse)
    bias = np.zeros(3) if fit.bias is None else coarse.T @ fit.bias
    first = Unknowns(
        rate_bias=bias, arm=np.array(settings.vehicle.gnss.lever_arm_body_m), delay_s=lag_s,
        axle=np.array((settings.vehicle.rear_axle_body_m or (0.0, 0.0, 0.0))[:2]),
    )  # fmt: skip
    moved = velocities._replace(begin=velocities.begin - lag_s, end=velocities.end - lag_s)
    return adjust(motion, arcs, starts_of(arcs, motion, moved, bias), first)

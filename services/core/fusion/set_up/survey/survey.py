"""Everything that a drive shows of an installation: first coarsely at any angle, then by least squares over arcs."""

from dataclasses import dataclass

import numpy as np

from ...settings import Settings
from ..axes import COLUMN_SD, GAIN, AxesFit, fit_axes, forward_of, mounting_of
from ..delay import lag_of, lag_of_positions
from ..motion import Intervals, Motion, Velocities, intervals_of
from ..regression import FloatArray, least_squares
from .adjust import Adjusted, adjust
from .arcs import arcs_of, starts_of
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
    coarse = None if fit is None or intervals is None else _coarse(fit, intervals)
    if coarse is None or fit is None or intervals is None:
        return Survey(fit, lag, None, np.eye(3))
    bias = _bias(fit, intervals) if fit.bias is None else fit.bias
    return Survey(fit, lag, _adjusted(motion, settings, velocities, coarse.T @ bias, coarse, lag_s), coarse)


def _coarse(fit: AxesFit, intervals: Intervals) -> FloatArray | None:
    """Axes of the vehicle in the published ones, as columns; None while forward is not known.

    A drive without bends shows what is down and what is forward; axes that are mirrored would need a bend.
    """
    if fit.columns is not None and forward_of(fit) is not None:
        return mounting_of(fit.columns)
    a = intervals.acceleration
    ahead = least_squares(np.column_stack([a, np.ones_like(a)]), intervals.force) if len(a) >= MIN_VELOCITIES else None
    if ahead is None:
        return None
    forward = ahead.coefficients[0] - (ahead.coefficients[0] @ fit.down) * fit.down
    size = float(np.linalg.norm(forward))
    if not GAIN[0] < size < GAIN[1] or float(ahead.sd[0].max()) > COLUMN_SD * size:
        return None
    forward /= size
    return np.column_stack([forward, np.cross(fit.down, forward), fit.down])


def _bias(fit: AxesFit, intervals: Intervals) -> FloatArray:
    """Of the gyroscopes [rad/s, published axes]: their mean without that of the course."""
    known = np.isfinite(intervals.course_rate)
    found: FloatArray = (intervals.rate[known] - intervals.course_rate[known, np.newaxis] * fit.down).mean(axis=0)
    return found


def _adjusted(
    motion: Motion, settings: Settings, velocities: Velocities, bias: FloatArray, coarse: FloatArray, lag_s: float
) -> Adjusted | None:
    arcs = arcs_of(motion, velocities)
    if arcs is None:
        return None
    arcs = arcs.turned(coarse)
    first = Unknowns(
        rate_bias=bias, arm=np.array(settings.vehicle.gnss.lever_arm_body_m), delay_s=lag_s,
        axle=np.array((settings.vehicle.rear_axle_body_m or (0.0, 0.0, 0.0))[:2]),
    )  # fmt: skip
    moved = velocities._replace(begin=velocities.begin - lag_s, end=velocities.end - lag_s)
    return adjust(motion, arcs, starts_of(arcs, motion, moved, bias), first)

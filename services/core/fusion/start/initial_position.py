"""Initial position and time-correlated GNSS error, with their joint covariance, from the first fixes."""

from collections.abc import Sequence
from math import sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shared.maths.earth import Geodetic, geodetic_from_ned_difference, ned_from_geodetic_difference

from ..aids.gnss.correlated import PositionErrors
from ..aids.gnss.fix import GnssPosition
from ..aids.gnss.position_errors import mean_at_rest

FloatArray = npt.NDArray[np.float64]

UNKNOWN_HEIGHT_SD = 100.0  # [m]
CARRIER_CORRELATION_S = 5.0  # correlation time of the errors of carrier-phase positions
MIN_VARIANCE_SHARE = 1e-6  # [-] smallest variance of the time-correlated error: with zero it would not be estimated
NO_DRIFT = np.zeros(3)  # [m²/s²] velocity variances at standstill


class FirstPlace(NamedTuple):
    """Position of the antenna, and time-correlated GNSS error over its standard deviation, with their covariance."""

    position: Geodetic
    cov: FloatArray  # shape (3, 3) [m², NED]
    error: tuple[float, ...]
    error_cov: FloatArray  # shape (3, 3)
    cross_cov: FloatArray  # shape (3, 3) [m] of position and error
    gnss_errors: PositionErrors


def first_place(fixes: Sequence[GnssPosition], gnss_errors: PositionErrors, zero_ns: int | None = None) -> FirstPlace:
    """Weighted mean of fixes at standstill, newest last.

    A time-correlated error is common to all of them: the mean of many is hardly better than one fix, and the errors of
    position and time-correlated error are correlated.

    Parameters
    ----------
    fixes : sequence of GnssPosition
        Of one receiver mode; the last one is the time of the result.
    gnss_errors : PositionErrors
        Statistics of their errors before the first of them.
    zero_ns : int, optional
        Stamp at which the time-correlated error is zero.
    """
    newest = fixes[-1]
    cov = newest.cov + np.diag([0.0, 0.0, 0.0 if newest.axes == 3 else UNKNOWN_HEIGHT_SD**2])
    offsets = np.array([ned_from_geodetic_difference(fix.position, newest.position) for fix in fixes])
    times_s = np.array([(fix.time_ns - newest.time_ns) * 1e-9 for fix in fixes])
    if not newest.time_correlated:
        independent = min(float(len(fixes)), 1.0 - times_s[0] / CARRIER_CORRELATION_S)
        place, zeros = _moved(newest.position, offsets.mean(axis=0)), np.zeros((3, 3))
        return FirstPlace(place, cov / independent, (0.0,) * 3, np.eye(3), zeros, gnss_errors.at_start())
    for fix, offset in zip(fixes, offsets, strict=True):
        gnss_errors = gnss_errors.after(fix.time_ns, offset, np.sqrt(fix.cov.diagonal()), NO_DRIFT)
    correlated_share, scaled = max(gnss_errors.correlated_share, 1e-6), gnss_errors.scaled(newest.cov)
    zero_s = None if zero_ns is None else (zero_ns - newest.time_ns) * 1e-9
    weights, joint = mean_at_rest(times_s, correlated_share, gnss_errors.correlation_s, zero_s)
    root = np.linalg.cholesky(scaled)
    place, error = weights @ offsets
    in_sds = np.linalg.solve(root, error) / sqrt(correlated_share)
    return FirstPlace(
        _moved(newest.position, place),
        joint[0, 0] * scaled + cov - newest.cov,
        tuple(in_sds.tolist()),
        max(joint[1, 1] / correlated_share, MIN_VARIANCE_SHARE) * np.eye(3),
        joint[0, 1] / sqrt(correlated_share) * root,
        gnss_errors.at_start(),
    )


def _moved(position: Geodetic, offset: FloatArray) -> Geodetic:
    north, east, down = offset.tolist()
    return geodetic_from_ned_difference((north, east, down), position)

"""Where a filter begins: the place that the first fixes give, and what their lasting error leaves unknown of it."""

from collections.abc import Sequence
from math import sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shared.maths.earth import Geodetic, geodetic_from_ned_difference, ned_from_geodetic_difference

from ..measurements.gnss import GnssPosition
from ..measurements.gnss_error_model import GnssErrorBank, KnownGnssErrors, mean_at_rest

FloatArray = npt.NDArray[np.float64]

UNKNOWN_HEIGHT_SD = 100.0  # [m]
REST_CORRELATION_S = 5.0  # errors of a carrier phase that are closer than this are taken for one
LEAST = 1e-6  # [-] variance of the lasting error: with none it would not be estimated
NOWHERE = np.zeros(3)


class FirstPlace(NamedTuple):
    """Position of the antenna and lasting error of GNSS over its standard deviation, and how well they are known."""

    position: Geodetic
    cov: FloatArray  # shape (3, 3) [m², NED]
    error: tuple[float, ...]
    error_cov: FloatArray  # shape (3, 3)
    both: FloatArray  # shape (3, 3) [m] covariance of position and error
    gnss_errors: GnssErrorBank | KnownGnssErrors


def first_place(
    rest: Sequence[GnssPosition], gnss_errors: GnssErrorBank | KnownGnssErrors, zero_ns: int | None = None
) -> FirstPlace:
    """Weigh the fixes of a rest, newest last, by what they show of the run of their errors.

    An error that lasts is in all of them: the mean of many is hardly better than one, and the filter must know that
    position and lasting error are wrong together.
    """
    newest = rest[-1]
    cov = newest.cov + np.diag([0.0, 0.0, 0.0 if newest.axes == 3 else UNKNOWN_HEIGHT_SD**2])
    offsets = np.array([ned_from_geodetic_difference(fix.position, newest.position) for fix in rest])
    times_s = np.array([(fix.time_ns - newest.time_ns) * 1e-9 for fix in rest])
    if not newest.lasts:
        independent = min(float(len(rest)), 1.0 - times_s[0] / REST_CORRELATION_S)
        place, zeros = _moved(newest.position, offsets.mean(axis=0)), np.zeros((3, 3))
        return FirstPlace(place, cov / independent, (0.0,) * 3, np.eye(3), zeros, gnss_errors.at_start())
    for fix, offset in zip(rest, offsets, strict=True):
        gnss_errors = gnss_errors.after(fix.time_ns, offset, np.sqrt(fix.cov.diagonal()), NOWHERE)
    lasting, scaled = max(gnss_errors.lasting, 1e-6), gnss_errors.scaled(newest.cov)
    zero_s = None if zero_ns is None else (zero_ns - newest.time_ns) * 1e-9
    weights, joint = mean_at_rest(times_s, lasting, gnss_errors.correlation_s, zero_s)
    root = np.linalg.cholesky(scaled)
    place, error = weights @ offsets
    in_sds = np.linalg.solve(root, error) / sqrt(lasting)
    return FirstPlace(
        _moved(newest.position, place),
        joint[0, 0] * scaled + cov - newest.cov,
        tuple(in_sds.tolist()),
        max(joint[1, 1] / lasting, LEAST) * np.eye(3),
        joint[0, 1] / sqrt(lasting) * root,
        gnss_errors.at_start(),
    )


def _moved(position: Geodetic, offset: FloatArray) -> Geodetic:
    north, east, down = offset.tolist()
    return geodetic_from_ned_difference((north, east, down), position)

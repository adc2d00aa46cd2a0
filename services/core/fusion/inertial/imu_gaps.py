"""Inflates the covariance for gaps in the IMU samples, and for suspect samples."""

from math import sqrt

import numpy as np

from . import error_model as em
from .filter import ErrorStateFilter

# A step longer than `propagation.GAP_S` is a gap: the state is propagated over it, and the covariance is inflated.
MAX_BRIDGED_S = 1.0  # a longer gap interrupts the solution
FORCE_SD = 2.0  # [m/s²] unmeasured acceleration of a car in a gap
RATE_SD = 0.3  # [rad/s] unmeasured rate
SUSPECT_PERIOD_S = 0.1  # between two inflations for suspect samples
SUSPECT_CORRELATION_S = 1.0  # correlation time of the errors of suspect samples


def inflate_for_gap(navigation: ErrorStateFilter, span_s: float) -> None:
    """Inflate the covariance for a time [s] without samples."""
    force_sd, rate_sd = FORCE_SD * span_s, RATE_SD * span_s
    navigation.inflate(attitude_sd=rate_sd, velocity_sd=force_sd, position_sd=0.5 * force_sd * span_s)


def inflate_for_lost_time(navigation: ErrorStateFilter, span_s: float) -> None:
    """Inflate the covariance as for a gap, and the position by the distance driven in that time [s]."""
    inflate_for_gap(navigation, span_s)
    navigation.inflate_along(em.POSITION, np.multiply(navigation.velocity, span_s))


def inflate_for_suspect_samples(navigation: ErrorStateFilter, span_s: float) -> None:
    """Inflate the covariance for suspect samples over a time [s]: errors as in a gap, correlated over a second."""
    root = sqrt(span_s * SUSPECT_CORRELATION_S)
    navigation.inflate(attitude_sd=RATE_SD * root, velocity_sd=FORCE_SD * root)

"""Inflates the covariance for time without IMU samples, or with suspect ones."""

from dataclasses import dataclass
from math import sqrt

import numpy as np

from ..filter import error_model as em
from ..filter.eskf import ErrorStateFilter
from ..measurements.base import FilterEvent

FORCE_SD = 2.0  # [m/s²] acceleration and rate of a car that are possible in a gap
RATE_SD = 0.3  # [rad/s]
SUSPECT_PERIOD_S = 0.1  # between two inflations for suspect samples
SUSPECT_CORRELATION_S = 1.0


def inflate_for_gap(navigation: ErrorStateFilter, span_s: float) -> None:
    """Inflate the covariance for a time without samples."""
    force_sd, rate_sd = FORCE_SD * span_s, RATE_SD * span_s
    navigation.inflate(attitude_sd=rate_sd, velocity_sd=force_sd, position_sd=0.5 * force_sd * span_s)


@dataclass(frozen=True)
class LostTime(FilterEvent):
    """Time [s] before this instant of which samples were rejected."""

    span_s: float

    def apply(self, navigation: ErrorStateFilter) -> None:
        """Inflate the covariance as for a gap, and the position by the distance that was not propagated."""
        inflate_for_gap(navigation, self.span_s)
        navigation.inflate_along(em.POSITION, np.multiply(navigation.velocity, self.span_s))


def inflate_for_suspect_samples(navigation: ErrorStateFilter, span_s: float) -> None:
    """Inflate the covariance for suspect samples: their errors are those of a gap, correlated over a second."""
    grown = sqrt(span_s * SUSPECT_CORRELATION_S)
    navigation.inflate(attitude_sd=RATE_SD * grown, velocity_sd=FORCE_SD * grown)

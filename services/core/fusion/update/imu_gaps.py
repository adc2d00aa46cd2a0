"""What is admitted of a time of which inertial samples tell nothing, or nothing that can be believed."""

from dataclasses import dataclass
from math import sqrt

import numpy as np

from ..filter import error_model as em
from ..filter.eskf import ErrorStateFilter
from ..measurements.base import News

FORCE_SD = 2.0  # [m/s²] what a car may do while nobody looks
RATE_SD = 0.3  # [rad/s]
DOUBT_PERIOD_S = 0.1  # between two times that the filter is told of doubtful samples
DOUBT_CORRELATION_S = 1.0


def admit_gap(navigation: ErrorStateFilter, span_s: float) -> None:
    """Widen the filter for a time without samples."""
    force_sd, rate_sd = FORCE_SD * span_s, RATE_SD * span_s
    navigation.widen(attitude_sd=rate_sd, velocity_sd=force_sd, position_sd=0.5 * force_sd * span_s)


@dataclass(frozen=True)
class LostTime(News):
    """Before this instant samples were refused that told of so much time."""

    span_s: float

    def tell(self, navigation: ErrorStateFilter) -> None:
        """Admit it as a gap, and besides the way, on which nobody has carried the filter."""
        admit_gap(navigation, self.span_s)
        navigation.widen_along(em.POSITION, np.multiply(navigation.velocity, self.span_s))


def admit_doubt(navigation: ErrorStateFilter, span_s: float) -> None:
    """Widen the filter for doubtful samples, which are no better than a guess: errors that last about a second."""
    grown = sqrt(span_s * DOUBT_CORRELATION_S)
    navigation.widen(attitude_sd=RATE_SD * grown, velocity_sd=FORCE_SD * grown)

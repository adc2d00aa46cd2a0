"""The six metrics: differences of means of a quantity by GNSS and by inertial sensors over a window of 5 s."""

from enum import StrEnum

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

WINDOW_S = 5.0
CONSECUTIVE = 2  # evaluations above the threshold that make an alarm


class Metric(StrEnum):
    """Quantity that is compared."""

    HEADING_RATE = "heading_rate"
    ACCELERATION_EAST = "acceleration_east"
    ACCELERATION_NORTH = "acceleration_north"
    ACCELERATION_UP = "acceleration_up"
    ACCELERATION = "acceleration"  # magnitude
    ALTITUDE_RATE = "altitude_rate"


UNITS = dict.fromkeys(Metric, "m/s2") | {Metric.HEADING_RATE: "rad/s", Metric.ALTITUDE_RATE: "m/s"}


def acceleration_differences(gnss: FloatArray, inertial: FloatArray) -> dict[Metric, float]:
    """Differences of two mean accelerations over the same interval.

    Parameters
    ----------
    gnss, inertial : ndarray, shape (3,)
        [m/s², NED] Means over a window.

    Returns
    -------
    dict
        [m/s²] GNSS minus inertial: east, north, up, and the difference of the magnitudes of the two means. The
        magnitude of a mean over 5 s has little of the bias that the magnitude of a noisy sample has.
    """
    north, east, down = (gnss - inertial).tolist()
    return {
        Metric.ACCELERATION_EAST: east,
        Metric.ACCELERATION_NORTH: north,
        Metric.ACCELERATION_UP: -down,
        Metric.ACCELERATION: float(np.linalg.norm(gnss) - np.linalg.norm(inertial)),
    }


def consecutive(exceeded: npt.NDArray[np.bool_], count: int = CONSECUTIVE) -> npt.NDArray[np.bool_]:
    """Where a condition holds for the given number of evaluations in a row, shape (n,)."""
    alarm = exceeded.copy()
    for shift in range(1, count):
        alarm[shift:] &= exceeded[:-shift]
        alarm[:shift] = False
    return alarm

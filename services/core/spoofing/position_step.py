"""Positions of GNSS against the integral of its own velocity over 5 s.

The other tests compare velocities with inertial sensors. A position that steps aside while the velocity stays that of
the vehicle passes them all.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, hypot

import numpy as np

from shared.maths.earth import ned_from_geodetic_difference

from .metrics import WINDOW_S
from .strapdown import SECOND_NS
from .tracks import VelocityFix

NAME, UNIT = "position_step", "m"
THRESHOLD = 5.0  # standard deviations
FALSE_ALARM_RATE = exp(-0.5 * THRESHOLD**2)  # of a horizontal difference with the same variance on both axes
LEAST_SD_M = 2.0  # reflections differ between the ends of a window, whatever the receiver states
UNKNOWN_SD_M = 5.0  # of a receiver that states no standard deviation
DELAY_SD_S = 0.2  # between the ages of position and velocity


@dataclass(frozen=True)
class PositionStep:
    """Horizontal difference over one window, and its limit [m]."""

    start_ns: int
    size: float
    limit: float


def position_step(fixes: Sequence[VelocityFix]) -> PositionStep | None:
    """Compare the change of position over a window with the integral of velocity.

    Parameters
    ----------
    fixes : sequence of VelocityFix
        Of `window_of_fixes`.

    Returns
    -------
    PositionStep or None
        None where the first or the last fix has no position.

    Notes
    -----
    With p_0 and p_k the positions at the ends, W the length, s_p and s_v the stated standard deviations (the larger of
    north and east) and s_t that of the difference between the ages of position and velocity::

        d = p_k - p_0 - integral of v,    s² = s_0² + s_p0² + s_pk² + (W s_v)² + (s_t |v_k - v_0|)²
    """
    first, last = fixes[0], fixes[-1]
    if first.position is None or last.position is None:
        return None
    north, east, _ = ned_from_geodetic_difference(last.position, first.position)
    times = np.array([fix.time_ns - first.time_ns for fix in fixes]) / SECOND_NS
    moved = np.trapezoid([fix.velocity_n[:2] for fix in fixes], times, axis=0)
    change = last.velocity_n[:2] - first.velocity_n[:2]
    speed_sd = max(float(fix.sd[:2].max()) for fix in fixes)
    parts = LEAST_SD_M, first.position_sd, last.position_sd, WINDOW_S * speed_sd, DELAY_SD_S * hypot(*change)
    return PositionStep(first.time_ns, hypot(north - moved[0], east - moved[1]), THRESHOLD * hypot(*parts))

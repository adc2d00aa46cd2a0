"""Positions of GNSS against the integral of its own velocity over 5 s.

The other tests compare velocities with inertial sensors. A position that steps aside while the velocity stays that of
the vehicle passes them all.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, hypot

import numpy as np

from shared.inertial.increments import SECOND_NS
from shared.maths.earth import ned_from_geodetic_difference

from ..inertial.tracks import VelocityFix
from .metrics import WINDOW_S

NAME, UNIT = "position_step", "m"
THRESHOLD = 5.0  # standard deviations
FALSE_ALARM_RATE = exp(-0.5 * THRESHOLD**2)  # of a horizontal difference with the same variance on both axes
MIN_SD_M = 2.0  # reflections differ between the ends of a window, whatever the receiver states
DEFAULT_SD_M = 5.0  # of a receiver that states no standard deviation
DELAY_SD_S = 0.2  # between the ages of position and velocity


@dataclass(frozen=True)
class PositionStep:
    """Horizontal difference over one window, and its limit [m]."""

    size: float
    limit: float
    suspect_ns: int  # newest fix before it


def position_step(fixes: Sequence[VelocityFix]) -> PositionStep | None:
    """Compare the change of position over a window with the integral of velocity.

    Parameters
    ----------
    fixes : sequence of VelocityFix
        Of `window_of_fixes`.

    Returns
    -------
    PositionStep or None
        None where a fix has no position. It is suspect since the fix before the largest step if that is half of the
        difference, since the start of the window otherwise.

    Notes
    -----
    With p_0 and p_k the positions at the ends, W the length, s_p and s_v the stated standard deviations (the larger of
    north and east) and s_t that of the difference between the ages of position and velocity::

        d = p_k - p_0 - integral of v,    s² = s_0² + s_p0² + s_pk² + (W s_v)² + (s_t |v_k - v_0|)²
    """
    first, last = fixes[0], fixes[-1]
    origin = first.position
    places = [fix.position for fix in fixes if fix.position is not None]
    if origin is None or len(places) < len(fixes):
        return None
    moved = np.diff([ned_from_geodetic_difference(place, origin)[:2] for place in places], axis=0)
    velocity = np.array([fix.velocity_n[:2] for fix in fixes])
    step_s = np.diff([fix.time_ns - first.time_ns for fix in fixes]) / SECOND_NS
    steps = moved - 0.5 * (velocity[1:] + velocity[:-1]) * step_s[:, None]
    sizes, size = np.hypot(*steps.T), float(np.hypot(*steps.sum(axis=0)))
    largest = int(sizes.argmax())
    suspect = fixes[largest] if sizes[largest] > 0.5 * size else first
    speed_sd = max(float(fix.sd[:2].max()) for fix in fixes)
    age_sd = DELAY_SD_S * float(np.hypot(*(velocity[-1] - velocity[0])))
    sd = hypot(MIN_SD_M, first.position_sd, last.position_sd, WINDOW_S * speed_sd, age_sd)
    return PositionStep(size, THRESHOLD * sd, suspect.time_ns)

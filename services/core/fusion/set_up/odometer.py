"""Scale of the odometer, by the speed of GNSS."""

import numpy as np

from shared.messages.explanation import explain

from ..codes import Code
from .findings import Check, Verdict
from .motion import Motion, Velocities
from .regression import least_squares

HIGH_SPEED_M_S = 4.0
MIN_INTERVALS = 30
SCALE_LIMIT = 0.1
SCALE_SD = 0.02


def check_odometer_scale(motion: Motion, velocities: Velocities, present: float) -> Check:
    """Compare the speed of the odometer with that of GNSS; `present` is the scale of the settings."""
    name = "odometer_scale"
    time, speed = motion.speeds.T
    if len(time) < 2 or len(velocities.begin) < MIN_INTERVALS:
        return Check(name)
    middle = 0.5 * (velocities.begin + velocities.end)
    near = np.searchsorted(time, middle).clip(1, len(time) - 1)
    fresh = (time[near] - time[near - 1] < 1.5) & (middle >= time[0]) & (middle <= time[-1])
    gnss = np.hypot(velocities.ned[:, 0], velocities.ned[:, 1])
    fit_for = fresh & (gnss > HIGH_SPEED_M_S)
    if fit_for.sum() < MIN_INTERVALS:
        return Check(name)
    wheel = np.interp(middle, time, speed)[fit_for]
    fit = least_squares(gnss[fit_for, np.newaxis], np.abs(wheel)[:, np.newaxis])
    if fit is None or float(fit.sd[0, 0]) > SCALE_SD:
        return Check(name)
    ratio, sd = float(fit.coefficients[0, 0]), float(fit.sd[0, 0])
    values = ratio, sd, 1.0, SCALE_LIMIT
    why = explain(Code.ODOMETER_SCALE, ratio=ratio, sd_ratio=sd)
    if abs(ratio - 1.0) < SCALE_LIMIT:
        return Check(name, Verdict.AGREES, why, *values)
    if abs(ratio - 1.0) < SCALE_LIMIT + 2.0 * sd:
        return Check(name)
    setting = (
        f"core.fusion.odometer.scale = {present / ratio:.3f}"
        if ratio > 0.05
        else "core.fusion.odometer.enabled = false"
    )
    return Check(name, Verdict.CONTRADICTS, why, *values, "-", setting)

"""What every inertial sample does to the filter, in plain floats: see `strapdown` for why.

The sample, corrected for what is known of the IMU's errors, carries the motion on; what the covariance needs to know
of the time since its last step is summed up; and the vibration is measured.
"""

from shared.maths.rotation import Vector

from .strapdown import Motion, mechanise

SHAKE_S = 1.0  # time constant of the measured vibration
SWAY_S = 0.1  # of the acceleration that is smoothed
FORCE_LIMIT = 1000.0  # [m/s²] no sensor of a car measures so much
RATE_LIMIT = 100.0  # [rad/s]

Errors = tuple[Vector, Vector, Vector, Vector]  # biases [m/s², rad/s] and scales [-] of accelerometer and gyroscope
Sums = tuple[float, float, float, float, float, float, float]
Shaking = tuple[float, float, float, float, float]
STEADY: Shaking = (0.0, 0.0, 0.0, 0.0, 0.0)
NO_SUMS: Sums = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def take_sample(
    motion: Motion,
    sums: Sums,
    shaking: Shaking,
    errors: Errors,
    sample: tuple[Vector, Vector],
    last: tuple[Vector, Vector],
    step: float,
) -> tuple[Motion, Sums, Shaking, Vector, Vector]:
    """Carry everything that goes on between two steps of the covariance over one sample.

    Parameters
    ----------
    motion : tuple
        As of `strapdown.mechanise`.
    sums : tuple of float
        Over the time since the last step of the covariance: the time [s], the specific force's impulse [m/s, NED], the
        turn [rad, body].
    shaking : tuple of float
        [m²/s³], [rad²/s] Power spectral density of what samples differ by from each other: force, rate.
        [m/s², NED] Acceleration without the fastest of it.
    errors : tuple
        What is known of the IMU's errors, in the order of the error model.
    sample, last : tuple
        [m/s², rad/s, body] Force and rate of this sample and of the one before, as measured.
    step : float
        [s] Length of the step.

    Returns
    -------
    tuple
        Motion, sums and shaking after the step; the rate [rad/s, body] without its errors; acceleration [m/s², NED].

    Notes
    -----
    White noise is measured by the difference of successive samples, whose variance is twice its own; the mean of three
    axes, smoothed over a second: S+ = S + t/T (t/6 |f - f_last|² - S).
    """
    (fx, fy, fz), (wx, wy, wz) = sample
    (lfx, lfy, lfz), (lwx, lwy, lwz) = last
    (bx, by, bz), (dx, dy, dz), (px, py, pz), (qx, qy, qz) = errors
    true_rate = wx - dx - qx * wx, wy - dy - qy * wy, wz - dz - qz * wz
    true_force = fx - bx - px * fx, fy - by - py * fy, fz - bz - pz * fz
    motion, (north, east, down), acceleration, (ax, ay, az) = mechanise(motion, true_force, true_rate, step)

    since, ix, iy, iz, tx, ty, tz = sums
    sums = since + step, ix + north * step, iy + east * step, iz + down * step, tx + ax, ty + ay, tz + az

    force_shake, rate_shake, an, ae, ad = shaking
    share, scale = step / SHAKE_S, step / 6.0
    share = min(share, 1.0)
    fx, fy, fz = fx - lfx, fy - lfy, fz - lfz
    wx, wy, wz = wx - lwx, wy - lwy, wz - lwz
    force_shake += share * (scale * (fx * fx + fy * fy + fz * fz) - force_shake)
    rate_shake += share * (scale * (wx * wx + wy * wy + wz * wz) - rate_shake)
    share = step / (SWAY_S + step)
    gn, ge, gd = acceleration
    an, ae, ad = an + share * (gn - an), ae + share * (ge - ae), ad + share * (gd - ad)
    return motion, sums, (force_shake, rate_shake, an, ae, ad), true_rate, acceleration


def credible(force: Vector, rate: Vector) -> bool:
    """Whether a sensor can have measured this; not if a reading is not a number."""
    fx, fy, fz = force
    wx, wy, wz = rate
    return fx * fx + fy * fy + fz * fz < FORCE_LIMIT**2 and wx * wx + wy * wy + wz * wz < RATE_LIMIT**2


def usual(force: Vector, rate: Vector, last_force: Vector, last_rate: Vector) -> bool:
    """Whether a sample is credible, and no reading is that of the last one: then there is nothing to doubt."""
    fx, fy, fz = force
    wx, wy, wz = rate
    lfx, lfy, lfz = last_force
    lwx, lwy, lwz = last_rate
    if fx == lfx or fy == lfy or fz == lfz or wx == lwx or wy == lwy or wz == lwz:
        return False
    return credible(force, rate)


def means(sums: Sums) -> tuple[Vector, Vector]:
    """Mean specific force [m/s², NED] and rate [rad/s, body] of the time that was summed up."""
    since, ix, iy, iz, tx, ty, tz = sums
    per_s = 1.0 / since
    return (ix * per_s, iy * per_s, iz * per_s), (tx * per_s, ty * per_s, tz * per_s)

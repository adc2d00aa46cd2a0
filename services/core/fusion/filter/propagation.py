"""Many ordinary samples in one go: a loop that Numba compiles where it is installed, and that runs without it as well.

A sample is ordinary if it follows the one before without a gap, and brings nothing to its turn but a step of the
covariance. Whatever is not, the loop leaves to the engine as if it had never looked at it, so that every decision has
one place.
"""

from collections.abc import Sequence
from math import exp, isfinite, pi

import numpy as np
import numpy.typing as npt

from shared.maths.kalman import correct
from shared.maths.rotation import Vector

from ..update.standstill_detector import QUIET_S, STILL, SURE, Rest, at_rest, doubt_of, length
from .error_model import ACCELEROMETER_SCALE, added_variances, error_rates, transition_matrix
from .imu_step import NO_SUMS, Errors, Shaking, Sums, means, take_sample
from .kalman import predict, variances
from .strapdown import Motion

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
Sample = tuple[Vector, Vector]
Stamps = IntArray | Sequence[int]
Rows = FloatArray | Sequence[Sequence[float]]
# What the engine counts beside the filter: what the detector of standstill knows; turn [rad, body] and time [s] of a
# standstill, and time [s] since the wheels were held against the filter, each since it was last made use of.
Beside = tuple[Rest, Vector, float, float]
# Motion, sums and vibration as of `sampling`; the last sample; rate and acceleration of the filter; the lasting error
# of GNSS; what is beside it.
Moment = tuple[Motion, Sums, Shaking, Sample, Vector, Vector, Vector, Beside]
# Period of the covariance [s], factor on the vibration, correlation time [s] of the lasting error; times [s] after
# a standstill and the wheels are due; speed [m/s] from which the odometer has a say in whether the vehicle stands.
Limits = tuple[float, float, float, float, float, float]
# What `run` goes on from, but for the samples: moment, covariance, errors, walks, limits.
Departure = tuple[Moment, FloatArray, Errors, FloatArray, Limits]

GAP_S = 0.05  # a longer step is a gap
FASTEST_M_S = 500.0
HIGHEST_LATITUDE = 0.4999 * pi  # the NED frame has no north at the pole; 2 km from it this filter ends
EARLY_S = 1e-9  # by which a step of the covariance may come too early, for the sums are rounded
NEVER = 1e99  # [s], [m/s] of limits


def run(
    moment: Moment, P: FloatArray, times_ns: Stamps, samples: Rows, errors: Errors, walks: FloatArray, limits: Limits
) -> tuple[int, Moment, FloatArray]:
    """Take samples as long as they are ordinary.

    Parameters
    ----------
    moment : tuple
        The filter between two samples.
    P : ndarray, shape (31, 31)
        Its covariance.
    times_ns : ndarray of int64, shape (n + 1,), or list
        Stamps; the first is that of the moment. A compiler wants arrays, Python is faster with lists.
    samples : ndarray, shape (n, 6), or list
        [m/s², rad/s, body] Specific force and angular rate of the times that end at the stamps.
    errors : tuple
        What is known of the IMU's errors, as of `sampling.take_sample`.
    walks : ndarray, shape (31,)
        [unit²/s] Noise that drives the errors, without vibration.
    limits : tuple of float
        See `Limits`.

    Returns
    -------
    int
        How many were taken.
    tuple
        The moment after them.
    ndarray, shape (31, 31)
        The covariance of then.
    """
    period, factor, memory, standstill_due, wheels_due, doubtful = limits
    motion, sums, shaking, last, rate, acceleration, lasting, (rest, turn, still, rolling) = moment
    taken = 0
    wheels_stand = doubtful < NEVER
    doubt = SURE if wheels_stand else doubt_of(P)
    for k in range(len(samples)):
        step = (times_ns[k + 1] - times_ns[k]) * 1e-9
        if not 0.0 < step <= GAP_S or rolling + step >= wheels_due:
            break
        s = samples[k]
        sample = (s[0], s[1], s[2]), (s[3], s[4], s[5])
        moved, summed, shaken, turning, gaining = take_sample(motion, sums, shaking, errors, sample, last, step)
        speed = length(moved[1])
        resting = at_rest(rest, turning, gaining, speed, step, doubt)
        if speed >= doubtful:
            break
        stilled = still + step if resting[2] >= QUIET_S and standstill_due < NEVER else 0.0
        if stilled >= standstill_due:
            break
        if summed[0] >= period - EARLY_S:
            remains = exp(-summed[0] / memory) if memory < NEVER else 1.0
            if not sound(moved):
                break
            grown, fine = grow(P, moved, summed, walks, shaken, factor, remains)
            if not fine:
                break
            P, summed = grown, NO_SUMS
            doubt = SURE if wheels_stand else doubt_of(P)
            if remains < 1.0:
                lasting = remains * lasting[0], remains * lasting[1], remains * lasting[2]
        motion, sums, shaking, last, rate, acceleration = moved, summed, shaken, sample, turning, gaining
        turn = (
            (turn[0] + rate[0] * step, turn[1] + rate[1] * step, turn[2] + rate[2] * step) if stilled > 0.0 else STILL
        )
        rest, still, rolling, taken = resting, stilled, rolling + step, k + 1
    return taken, (motion, sums, shaking, last, rate, acceleration, lasting, (rest, turn, still, rolling)), P


def grow(
    P: FloatArray, motion: Motion, sums: Sums, walks: FloatArray, shaking: Shaking, factor: float, remains: float
) -> tuple[FloatArray, bool]:
    """Carry the covariance over the time that was summed up, and say whether it is still one."""
    force_n, rate_b = means(sums)
    Phi = transition_matrix(error_rates(motion, force_n, rate_b), sums[0], remains)
    grown = predict(P, Phi, added_variances(walks, shaking, factor, sums[0], remains))
    total, least = variances(grown, ACCELEROMETER_SCALE.start)
    return grown, isfinite(total) and least > 0.0


class Arithmetic:
    """What is done to a covariance, as NumPy does it."""

    grow = staticmethod(grow)
    correct = staticmethod(correct)


PLAIN = Arithmetic()


def sound(motion: Motion) -> bool:
    """Whether the numbers of a motion have a meaning; `unsoundness` says why not."""
    quaternion, velocity, position, _ = motion
    total = quaternion[0] + velocity[0] + velocity[1] + velocity[2] + position[1] + position[2]
    return isfinite(total) and length(velocity) < FASTEST_M_S and abs(position[0]) < HIGHEST_LATITUDE


def unsoundness(motion: Motion) -> str:
    """Say what is wrong with a motion that is not `sound`."""
    quaternion, velocity, position, _ = motion
    if not isfinite(sum(quaternion) + sum(velocity) + sum(position)):
        return "the state is no longer finite"
    return (
        "the velocity is beyond any vehicle's" if length(velocity) >= FASTEST_M_S else "the position is too near a pole"
    )

"""Inertial samples combined to increments of up to 50 ms, for solutions that run beside the published one.

One increment has the effect of its samples to the second order: rotation and velocity of the samples in it do not
commute, which coning and sculling correct. Errors of the IMU are subtracted from an increment as from a sample; what
that neglects is of the third order.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from .propagation import INCREMENT_RATE, INCREMENT_VIBRATION

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

LONGEST_NS = 50_000_000  # [ns] as the covariance step: a longer one would be a gap
CYCLIC = np.array([1, 2, 0])
WIDTH = INCREMENT_RATE + 3  # columns


class RawSamples(NamedTuple):
    """Contiguous samples as they were measured, with the one before."""

    times_ns: IntArray  # shape (n,), ends of the samples
    rows: FloatArray  # [m/s², rad/s, body] shape (n, 6)
    before_ns: int  # end of the sample before
    before: FloatArray  # shape (6,)


def combined(samples: RawSamples, starts: IntArray) -> FloatArray:
    """Increments of groups of samples.

    Parameters
    ----------
    samples : RawSamples
        All samples.
    starts : ndarray, shape (m,)
        Index of the first sample of each group; the first is 0.

    Returns
    -------
    ndarray, shape (m, 11)
        [m/s², rad/s, body] Mean specific force and angular rate with the effect of the samples; [m²/s³, rad²/s]
        measured vibration PSD of the group; [rad/s, body] rate of its last sample.

    Notes
    -----
    With a, v the rotation and the velocity gain of each sample, A the sum of all rotations before it in the group, and
    phi, V their sums over the group::

        rotation = phi + 1/2 sum(A x a),  gain = V + sum((A + a/2) x v) - 1/2 phi x V

    The last term is what the strapdown adds for a rotation at constant rate.

    References
    ----------
    P. Savage, "Strapdown inertial navigation integration algorithm design, part 1 and 2", JGCD 21(1, 2), 1998.
    """
    times_ns, rows, before_ns, before = samples
    n = len(times_ns)
    ends = np.empty(len(starts), np.int64)  # of the groups: after the last sample
    ends[:-1], ends[-1] = starts[1:], n
    step, changes = np.empty((n, 1)), np.empty((n, 6))
    step[0], step[1:, 0] = (times_ns[0] - before_ns) * 1e-9, (times_ns[1:] - times_ns[:-1]) * 1e-9
    changes[0], changes[1:] = rows[0] - before, rows[1:] - rows[:-1]
    gains = rows * step
    v, a = gains[:, :3], gains[:, 3:]
    summed = np.add.reduceat(gains, starts)
    V, phi, span = summed[:, :3], summed[:, 3:], np.add.reduceat(step, starts)
    A, counts = np.zeros((n, 3)), ends - starts
    for j in range(1, int(counts.max())):  # each group by itself, so that its bits depend on no other
        at = starts[counts > j] + j
        A[at] = A[at - 1] + a[at - 1]
    made = np.empty((len(starts), WIDTH))
    made[:, :3] = (V + np.add.reduceat(_cross(A + 0.5 * a, v), starts) - 0.5 * _cross(phi, V)) / span
    made[:, 3:6] = (phi + 0.5 * np.add.reduceat(_cross(A, a), starts)) / span
    changes *= changes
    changes *= step * step / 6.0
    power = np.add.reduceat(changes, starts) / span
    made[:, INCREMENT_VIBRATION] = power[:, :3].sum(axis=1)
    made[:, INCREMENT_VIBRATION + 1] = power[:, 3:].sum(axis=1)
    made[:, INCREMENT_RATE:] = rows[ends - 1, 3:]
    return made


def group_starts(times_ns: IntArray, marks_ns: IntArray, stamps_ns: IntArray) -> tuple[IntArray, IntArray]:
    """Index of the first sample of each group: between marks and, in each interval, after every 50 ms.

    Parameters
    ----------
    times_ns : ndarray, shape (n,)
        Ends of the samples.
    marks_ns : ndarray, shape (k,)
        Times at which a group ends in any case.
    stamps_ns : ndarray, shape (s,)
        Stamps of measurements: a sample that one of them divides is a group of its own.

    Returns
    -------
    tuple of ndarray
        Starts by the marks alone, and all starts; the first is 0 in both.
    """
    interval = marks_ns.searchsorted(times_ns)
    begin_ns = marks_ns[np.maximum(interval - 1, 0)] if len(marks_ns) else times_ns[:1]
    part = (times_ns - begin_ns - 1) // LONGEST_NS
    new = np.ones(len(times_ns), bool)
    new[1:] = (interval[1:] != interval[:-1]) | (part[1:] != part[:-1])
    at = times_ns.searchsorted(stamps_ns)
    at = at[at < len(times_ns)]
    divided = new.copy()
    divided[at[times_ns[at] != stamps_ns[: len(at)]]] = True
    divided[at[at + 1 < len(times_ns)] + 1] = True
    return new.nonzero()[0], divided.nonzero()[0]


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Vector products of rows, shape (n, 3)."""
    c: FloatArray = (a * b[:, CYCLIC] - a[:, CYCLIC] * b)[:, CYCLIC]
    return c

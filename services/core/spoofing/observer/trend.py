"""How fast a heading turns away from the gyroscope's over a window: the slope of their difference, and its variance."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shared.inertial.increments import SECOND_NS
from shared.maths.rotation import Vector

from ..gyroscope.sources import Reading

FloatArray = npt.NDArray[np.float64]

MIN_SHARE = 0.8  # of the window, from its first to its last reading
MIN_READINGS = 0.4  # of its seconds
MIN_SD = 2e-3  # [rad] of one course: of the vehicle, which drifts across its lane
# [rad] By which side wind and crossfall change the sideslip between the ends of a window.
OFFSET_SD = 2e-3


# Share of the squares that a slope leaves, below which those that a single step leaves are clearly fewer: a heading
# that has jumped, or that jumped back when an error ended, does not turn away.
STEP_SHARE = 0.6


class Trend(NamedTuple):
    """Slope of the difference heading minus gyroscope."""

    rate: float  # [rad/s]
    variance: float  # [rad²/s²] of the heading alone
    turn_rate: float  # [rad/s] slope of the gyroscope's own yaw: times an error of its scale, an error of the slope
    span_s: float
    jumps: bool  # one step explains the difference better


def row_of(reading: Reading, begin_ns: int) -> list[float]:
    """Reading as a row of the table that `trend` takes; its time counts from a begin."""
    turn = reading.turn
    since_s = (turn.time_ns - begin_ns) / SECOND_NS
    return [since_s, reading.angle, reading.variance, turn.angle, *turn.axis_s, turn.rate]


def trend(
    table: FloatArray, bias: Vector, length_s: float, *, correlation_s: float, time_sd_s: float
) -> Trend | None:  # fmt: skip
    """Slope over the newest readings.

    Parameters
    ----------
    table : ndarray, shape (n, 8)
        Of `row_of`, about one a second, newest last.
    bias : tuple of float
        [rad/s, body] Of the gyroscope.
    length_s : float
        [s] Length of the window.
    correlation_s, time_sd_s : float
        [s] Correlation time of the heading's errors, standard deviation of its stamps.

    Returns
    -------
    Trend or None
        None where readings are missing.

    Notes
    -----
    Weighted least squares: with weights w and times t about their weighted mean, k = w t / sum(w t²), the slope is
    sum(k d) and its variance c sum(k² v), c = (1 + p) / (1 - p) for errors that are correlated by p from one reading to
    the next. One reading, that which moves the slope most, is left out: it may be a reflection.
    """
    if not len(table):
        return None
    chosen = table[table[:, 0] >= table[-1, 0] - length_s]
    t = chosen[:, 0] - chosen[-1, 0]
    if len(chosen) < MIN_READINGS * length_s or -t[0] < MIN_SHARE * length_s:
        return None
    yaw = chosen[:, 3] - chosen[:, 4:7] @ np.array(bias)
    off = chosen[:, 1] - yaw
    off = np.remainder(off - float(np.angle(np.exp(1j * off).sum())) + np.pi, 2.0 * np.pi) - np.pi
    v = chosen[:, 2] + MIN_SD**2 + (time_sd_s * chosen[:, 7]) ** 2
    return _without_the_worst(t, off, yaw, v, correlation_s)


def _without_the_worst(t: FloatArray, off: FloatArray, yaw: FloatArray, v: FloatArray, correlation_s: float) -> Trend:
    k = _weights(t, v)
    residual = off - off.mean() - float(k @ off) * (t - t.mean())
    rest = np.arange(len(t)) != int(np.abs(k * residual).argmax())
    t, off, yaw, v = t[rest], off[rest], yaw[rest], v[rest]
    k = _weights(t, v)
    span_s = float(t[-1] - t[0])
    p = float(np.exp(-span_s / (len(t) - 1) / correlation_s))
    variance = (1.0 + p) / (1.0 - p) * float(k**2 @ v) + (2.0 * OFFSET_SD / span_s) ** 2
    rate = float(k @ off)
    return Trend(rate, variance, float(k @ (yaw - yaw.mean())), span_s, _jumps(off, rate * t))


def _jumps(off: FloatArray, line: FloatArray) -> bool:
    """Whether two levels, the best that differ before and after a reading, fit clearly better than a line."""
    n = len(off)
    about, left = off - off.mean(), np.arange(1, n)
    sums = np.cumsum(about)[:-1]
    by_step = float(about @ about) - float((sums**2 * (1.0 / left + 1.0 / (n - left))).max())
    residual = off - line
    return by_step < STEP_SHARE * n * float(residual.var())


def _weights(t: FloatArray, v: FloatArray) -> FloatArray:
    w = 1.0 / v
    about = t - float(w @ t) / float(w.sum())
    k: FloatArray = w * about / float(w @ about**2)
    return k

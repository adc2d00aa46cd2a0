"""Fast test: mean difference of GNSS and odometer speed over 5 s against its own noise."""

from collections.abc import Sequence
from math import sqrt

import numpy as np
import numpy.typing as npt
from scipy.special import chdtri, ndtr

from shared.maths.correlated_noise import mean_variance

from .aligned import SECOND_NS, AlignedPair

FloatArray = npt.NDArray[np.float64]

WINDOW_S = 5.0
MIN_SAMPLES = 4
MIN_PROBABILITY = 1e-300


def tail_probability(difference: float, *, sd: float, half_width: float) -> float:
    """Probability that a normal error plus a uniform one exceeds a difference, in either direction.

    Parameters
    ----------
    difference : float
        [m/s] Its magnitude counts.
    sd : float
        [m/s] Standard deviation of the normal error; positive.
    half_width : float
        [m/s] The uniform error lies within ± this: rounding by an odometer, constant over a window of steady speed.

    Returns
    -------
    float
        [-] P(|g + u| > |d|).

    Notes
    -----
    With Q the normal tail, φ the normal density and K(z) = φ(z) - z Q(z) the integral of Q from z on::

        P(|g + u| > x) = σ/h · [ K((x - h)/σ) - K((x + h)/σ) ]
    """
    x = abs(difference)
    if half_width < 1e-6 * sd:
        return float(2.0 * ndtr(-x / sd))
    z = np.array([(x - half_width) / sd, (x + half_width) / sd])
    near, far = np.exp(-0.5 * z**2) / sqrt(2.0 * np.pi) - z * ndtr(-z)
    return float(np.clip(sd / half_width * (near - far), 0.0, 1.0))


def fast_statistic(
    pairs: Sequence[AlignedPair],
    *,
    scale: float,
    calibration_variance: float,
    correlation_s: float,
    dead_zone_m_s: float,
) -> float:
    """Statistic of the mean difference d of GNSS speed and scaled odometer speed in a window.

    Parameters
    ----------
    pairs : sequence of AlignedPair
        The window; at least one.
    scale : float
        [-] Learned scale of the odometer.
    calibration_variance : float
        [m²/s²] Variance of the scaled odometer speed from the errors of scale and delay, common to the window.
    correlation_s : float
        [s] Correlation time of GNSS speed errors.
    dead_zone_m_s : float
        [m/s] Speed below which an odometer may read zero.

    Returns
    -------
    float
        [-] T, chi-square with one degree of freedom without a fault; compare with `threshold`, not with its square.

    Notes
    -----
    T is the chi-square value whose tail probability is that of d under normal noise plus the odometer's rounding::

        T = χ²⁻¹( P(|g + u| > |d|), 1 ),   σ_g² = var(mean v_gnss) + var(s · v_odo),   |u| <= s · resolution / 2

    Without rounding this is T = d²/σ_g². At steady speed the rounding error u is the same for all samples; in a window
    in which the odometer passes several steps the errors are independent, and s² · resolution² / 12n is added to σ_g².
    """
    time_s = np.array([(pair.time_ns - pairs[0].time_ns) / SECOND_NS for pair in pairs])
    difference = float(np.mean([pair.gnss - scale * pair.odometer for pair in pairs]))
    noise = float(mean_variance(time_s, np.array([pair.gnss_sd for pair in pairs]), correlation_s))
    speeds, step = [pair.odometer for pair in pairs], max(pair.resolution for pair in pairs)
    variance, half_width = noise + calibration_variance, 0.5 * scale * step
    if min(speeds) <= 0.0:
        half_width = max(half_width, dead_zone_m_s)
    elif max(speeds) - min(speeds) > 2.0 * step:
        variance, half_width = variance + half_width**2 / (3.0 * len(pairs)), 0.0
    probability = tail_probability(difference, sd=sqrt(variance), half_width=half_width)
    return float(chdtri(1, max(probability, MIN_PROBABILITY)))

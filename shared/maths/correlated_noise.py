"""Statistics of noise that is correlated over time."""

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


def mean_variance(time_s: FloatArray, sd: FloatArray, correlation_s: float) -> FloatArray:
    """Variance of the mean of samples whose errors are correlated as exp(-|Δt|/τ).

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        [s] Times of the samples.
    sd : ndarray, shape (..., n)
        [any unit] Their standard deviations; leading axes are those of the result.
    correlation_s : float
        [s] Correlation time τ; positive.

    Notes
    -----
    1/n² · Σᵢⱼ σᵢ σⱼ exp(-|tᵢ - tⱼ|/τ)
    """
    correlation = np.exp(-np.abs(time_s[:, None] - time_s[None, :]) / correlation_s)
    variance: FloatArray = np.vecdot(sd @ correlation, sd) / len(time_s) ** 2
    return variance

"""How far GNSS may still be off after it came back: the posterior of another offset, and the bound that it leaves.

A return that agrees with what was before either ended the error, or GNSS is at another offset that looks like it. Other
offsets are taken as p times as probable as an end (`OTHER_OFFSET_PROBABILITY`), and as spread evenly within a radius R
(`OTHER_OFFSET_RADIUS_M`). With a difference d of covariance S (standard deviations s₁, s₂, r² = dᵀ S⁻¹ d) the weight of
another offset is::

    on the ground  w = p 2 s₁ s₂ / R² exp(r²/2)          vertical  w = p √(2π) s / 2R exp(r²/2)

and given it the offset is N(d, S), so that the bound is |d| + k(risk / w) s₁, and 0 where w is below the risk. A sharp
comparison closes an error wholly; a blunt one leaves what it cannot tell from another offset.
"""

from math import exp, log, pi, sqrt

from shared.maths.quantiles import line_factor

OTHER_OFFSET_PROBABILITY = 0.25  # a spoofer that moves on to another offset, against one that ends
OTHER_OFFSET_RADIUS_M = 60.0  # radius within which another offset may be: a car park, a parallel street
MAX_RATIO = 10.0  # beyond which the weight is 1 in any case


def horizontal_bound(size_m: float, spread_m: tuple[float, float], ratio: float, risk: float) -> float:
    """Bound [m] of an offset on the ground.

    Parameters
    ----------
    size_m : float
        [m] Length of the difference.
    spread_m : tuple of float
        [m] Larger and smaller standard deviation of it.
    ratio : float
        [-] The difference in standard deviations.
    risk : float
        [-] Probability with which the offset may be larger.
    """
    weight = OTHER_OFFSET_PROBABILITY * 2.0 * spread_m[0] * spread_m[1] / OTHER_OFFSET_RADIUS_M**2 * _evidence(ratio)
    return 0.0 if weight <= risk else size_m + spread_m[0] * sqrt(2.0 * log(min(1.0, weight) / risk))


def vertical_bound(size_m: float, sd_m: float, risk: float) -> float:
    """Bound [m] of a vertical offset."""
    weight = (
        OTHER_OFFSET_PROBABILITY
        * sqrt(0.5 * pi)
        * sd_m
        / OTHER_OFFSET_RADIUS_M
        * _evidence(size_m / sd_m if sd_m > 0.0 else MAX_RATIO)
    )
    return 0.0 if weight <= risk else size_m + sd_m * line_factor(risk / min(1.0, weight))


def _evidence(ratio: float) -> float:
    return exp(0.5 * min(ratio, MAX_RATIO) ** 2)

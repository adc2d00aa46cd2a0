"""Protection levels: how far off a solution may be, but for a probability that was agreed upon before.

The covariance is where it begins; what it does not know of is added, and nothing is ever taken away::

    risk = (1 - P_fault) P(|σ n| > L) + P_fault P(|σ n + fault| > L),   level = rejection_bound + L

with n a normal number (vertical) or a normal pair (horizontal), σ² the inflated covariance, and fault the most that
one wrong fix can have done without the gate seeing it. docs/explanation/protection-levels.md has every term.
"""

from collections.abc import Sequence
from math import erfc, exp, isfinite, sqrt
from typing import NamedTuple

from shared.maths.quantiles import circle_factor, line_factor, principal_variances
from shared.maths.rotation import Vector

from .error_monitor import ErrorMonitor
from .set_up_spread import NO_SPREAD, SetUpSpread

SPLITS = (0.5, 0.75, 0.95)  # [-] shares of the risk that horizontal errors without a fault may have
FAULT_PROBABILITY = 0.01  # that one fix is wrong by as much as the gate lets pass
OUTAGE_FACTOR = 3.0  # [-] on the variance that an outage adds, for errors of sensors that no state stands for
OUTAGE_S = 10.0  # time in which these have come to bear
MAX_DISTANCE_M = 1e9
VERTICAL_TOLERANCE = 1e-4  # [-] of a vertical level, by which it may be too large


class Levels(NamedTuple):
    """Radius on the ground and half height about the solution [m], with the probability of being outside each."""

    horizontal: float
    vertical: float
    risk: float


def horizontal_level(nn: float, ne: float, ee: float, risk: float) -> float:
    """Radius [m] of the circle that holds a horizontal error of a covariance [m²] but for a probability."""
    major, ratio = _ellipse(nn, ne, ee)
    return major * circle_factor(ratio, risk)


def _ellipse(nn: float, ne: float, ee: float) -> tuple[float, float]:
    """Larger standard deviation [m] of a covariance, and the ratio of the smaller to it."""
    major2, minor2 = principal_variances(nn, ne, ee)
    return (sqrt(major2), sqrt(max(minor2, 0.0) / major2)) if major2 > 0.0 else (0.0, 0.0)


def vertical_level(variance: float, risk: float) -> float:
    """Half height [m] that holds a vertical error of a variance [m²] but for a probability."""
    return sqrt(max(variance, 0.0)) * line_factor(risk)


def horizontal_level_with_fault(cov: tuple[float, float, float], fault: float, risk: float) -> float:
    """Radius [m] that holds a horizontal error of a covariance [m²: NN, NE, EE], moved by a fault [m] or not.

    Notes
    -----
    For every share a of the risk::

        L(a) = max( k(a risk) σ,  fault + k((1 - a) risk / P_fault) σ )

    is enough, and so is the least of some.
    """
    major, ratio = _ellipse(*cov)
    return min(
        max(
            major * circle_factor(ratio, share * risk),
            fault + major * circle_factor(ratio, (1.0 - share) * risk / FAULT_PROBABILITY),
        )
        for share in SPLITS
    )


def vertical_level_with_fault(variance: float, fault: float, risk: float) -> float:
    """Half height [m] that holds a vertical error of a variance [m²], moved by a fault [m] or not: exactly.

    Notes
    -----
    No quantile function inverts a sum of tails. The root is bisected here, because `scipy.optimize` would add 24 MB to
    a live process.
    """
    low = vertical_level(variance, risk)
    if fault <= 0.0 or variance <= 0.0:
        return low + max(0.0, fault)
    per_m, near, high = sqrt(0.5 / variance), VERTICAL_TOLERANCE * low, low + fault
    while high - low > near:
        middle = 0.5 * (low + high)
        moved = 0.5 * (erfc((middle - fault) * per_m) + erfc((middle + fault) * per_m))
        outside = (1.0 - FAULT_PROBABILITY) * erfc(middle * per_m) + FAULT_PROBABILITY * moved
        low, high = (middle, high) if outside > risk else (low, middle)
    return high


def protection_levels(
    position_cov: Sequence[Sequence[float]],
    velocity: Vector,
    time_ns: int,
    monitor: ErrorMonitor,
    *,
    risk: float,
    time_sd_s: float,
    spread: SetUpSpread = NO_SPREAD,
) -> Levels:
    """Say how far off a solution may be.

    Parameters
    ----------
    position_cov : 3 sequences of 3 floats
        [m², NED] Covariance of the position as the filter knows it.
    velocity : tuple of float
        [m/s, NED]
    time_ns : int
        Stamp of the solution.
    monitor : ErrorMonitor
        Statistics of the innovations, undetected shifts and rejected positions: errors outside the covariance.
    risk : float
        [-] Probability with which the error may be beyond a level, of each of the two.
    time_sd_s : float
        [s] Error of GNSS stamps.
    spread : SetUpSpread
        Of lever arm and delay, as far as no check has measured them.

    Returns
    -------
    Levels
        [m]

    Notes
    -----
    With s² the scale of recent innovations, g the growth in an outage of t, L the variance of time-correlated errors
    of GNSS and P₀ the covariance after the last fix that was used::

        Σ = s² (1 + (g - 1) (1 - tr P₀ / tr P)) P + L + stamp + set-up      g = (1 + 2 (1 - exp(-t/10 s))) overstatement

    The stamp's part is what P lacks of (v σ_t)² along the velocity. That of the set-up is the variance of the lever arm
    on each axis, and what all that lacks of (v σ_d)²: both are equal at every fix, so that no fix takes them away. A
    delay at the end of what is assumed and a filter at the end of its own are not taken to come together. The way
    driven in a delay of positions that is known and not corrected is no random error: it is added to the level.
    """
    (nn, ne, _), (_, ee, _), (_, _, dd) = position_cov
    age_s = (time_ns - monitor.used_ns) * 1e-9
    growth = (1.0 + (OUTAGE_FACTOR - 1.0) * (1.0 - exp(-max(0.0, age_s) / OUTAGE_S))) * monitor.overstatement
    after_fix = monitor.cov_after_fix
    scale_h = monitor.scale_horizontal * _grown(after_fix[0] + after_fix[2], nn + ee, growth)
    scale_v = monitor.scale_vertical * _grown(after_fix[3], dd, growth)
    north, east, speed2 = velocity[0], velocity[1], velocity[0] ** 2 + velocity[1] ** 2
    stamp = 0.0  # [s²] of which the velocity makes a covariance
    if speed2 > 0.0:
        along = (north * north * nn + 2.0 * north * east * ne + east * east * ee) / speed2
        stamp = max(0.0, time_sd_s**2 - along / speed2)
    correlated = monitor.correlated_variance_horizontal
    nn, ne, ee = scale_h * nn + stamp * north**2, scale_h * ne + stamp * north * east, scale_h * ee + stamp * east**2
    arm = correlated + spread.arm_horizontal_m**2
    nn, ee = nn + arm, ee + arm
    late = 0.0  # [s²] as above
    if speed2 > 0.0:
        along = (north * north * nn + 2.0 * north * east * ne + east * east * ee) / speed2
        late = max(0.0, spread.delay_s**2 - along / speed2)
    cov = (nn + late * north**2, ne + late * north * east, ee + late * east**2)
    variance = scale_v * dd + monitor.correlated_variance_vertical
    variance += spread.arm_vertical_m**2 + (spread.delay_s * velocity[2]) ** 2
    if not isfinite(sum(cov) + variance):
        return Levels(MAX_DISTANCE_M, MAX_DISTANCE_M, risk)  # of numbers that have broken down nothing is known
    (fault_h, fault_v), (rejected_h, rejected_v) = monitor.fault_shift, monitor.rejection_bound
    late_h, late_v = monitor.delay_s * sqrt(speed2), monitor.delay_s * abs(velocity[2])
    horizontal = rejected_h + late_h + horizontal_level_with_fault(cov, fault_h, risk)
    vertical = rejected_v + late_v + vertical_level_with_fault(variance, fault_v, risk)
    return Levels(min(horizontal, MAX_DISTANCE_M), min(vertical, MAX_DISTANCE_M), risk)


def _grown(then: float, now: float, growth: float) -> float:
    """Factor on a variance of which only what has grown since then is multiplied."""
    return 1.0 + (growth - 1.0) * max(0.0, 1.0 - then / now) if now > 0.0 else 1.0

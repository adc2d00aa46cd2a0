"""The solutions of the bank against each other: whether odometer or GNSS contradicts the inertial sensors alone.

The inertial sensors alone, with the non-holonomic constraint, know the way for a minute. Beside them stand the solution
without GNSS, which has the odometer, and the one without odometer, which has GNSS. Compared is the way along the
direction of motion: a wrong heading turns it and leaves its length, so that the gyroscope decides nothing here.
"""

from dataclasses import replace
from math import hypot
from statistics import NormalDist
from typing import NamedTuple

from shared.messages.explanation import Explanation, explain
from shared.messages.trust import Hypothesis, HypothesisSolution, Outcome, TrustHypotheses
from shared.trust.accused import GNSS, IMU, ODOMETER

from ..codes import Code
from ..facts import Monitor, Statement

FALSE_ALARM_RATE = 1e-3  # it decides where another monitor, with its own rate, has found a contradiction
LIMIT = NormalDist().inv_cdf(1.0 - 0.5 * FALSE_ALARM_RATE) ** 2  # chi-square with one degree of freedom
AGREEMENT_SHARE = 0.25  # of the limit: half of the difference
CLEAR_SHARE = 0.5  # of the difference of the one that contradicts, to which that of the other may come
MIN_SPEED_M_S = 2.0
WINDOW_S = 10.0  # in which the way grows by what is another sample of it
NEEDED = (Hypothesis.GNSS_AND_ODOMETER, Hypothesis.GNSS, Hypothesis.ODOMETER)


class SolutionDistance(NamedTuple):
    """Distance of two solutions along the way [m], and its square over the sum of their variances [-]."""

    distance_m: float
    squared: float


def compared(bank: TrustHypotheses) -> Statement:
    """Statement on the solutions of the bank."""
    known = {solution.hypothesis: solution for solution in bank.solutions}
    base = Statement(
        Monitor.HYPOTHESES, Outcome.NOT_EVALUATED, bank.sampled_ns, "", threshold=LIMIT,
        false_alarm_rate=FALSE_ALARM_RATE, window_s=WINDOW_S,
    )  # fmt: skip
    if any(hypothesis not in known for hypothesis in NEEDED):
        return _with(base, Outcome.NOT_EVALUATED, explain(Code.NOT_COMPARABLE))
    alone, without_gnss, without_odometer = (known[hypothesis] for hypothesis in NEEDED)
    if hypot(*alone.velocity_ned_m_s[:2]) < MIN_SPEED_M_S:
        return _with(base, Outcome.NOT_EVALUATED, explain(Code.HARDLY_MOVES))
    odometer, gnss = _along(alone, without_gnss), _along(alone, without_odometer)
    # An odometer that this solution would reject takes no part in the solution without GNSS.
    wrong_speed = alone.odometer_innovations or 0.0
    accused = _accused(max(odometer.squared, wrong_speed), odometer, gnss, _along(without_gnss, without_odometer))
    if accused is None:
        return _with(base, Outcome.NOT_EVALUATED, _compared(Code.NO_TWO_AGREE, odometer, gnss, wrong_speed))
    statistic = max(odometer.squared, gnss.squared, wrong_speed)
    outcome = Outcome.ACCUSES if accused else Outcome.PASS
    return _with(base, outcome, _compared(Code.SOLUTIONS_COMPARED, odometer, gnss, wrong_speed), accused, statistic)


def _compared(code: Code, odometer: SolutionDistance, gnss: SolutionDistance, wrong_speed: float) -> Explanation:
    return explain(
        code, odometer_m=odometer.distance_m, gnss_m=gnss.distance_m, odometer_statistic=odometer.squared,
        gnss_statistic=gnss.squared, speed_statistic=wrong_speed, threshold=LIMIT,
    )  # fmt: skip


def _accused(
    of_odometer: float, odometer: SolutionDistance, gnss: SolutionDistance, both: SolutionDistance
) -> tuple[str, ...] | None:
    """Who contradicts the inertial sensors, or everything else; None where no two of three agree."""
    if max(of_odometer, gnss.squared) <= LIMIT:
        return ()
    if of_odometer <= AGREEMENT_SHARE * LIMIT and odometer.distance_m <= CLEAR_SHARE * gnss.distance_m:
        return (GNSS,)
    if gnss.squared <= AGREEMENT_SHARE * LIMIT and of_odometer > LIMIT:
        return (ODOMETER,)
    return (IMU, GNSS, ODOMETER) if both.squared <= AGREEMENT_SHARE * LIMIT else None


def _with(
    base: Statement, outcome: Outcome, why: Explanation, accused: tuple[str, ...] = (), statistic: float | None = None
) -> Statement:
    return replace(base, outcome=outcome, why=why, accused=accused, statistic=statistic)


def _along(one: HypothesisSolution, other: HypothesisSolution) -> SolutionDistance:
    """Distance of two solutions along the way of the first."""
    vn, ve, _ = one.velocity_ned_m_s
    speed = hypot(vn, ve)
    direction = vn / speed, ve / speed
    north, east = (other.apart_ned_m[k] - one.apart_ned_m[k] for k in (0, 1))
    distance = direction[0] * north + direction[1] * east
    variance = sum(_variance(solution, direction) for solution in (one, other))
    return SolutionDistance(abs(distance), distance**2 / variance if variance > 0.0 else 0.0)


def _variance(solution: HypothesisSolution, direction: tuple[float, float]) -> float:
    """Variance of a position along a horizontal direction [m²]."""
    nn, ne, _, ee, *_ = solution.position_cov_ned_m2
    north, east = direction
    return nn * north**2 + 2.0 * ne * north * east + ee * east**2

"""The hypotheses that a satellite, or a constellation, is wrong: positions without it, for `trust/hypotheses`."""

from math import degrees, sqrt

from shared.maths.earth import geodetic_from_ecef
from shared.maths.quantiles import chi_square_limit, circle_factor, line_factor, principal_variances
from shared.messages.explanation import Explanation, explain
from shared.messages.trust import Hypothesis, HypothesisSolution, TrustHypotheses
from shared.words.words import reason

from .codes import Code
from .measurements import FloatArray, upper
from .satellites.leave_out import SubsetSolution, solutions_without
from .satellites.monitor import no_redundancy
from .satellites.solution import PositionFit

SOURCE = "core.cooperative"
SOLUTIONS_MAXIMUM = 64  # of a message: GPS and Galileo have 68 satellites
# [m] A level beyond is no level: the geometry without these satellites determines no position on a road.
LEVEL_MAXIMUM_M = 1e5
HEIGHT_MAXIMUM_M = 1e5  # above or below the ellipsoid; with a satellite that is wrong by 1000 km others are far off
SPEED_MAXIMUM_M_S = 1e4  # above that of a satellite


def satellite_hypotheses(
    position: PositionFit | None, why_not: Explanation | None, time_ns: int, *, false_alarm_rate: float, risk: float
) -> TrustHypotheses:
    """Give the positions without each satellite and each constellation.

    Parameters
    ----------
    position : PositionFit or None
        All in view, suspected satellites included; None without a solution.
    why_not : Explanation or None
        Why there is none.
    time_ns : int
        [ns, OBU time line] Of the epoch.
    false_alarm_rate : float
        [-] Of all separations of an epoch together.
    risk : float
        [-] Probability with which the error of a position is beyond its level, of each of the two.

    Returns
    -------
    TrustHypotheses
        At most 64 positions, those with the largest separation over its limit; or the reason why there is none.
    """
    found = () if position is None else solutions_without(position, false_alarm_rate)
    rate = false_alarm_rate / max(len(found), 1)
    shown = []
    if position is not None:
        shown = [one for left in found if (one := _solution(position, left, time_ns, rate, risk)) is not None]
    if not shown:
        why = why_not or _why_none(position)
        return TrustHypotheses(
            sampled_ns=time_ns, source=SOURCE, missing_codes=((Hypothesis.SATELLITES, why),),
            missing=((Hypothesis.SATELLITES, reason(why)),),
        )  # fmt: skip
    shown.sort(key=_ratio, reverse=True)
    return TrustHypotheses(sampled_ns=time_ns, source=SOURCE, solutions=tuple(shown[:SOLUTIONS_MAXIMUM]))


def _why_none(position: PositionFit | None) -> Explanation:
    if position is None:
        return explain(Code.NO_SOLUTION, usable_count=0)
    return no_redundancy(position) if position.fit.dof < 1 else explain(Code.NOT_DETERMINED)


def _ratio(solution: HypothesisSolution) -> float:
    return (solution.separation or 0.0) / (solution.separation_limit or 1.0)


def _solution(
    position: PositionFit, left: SubsetSolution, time_ns: int, rate: float, risk: float
) -> HypothesisSolution | None:
    """One position; None where it is none of a vehicle on Earth, or has no level."""
    horizontal, vertical = _levels(left.cov_n, risk)
    if not max(horizontal, vertical) <= LEVEL_MAXIMUM_M:
        return None
    geometry = position.geometry
    x, y, z = (geometry.position_e + geometry.ned_from_ecef.T @ (position.fit.parameters[:3] - left.apart_n)).tolist()
    place = geodetic_from_ecef((x, y, z))
    apart_n, velocity_n = left.apart_n.tolist(), left.velocity_n.tolist()
    if abs(place.height) > HEIGHT_MAXIMUM_M or max(map(abs, velocity_n)) > SPEED_MAXIMUM_M_S:
        return None
    tested = left.separation is not None and left.separation_dof > 0
    return HypothesisSolution(
        hypothesis=Hypothesis.SATELLITES,
        left_out=tuple(str(satellite) for satellite in left.satellites),
        since_ns=time_ns,
        latitude_deg=degrees(place.latitude),
        longitude_deg=degrees(place.longitude),
        height_ellipsoid_m=place.height,
        velocity_ned_m_s=(velocity_n[0], velocity_n[1], velocity_n[2]),
        position_cov_ned_m2=upper(left.cov_n),
        protection_level_horizontal_m=horizontal,
        protection_level_vertical_m=vertical,
        apart_ned_m=(apart_n[0], apart_n[1], apart_n[2]),
        separation=left.separation if tested else None,
        separation_limit=chi_square_limit(left.separation_dof, rate) if tested else None,
        innovations=left.innovations,
    )


def _levels(cov: FloatArray, risk: float) -> tuple[float, float]:
    """Radius and half height [m] outside which a position of a covariance is with a probability."""
    (nn, ne, _), (_, ee, _), (_, _, dd) = cov.tolist()
    major2, minor2 = principal_variances(nn, ne, ee)
    ratio = sqrt(max(minor2, 0.0) / major2) if major2 > 0.0 else 0.0
    return sqrt(max(major2, 0.0)) * circle_factor(ratio, risk), sqrt(max(dd, 0.0)) * line_factor(risk)

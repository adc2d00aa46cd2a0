"""The verdict: whether the position can be used now, and why. The first row of the table that matches decides.

====  ==================================================================================  ==============
row   condition                                                                           state
====  ==================================================================================  ==============
1     no solution yet                                                                     INITIALISING
2     solution lost or stale                                                              NO_FIX
3     protection level above the alert limit, horizontal or vertical                      UNSAFE
4     a hypothesis survives to whose solution the level does not reach                    UNSAFE
5     no GNSS in the position: excluded and confirmed by fusion, or missing for too long  DEAD_RECKONING
6     a hypothesis survives, a source is excluded, or a monitor doubts                    CAUTION
7     no inertial unit, no independent check, paused checks, or a silent monitor          CAUTION
8     protection level above 0.8 of the alert limit                                       CAUTION
9     otherwise                                                                           SAFE
====  ==================================================================================  ==============

The level reaches to the solution of every hypothesis that survives, so that row 3 decides between UNSAFE and CAUTION.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from shared.load import PAUSED
from shared.messages.trust import Hypothesis
from shared.missing_sensors import NO_GNSS_YET, NO_INERTIAL_UNIT

from .facts import AGAINST_GNSS, GNSS, IMU, INERTIAL, ODOMETER, SECOND_NS, Facts, Monitor, Outcome, Posterior, Statement


class TrustState(StrEnum):
    """Whether the position can be used."""

    SAFE = "safe"
    CAUTION = "caution"
    UNSAFE = "unsafe"
    DEAD_RECKONING = "dead_reckoning"
    NO_FIX = "no_fix"
    INITIALISING = "initialising"


@dataclass(frozen=True)
class Verdict:
    """State, the row that decided, and why.

    `reasons` begins with that of the deciding row; those of later rows that match too follow. `findings` are sensors,
    satellites and neighbours that are accused or left out without lowering the verdict.
    """

    state: TrustState
    row: int
    reasons: tuple[str, ...]
    findings: tuple[str, ...]


Row = Callable[[Facts], str | None]
CHECKS_PAUSED = f"checks are {PAUSED}"


def _no_solution(facts: Facts) -> str | None:
    return "no navigation solution yet" if facts.solution is None else None


def solution_lost(facts: Facts) -> str | None:
    """Row 2: why there is no position, or none that is current; None before the first."""
    solution = facts.solution
    if solution is None:
        return None
    age_s, limit_s = (facts.time_ns - solution.sampled_ns) / SECOND_NS, facts.limits.solution_silent_after_s
    if not -1.0 <= age_s <= limit_s:
        return f"navigation solution is {age_s:.1f} s old, limit {limit_s:.1f} s"
    return None if solution.navigating else f"navigation solution is lost: fusion's phase is {solution.phase}"


def _levels(facts: Facts, share: float) -> str | None:
    """Say which protection level exceeds a share of its alert limit; one that is missing does."""
    if facts.solution is None:
        return None
    found = []
    for name, level, limit in (
        ("horizontal", facts.solution.protection_level_horizontal_m, facts.limits.horizontal_m),
        ("vertical", facts.solution.protection_level_vertical_m, facts.limits.vertical_m),
    ):
        if level is None:
            found.append(f"{name} protection level is missing")
        elif not level <= share * limit:
            of_limit = "" if share == 1.0 else f"{100.0 * share:.0f} % of "
            found.append(f"{name} protection level {level:.1f} m is above {of_limit}the alert limit of {limit:.1f} m")
    return "; ".join(found) or None


def _above_alert_limit(facts: Facts) -> str | None:
    found = _levels(facts, 1.0)
    return None if found is None else found + _both_sides(facts)


def _both_sides(facts: Facts) -> str:
    """Say what a level holds beside the uncertainty of the solution itself."""
    said = ""
    if facts.other_distance_m is not None and facts.other_level_m is not None:
        one, other = ("without", "with") if facts.exclusion_confirmed else ("with", "without")
        said += (
            f"; the solution {one} GNSS is {facts.other_distance_m:.1f} m from the one {other} it, whose own level is "
            f"{facts.other_level_m:.1f} m"
        )
    if facts.held is not None:
        said += f"; the level holds: {facts.held}"
    return said


def _not_reached(facts: Facts) -> str | None:
    """Row 4: a hypothesis to whose solution the level does not reach."""
    found = [reason for reason in (_conflict(facts), _satellite_fault(facts)) if reason is not None]
    found += [
        f"{WRONG[one.hypothesis]}, and nothing says where the vehicle is then ({one.reason})"
        for one in facts.surviving
        if _is_unknown(facts, one.hypothesis)
    ]
    return "; ".join(found) or None


def _is_unknown(facts: Facts, hypothesis: Hypothesis) -> bool:
    """Whether a hypothesis has no solution; those of GNSS and satellites are judged by what fusion says of them."""
    if hypothesis is Hypothesis.ODOMETER and not facts.odometer_in_use:
        return False
    return hypothesis in SOLVED_BY_THE_BANK and hypothesis not in facts.alternatives


def _conflict(facts: Facts) -> str | None:
    """A conflict of GNSS of which fusion does not state both sides."""
    accusing = facts.accusing(AGAINST_GNSS, GNSS)
    if _excluded(facts) or facts.imu_exclusion_confirmed or not (accusing or facts.conflict_open):
        return None
    if facts.conflict_open and (facts.other_level_m is not None or facts.exclusion_declined):
        return None
    why = _sentences(facts, accusing) if accusing else "GNSS has not agreed for long enough"
    return f"{why}; fusion has not computed the solution without GNSS yet"


def _satellite_fault(facts: Facts) -> str | None:
    if _excluded(facts):
        return None
    inside = [
        accused
        for statement in facts.accusing((Monitor.SATELLITES,))
        for accused in statement.accused
        if accused not in facts.satellites_left_out and not accused.startswith("neighbour")
    ]
    if not inside:
        return None
    return f"{_sentences(facts, facts.accusing((Monitor.SATELLITES,)))}; the position in use contains the fault"


def _without_gnss(facts: Facts) -> str | None:
    """Row 5: dead reckoning, because GNSS is excluded or missing."""
    if _excluded(facts):
        accusing = facts.accusing(AGAINST_GNSS, GNSS)
        why = f": {_sentences(facts, accusing)}" if accusing else " until it has agreed for the minimum healthy time"
        return f"GNSS is excluded, position by dead reckoning{why}{_both_sides(facts)}"
    return _coasting(facts)


def _coasting(facts: Facts) -> str | None:
    if facts.solution is None or facts.imu_exclusion_confirmed:  # the position without inertial sensors is of GNSS
        return None
    age_s, limit_s = facts.solution.gnss_age_s, facts.limits.coasting_after_s
    if age_s is None:
        return NO_GNSS_YET
    return None if age_s <= limit_s else f"no GNSS fix used for {age_s:.1f} s, limit {limit_s:.1f} s"


def _unresolved(facts: Facts) -> str | None:
    """Row 6: hypotheses that survive, sources that are not used, and monitors that doubt."""
    found = []
    if _surviving(facts) and not _excluded(facts):
        found.append(_of_hypotheses(facts))
    elif facts.conflict_open and not _excluded(facts):
        declined = f"; GNSS is used: {facts.exclusion_declined}" if facts.exclusion_declined else ""
        found.append(f"GNSS has not agreed for long enough after a conflict{declined}{_both_sides(facts)}")
    if facts.imu_excluded and not facts.survives(Hypothesis.IMU):
        found.append("the inertial sensors have not agreed for long enough")
    accusing = facts.accusing((Monitor.EVIDENCE,))
    found += [_sentences(facts, accusing)] if accusing else []
    found += [
        f"monitor {monitor} is close to its threshold: {statement.reason}"
        for monitor in INERTIAL
        if (statement := facts.statement(monitor)).doubtful and statement.outcome is Outcome.PASS
    ]
    return "; ".join(found) or None


def _surviving(facts: Facts) -> tuple[Posterior, ...]:
    """Hypotheses that lower the verdict: not a satellite that is left out."""
    outside = _satellite_fault(facts) is None
    return tuple(one for one in facts.surviving if not (one.hypothesis is Hypothesis.SATELLITES and outside))


def _of_hypotheses(facts: Facts) -> str:
    """Say between which hypotheses nothing decides, or which one is acted on, and what the monitors say."""
    surviving = _surviving(facts)
    named = ", or ".join(f"{WRONG[one.hypothesis]} ({100.0 * one.probability:.1f} %)" for one in surviving)
    said = [one for one in facts.accusing(tuple(Monitor)) if one.monitor is not Monitor.EVIDENCE]
    why = f": {_sentences(facts, said)}" if said else ""
    if len(surviving) > 1:
        declined = f"; GNSS is used: {facts.exclusion_declined}" if facts.exclusion_declined else ""
        return f"unresolved: {named}; {_decider(facts)}{why}{declined}{_both_sides(facts)}"
    return f"{named}; {_consequence_of(surviving[0].hypothesis, facts)}{why}{_both_sides(facts)}"


def _decider(facts: Facts) -> str:
    """Say what would decide between the hypotheses that survive."""
    names = {one.hypothesis for one in facts.surviving}
    if Hypothesis.GNSS_AND_ODOMETER in names:
        return "centripetal speed in further bends, a second receiver or authenticated signals would decide"
    if names >= {Hypothesis.GNSS, Hypothesis.IMU} and not facts.odometer_in_use:
        return "an odometer or wheel speeds would decide"
    if names >= {Hypothesis.GNSS, Hypothesis.ODOMETER}:
        return "the inertial change of speed in braking or acceleration would decide"
    return "a step back, a second receiver or authenticated signals would decide"


def _consequence_of(hypothesis: Hypothesis, facts: Facts) -> str:
    """What follows for the source of a hypothesis that alone survives."""
    match hypothesis:
        case Hypothesis.ODOMETER:
            return "it is no longer used" if facts.odometer_excluded else "it is not used for the position"
        case Hypothesis.IMU if facts.imu_exclusion_confirmed:
            return "the position is that of GNSS and odometer"
        case Hypothesis.GNSS if facts.exclusion_declined:
            return f"it is used all the same: {facts.exclusion_declined}"
        case _:
            return "the level reaches to the solution without it"


def _silent(facts: Facts) -> str | None:
    silent = [monitor for monitor in Monitor if monitor in facts.limits.required and facts.is_silent(monitor)]
    return "; ".join(f"monitor {monitor}: {facts.statement(monitor).reason}" for monitor in silent) or None


def _not_checked(facts: Facts) -> str | None:
    """Row 7: the position needs one independent check, of which there are two kinds, and monitors that are alive."""
    checks = (*INERTIAL, Monitor.SATELLITES)
    found = []
    if facts.solution is not None and facts.solution.gnss_only:
        found.append(NO_INERTIAL_UNIT)
    if facts.checks_paused:
        found.append(CHECKS_PAUSED)
    if all(facts.outcome(monitor) is Outcome.NOT_EVALUATED for monitor in checks):
        reasons = "; ".join(f"{monitor}: {facts.statement(monitor).reason}" for monitor in checks)
        found.append(f"no independent check of the position is evaluated: {reasons}")
    if (silent := _silent(facts)) is not None:
        found.append(silent)
    return "; ".join(found) or None


def _near_alert_limit(facts: Facts) -> str | None:
    return _levels(facts, facts.limits.near_share)


def _excluded(facts: Facts) -> bool:
    return facts.gnss_excluded and facts.exclusion_confirmed


def _sentences(facts: Facts, statements: list[Statement]) -> str:
    return "; ".join(_sentence(facts, statement) for statement in statements)


def _sentence(facts: Facts, statement: Statement) -> str:
    who = " or ".join(statement.accused) or "nobody"
    text = f"monitor {statement.monitor} suspects {who}: {statement.reason}"
    if statement.statistic is not None and statement.threshold is not None:
        text += f" (statistic {statement.statistic:.3g}, threshold {statement.threshold:.3g})"
    if statement.suspect_since_ns is not None:
        text += f", suspect for {(facts.time_ns - statement.suspect_since_ns) / SECOND_NS:.0f} s"
    return text


# Of each hypothesis, in words.
WRONG = {
    Hypothesis.GNSS: "GNSS is wrong",
    Hypothesis.IMU: "the inertial sensors are wrong",
    Hypothesis.ODOMETER: "the odometer is wrong",
    Hypothesis.GNSS_AND_ODOMETER: "GNSS and odometer are falsified alike",
    Hypothesis.RECEIVER_TIME: "the time of the receiver is wrong",
    Hypothesis.SATELLITES: "a satellite is wrong",
}
SOLVED_BY_THE_BANK = (
    Hypothesis.IMU, Hypothesis.ODOMETER, Hypothesis.GNSS_AND_ODOMETER, Hypothesis.RECEIVER_TIME,
)  # fmt: skip
ROWS: tuple[tuple[TrustState, Row], ...] = (
    (TrustState.INITIALISING, _no_solution),
    (TrustState.NO_FIX, solution_lost),
    (TrustState.UNSAFE, _above_alert_limit),
    (TrustState.UNSAFE, _not_reached),
    (TrustState.DEAD_RECKONING, _without_gnss),
    (TrustState.CAUTION, _unresolved),
    (TrustState.CAUTION, _not_checked),
    (TrustState.CAUTION, _near_alert_limit),
)


def findings(facts: Facts) -> tuple[str, ...]:
    """Sensors, satellites and neighbours that are accused, satellites that are left out, and checks that are missing.

    A check that is not evaluated lowers nothing while another one is.
    """
    accused = {name for statement in facts.accusing(tuple(Monitor)) for name in statement.accused}
    named = [f"{name} is suspected{_consequence(name, facts)}" for name in sorted(accused)]
    if facts.odometer_excluded and ODOMETER not in accused:
        named.append("odometer is not used: it was suspected before")
    named += [f"satellite {name} is excluded" for name in sorted(facts.satellites_left_out)]
    if facts.checks_paused:
        named.append(CHECKS_PAUSED)
    if facts.held is not None:
        named.append(f"the level holds: {facts.held}")
    missing = [
        monitor for monitor in (*INERTIAL, Monitor.SATELLITES) if facts.outcome(monitor) is Outcome.NOT_EVALUATED
    ]
    return tuple(named + [f"{monitor} not evaluated: {facts.statement(monitor).reason}" for monitor in missing])


def _consequence(name: str, facts: Facts) -> str:
    """What follows for a sensor that is suspected."""
    if name == GNSS:
        return ", and not used" if _excluded(facts) else ", and still used"
    if name == ODOMETER:
        return ", and not used" if facts.odometer_excluded else ", and still used"
    if name == IMU:
        return ", and not used" if facts.imu_exclusion_confirmed else ", and still used"
    return ""


def verdict(facts: Facts) -> Verdict:
    """Apply the table of this module to the facts."""
    matching = [(row, state, reason) for row, (state, find) in enumerate(ROWS, 1) if (reason := find(facts))]
    if matching:
        row, state, _ = matching[0]
        return Verdict(state, row, tuple(reason for _, _, reason in matching), findings(facts))
    limits, solution = facts.limits, facts.solution
    levels = (solution.protection_level_horizontal_m, solution.protection_level_vertical_m) if solution else (0.0, 0.0)
    reason = (
        f"protection levels {levels[0]:.1f} m horizontal and {levels[1]:.1f} m vertical, "
        f"alert limits {limits.horizontal_m:.1f} m and {limits.vertical_m:.1f} m; no monitor suspects GNSS"
    )
    return Verdict(TrustState.SAFE, len(ROWS) + 1, (reason,), findings(facts))

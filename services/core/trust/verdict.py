"""The verdict: whether the position can be used now, and why. The first row of the table that matches decides.

====  ==================================================================================  ==============
row   condition                                                                           state
====  ==================================================================================  ==============
1     no solution yet                                                                     INITIALISING
2     solution lost or stale                                                              NO_FIX
3     protection level above the alert limit, horizontal or vertical                      UNSAFE
4     GNSS is in conflict, and fusion does not know the solution without it yet           UNSAFE
5     a satellite fault inside the position in use                                        UNSAFE
6     motion conflict, inertial monitors not wholly evaluated, GNSS not excluded          UNSAFE
7     GNSS excluded and confirmed by fusion                                               DEAD_RECKONING
8     no GNSS used for longer than `coasting_after_s`                                     DEAD_RECKONING
9     a conflict that is not decided, or decided against the odometer                     CAUTION
10    evidence alone, or a doubt of an inertial monitor                                   CAUTION
11    a required monitor is silent                                                        CAUTION
12    no independent check: neither inertial windows nor satellites evaluated             CAUTION
13    protection level above 0.8 of the alert limit                                       CAUTION
14    otherwise                                                                           SAFE
====  ==================================================================================  ==============

In a conflict the level reaches to the solution that is not published, so that row 3 decides between UNSAFE and CAUTION.
An accusation by the long window that follows from an odometer accused before (`by_accused_odometer`) opens a conflict
as every other, but does not exclude GNSS.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from .facts import GNSS, INERTIAL, MOTION, ODOMETER, SECOND_NS, Facts, Monitor, Outcome, Statement

LEAD_NS = 3 * SECOND_NS  # from the exclusion of the odometer to an accusation that follows from it


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


def _conflict(facts: Facts) -> str | None:
    """Row 4: a conflict of which fusion does not state both sides."""
    accusing = facts.accusing(INERTIAL, GNSS)
    if _excluded(facts) or not (accusing or facts.conflict_open):
        return None
    if facts.conflict_open and (facts.other_level_m is not None or facts.exclusion_declined):
        return None
    why = _sentences(facts, accusing) if accusing else "GNSS has not agreed for long enough"
    return f"{why}; fusion has not computed the solution without GNSS yet"


def _undecided(facts: Facts) -> str | None:
    """Row 9: both sides of a conflict are known, and nothing decides between them."""
    if not facts.conflict_open or _excluded(facts):
        return None
    accusing = facts.accusing((*INERTIAL, Monitor.SATELLITES), GNSS)
    why = _sentences(facts, accusing) if accusing else "GNSS has not agreed for long enough after a conflict"
    if by_accused_odometer(facts):
        why += "; it uses the odometer, which was suspected before"
    declined = f"; GNSS is used: {facts.exclusion_declined}" if facts.exclusion_declined else ""
    return f"unresolved: {why}{declined}{_both_sides(facts)}"


def _conflict_of_odometer_or_gnss(facts: Facts) -> str | None:
    found = [reason for reason in (_undecided(facts), _odometer_conflict(facts)) if reason is not None]
    return "; ".join(found) or None


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


def _unresolved_motion_conflict(facts: Facts) -> str | None:
    conflict = facts.accusing(MOTION)
    open_ones = [monitor for monitor in INERTIAL if facts.outcome(monitor) is Outcome.NOT_EVALUATED]
    if not conflict or not open_ones or facts.conflict_open:
        return None
    reasons = "; ".join(f"{monitor}: {facts.statement(monitor).reason}" for monitor in open_ones)
    return f"{_sentences(facts, conflict)}; GNSS or odometer is wrong, and inertial monitors cannot tell ({reasons})"


def _gnss_excluded(facts: Facts) -> str | None:
    if not _excluded(facts):
        return None
    accusing = facts.accusing(INERTIAL, GNSS)
    why = f": {_sentences(facts, accusing)}" if accusing else " until it has agreed for the minimum healthy time"
    return f"GNSS is excluded, position by dead reckoning{why}{_both_sides(facts)}"


def _coasting(facts: Facts) -> str | None:
    if facts.solution is None:
        return None
    age_s, limit_s = facts.solution.gnss_age_s, facts.limits.coasting_after_s
    if age_s is None:
        return "no GNSS fix has been used"
    return None if age_s <= limit_s else f"no GNSS fix used for {age_s:.1f} s, limit {limit_s:.1f} s"


def _odometer_conflict(facts: Facts) -> str | None:
    """Row 9: GNSS and odometer disagree, and the inertial monitors agree with GNSS."""
    conflict = facts.accusing(MOTION)
    if not conflict or any(facts.outcome(monitor) is not Outcome.PASS for monitor in INERTIAL):
        return None
    unused = bool(facts.accusing(MOTION, ODOMETER)) or by_accused_odometer(facts)
    then = "the odometer is no longer used" if unused else "nothing is excluded"
    return f"{_sentences(facts, conflict)}; inertial monitors agree with GNSS, {then}"


def _evidence(facts: Facts) -> str | None:
    accusing = facts.accusing((Monitor.EVIDENCE,))
    doubts = [
        f"monitor {monitor} is close to its threshold: {statement.reason}"
        for monitor in INERTIAL
        if (statement := facts.statement(monitor)).doubtful and statement.outcome is Outcome.PASS
    ]
    return "; ".join([*([_sentences(facts, accusing)] if accusing else []), *doubts]) or None


def _silent(facts: Facts) -> str | None:
    silent = [monitor for monitor in Monitor if monitor in facts.limits.required and facts.is_silent(monitor)]
    return "; ".join(f"monitor {monitor}: {facts.statement(monitor).reason}" for monitor in silent) or None


def _not_evaluated(facts: Facts) -> str | None:
    """Row 12: the position needs one independent check, of which there are two kinds."""
    checks = (*INERTIAL, Monitor.SATELLITES)
    if any(facts.outcome(monitor) is not Outcome.NOT_EVALUATED for monitor in checks):
        return None
    reasons = "; ".join(f"{monitor}: {facts.statement(monitor).reason}" for monitor in checks)
    return f"no independent check of the position is evaluated: {reasons}"


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


ROWS: tuple[tuple[TrustState, Row], ...] = (
    (TrustState.INITIALISING, _no_solution),
    (TrustState.NO_FIX, solution_lost),
    (TrustState.UNSAFE, _above_alert_limit),
    (TrustState.UNSAFE, _conflict),
    (TrustState.UNSAFE, _satellite_fault),
    (TrustState.UNSAFE, _unresolved_motion_conflict),
    (TrustState.DEAD_RECKONING, _gnss_excluded),
    (TrustState.DEAD_RECKONING, _coasting),
    (TrustState.CAUTION, _conflict_of_odometer_or_gnss),
    (TrustState.CAUTION, _evidence),
    (TrustState.CAUTION, _silent),
    (TrustState.CAUTION, _not_evaluated),
    (TrustState.CAUTION, _near_alert_limit),
)


def findings(facts: Facts) -> tuple[str, ...]:
    """Sensors, satellites and neighbours that are accused, satellites that are left out, and checks that are missing.

    A check that is not evaluated lowers nothing while another one is.
    """
    accused = {name for statement in facts.accusing(tuple(Monitor)) for name in statement.accused}
    named = [f"{name} is suspected{_consequence(name, facts)}" for name in sorted(accused)]
    if odometer_accused(facts) and ODOMETER not in accused:
        named.append("odometer is not used: it was suspected before")
    named += [f"satellite {name} is excluded" for name in sorted(facts.satellites_left_out)]
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
        return ", and not used" if odometer_accused(facts) else ", and still used"
    return ""


def odometer_accused(facts: Facts) -> bool:
    """Whether fusion must not use the odometer: a motion monitor accuses it and both inertial windows pass.

    It stays so while the long window, which uses the odometer, accuses GNSS in turn.
    """
    agreed = _odometer_conflict(facts) is not None and bool(facts.accusing(MOTION, ODOMETER))
    return agreed or by_accused_odometer(facts)


def by_accused_odometer(facts: Facts) -> bool:
    """Whether the long window began to accuse GNSS, not excluded so far, when the odometer had been for `LEAD_NS`.

    Its free propagations use the odometer, so that a wrong one contradicts a right GNSS. In a drag-off the long window
    accuses before, or at the same time.
    """
    since_ns = facts.odometer_excluded_since_ns
    began_ns = [one.since_ns for one in facts.accusing((Monitor.INERTIAL_LONG,), GNSS)]
    if facts.exclusion_confirmed or since_ns is None:
        return False
    return any(ns is not None and ns - since_ns >= LEAD_NS for ns in began_ns)


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

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
7     no inertial unit, check, or confirmation of a start; paused or silent monitors      CAUTION
8     protection level above 0.8 of the alert limit                                       CAUTION
9     otherwise                                                                           SAFE
====  ==================================================================================  ==============

The level reaches to the solution of every hypothesis that survives, so that row 3 decides between UNSAFE and CAUTION.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from shared.messages.explanation import Explanation, Reference, ReferenceKind, explain
from shared.messages.trust import Hypothesis, Outcome, TrustLevel
from shared.trust.accused import GNSS, IMU, ODOMETER, reference

from .codes import Code
from .facts import AGAINST_GNSS, INERTIAL, SECOND_NS, Facts, Monitor, Posterior, Statement

NAMED_MAXIMUM = 2  # hypotheses in one sentence
REASONS_MAXIMUM = 32
FINDINGS_MAXIMUM = 64
USUAL_LAG_S = 1.0  # of fusion behind its newest sample; the limit of row 5 holds it
Explanations = tuple[Explanation, ...]
Row = Callable[[Facts], Explanations]  # empty where the row does not match


@dataclass(frozen=True)
class Verdict:
    """State, the row that decided, and why.

    `reasons` begins with those of the deciding row, whose first is the one to be shown alone; those of later rows that
    match too follow. `findings` are sensors, satellites and neighbours that are accused or left out without lowering
    the verdict.
    """

    state: TrustLevel
    row: int
    reasons: Explanations
    findings: Explanations


def _no_solution(facts: Facts) -> Explanations:
    return (explain(Code.NO_SOLUTION_YET),) if facts.solution is None else ()


def solution_lost(facts: Facts) -> Explanations:
    """Row 2: why there is no position, or none that is current; empty before the first."""
    solution = facts.solution
    if solution is None:
        return ()
    age_s, limit_s = (facts.time_ns - solution.sampled_ns) / SECOND_NS, facts.limits.solution_silent_after_s
    if not -1.0 <= age_s <= limit_s:
        return (explain(Code.SOLUTION_OLD, age_s=age_s, limit_s=limit_s),)
    return () if solution.navigating else (explain(Code.SOLUTION_LOST, phase=solution.phase),)


def axes(facts: Facts) -> tuple[tuple[str, float | None, float], ...]:
    """Name, protection level and alert limit of each axis."""
    if facts.solution is None:
        return ()
    horizontal_m, vertical_m = facts.solution.protection_levels_m
    return (
        ("horizontal", horizontal_m, facts.limits.horizontal_m),
        ("vertical", vertical_m, facts.limits.vertical_m),
    )


def _above_alert_limit(facts: Facts) -> Explanations:
    """Row 3: a level above its limit, after what makes it more than a lack of accuracy."""
    levels = [
        explain(Code.LEVEL_MISSING, axis=axis)
        if level_m is None
        else explain(Code.LEVEL_ABOVE_LIMIT, axis=axis, level_m=level_m, limit_m=limit_m)
        for axis, level_m, limit_m in axes(facts)
        if level_m is None or not level_m <= limit_m
    ]
    return (*_cause_of_conflict(facts), *levels, *_both_sides(facts)) if levels else ()


def _cause_of_conflict(facts: Facts) -> Explanations:
    """What contradicts the position that must not be used; empty without a contradiction."""
    if _excluded(facts):
        return (explain(Code.UNSAFE_DEAD_RECKONING),)
    if surviving := _surviving(facts):
        code = Code.UNSAFE_SUSPECTED if len(surviving) <= NAMED_MAXIMUM else Code.UNSAFE_MANY_SUSPECTED
        return (explain(code, suspects=[posterior.hypothesis for posterior in surviving]), *_probabilities(surviving))
    return (explain(Code.UNSAFE_CONFLICT),) if facts.conflict_open else _still_off(facts)


def _still_off(facts: Facts) -> Explanations:
    """What a level still holds that would be within its limit without it, and what to do about it."""
    held_m = facts.held_m or (0.0, 0.0)
    of_held = [
        held > 0.0 and level_m is not None and level_m > limit_m >= level_m - held
        for held, (_, level_m, limit_m) in zip(held_m, axes(facts), strict=False)
    ]
    if not any(of_held):
        return ()
    why = {explanation.code for explanation in facts.held_why}
    if HELD_AFTER_LOSS in why and not HELD_OFFSETS & why:
        return (explain(Code.UNSAFE_HELD_AFTER_LOSS),)
    if HELD_AT_START in why:
        return (explain(Code.UNSAFE_HELD_AT_START),)
    return (explain(Code.UNSAFE_HELD_NEAR_PLACE if ENDS_AT_PLACE in why else Code.UNSAFE_HELD),)


def _both_sides(facts: Facts) -> Explanations:
    """What a level covers beside the uncertainty of the solution itself."""
    found = []
    if facts.other_distance_m is not None and facts.other_level_m is not None:
        other = "with_gnss" if facts.exclusion_confirmed else "without_gnss"
        found.append(
            explain(
                Code.SOLUTIONS_APART, other=other, distance_m=facts.other_distance_m, level_m=facts.other_level_m
            )
        )  # fmt: skip
    return (*found, *_held(facts))


def _held(facts: Facts) -> Explanations:
    if facts.held_m is None:
        return ()
    return (explain(Code.LEVEL_HELD, horizontal_m=facts.held_m[0], vertical_m=facts.held_m[1]), *facts.held_why)


def _not_reached(facts: Facts) -> Explanations:
    """Row 4: a hypothesis to whose solution the level does not reach."""
    unknown = tuple(
        explain(Code.NO_OTHER_SOLUTION, hypothesis=posterior.hypothesis)
        for posterior in facts.surviving
        if _is_unknown(facts, posterior.hypothesis)
    )
    found = (*_conflict(facts), *_satellite_fault(facts), *unknown)
    if not found or found[0].code == Code.SATELLITE_IN_USE or _excluded(facts) or not facts.surviving:
        return found
    return (*_cause_of_conflict(facts), *found)


def _is_unknown(facts: Facts, hypothesis: Hypothesis) -> bool:
    """Whether a hypothesis has no solution; those of GNSS and satellites are judged by what fusion says of them."""
    if hypothesis is Hypothesis.ODOMETER and not facts.odometer_in_use:
        return False
    return hypothesis in SOLVED_BY_THE_BANK and hypothesis not in facts.alternatives


def _conflict(facts: Facts) -> Explanations:
    """A conflict of GNSS of which fusion does not state both sides."""
    accusing = facts.accusing(AGAINST_GNSS, GNSS)
    if _excluded(facts) or facts.imu_exclusion_confirmed or not (accusing or facts.conflict_open):
        return ()
    if facts.conflict_open and (facts.other_level_m is not None or facts.exclusion_declined):
        return ()
    if facts.disturbed_since_ns is not None and not accusing:  # fusion holds the spread at the return
        return ()
    why = _statements(accusing) if accusing else (explain(Code.GNSS_NOT_AGREED),)
    return (explain(Code.NO_SOLUTION_WITHOUT_GNSS), *why)


def _satellite_fault(facts: Facts) -> Explanations:
    """A satellite that is accused, and not left out."""
    if _excluded(facts):
        return ()
    accusing = facts.accusing((Monitor.SATELLITES,))
    inside = [
        accused
        for statement in accusing
        for accused in statement.accused
        if accused not in facts.satellites_left_out and reference(accused).kind is not ReferenceKind.NEIGHBOUR
    ]
    if not inside:
        return ()
    return (explain(Code.SATELLITE_IN_USE, satellites=_references(inside)), *_statements(accusing))


def _without_gnss(facts: Facts) -> Explanations:
    """Row 5: dead reckoning, because GNSS is excluded or missing."""
    if _excluded(facts):
        accusing = facts.accusing(AGAINST_GNSS, GNSS)
        why = _statements(accusing) if accusing else (explain(Code.GNSS_NOT_AGREED),)
        return (explain(Code.GNSS_EXCLUDED), *why, *_both_sides(facts))
    return _coasting(facts)


def _coasting(facts: Facts) -> Explanations:
    if facts.solution is None or facts.imu_exclusion_confirmed:  # the position without inertial sensors is of GNSS
        return ()
    waited_s = max(0.0, facts.merge_lag_s - USUAL_LAG_S)
    age_s, limit_s = facts.solution.gnss_age_s, facts.limits.coasting_after_s + waited_s
    if age_s is None:
        return (explain(Code.NO_GNSS_YET),)
    return () if age_s <= limit_s else (explain(Code.GNSS_MISSING, age_s=age_s, limit_s=limit_s),)


def _unresolved(facts: Facts) -> Explanations:
    """Row 6: hypotheses that survive, sources that are not used, and monitors that doubt."""
    found: list[Explanation] = []
    if _surviving(facts) and not _excluded(facts):
        found += _of_hypotheses(facts)
    elif facts.conflict_open and not _excluded(facts):
        code = Code.CONFLICT if facts.disturbed_since_ns is None else Code.GNSS_BACK
        found += [explain(code), *_declined(facts), *_both_sides(facts)]
    if facts.imu_excluded and not facts.survives(Hypothesis.IMU):
        found.append(explain(Code.IMU_NOT_AGREED))
    if accusing := facts.accusing((Monitor.EVIDENCE,)):
        found += [explain(Code.GNSS_DISTURBED), *_statements(accusing)]
    for monitor in (*INERTIAL, Monitor.GYROSCOPE, Monitor.MOTION):
        statement = facts.statement(monitor)
        if statement.doubtful:  # also of one that is not evaluated: a question needs no learned scale
            found.append(explain(Code.MONITOR_DOUBTFUL, monitor=monitor))
    return tuple(found)


def _surviving(facts: Facts) -> tuple[Posterior, ...]:
    """Hypotheses that lower the verdict: not a satellite that is left out."""
    outside = not _satellite_fault(facts)
    return tuple(
        posterior for posterior in facts.surviving if not (posterior.hypothesis is Hypothesis.SATELLITES and outside)
    )


def _of_hypotheses(facts: Facts) -> Explanations:
    """Between which hypotheses nothing decides, or which one is acted on, and what the monitors say."""
    surviving = _surviving(facts)
    suspects = [posterior.hypothesis for posterior in surviving]
    said = [statement for statement in facts.accusing(tuple(Monitor)) if statement.monitor is not Monitor.EVIDENCE]
    rest = (*_probabilities(surviving), *_statements(said), *_declined(facts), *_both_sides(facts))
    if len(suspects) == 1 and _is_left_out(suspects[0], facts):
        return (explain(Code.SOURCE_LEFT_OUT, hypothesis=suspects[0]), *rest)
    code = Code.SUSPECTED if len(suspects) <= NAMED_MAXIMUM else Code.MANY_SUSPECTED
    decider = (explain(Code.DECIDED_BY, means=_decider(facts)),) if len(suspects) > 1 else ()
    return (explain(code, suspects=suspects), *decider, *rest)


def _probabilities(posteriors: Iterable[Posterior]) -> Explanations:
    return tuple(
        explain(Code.HYPOTHESIS, hypothesis=posterior.hypothesis, probability=posterior.probability)
        for posterior in posteriors
    )


def _declined(facts: Facts) -> Explanations:
    return (explain(Code.EXCLUSION_DECLINED),) if facts.exclusion_declined else ()


def _decider(facts: Facts) -> str:
    """What would decide between the hypotheses that survive."""
    names = {posterior.hypothesis for posterior in facts.surviving}
    if Hypothesis.GNSS_AND_ODOMETER in names:
        return "bends"
    if names >= {Hypothesis.GNSS, Hypothesis.IMU} and not facts.odometer_in_use:
        return "odometer"
    if names >= {Hypothesis.GNSS, Hypothesis.ODOMETER}:
        return "braking"
    return "return"


def _is_left_out(hypothesis: Hypothesis, facts: Facts) -> bool:
    """Whether the position is computed without the source of a hypothesis."""
    return (hypothesis is Hypothesis.ODOMETER and facts.odometer_excluded) or (
        hypothesis is Hypothesis.IMU and facts.imu_exclusion_confirmed
    )


def _silent(facts: Facts) -> Explanations:
    """Required monitors that do not publish; those that never have are named together."""
    silent = [monitor for monitor in Monitor if monitor in facts.limits.required and facts.is_silent(monitor)]
    missing = [monitor for monitor in silent if monitor not in facts.statements]
    known = [why for monitor in silent if monitor in facts.statements and (why := facts.statement(monitor).why)]
    return (*((explain(Code.MONITORS_MISSING, monitors=missing),) if missing else ()), *known)


def _not_checked(facts: Facts) -> Explanations:
    """Row 7: the position needs one independent check, of which there are two kinds, and monitors that are alive."""
    found: list[Explanation] = []
    if facts.solution is not None and facts.solution.gnss_only:
        found.append(explain(Code.NO_INERTIAL_UNIT))
    if facts.checks_paused:
        found.append(explain(Code.CHECKS_PAUSED))
    if len(_not_evaluated(facts)) == len(CHECKS):
        found += [explain(Code.NO_INDEPENDENT_CHECK), explain(Code.NOT_EVALUATED, monitors=CHECKS)]
    if facts.start_unconfirmed is not None:
        found.append(facts.start_unconfirmed)
    return (*found, *_silent(facts))


def _not_evaluated(facts: Facts) -> list[Monitor]:
    """Independent checks without an outcome."""
    return [monitor for monitor in CHECKS if facts.outcome(monitor) is Outcome.NOT_EVALUATED]


def _near_alert_limit(facts: Facts) -> Explanations:
    """Row 8: a level above a share of its limit, which it does not exceed."""
    share = facts.limits.near_share
    return tuple(
        explain(Code.LEVEL_NEAR_LIMIT, axis=axis, level_m=level_m, limit_m=limit_m, share=share)
        for axis, level_m, limit_m in axes(facts)
        if level_m is not None and share * limit_m < level_m <= limit_m
    )


def _excluded(facts: Facts) -> bool:
    return facts.gnss_excluded and facts.exclusion_confirmed


def _references(accused: Iterable[str]) -> tuple[Reference, ...]:
    return tuple(reference(name) for name in accused)[:ACCUSED_MAXIMUM]


def _statements(statements: Iterable[Statement]) -> Explanations:
    return tuple(_statement(statement) for statement in statements)


def _statement(statement: Statement) -> Explanation:
    accused = _references(statement.accused)
    since_ns = statement.stated_ns if statement.suspect_since_ns is None else statement.suspect_since_ns
    if statement.statistic is None or statement.threshold is None:
        return explain(Code.MONITOR_SUSPECTS_BY_RULE, monitor=statement.monitor, accused=accused, since_ns=since_ns)
    return explain(
        Code.MONITOR_SUSPECTS, monitor=statement.monitor, accused=accused, statistic=statement.statistic,
        threshold=statement.threshold, since_ns=since_ns,
    )  # fmt: skip


HELD_AT_START, ENDS_AT_PLACE = "fusion.held_at_start", "fusion.ends_at_place"  # codes of fusion
HELD_AFTER_LOSS, HELD_OFFSETS = "fusion.held_after_loss", {"fusion.held_step", "fusion.held_grew", HELD_AT_START}
ACCUSED_MAXIMUM = 16  # named of one statement
CHECKS = (*INERTIAL, Monitor.SATELLITES)  # independent of the position
SOLVED_BY_THE_BANK = (
    Hypothesis.IMU, Hypothesis.ODOMETER, Hypothesis.GNSS_AND_ODOMETER, Hypothesis.RECEIVER_TIME,
)  # fmt: skip
ROWS: tuple[tuple[TrustLevel, Row], ...] = (
    (TrustLevel.INITIALISING, _no_solution),
    (TrustLevel.NO_FIX, solution_lost),
    (TrustLevel.UNSAFE, _above_alert_limit),
    (TrustLevel.UNSAFE, _not_reached),
    (TrustLevel.DEAD_RECKONING, _without_gnss),
    (TrustLevel.CAUTION, _unresolved),
    (TrustLevel.CAUTION, _not_checked),
    (TrustLevel.CAUTION, _near_alert_limit),
)


def findings(facts: Facts) -> Explanations:
    """Sensors, satellites and neighbours that are accused, satellites that are left out, and checks that are missing.

    A check that is not evaluated lowers nothing while another one is.
    """
    accused = {name for statement in facts.accusing(tuple(Monitor)) for name in statement.accused}
    found = [explain(_consequence(name, facts), reference(name)) for name in sorted(accused)]
    if facts.odometer_excluded and ODOMETER not in accused:
        found.append(explain(Code.ODOMETER_LEFT_OUT))
    found += [
        explain(Code.SATELLITE_EXCLUDED, Reference(kind=ReferenceKind.SATELLITE, name=name))
        for name in sorted(facts.satellites_left_out)
    ]
    if facts.checks_paused:
        found.append(explain(Code.CHECKS_PAUSED))
    if facts.fixes_late_s is not None:
        found.append(explain(Code.FIXES_LATE, late_s=facts.fixes_late_s))
    found += _held(facts)
    if missing := _not_evaluated(facts):
        found.append(explain(Code.NOT_EVALUATED, monitors=missing))
    return tuple(found[:FINDINGS_MAXIMUM])


def _consequence(name: str, facts: Facts) -> Code:
    """What follows for a source that is suspected."""
    left_out = {GNSS: _excluded(facts), ODOMETER: facts.odometer_excluded, IMU: facts.imu_exclusion_confirmed}
    if name not in left_out:
        return Code.ACCUSED
    return Code.ACCUSED_LEFT_OUT if left_out[name] else Code.ACCUSED_IN_USE


def _safe(facts: Facts) -> Explanation:
    """Why the position can be used."""
    (_, horizontal_m, horizontal_limit_m), (_, vertical_m, vertical_limit_m) = axes(facts)
    without = any(
        posterior.acted_on for posterior in facts.surviving
    )  # what survives in a position that is SAFE is left out
    return explain(
        Code.SAFE_WITHOUT_SATELLITES if without else Code.SAFE, horizontal_m=horizontal_m, vertical_m=vertical_m,
        horizontal_limit_m=horizontal_limit_m, vertical_limit_m=vertical_limit_m,
    )  # fmt: skip


def verdict(facts: Facts) -> Verdict:
    """Apply the table of this module to the facts."""
    matching = [(row, state, found) for row, (state, find) in enumerate(ROWS, 1) if (found := find(facts))]
    if not matching:
        return Verdict(TrustLevel.SAFE, len(ROWS) + 1, (_safe(facts),), findings(facts))
    row, state, _ = matching[0]
    reasons: list[Explanation] = []
    for explanation in (item for _, _, pair in matching for item in pair):
        if explanation not in reasons:  # two rows may rest on the same statement
            reasons.append(explanation)
    return Verdict(state, row, tuple(reasons[:REASONS_MAXIMUM]), findings(facts))

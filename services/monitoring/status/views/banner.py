"""One sentence first: can this position be used, and if not, why and what to do.

The verdict is made in `core.trust` alone; this module puts `trust/state` into words. SAFE is shown when, and only when,
the newest `trust/state` is within its deadline and says so.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from math import degrees

from shared.messages.gnss import FixType, GnssFix
from shared.messages.navigation import (
    AidingKind,
    AidingUpdate,
    NavigationPhase,
    NavigationSolution,
    SetUpState,
    SetUpVerdict,
)
from shared.messages.operation import ProcessLoad
from shared.messages.trust import MonitorOutcome, TrustLevel, TrustState
from shared.missing_sensors import NO_INERTIAL_UNIT
from shared.runtime.freshness import STARTUP_GRACE_S, limits_of
from shared.topics import BY_NAME

from .geometry import vertical_sd
from .hypotheses import figures, sentence_of, suspected
from .plain_words import label_of, plain, sentence, who

HEADING_SD_LIMIT_DEG = 3.0  # above, a heading misleads more than it helps: 5 % of the distance sideways
FITS = {AidingKind.NON_HOLONOMIC: "Non-holonomic constraint"}
NOTHING_TO_JUDGE = "there is no position to judge"
GATE_LIMIT = 1.0  # by definition of the test ratio
AIDING_RECENT_S = 5.0
RATIO_MAXIMUM = 9.99
MONITORS_MAXIMUM = 16  # shown


class Trust(StrEnum):
    """State of the banner, or of a check: those of `TrustLevel`, and what is not known or not evaluated.

    UNSAFE for an exceeded alert limit is a state of its own: its cause is accuracy, not an accusation.
    """

    SAFE = "safe"
    CAUTION = "caution"
    UNSAFE = "unsafe"
    ABOVE_LIMIT = "above_limit"
    DEAD_RECKONING = "dead_reckoning"
    NO_FIX = "no_fix"
    INITIALISING = "initialising"
    STARTING = "starting"  # nothing newer than the last start of a process or of the broker is received yet
    STALE = "stale"
    BROKER_LOST = "broker_lost"
    OFF = "off"


WORDS = {
    Trust.SAFE: "SAFE",
    Trust.CAUTION: "CAUTION",
    Trust.UNSAFE: "UNSAFE",
    Trust.ABOVE_LIMIT: "ABOVE LIMIT",
    Trust.DEAD_RECKONING: "DEAD RECKONING",
    Trust.NO_FIX: "NO POSITION",
    Trust.INITIALISING: "INITIALISING",
    Trust.STARTING: "STARTING",
    Trust.STALE: "NO DATA",
    Trust.BROKER_LOST: "BROKER LOST",
    Trust.OFF: "NOT EVALUATED",
}
KNOWN = frozenset(Trust(level.value) for level in TrustLevel) | {Trust.ABOVE_LIMIT}  # a verdict is there
ROW_ABOVE_LIMIT = 3  # of the verdict table of `core.trust`
OUTCOMES = {
    MonitorOutcome.PASS: Trust.SAFE,
    MonitorOutcome.ACCUSES: Trust.UNSAFE,
    MonitorOutcome.NOT_EVALUATED: Trust.OFF,
}


class Kind(StrEnum):
    """What a check shows."""

    MONITOR = "monitor"  # outcome of an integrity monitor, from `trust/state`
    INPUT = "input"  # a measurement or a result that the monitors and the filter use


@dataclass(frozen=True)
class Evidence:
    """What the banner shows; ages in seconds, None for what did not come since the last start of its producer."""

    broker: bool
    received_ns: int | None = None  # stamp of the newest message of all
    awaited: str | None = None  # what is to come after a start, as long as nothing is known to keep it away
    earlier_monitors: frozenset[str] = frozenset()  # their process was restarted since their last statement
    trust: TrustState | None = None
    trust_age_s: float | None = None
    trust_cause: str | None = None  # root cause of a missing or old verdict
    solution: NavigationSolution | None = None
    solution_age_s: float | None = None
    filter_says: str | None = None  # the filter's own reason for its phase
    phase: NavigationPhase | None = None
    fix: GnssFix | None = None
    fix_age_s: float | None = None
    imu_age_s: float | None = None
    odometer_age_s: float | None = None
    aiding: Mapping[AidingKind, tuple[AidingUpdate, float]] | None = None  # newest of each kind, and its age
    alert_limit_horizontal_m: float | None = None  # as configured, from `navigation/state`
    alert_limit_vertical_m: float | None = None
    set_up: SetUpState | None = None
    cause: str | None = None  # root cause of a missing or old solution
    load: ProcessLoad | None = None  # of core.fusion, while it is behind or checks are paused


@dataclass(frozen=True)
class Check:
    """One line of the list behind the verdict: statistic, limit, result."""

    name: str
    label: str
    state: Trust  # safe here means: this check passes
    text: str
    ratio: float | None = None  # statistic over limit, where there is one: 1 is the limit
    link: str = ""  # page of the dashboard
    kind: Kind = Kind.INPUT


@dataclass(frozen=True)
class Verdict:
    """The banner: a state, one sentence, what to do, and the checks."""

    state: Trust
    sentence: str
    action: str
    checks: tuple[Check, ...]
    reasons: tuple[str, ...] = ()  # with statistics, for those who ask why
    since_ns: int | None = None  # of the state
    row: int | None = None  # of the verdict table of `core.trust` that decided


WAITING = {
    NavigationPhase.WAITING_FOR_IMU: "no inertial data are received",
    NavigationPhase.LEVELLING: "stand still for a few seconds",
    NavigationPhase.WAITING_FOR_GNSS: "no usable GNSS fix is received",
    NavigationPhase.WAITING_FOR_HEADING: "the heading is not known: drive a few metres",
}
NOT_CHECKED = (TrustLevel.CAUTION, 7)  # state and row without an independent check
SENTENCES = {
    TrustLevel.SAFE: "The position can be used",
    TrustLevel.CAUTION: "Use the position with caution",
    TrustLevel.UNSAFE: "The position must not be used",
    TrustLevel.DEAD_RECKONING: "Position by dead reckoning",
    TrustLevel.NO_FIX: "No position",
    TrustLevel.INITIALISING: "No position yet",
}
# Why, by the row of the verdict table of `core.trust` that decided; the state tells rows of earlier releases apart.
NO_GNSS = "no GNSS is received that can be used"
WHY = {
    (TrustLevel.INITIALISING, 1): "the first solution is awaited",
    (TrustLevel.NO_FIX, 2): "there is no current solution",
    (TrustLevel.UNSAFE, 3): "its error may be above the alert limit",
    (TrustLevel.UNSAFE, 4): "a source is suspected, and it is not known where the vehicle is without it",
    (TrustLevel.DEAD_RECKONING, 5): "GNSS is not used, because other sensors contradict it",
    (TrustLevel.CAUTION, 6): "there are signs that a source may be wrong",
    (TrustLevel.CAUTION, 7): "no independent check of it is complete",
    (TrustLevel.CAUTION, 8): "its error may come close to the alert limit",
    (TrustLevel.UNSAFE, 5): "it contains a satellite that is suspected",
    (TrustLevel.UNSAFE, 6): "GNSS and the odometer disagree, and it is not known which of them is wrong",
    (TrustLevel.DEAD_RECKONING, 7): "GNSS is not used, because other sensors contradict it",
    (TrustLevel.DEAD_RECKONING, 8): NO_GNSS,
    (TrustLevel.CAUTION, 10): "there are signs that GNSS may be disturbed",
    (TrustLevel.CAUTION, 11): "a monitor that is required does not report",
    (TrustLevel.CAUTION, 12): "nothing independent checks it yet",
    (TrustLevel.CAUTION, 13): "its error may come close to the alert limit",
}
ROWS_CONFLICT = (6, 9)  # 9 of earlier releases
ROW_WITHOUT_GNSS = 5
# Rows with a cause of their own, whatever hypotheses survive beside it.
OTHER_CAUSES = {
    (TrustLevel.UNSAFE, 5),
    (TrustLevel.DEAD_RECKONING, 8),
    (TrustLevel.CAUTION, 7),
    (TrustLevel.CAUTION, 11),
    (TrustLevel.CAUTION, 12),
}
JUDGED = (TrustLevel.CAUTION, TrustLevel.UNSAFE, TrustLevel.DEAD_RECKONING)
ACTIONS = {
    TrustLevel.SAFE: "Use the position within its protection level. The Trust page shows every monitor.",
    TrustLevel.CAUTION: (
        "Use it for route guidance, not where a wrong position does harm. The Trust page shows what is not evaluated."
    ),
    TrustLevel.UNSAFE: (
        "Do not use the position shown. Check the antenna and leave the area of interference; the Trust page shows the "
        "evidence."
    ),
    TrustLevel.DEAD_RECKONING: "Expect the error to grow with distance and time, until GNSS is used again.",
    TrustLevel.NO_FIX: (
        "Do not use the position shown. It is the last one known, and the circle grows with time. "
        "The checks show which input is missing."
    ),
    TrustLevel.INITIALISING: (
        "The checks show which input is missing. Outdoors a first position takes up to a minute."
    ),
}  # fmt: skip
ABOVE_LIMIT_ACTION = (
    "Do not use the position where an error above the alert limit does harm. The protection level falls with more "
    "satellites, corrections or a moving vehicle. The alert limits are set in the vehicle's file."
)
TOO_SLOW_ACTION = (
    "End other programs on this computer, check its temperature and power supply, lower the rates of the sensors, or "
    "use a faster one. Everything is resumed by itself."
)


def show(evidence: Evidence) -> Verdict:
    """Make the banner of the newest `trust/state`, or say why there is no verdict."""
    e, checks = evidence, tuple(_checks(evidence))
    if not e.broker:
        return Verdict(
            Trust.BROKER_LOST,
            f"Nothing is known: {e.cause or 'the broker is not reachable'}.",
            "Start the broker or read its log. All messages pass through it; processes reconnect by themselves.",
            tuple(replace(check, state=Trust.STALE, text="not known", ratio=None) for check in checks),
            since_ns=e.received_ns,
        )
    if e.awaited:
        return Verdict(
            Trust.STARTING,
            f"Nothing is known yet: waiting for {e.awaited}.",
            "Wait a few seconds. If it lasts, the page System shows which process does not publish.",
            checks,
        )
    if e.trust is None or (missing := no_verdict(e.trust_age_s)):
        why = "no verdict of core.trust" if e.trust is None else missing
        return Verdict(
            Trust.STALE,
            sentence(f"Trust is not evaluated: {why}", e.trust_cause),
            "Do not rely on the position shown: no monitor is evaluated. The log of core.trust has the reason.",
            checks,
        )
    return _verdict(e, e.trust, checks)


def no_verdict(age_s: float | None) -> str | None:
    """Time without a verdict, as text; None while the newest is within its deadline."""
    if age_s is not None and age_s < _stale_after_s("trust/state"):
        return None
    return "no verdict" if age_s is None else f"no verdict for {age_s:.0f} s"


def _verdict(e: Evidence, trust: TrustState, checks: tuple[Check, ...]) -> Verdict:
    waiting = WAITING.get(e.phase) if e.phase else None
    slow = _too_slow(e, trust)
    known = {TrustLevel.NO_FIX: slow or e.cause or waiting, TrustLevel.INITIALISING: waiting or e.cause}.get(
        trust.state
    )
    if (trust.state, trust.row) == NOT_CHECKED and e.phase is NavigationPhase.GNSS_ONLY:
        known = NO_INERTIAL_UNIT
    elif (trust.state, trust.row) == NOT_CHECKED:
        known = slow
    why = known or _which_is_wrong(e, trust) or _why(trust)
    conflict = trust.suspect_since_ns is not None or suspected(trust.beliefs)
    above = trust.state is TrustLevel.UNSAFE and trust.row == ROW_ABOVE_LIMIT and not conflict
    return Verdict(
        Trust.ABOVE_LIMIT if above else Trust(trust.state.value),
        sentence(f"{SENTENCES[trust.state]}{f': {why}' if why else ''}"),
        ABOVE_LIMIT_ACTION if above else TOO_SLOW_ACTION if slow and known == slow else ACTIONS[trust.state],
        checks,
        (*(plain(reason) for reason in trust.reasons), *figures(trust.beliefs)),
        trust.since_ns,
        trust.row,
    )


def _too_slow(e: Evidence, trust: TrustState) -> str | None:
    """Why this computer is the cause of a verdict: it is too slow for the checks, or even for the position."""
    load = e.load
    if load is None or not load.paused:
        return None
    if trust.state is TrustLevel.NO_FIX:
        return f"this computer is too slow, and {load.lag_s:.0f} s behind the sensors"
    return "checks are paused, because this computer is too slow"


def _which_is_wrong(e: Evidence, trust: TrustState) -> str | None:
    """Name what may be wrong by the hypotheses that survive; where the position can be used, only what is acted on."""
    beliefs = trust.beliefs
    if trust.state is TrustLevel.SAFE:
        beliefs = tuple(one for one in beliefs if one.acted_on)
    elif trust.state not in JUDGED or (trust.state, trust.row) in OTHER_CAUSES or _without_gnss(trust):
        return None
    return sentence_of(beliefs, odometer=e.odometer_age_s is not None and not trust.odometer_excluded)


def _without_gnss(trust: TrustState) -> bool:
    """Whether GNSS is missing and not excluded."""
    return (trust.state, trust.row, trust.gnss_excluded) == (TrustLevel.DEAD_RECKONING, ROW_WITHOUT_GNSS, False)


def _why(trust: TrustState) -> str | None:
    """Say why in a few words without figures; None where the state says it all."""
    if _without_gnss(trust):
        return NO_GNSS
    if trust.state is TrustLevel.CAUTION and trust.row in ROWS_CONFLICT:
        if trust.odometer_excluded:
            return "the odometer is not used, because GNSS and the inertial sensors contradict it"
        if trust.suspect_since_ns is not None:
            return "GNSS and other sensors disagree, and it is not known which of them is wrong"
        if trust.row == ROWS_CONFLICT[1]:
            return "GNSS and the odometer disagree"
    return WHY.get((trust.state, trust.row))


def _checks(e: Evidence) -> list[Check]:
    return [
        *_monitor_checks(e),
        _protection_check(e),
        _fix_check(e),
        _age_check("imu", "Inertial unit", e.imu_age_s, "imu/sample", "samples"),
        _phase_check(e),
        _heading_check(e),
        *_set_up_checks(e),
        *_gate_checks(e),
        _age_check("odometer", "Vehicle speed", e.odometer_age_s, "vehicle/wheel_speed", "speed"),
    ]


def _monitor_checks(e: Evidence) -> list[Check]:
    """Show the outcome of each monitor as `core.trust` used it; of an old verdict none is known to hold any more."""
    if e.trust is None:
        return []
    checks = []
    for statement in e.trust.monitors[:MONITORS_MAXIMUM]:
        earlier = "no statement since its process was restarted" if statement.monitor in e.earlier_monitors else None
        nothing = NOTHING_TO_JUDGE if e.trust.state is TrustLevel.NO_FIX else None
        missing = no_verdict(e.trust_age_s) or earlier or nothing
        text = plain(statement.reason)
        ratio = ratio_of(statement.outcome, statement.statistic, statement.threshold)
        if statement.accused:
            text = f"suspects {who(statement.accused)}: {text}"
        elif statement.outcome is MonitorOutcome.PASS and ratio is not None:
            text = f"{100.0 * ratio:.0f} % of threshold"
        checks.append(
            Check(
                statement.monitor,
                label_of(statement.monitor),
                Trust.STALE if missing else OUTCOMES[statement.outcome],
                missing or text,
                None if missing or ratio is None else min(ratio, RATIO_MAXIMUM),
                f"trust?monitor={statement.monitor}",
                Kind.MONITOR,
            )
        )
    return checks


def ratio_of(outcome: MonitorOutcome, statistic: float | None, threshold: float | None) -> float | None:
    """Statistic over threshold [-], above 1 the test accuses; None where nothing was evaluated or has no threshold."""
    if outcome is MonitorOutcome.NOT_EVALUATED or statistic is None or threshold is None or threshold <= 0.0:
        return None
    return max(statistic / threshold, 0.0)


def _fix_check(e: Evidence) -> Check:
    label, link = "GNSS fix", "system?topic=gnss/fix"
    if e.fix is None or e.fix_age_s is None:
        return Check("fix", label, Trust.STALE, "none received", link=link)
    satellites = "" if e.fix.satellites_used is None else f", {e.fix.satellites_used} satellites"
    limit_s = _stale_after_s("gnss/fix")
    if e.fix_age_s >= limit_s:
        return Check("fix", label, Trust.STALE, f"older than {limit_s:g} s", link=link)
    if e.fix.fix_type in (FixType.NONE, FixType.TIME_ONLY, FixType.DEAD_RECKONING):
        return Check("fix", label, Trust.CAUTION, f"the receiver has no position{satellites}", link=link)
    kind = e.fix.fix_type.replace("two_d", "2-D").replace("three_d", "3-D").replace("_", " ")
    return Check("fix", label, Trust.SAFE, f"{kind}{satellites}", link=link)


def _age_check(name: str, label: str, age_s: float | None, topic: str, what: str) -> Check:
    limit_s = _stale_after_s(topic)
    if age_s is None:
        state = Trust.OFF if name == "odometer" else Trust.STALE
        return Check(name, label, state, f"no {what} received", link=f"system?topic={topic}")
    if age_s >= limit_s:
        return Check(name, label, Trust.STALE, f"no {what} for more than {limit_s:g} s", link=f"system?topic={topic}")
    return Check(name, label, Trust.SAFE, f"{what} in time", link=f"system?topic={topic}")


def _phase_check(e: Evidence) -> Check:
    link = "system?topic=navigation/state"
    if e.phase is None:
        return Check("phase", "Filter", Trust.STALE, "does not publish its state", link=link)
    text = e.phase.replace("_", " ").replace("imu", "IMU").replace("gnss", "GNSS")
    text = text.replace("GNSS only", "GNSS only: no inertial unit")
    if e.phase is NavigationPhase.NAVIGATING:
        return Check("phase", "Filter", Trust.SAFE, text, link=link)
    return Check("phase", "Filter", Trust.CAUTION, f"{text}: {e.filter_says}" if e.filter_says else text, link=link)


def _heading_check(e: Evidence) -> Check:
    if e.solution is None or _is_old(e):
        return Check("heading", "Heading", Trust.STALE, "unknown", link="system?topic=navigation/solution")
    sd_deg = _heading_sd_deg(e.solution)
    state = Trust.SAFE if sd_deg <= HEADING_SD_LIMIT_DEG else Trust.CAUTION
    text = f"± {sd_deg:.1f}° (1 σ), limit {HEADING_SD_LIMIT_DEG:g}°"
    return Check(
        "heading",
        "Heading",
        state,
        text,
        min(sd_deg / HEADING_SD_LIMIT_DEG, RATIO_MAXIMUM),
        "system?topic=navigation/solution",
    )


def _set_up_checks(e: Evidence) -> list[Check]:
    """Show what driving has found wrong with the set-up; the page System has all checks and the settings to paste."""
    return [
        Check(
            f"set-up {check.name}", "Installation", Trust.CAUTION, check.sentence, link="system?topic=navigation/set_up"
        )
        for check in (e.set_up.checks if e.set_up else ())
        if check.verdict is SetUpVerdict.CONTRADICTS
    ]


def _protection_check(e: Evidence) -> Check:
    """Compare the protection levels with the alert limits of the vehicle's configuration; the worse axis counts."""
    name, label, link = "protection", "Protection level", "system?topic=navigation/solution"
    if e.solution is None or _is_old(e):
        return Check(name, label, Trust.STALE, "unknown", link=link)
    axes = [
        ("horizontal", e.solution.protection_level_horizontal_m, e.alert_limit_horizontal_m),
        ("vertical", e.solution.protection_level_vertical_m, e.alert_limit_vertical_m),
    ]
    levels = [(axis, level_m, limit_m) for axis, level_m, limit_m in axes if level_m is not None]
    if not levels:
        return Check(name, label, Trust.OFF, "not published by the filter", link=link)
    text = ", ".join(
        f"{level_m:.1f} m {axis}" + ("" if limit_m is None else f" (limit {limit_m:g} m)")
        for axis, level_m, limit_m in levels
    )
    ratios = [level_m / limit_m for _, level_m, limit_m in levels if limit_m is not None]
    if not ratios:
        return Check(name, label, Trust.STALE, f"{text}; alert limits not received", link=link)
    state = Trust.SAFE if max(ratios) <= 1.0 else Trust.ABOVE_LIMIT
    return Check(name, label, state, text, min(max(ratios), RATIO_MAXIMUM), link)


def _gate_checks(e: Evidence) -> list[Check]:
    """Show the newest innovation of each kind against its gate."""
    checks = []
    for kind, update, _ in _recent(e):
        good = update.used and update.test_ratio <= GATE_LIMIT
        text = f"{100.0 * update.test_ratio:.0f} % of limit" + ("" if update.used else ", discarded")
        label = f"{FITS.get(kind) or _capital(kind.replace('_', ' ').replace('gnss', 'GNSS'))} residual"
        state = Trust.SAFE if good else Trust.CAUTION
        checks.append(
            Check(
                f"gate {kind}",
                label,
                state,
                text,
                min(update.test_ratio, RATIO_MAXIMUM),
                "system?topic=navigation/aiding",
            )
        )
    return checks or [
        Check(
            "gate",
            "Residuals",
            Trust.STALE,
            f"none in {AIDING_RECENT_S:g} s",
            link="system?topic=navigation/aiding",
        )
    ]


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _is_old(e: Evidence) -> bool:
    return e.solution_age_s is None or e.solution_age_s >= _stale_after_s("navigation/solution")


def _recent(e: Evidence) -> list[tuple[AidingKind, AidingUpdate, float]]:
    entries = (e.aiding or {}).items()
    return [(kind, update, age_s) for kind, (update, age_s) in entries if age_s < AIDING_RECENT_S]


def _heading_sd_deg(solution: NavigationSolution) -> float:
    return degrees(vertical_sd(solution.attitude_cov_ned_rad2))


def _stale_after_s(topic: str) -> float:
    limits = limits_of(BY_NAME[topic])
    return limits.stale_after_s if limits else STARTUP_GRACE_S

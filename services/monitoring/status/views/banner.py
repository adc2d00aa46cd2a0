"""One sentence first: can this position be used, and if not, why and what to do.

The verdict is made in `core.trust` alone; this module shows the words of its first code. SAFE is shown when, and only
when, the newest `trust/state` is within its deadline and says so. What the banner itself says has codes too, and
`words.toml` beside this file has their words.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from math import degrees

from shared.bus.codes import broker_down
from shared.messages.explanation import Explanation, explain
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
from shared.messages.trust import Outcome, TrustLevel, TrustState
from shared.runtime.freshness import STARTUP_GRACE_S, limits_of
from shared.topics import BY_NAME
from shared.trust.accused import reference
from shared.trust.result import told
from shared.words.words import ENGLISH, LANGUAGES, CodedText, Words, reason, said, stated, words

from .codes import Code
from .geometry import vertical_sd
from .hypotheses import figures
from .plain_words import label_of

HEADING_SD_LIMIT_DEG = 3.0  # above, a heading misleads more than it helps: 5 % of the distance sideways
GATE_LIMIT = 1.0  # by definition of the test ratio
AIDING_RECENT_S = 5.0
RATIO_MAXIMUM = 9.99
MONITORS_MAXIMUM = 16  # shown
ACCUSED_MAXIMUM = 16


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


WORDS = {state: words().name("state", state) for state in Trust}
KNOWN = frozenset(Trust(level.value) for level in TrustLevel) | {Trust.ABOVE_LIMIT}  # a verdict is there
OUTCOMES = {
    Outcome.PASS: Trust.SAFE,
    Outcome.ACCUSES: Trust.UNSAFE,
    Outcome.NOT_EVALUATED: Trust.OFF,
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
    awaited: CodedText | None = None  # what is to come after a start, as long as nothing is known to keep it away
    earlier_monitors: frozenset[str] = frozenset()  # their process was restarted since their last statement
    trust: TrustState | None = None
    trust_age_s: float | None = None
    trust_cause: CodedText | None = None  # root cause of a missing or old verdict
    solution: NavigationSolution | None = None
    solution_age_s: float | None = None
    filter_codes: tuple[Explanation, ...] = ()  # why the filter is in its phase
    filter_says: str | None = None  # the same as its own text
    phase: NavigationPhase | None = None
    fix: GnssFix | None = None
    fix_age_s: float | None = None
    imu_age_s: float | None = None
    odometer_age_s: float | None = None
    aiding: Mapping[AidingKind, tuple[AidingUpdate, float]] | None = None  # newest of each kind, and its age
    alert_limit_horizontal_m: float | None = None  # as configured, from `navigation/state`
    alert_limit_vertical_m: float | None = None
    set_up: SetUpState | None = None
    cause: CodedText | None = None  # root cause of a missing or old solution
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


OF_STATE = {level: Code(f"banner.{level.value}") for level in TrustLevel}


@dataclass(frozen=True)
class Line:
    """Sentence and what to do, in one language."""

    sentence: str
    action: str


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
    lines: Mapping[str, Line] = field(default_factory=dict)  # in languages other than English


WAITING_STATES = frozenset(
    (
        NavigationPhase.WAITING_FOR_IMU,
        NavigationPhase.LEVELLING,
        NavigationPhase.WAITING_FOR_GNSS,
        NavigationPhase.WAITING_FOR_HEADING,
    )
)


def show(evidence: Evidence) -> Verdict:
    """Make the banner of the newest `trust/state`, or say why there is no verdict."""
    e, checks = evidence, tuple(_checks(evidence))
    if not e.broker:
        unknown = reason(explain(Code.CHECK_UNKNOWN))
        stale = tuple(replace(check, state=Trust.STALE, text=unknown, ratio=None) for check in checks)
        lines = _lines(explain(Code.BROKER_LOST), cause=e.cause or stated(broker_down(connected=False)))
        return _spoken(Trust.BROKER_LOST, lines, stale, since_ns=e.received_ns)
    if e.awaited:
        return _spoken(Trust.STARTING, _lines(explain(Code.STARTING), cause=e.awaited), checks)
    if e.trust is None or no_verdict(e.trust_age_s):
        return _spoken(Trust.STALE, _without_verdict(e), checks)
    return _verdict(e, e.trust, checks)


def _lines(
    explanation: Explanation, state: TrustLevel | None = None, text: str = "", cause: CodedText | None = None
) -> dict[str, Line]:
    """Put a code into words in every language.

    Parameters
    ----------
    explanation : Explanation
        What is to be said.
    state : TrustLevel, optional
        Whose words are used for what the code has none.
    text : str
        The message's own text of this code, shown where the code has no words.
    cause : Told, optional
        What the sentence names as its cause.
    """
    return {language: _line(words(language), explanation, state, text, cause) for language in LANGUAGES}


def _line(
    spoken: Words, explanation: Explanation, state: TrustLevel | None, text: str, cause: CodedText | None
) -> Line:
    general = None if state is None else explain(OF_STATE[state])
    sentence = spoken.sentence(explanation, **({"cause": cause} if cause else {})) or text
    action = spoken.action(explanation)
    if general is not None:
        sentence, action = sentence or spoken.sentence(general) or "", action or spoken.action(general)
    return Line(sentence, action or "")


def _without_verdict(e: Evidence) -> dict[str, Line]:
    if e.trust is None or e.trust_age_s is None:
        why = explain(Code.NO_VERDICT_CAUSE if e.trust_cause else Code.NO_VERDICT)
    else:
        why = explain(Code.OLD_VERDICT_CAUSE if e.trust_cause else Code.OLD_VERDICT, age_s=round(e.trust_age_s))
    return _lines(why, cause=e.trust_cause)


def no_verdict(age_s: float | None) -> Explanation | None:
    """Time without a verdict; None while the newest is within its deadline."""
    if age_s is not None and age_s < _stale_after_s("trust/state"):
        return None
    return explain(Code.CHECK_NO_VERDICT) if age_s is None else explain(Code.CHECK_OLD_VERDICT, age_s=round(age_s))


def _verdict(e: Evidence, trust: TrustState, checks: tuple[Check, ...]) -> Verdict:
    """Show what decided, by its code; without one, as in recordings of earlier releases, by its reason as it is."""
    deciding = trust.reason_codes[0] if trust.reason_codes else explain(OF_STATE[trust.state])
    text = trust.reasons[0] if trust.reasons else ""
    known = _cause(e, trust)
    if known is None and not trust.reason_codes and text:
        lines = {language: replace(line, sentence=text) for language, line in _lines(deciding).items()}
    else:
        lines = _lines(known or deciding, trust.state, text, e.cause)
    return _spoken(
        Trust(words().row(deciding.code).level or trust.state.value),
        lines,
        checks,
        (*details(trust.reasons, trust.reason_codes), *figures(trust.beliefs)),
        trust.since_ns,
        trust.row,
    )


def _spoken(
    state: Trust,
    lines: Mapping[str, Line],
    checks: tuple[Check, ...],
    reasons: tuple[str, ...] = (),
    since_ns: int | None = None,
    row: int | None = None,
) -> Verdict:
    english = lines[ENGLISH]
    others = {language: line for language, line in lines.items() if language != ENGLISH}
    return Verdict(state, english.sentence, english.action, checks, reasons, since_ns, row, others)


def _cause(e: Evidence, trust: TrustState) -> Explanation | None:
    """Why there is no position, where this process knows more of it than `core.trust`."""
    waiting = e.phase in WAITING_STATES
    match trust.state:
        case TrustLevel.NO_FIX if e.load is not None and e.load.paused:
            return explain(Code.NO_FIX_SLOW, lag_s=round(e.load.lag_s))
        case TrustLevel.NO_FIX if e.cause:
            return explain(Code.NO_FIX_CAUSE)
        case TrustLevel.NO_FIX if waiting:
            return explain(Code.NO_FIX_WAITING, phase=e.phase)
        case TrustLevel.INITIALISING if waiting:
            return explain(Code.INITIALISING_WAITING, phase=e.phase)
        case TrustLevel.INITIALISING if e.cause:
            return explain(Code.INITIALISING_CAUSE)
        case _:
            return None


def details(reasons: Sequence[str], codes: Sequence[Explanation]) -> list[str]:
    """Say reasons with their figures: by their codes, and what has no code or no row by the message's own text."""
    found = [said(text, code) for code, text in zip(codes, reasons, strict=False)]
    return [*found, *reasons[len(found) :]]


def _checks(e: Evidence) -> list[Check]:
    return [
        *_monitor_checks(e),
        _protection_check(e),
        _fix_check(e),
        _age_check("imu", e.imu_age_s, "imu/sample"),
        _phase_check(e),
        _heading_check(e),
        *_set_up_checks(e),
        *_gate_checks(e),
        _age_check("odometer", e.odometer_age_s, "vehicle/wheel_speed"),
    ]


def _monitor_checks(e: Evidence) -> list[Check]:
    """Show the outcome of each monitor as `core.trust` used it; of an old verdict none is known to hold any more."""
    if e.trust is None:
        return []
    checks = []
    for statement in e.trust.monitors[:MONITORS_MAXIMUM]:
        earlier = explain(Code.CHECK_RESTARTED) if statement.monitor in e.earlier_monitors else None
        nothing = explain(Code.CHECK_NO_POSITION) if e.trust.state is TrustLevel.NO_FIX else None
        missing = no_verdict(e.trust_age_s) or earlier or nothing
        text = told(statement)
        ratio = ratio_of(statement.outcome, statement.statistic, statement.threshold)
        if statement.accused:
            accused = tuple(reference(name) for name in statement.accused[:ACCUSED_MAXIMUM])
            text = f"{reason(explain(Code.CHECK_SUSPECTS, accused=accused))}; {text}"
        elif statement.outcome is Outcome.PASS and ratio is not None:
            text = reason(explain(Code.CHECK_SHARE, share=round(ratio, 2)))
        checks.append(
            Check(
                statement.monitor,
                label_of(statement.monitor),
                Trust.STALE if missing else OUTCOMES[statement.outcome],
                reason(missing) if missing else text,
                None if missing or ratio is None else min(ratio, RATIO_MAXIMUM),
                f"trust?monitor={statement.monitor}",
                Kind.MONITOR,
            )
        )
    return checks


def ratio_of(outcome: Outcome, statistic: float | None, threshold: float | None) -> float | None:
    """Statistic over threshold [-], above 1 the test accuses; None where nothing was evaluated or has no threshold."""
    if outcome is Outcome.NOT_EVALUATED or statistic is None or threshold is None or threshold <= 0.0:
        return None
    return max(statistic / threshold, 0.0)


def _fix_check(e: Evidence) -> Check:
    link, limit_s = "system?topic=gnss/fix", _stale_after_s("gnss/fix")
    if e.fix is None or e.fix_age_s is None:
        return _check("fix", Trust.STALE, link, explain(Code.CHECK_NONE_RECEIVED))
    if e.fix_age_s >= limit_s:
        return _check("fix", Trust.STALE, link, explain(Code.CHECK_OLD, limit_s=limit_s))
    count = e.fix.satellites_used
    satellites = () if count is None else (explain(Code.SATELLITES, satellites_count=count),)
    if e.fix.fix_type in (FixType.NONE, FixType.TIME_ONLY, FixType.DEAD_RECKONING):
        return _check("fix", Trust.CAUTION, link, explain(Code.FIX_WITHOUT_POSITION), *satellites)
    return _check("fix", Trust.SAFE, link, explain(Code.FIX, fix_type=e.fix.fix_type), *satellites)


def _check(name: str, state: Trust, link: str, *why: Explanation, ratio: float | None = None) -> Check:
    """Make a check whose label is that of its name."""
    shown = None if ratio is None else min(ratio, RATIO_MAXIMUM)
    return Check(name, words().name("check", name.replace(" ", "_")), state, reason(*why), shown, link)


def _age_check(name: str, age_s: float | None, topic: str) -> Check:
    limit_s, link = _stale_after_s(topic), f"system?topic={topic}"
    if age_s is None:
        return _check(name, Trust.OFF if name == "odometer" else Trust.STALE, link, explain(Code.CHECK_NONE_RECEIVED))
    if age_s >= limit_s:
        return _check(name, Trust.STALE, link, explain(Code.CHECK_OLD, limit_s=limit_s))
    return _check(name, Trust.SAFE, link, explain(Code.CHECK_IN_TIME))


def _phase_check(e: Evidence) -> Check:
    link = "system?topic=navigation/state"
    if e.phase is None:
        return _check("phase", Trust.STALE, link, explain(Code.NO_STATE))
    here = explain(Code.PHASE, phase=e.phase)
    if e.phase is NavigationPhase.NAVIGATING:
        return _check("phase", Trust.SAFE, link, here)
    made = _check("phase", Trust.CAUTION, link, here, *e.filter_codes)
    # A recording of an earlier release has the filter's own text alone.
    return made if e.filter_codes or not e.filter_says else replace(made, text=f"{made.text}; {e.filter_says}")


def _heading_check(e: Evidence) -> Check:
    link = "system?topic=navigation/solution"
    if e.solution is None or _is_old(e):
        return _check("heading", Trust.STALE, link, explain(Code.CHECK_UNKNOWN))
    sd_deg = _heading_sd_deg(e.solution)
    why = explain(Code.HEADING, sd_deg=sd_deg, limit_deg=HEADING_SD_LIMIT_DEG)
    good = sd_deg <= HEADING_SD_LIMIT_DEG
    return _check("heading", Trust.SAFE if good else Trust.CAUTION, link, why, ratio=sd_deg / HEADING_SD_LIMIT_DEG)


def _set_up_checks(e: Evidence) -> list[Check]:
    """Show what driving has found wrong with the set-up; the page System has all checks and the settings to paste."""
    label, link = words().name("check", "set_up"), "system?topic=navigation/set_up"
    return [
        Check(f"set-up {check.name}", label, Trust.CAUTION, said(check.sentence, check.code), link=link)
        for check in (e.set_up.checks if e.set_up else ())
        if check.verdict is SetUpVerdict.CONTRADICTS
    ]


def _protection_check(e: Evidence) -> Check:
    """Compare the protection levels with the alert limits of the vehicle's configuration; the worse axis counts."""
    link = "system?topic=navigation/solution"
    if e.solution is None or _is_old(e):
        return _check("protection", Trust.STALE, link, explain(Code.CHECK_UNKNOWN))
    axes = [
        ("horizontal", e.solution.protection_level_horizontal_m, e.alert_limit_horizontal_m),
        ("vertical", e.solution.protection_level_vertical_m, e.alert_limit_vertical_m),
    ]
    levels = [(axis, level_m, limit_m) for axis, level_m, limit_m in axes if level_m is not None]
    if not levels:
        return _check("protection", Trust.OFF, link, explain(Code.LEVEL_NOT_PUBLISHED))
    why = [
        explain(Code.LEVEL if limit_m is None else Code.LEVEL_LIMITED, axis=axis, level_m=level_m, limit_m=limit_m)
        for axis, level_m, limit_m in levels
    ]
    ratios = [level_m / limit_m for _, level_m, limit_m in levels if limit_m is not None]
    if not ratios:
        return _check("protection", Trust.STALE, link, *why, explain(Code.NO_ALERT_LIMIT))
    state = Trust.SAFE if max(ratios) <= 1.0 else Trust.ABOVE_LIMIT
    return _check("protection", state, link, *why, ratio=max(ratios))


def _gate_checks(e: Evidence) -> list[Check]:
    """Show the newest innovation of each kind against its gate; displacements stand in for the receiver's velocity."""
    link, checks = "system?topic=navigation/aiding", []
    recent = _recent(e)
    carried = any(kind is AidingKind.CARRIER_DISPLACEMENT and update.used for kind, update, _ in recent)
    for kind, update, _ in recent:
        used = update.used or (carried and kind is AidingKind.GNSS_VELOCITY)
        code = Code.RESIDUAL if used else Code.RESIDUAL_DISCARDED
        why = explain(code, share=round(min(update.test_ratio, 1e6), 2))
        state = Trust.SAFE if used and update.test_ratio <= GATE_LIMIT else Trust.CAUTION
        checks.append(_check(f"gate {kind}", state, link, why, ratio=update.test_ratio))
    return checks or [_check("gate", Trust.STALE, link, explain(Code.NO_RESIDUAL, limit_s=AIDING_RECENT_S))]


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

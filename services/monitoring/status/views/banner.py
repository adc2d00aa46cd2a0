"""One sentence first: can this position be trusted, and if not, why and what to do.

The unit has no integrity monitor yet, so nothing here ever answers SAFE: the best answer is CAUTION, "position not
monitored", together with the list of what is known. UNSAFE is left to the monitors that can detect.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from math import degrees

from shared.messages.gnss import FixType, GnssFix
from shared.messages.navigation import AidingKind, AidingUpdate, NavigationPhase, NavigationSolution
from shared.runtime.freshness import STARTUP_GRACE_S, limits_of
from shared.topics import BY_NAME

from .geometry import vertical_sd

HEADING_SD_LIMIT_DEG = 3.0  # above, a heading misleads more than it helps: 5 % of the distance sideways
FITS = {AidingKind.NON_HOLONOMIC: "non-holonomic constraint"}
GATE_LIMIT = 1.0  # by definition of the test ratio
AIDING_RECENT_S = 5.0


class Trust(StrEnum):
    """How far the position may be believed."""

    SAFE = "safe"
    CAUTION = "caution"
    UNSAFE = "unsafe"
    STALE = "stale"
    OFF = "off"


WORDS = {
    Trust.SAFE: "SAFE",
    Trust.CAUTION: "CAUTION",
    Trust.UNSAFE: "UNSAFE",
    Trust.STALE: "NO DATA",
    Trust.OFF: "NOT MONITORED",
}


@dataclass(frozen=True)
class Evidence:
    """All that the verdict rests on; ages in seconds, None for what never came."""

    broker: bool
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
    monitored: bool = True  # False: monitoring.health does not report
    down: tuple[str, ...] = ()  # processes that should run and do not
    cause: str | None = None  # root cause of a missing or old solution


@dataclass(frozen=True)
class Check:
    """One line of the list behind the verdict: statistic, limit, verdict."""

    name: str
    label: str
    state: Trust  # safe here means: this check passes
    text: str
    ratio: float | None = None  # statistic over limit, where there is one: 1 is the limit
    link: str = ""
    fitted: bool = True  # False: this version has no such monitor


@dataclass(frozen=True)
class Verdict:
    """The banner: a state, one sentence, what to do, and the checks; `code` names the case, for as long as it holds."""

    state: Trust
    code: str
    sentence: str
    action: str
    checks: tuple[Check, ...]


WAITING = {
    NavigationPhase.WAITING_FOR_IMU: "no inertial data are received",
    NavigationPhase.LEVELLING: "the filter is levelling, which needs the vehicle to stand still",
    NavigationPhase.WAITING_FOR_GNSS: "no usable GNSS fix is received",
    NavigationPhase.WAITING_FOR_HEADING: "the heading is not known, which needs the vehicle to drive a little",
}
NOT_MONITORED = (
    ("raim", "Satellite fault (RAIM)", "not part of this version"),
    ("spoofing", "Spoofing and jamming", "not part of this version"),
    ("motion", "GNSS against odometer", "not part of this version"),
)


def judge(evidence: Evidence) -> Verdict:
    """Turn the evidence into the banner."""
    checks = tuple(_checks(evidence))
    state, code, sentence, action = _sentence(evidence)
    return Verdict(state, code, sentence, action, checks)


def _sentence(e: Evidence) -> tuple[Trust, str, str, str]:
    if not e.broker:
        return (
            Trust.STALE,
            "broker",
            f"Nothing is known: {e.cause or 'the broker is not reachable'}.",
            "Start the broker or read its log. All messages pass through it; processes reconnect by themselves.",
        )
    if e.solution is None:
        return (
            Trust.STALE,
            "none",
            f"No position yet: {_why_none(e)}.",
            "The checks show which input is missing. Outdoors a first position takes up to a minute.",
        )
    if _is_old(e):
        return (
            Trust.STALE,
            "stale",
            f"The position is stale: {_why_stale(e)}.",
            "Do not use the position shown. It is the last one known, and the circle grows with time.",
        )
    return _sentence_while_navigating(e, e.solution)


def _sentence_while_navigating(e: Evidence, solution: NavigationSolution) -> tuple[Trust, str, str, str]:
    if solution.phase is NavigationPhase.COASTING:
        return (
            Trust.CAUTION,
            "coasting",
            "Position not monitored, and by dead reckoning only: no GNSS fix is being used.",
            "Expect the error to grow with distance and time. A clear view of the sky ends it.",
        )
    if rejected := [kind for kind, update, _ in _recent(e) if not update.used and update.test_ratio > GATE_LIMIT]:
        kinds = " and ".join(kind.replace("_", " ").replace("gnss", "GNSS") for kind in rejected)
        return (
            Trust.CAUTION,
            f"rejected {kinds}",
            f"Position not monitored, and the filter rejects its {kinds} measurements: they contradict the motion.",
            "GNSS or the inertial unit is wrong. Keep away from reflecting walls and check the antenna.",
        )
    if _heading_sd_deg(solution) > HEADING_SD_LIMIT_DEG:
        return (
            Trust.CAUTION,
            "heading",
            "Position not monitored, and the heading is not yet known well.",
            "Drive a little, straight and with a turn: the heading is found from the motion.",
        )
    if not e.monitored:
        return (
            Trust.CAUTION,
            "unwatched",
            "Position not monitored, and monitoring.health does not report: the state of all processes is unknown.",
            "Start monitoring.health or read its log. Until then faults of other processes are not shown.",
        )
    if e.down:
        return (
            Trust.CAUTION,
            f"down {e.down}",
            f"Position not monitored, and {_and(e.down)} {'is' if len(e.down) == 1 else 'are'} not running.",
            "The System page shows what failed and why.",
        )
    return (
        Trust.CAUTION,
        "unmonitored",
        "Position not monitored: this version has no integrity monitor that could vouch for it.",
        "Use it to find your way, not where a wrong position does harm. The checks list what is known.",
    )


def _why_none(e: Evidence) -> str:
    """Prefer what the filter is waiting for over what monitoring.health sees."""
    if e.phase in WAITING:
        return WAITING[e.phase]
    return e.cause or "nothing has been received from core.fusion"


def _why_stale(e: Evidence) -> str:
    """Name the root cause, and what a filter that starts again is waiting for."""
    waiting = f" ({WAITING[e.phase]})" if e.phase in WAITING and e.cause else ""
    return (e.cause or "the root cause is not known yet") + waiting


def _checks(e: Evidence) -> list[Check]:
    checks = [
        _fix_check(e),
        _age_check("imu", "Inertial unit", e.imu_age_s, "imu/sample", "samples"),
        _phase_check(e),
        _heading_check(e),
        _protection_check(e),
        *_gate_checks(e),
        _age_check("odometer", "Vehicle speed", e.odometer_age_s, "vehicle/wheel_speed", "speed"),
    ]
    checks += [Check(name, label, Trust.OFF, text, fitted=False) for name, label, text in NOT_MONITORED]
    return checks


def _fix_check(e: Evidence) -> Check:
    label, link = "GNSS fix", "topic=gnss/fix"
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
        return Check(name, label, state, f"no {what} received", link=f"topic={topic}")
    if age_s >= limit_s:
        return Check(name, label, Trust.STALE, f"no {what} for more than {limit_s:g} s", link=f"topic={topic}")
    return Check(name, label, Trust.SAFE, f"{what} in time", link=f"topic={topic}")


def _phase_check(e: Evidence) -> Check:
    link = "topic=navigation/state"
    if e.phase is None:
        return Check("phase", "Filter", Trust.STALE, "does not publish its state", link=link)
    text = e.phase.replace("_", " ").replace("imu", "IMU").replace("gnss", "GNSS")
    if e.phase is NavigationPhase.NAVIGATING:
        return Check("phase", "Filter", Trust.SAFE, text, link=link)
    return Check("phase", "Filter", Trust.CAUTION, f"{text}: {e.filter_says}" if e.filter_says else text, link=link)


def _heading_check(e: Evidence) -> Check:
    if e.solution is None or _is_old(e):
        return Check("heading", "Heading", Trust.STALE, "unknown", link="topic=navigation/solution")
    sd_deg = _heading_sd_deg(e.solution)
    state = Trust.SAFE if sd_deg <= HEADING_SD_LIMIT_DEG else Trust.CAUTION
    text = f"± {sd_deg:.1f}° (1 σ), limit {HEADING_SD_LIMIT_DEG:g}°"
    return Check(
        "heading", "Heading", state, text, min(sd_deg / HEADING_SD_LIMIT_DEG, 9.99), "topic=navigation/solution"
    )


def _protection_check(e: Evidence) -> Check:
    """Compare the protection levels with the alert limits of the vehicle's configuration; the worse axis counts."""
    name, label, link = "protection", "Protection level", "topic=navigation/solution"
    if e.solution is None or _is_old(e):
        return Check(name, label, Trust.STALE, "unknown", link=link)
    axes = [
        ("horizontal", e.solution.protection_level_horizontal_m, e.alert_limit_horizontal_m),
        ("vertical", e.solution.protection_level_vertical_m, e.alert_limit_vertical_m),
    ]
    levels = [(axis, level_m, limit_m) for axis, level_m, limit_m in axes if level_m is not None]
    if not levels:
        return Check(name, label, Trust.OFF, "not published by the filter", link=link, fitted=False)
    text = ", ".join(
        f"{level_m:.1f} m {axis}" + ("" if limit_m is None else f" (limit {limit_m:g} m)")
        for axis, level_m, limit_m in levels
    )
    ratios = [level_m / limit_m for _, level_m, limit_m in levels if limit_m is not None]
    if not ratios:
        return Check(name, label, Trust.STALE, f"{text}; alert limits not received", link=link)
    state = Trust.SAFE if max(ratios) <= 1.0 else Trust.CAUTION
    return Check(name, label, state, text, min(max(ratios), 9.99), link)


def _gate_checks(e: Evidence) -> list[Check]:
    """Show the newest innovation of each kind against its gate."""
    checks = []
    for kind, update, _ in _recent(e):
        good = update.used and update.test_ratio <= GATE_LIMIT
        text = f"{update.test_ratio:.2f} of the limit" + ("" if update.used else ", rejected")
        label = f"Fit of {FITS.get(kind) or kind.replace('_', ' ').replace('gnss', 'GNSS')}"
        state = Trust.SAFE if good else Trust.CAUTION
        checks.append(
            Check(f"gate {kind}", label, state, text, min(update.test_ratio, 9.99), "topic=navigation/aiding")
        )
    return checks or [
        Check(
            "gate",
            "Fit of the measurements",
            Trust.STALE,
            f"none in {AIDING_RECENT_S:g} s",
            link="topic=navigation/aiding",
        )
    ]


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


def _and(names: tuple[str, ...]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"

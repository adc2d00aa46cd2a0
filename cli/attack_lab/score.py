"""Rates of detection and of false alarms, with confidence intervals, and the errors that stayed undetected."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

import numpy as np
from scipy.special import betaincinv, gammaincinv

from shared.maths.earth import FloatArray
from shared.messages.trust import TrustLevel

from .cases import CLEAN, Case
from .timeline import Timeline

CONFIDENCE = 0.95
WARM_UP_S = 60.0  # after the start of a drive, before which false alarms and the share of SAFE are not counted
RECOVERY_S = 70.0  # after an attack in which an accusation is no false alarm: the longest window and readmission
WITHDRAWN = (TrustLevel.UNSAFE, TrustLevel.DEAD_RECKONING, TrustLevel.NO_FIX)
VERDICT = "verdict"
Run = tuple[Case, Timeline]


@dataclass(frozen=True)
class Detection:
    """How one monitor, or the verdict, answered an attack over all its runs."""

    attack: str
    monitor: str
    runs: int
    detected: int
    rate_interval: tuple[float, float]  # Clopper-Pearson, `CONFIDENCE`
    delay_median_s: float | None  # from the start of the attack, of the runs in which it was detected
    delay_max_s: float | None


@dataclass(frozen=True)
class FalseAlarms:
    """Accusations of one monitor, or withdrawals by the verdict, without an attack."""

    monitor: str
    hours: float  # evaluated and without an attack
    episodes: int
    per_hour: float | None
    per_hour_interval: tuple[float, float]  # exact Poisson interval, `CONFIDENCE`


@dataclass(frozen=True)
class Harm:
    """Errors of the position in use during an attack and the recovery after it, over all its runs."""

    attack: str
    runs: int
    largest_error_m: float | None  # horizontal, of the fused position
    largest_undetected_error_m: float | None  # the same before the verdict withdraws the position
    largest_safe_error_m: float | None  # the same while the verdict is SAFE
    hazardous_s: float  # SAFE although an error is above its alert limit
    safe_s: float
    above_level_fraction: float | None  # errors above their protection level
    recovered: int  # runs that end with SAFE
    safe_again_s: float | None  # longest time from the end of an attack until the verdict stays SAFE, of these


def binomial_interval(successes: int, trials: int) -> tuple[float, float]:
    """Clopper-Pearson interval of a probability."""
    if not trials:
        return 0.0, 1.0
    tail = 0.5 * (1.0 - CONFIDENCE)
    low = betaincinv(successes, trials - successes + 1, tail) if successes else 0.0
    high = betaincinv(successes + 1, trials - successes, 1.0 - tail) if successes < trials else 1.0
    return float(low), float(high)


def poisson_interval(count: int, exposure: float) -> tuple[float, float]:
    """Exact interval of a rate, given a number of events in an exposure."""
    if exposure <= 0.0:
        return 0.0, inf
    tail = 0.5 * (1.0 - CONFIDENCE)
    low = gammaincinv(count, tail) if count else 0.0
    return float(low / exposure), float(gammaincinv(count + 1, 1.0 - tail) / exposure)


def monitors_of(runs: Sequence[Run]) -> list[str]:
    """All monitors that appear in the runs."""
    return sorted({name for _, timeline in runs for name in timeline.accused_s})


def detected_after_s(case: Case, timeline: Timeline, monitor: str) -> float | None:
    """Time from the start of the attack to the first accusation, or withdrawal by the verdict; None if there is none.

    An accusation that began before the attack counts as no detection of it.
    """
    begin_s, end_s = case.interval_s
    if monitor == VERDICT:
        starts = _withdrawals(timeline)
    else:
        starts = [start for start, _ in timeline.accused_s.get(monitor, [])]
    return min((start - begin_s for start in starts if begin_s <= start <= end_s), default=None)


def detections(runs: Sequence[Run]) -> list[Detection]:
    """One row for each attack and monitor, the verdict included."""
    rows = []
    for attack, group in by_attack(runs).items():
        for monitor in (*monitors_of(runs), VERDICT):
            found = [detected_after_s(case, timeline, monitor) for case, timeline in group]
            delays = [delay for delay in found if delay is not None]
            rows.append(
                Detection(
                    attack, monitor, len(group), len(delays), binomial_interval(len(delays), len(group)),
                    float(np.median(delays)) if delays else None, max(delays, default=None),
                )
            )  # fmt: skip
    return rows


def false_alarms(runs: Sequence[Run]) -> list[FalseAlarms]:
    """Accusations that begin outside an attack and its recovery, after the warm-up; the verdict's by rows 3 to 7."""
    rows = []
    for monitor in (*monitors_of(runs), VERDICT):
        episodes, hours = 0, 0.0
        for case, timeline in runs:
            clean = _clean(case, timeline)
            clean_s = sum(end - begin for begin, end in clean)
            if monitor == VERDICT:
                starts, share = _withdrawals(timeline), 1.0
            else:
                starts = [start for start, _ in timeline.accused_s.get(monitor, [])]
                share = timeline.evaluated_s.get(monitor, 0.0) / max(timeline.duration_s, 1e-9)
            hours += clean_s * share / 3600.0
            episodes += sum(any(begin <= start < end for begin, end in clean) for start in starts)
        rate = episodes / hours if hours > 0.0 else None
        rows.append(FalseAlarms(monitor, hours, episodes, rate, poisson_interval(episodes, hours)))
    return rows


def safe_share(runs: Sequence[Run]) -> float | None:
    """Share of SAFE on clean drives after the warm-up; None without clean drives."""
    clean = [timeline for case, timeline in runs if case.attack is None and timeline.duration_s > WARM_UP_S]
    total = sum(timeline.duration_s - WARM_UP_S for timeline in clean)
    safe = sum(timeline.seconds_in([TrustLevel.SAFE], WARM_UP_S, timeline.duration_s) for timeline in clean)
    return safe / total if total else None


def harms(runs: Sequence[Run]) -> list[Harm]:
    """One row for each attack; clean drives are counted from the warm-up on."""
    return [_harm(attack, group) for attack, group in by_attack(runs, clean=True).items()]


def _harm(attack: str, group: Sequence[Run]) -> Harm:
    largest, undetected, while_safe, above, hazardous_s, safe_s = [], [], [], [], 0.0, 0.0
    again = [after_s for run in group if (after_s := safe_again_s(*run)) is not None]
    for case, timeline in group:
        begin_s = case.interval_s[0] if case.attack else WARM_UP_S
        rows = timeline.error_s >= begin_s
        times, error, level = timeline.error_s[rows], timeline.error_m[rows], timeline.level_m[rows]
        safe_s += timeline.seconds_in([TrustLevel.SAFE], begin_s, timeline.duration_s)
        if not len(times):
            continue
        safe = np.array([verdict is TrustLevel.SAFE for verdict in timeline.verdict_at(times)])
        withdrawn_s = min((start for start in _withdrawals(timeline) if start >= begin_s), default=inf)
        beyond = np.any(error > np.array(timeline.alert_limits_m), axis=1)
        largest.append(float(error[:, 0].max()))
        undetected.append(_largest(error[times < withdrawn_s, 0]))
        while_safe.append(_largest(error[safe, 0]))
        hazardous_s += float(np.sum(safe & beyond)) * float(np.median(np.diff(times))) if len(times) > 1 else 0.0
        known = np.isfinite(level).all(axis=1)
        above.append(float(np.mean(np.any(error > level, axis=1)[known])) if known.any() else 0.0)
    return Harm(
        attack, len(group), max(largest, default=None), max(undetected, default=None), max(while_safe, default=None),
        hazardous_s, safe_s, float(np.mean(above)) if above else None, len(again), max(again, default=None),
    )  # fmt: skip


def safe_again_s(case: Case, timeline: Timeline) -> float | None:
    """Time from the end of the attack until the verdict stays SAFE; None if it does not."""
    if not timeline.verdicts or timeline.verdicts[-1] is not TrustLevel.SAFE:
        return None
    other = [k for k, verdict in enumerate(timeline.verdicts) if verdict is not TrustLevel.SAFE]
    return max(0.0, float(timeline.verdict_s[other[-1] + 1]) - case.interval_s[1]) if other else 0.0


def _largest(values: FloatArray) -> float:
    return float(values.max()) if len(values) else 0.0


def _withdrawals(timeline: Timeline) -> list[float]:
    """Times at which the verdict withdraws the position that it has given before [s]."""
    verdicts = [TrustLevel.INITIALISING, *timeline.verdicts]
    usable = (TrustLevel.SAFE, TrustLevel.CAUTION)
    return [
        float(time_s)
        for time_s, before, after in zip(timeline.verdict_s, verdicts, verdicts[1:], strict=False)
        if before in usable and after in WITHDRAWN
    ]


def _clean(case: Case, timeline: Timeline) -> list[tuple[float, float]]:
    """Intervals after the warm-up that are neither in the attack nor in the recovery after it [s]."""
    begin_s, end_s = case.interval_s
    intervals = [(WARM_UP_S, timeline.duration_s)] if case.attack is None else [
        (WARM_UP_S, begin_s), (end_s + RECOVERY_S, timeline.duration_s)
    ]  # fmt: skip
    return [(begin, end) for begin, end in intervals if end > begin]


def by_attack(runs: Sequence[Run], *, clean: bool = False) -> dict[str, list[Run]]:
    """Group runs by the label of their attack; clean drives only if they are asked for."""
    groups: dict[str, list[Run]] = {}
    for case, timeline in runs:
        if clean or case.label != CLEAN:
            groups.setdefault(case.label, []).append((case, timeline))
    return groups

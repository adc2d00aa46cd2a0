"""How the unit answered an attack, scored against the truth from the start of the attack to the end of the run."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from shared.attacks import BY_NAME, AttackRow
from shared.maths.earth import FloatArray
from shared.messages.explanation import ReferenceKind
from shared.messages.simulation import AttackName
from shared.messages.trust import TrustLevel
from shared.trust.accused import GNSS, ODOMETER, reference

from .cases import Case
from .score import VERDICT, Run, binomial_interval, by_attack, detected_after_s, safe_again_s
from .timeline import Interval, Timeline

KINDS = (ReferenceKind.SATELLITE, ReferenceKind.NEIGHBOUR)  # of sources that are accused by an ID of their own
USABLE = (TrustLevel.SAFE, TrustLevel.CAUTION)
TRACK_EVERY_S = 10.0
Pair = tuple[float | None, float | None]  # [m] horizontal and vertical; None where it is unknown


@dataclass(frozen=True)
class TrackPoint:
    """Error and level at one time of a run."""

    after_s: float  # since the start of the attack
    verdict: TrustLevel
    error_m: Pair
    level_m: Pair


@dataclass(frozen=True)
class Outcome:
    """The answer to the attack of one run; everything is counted until the end of the run."""

    safe_s: float
    safe_above_level_s: float  # SAFE although an error is above its published protection level
    safe_above_limit_s: float  # SAFE although an error is above its alert limit
    above_level_fraction: float | None  # of all times with a level
    safe_error_m: Pair  # largest while SAFE
    detected: bool  # by a monitor or by the verdict, between start and end of the attack
    accused: tuple[str, ...]  # by a statement that began between start and end of the attack, in the order of time
    accused_after: tuple[str, ...]  # by one that began later, when every source is healthy
    right: bool  # a source at fault is accused, and no healthy one is excluded
    healthy_excluded: tuple[str, ...]  # sources that the attack does not touch
    healthy_excluded_s: float  # the longest time without a pause
    excluded_after_s: float  # how long the attacked source stays excluded after the end of the attack, at the longest
    not_safe_after_s: float | None  # from the start of the attack; None: SAFE to the end
    usable_again_s: (
        float | None
    )  # from the end of the attack until SAFE or CAUTION to the end of the run; None: neither
    safe_again_s: float | None  # the same of SAFE
    end: TrackPoint | None  # None without a truth
    track: tuple[TrackPoint, ...]  # every `TRACK_EVERY_S`


@dataclass(frozen=True)
class Answer:
    """The outcomes of all runs of one attack; intervals are those of Clopper and Pearson."""

    attack: str
    expected: str  # whom a monitor should accuse
    runs: int
    detected: int
    detected_interval: tuple[float, float]
    right: int
    right_interval: tuple[float, float]
    accused: tuple[str, ...]  # in any run
    accused_after: tuple[str, ...]
    healthy_excluded: tuple[str, ...]
    safe_s: float
    safe_above_level_s: float
    safe_above_limit_s: float
    above_level_fraction: float | None  # mean
    # The rest is the worst run.
    safe_error_m: Pair
    healthy_excluded_s: float
    excluded_after_s: float
    not_safe: int  # runs in which the verdict is not SAFE at some time
    not_safe_after_s: float | None  # of these
    usable_again: int  # runs that end with SAFE or CAUTION
    usable_again_s: float | None  # of these
    end_error_m: Pair
    end_level_m: Pair  # of the run with the largest horizontal error at its end


def outcome(case: Case, timeline: Timeline) -> Outcome:
    """Score the run of an attack.

    Parameters
    ----------
    case : Case
        With an attack.
    timeline : Timeline
        What the unit published, and its true errors; without a truth all errors are unknown.

    Raises
    ------
    ValueError
        The case has no attack.
    """
    if case.attack is None:
        raise ValueError("a clean drive has no outcome of an attack")
    row, (begin_s, end_s) = BY_NAME[case.attack.attack], case.interval_s
    rows = timeline.error_s >= begin_s
    times, error, level = timeline.error_s[rows], timeline.error_m[rows], timeline.level_m[rows]
    step_s = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    safe = np.array([verdict is TrustLevel.SAFE for verdict in timeline.verdict_at(times)], dtype=bool)
    above_level = np.any(error > level, axis=1)  # an unknown level is not exceeded
    above_limit = np.any(error > np.array(timeline.alert_limits_m), axis=1)
    known = np.isfinite(level).all(axis=1)
    accused, excluded = _accused(timeline, begin_s, end_s), _healthy_excluded(row, timeline, begin_s)
    track = tuple(_track(timeline, begin_s))
    return Outcome(
        safe_s=timeline.seconds_in([TrustLevel.SAFE], begin_s, timeline.duration_s),
        safe_above_level_s=float(np.sum(safe & above_level)) * step_s,
        safe_above_limit_s=float(np.sum(safe & above_limit)) * step_s,
        above_level_fraction=float(np.mean(above_level[known])) if known.any() else None,
        safe_error_m=_largest(error[safe]),
        detected=any(
            detected_after_s(case, timeline, name) is not None for name in (*timeline.accused_s, VERDICT)
        ),
        accused=accused,
        accused_after=_accused(timeline, np.nextafter(end_s, np.inf), timeline.duration_s),
        right=_is_right(row, accused) and not excluded,
        healthy_excluded=tuple(excluded),
        healthy_excluded_s=max(excluded.values(), default=0.0),
        excluded_after_s=max(
            (_longest(timeline.excluded_s.get(name, []), end_s) for name in attacked_sources(row)), default=0.0
        ),
        not_safe_after_s=_first_other(timeline, begin_s),
        usable_again_s=_again_s(timeline, end_s),
        safe_again_s=safe_again_s(case, timeline),
        end=_point(timeline, len(timeline.error_s) - 1, begin_s) if len(timeline.error_s) else None,
        track=track,
    )  # fmt: skip


def answers(runs: Sequence[Run]) -> list[Answer]:
    """One row for each attack."""
    return [_answer(attack, group) for attack, group in by_attack(runs).items()]


def _answer(attack: str, group: Sequence[Run]) -> Answer:
    found = [outcome(*run) for run in group]
    row = BY_NAME[_attack_of(group[0][0])]
    detected, right = sum(outcome.detected for outcome in found), sum(outcome.right for outcome in found)
    shares = [outcome.above_level_fraction for outcome in found if outcome.above_level_fraction is not None]
    left_safe = [outcome.not_safe_after_s for outcome in found if outcome.not_safe_after_s is not None]
    again = [outcome.usable_again_s for outcome in found if outcome.usable_again_s is not None]
    ends = [outcome.end for outcome in found if outcome.end is not None]
    end = max(ends, key=lambda point: point.error_m[0] or 0.0, default=None)
    return Answer(
        attack, " or ".join((row.accused or "nobody", *row.also)), len(found),
        detected, binomial_interval(detected, len(found)), right, binomial_interval(right, len(found)),
        _all(outcome.accused for outcome in found), _all(outcome.accused_after for outcome in found),
        _all(outcome.healthy_excluded for outcome in found),
        sum(outcome.safe_s for outcome in found), sum(outcome.safe_above_level_s for outcome in found),
        sum(outcome.safe_above_limit_s for outcome in found), float(np.mean(shares)) if shares else None,
        (_worst(outcome.safe_error_m[0] for outcome in found), _worst(outcome.safe_error_m[1] for outcome in found)),
        max(outcome.healthy_excluded_s for outcome in found), max(outcome.excluded_after_s for outcome in found),
        len(left_safe), max(left_safe, default=None), len(again), max(again, default=None),
        end.error_m if end else (None, None), end.level_m if end else (None, None),
    )  # fmt: skip


def attacked_sources(row: AttackRow) -> tuple[str, ...]:
    """Sources with an exclusion that are not healthy during an attack; GNSS too where satellites or signals are."""
    own = GNSS if row.accused in (ReferenceKind.SATELLITE, "") else row.accused
    return tuple(name for name in (own, *row.also) if name in (GNSS, ODOMETER))


def _attack_of(case: Case) -> AttackName:
    if case.attack is None:
        raise ValueError("a clean drive has no attack")
    return case.attack.attack


def _is_right(row: AttackRow, accused: Sequence[str]) -> bool:
    """Whether a source at fault is accused; where signals are only lost, whether no other source than GNSS is."""
    if not row.accused:
        return all(name == GNSS for name in accused)
    return any(_names(name, source) for name in accused for source in (row.accused, *row.also))


def _names(name: str, source: str) -> bool:
    """Whether an accused name is of a kind of source; satellites are named as RINEX does."""
    return reference(name).kind == source if source in KINDS else name == source


def _accused(timeline: Timeline, begin_s: float, end_s: float) -> tuple[str, ...]:
    firsts = {
        name: min((start for start, _ in intervals if begin_s <= start <= end_s), default=None)
        for name, intervals in timeline.named_s.items()
    }
    return tuple(sorted((name for name, at in firsts.items() if at is not None), key=lambda name: (firsts[name], name)))


def _healthy_excluded(row: AttackRow, timeline: Timeline, begin_s: float) -> dict[str, float]:
    """Sources that the attack does not touch and the longest time for which each is excluded [s], if it is."""
    longest = {
        name: _longest(intervals, begin_s)
        for name, intervals in timeline.excluded_s.items()
        if name not in attacked_sources(row)
    }
    return {name: seconds for name, seconds in longest.items() if seconds > 0.0}


def _longest(intervals: Sequence[Interval], begin_s: float) -> float:
    """Longest part after a time [s]."""
    return max((end - max(start, begin_s) for start, end in intervals if end > begin_s), default=0.0)


def _first_other(timeline: Timeline, begin_s: float) -> float | None:
    """Time from the start until the verdict is not SAFE, which it may be already."""
    edges = [*timeline.verdict_s[1:], timeline.duration_s]
    found = (
        max(0.0, float(start) - begin_s)
        for start, end, verdict in zip(timeline.verdict_s, edges, timeline.verdicts, strict=True)
        if end > begin_s and verdict is not TrustLevel.SAFE
    )
    return next(found, None)


def _again_s(timeline: Timeline, end_s: float) -> float | None:
    """Time from the end of the attack until the verdict stays SAFE or CAUTION; None if it does not."""
    if not timeline.verdicts or timeline.verdicts[-1] not in USABLE:
        return None
    other = [k for k, verdict in enumerate(timeline.verdicts) if verdict not in USABLE]
    return max(0.0, float(timeline.verdict_s[other[-1] + 1]) - end_s) if other else 0.0


def _track(timeline: Timeline, begin_s: float) -> Iterator[TrackPoint]:
    for at_s in np.arange(begin_s, timeline.duration_s, TRACK_EVERY_S):
        place = int(np.searchsorted(timeline.error_s, at_s))
        if place < len(timeline.error_s) and timeline.error_s[place] < at_s + TRACK_EVERY_S:
            yield _point(timeline, place, begin_s)


def _point(timeline: Timeline, place: int, begin_s: float) -> TrackPoint:
    at_s = timeline.error_s[place]
    verdict: TrustLevel = timeline.verdict_at(np.array([at_s]))[0]
    return TrackPoint(
        round(float(at_s) - begin_s, 1), verdict, _pair(timeline.error_m[place]), _pair(timeline.level_m[place])
    )


def _pair(values: FloatArray) -> Pair:
    horizontal, vertical = (round(float(value), 2) if np.isfinite(value) else None for value in values)
    return horizontal, vertical


def _largest(errors: FloatArray) -> Pair:
    return _pair(errors.max(axis=0)) if len(errors) else (None, None)


def _worst(values: Iterator[float | None]) -> float | None:
    return max((value for value in values if value is not None), default=None)


def _all(names: Iterator[tuple[str, ...]]) -> tuple[str, ...]:
    """Names of all runs without repetition, in the order in which they appear."""
    return tuple(dict.fromkeys(name for some in names for name in some))

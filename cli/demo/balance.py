"""What a run amounted to: errors against the simulator's truth, latency, rates, restarts."""

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from shared.maths import earth, rotation
from shared.messages.base import Message
from shared.messages.gnss import GnssFix
from shared.messages.navigation import NavigationSolution, TruthState
from shared.messages.operation import DeadlineReport, ProcessHealth, ProcessLoad, ProcessState, TopicAge
from shared.messages.simulation import SimulationState
from shared.messages.trust import TrustLevel, TrustState
from shared.runtime.config import VehicleFile
from shared.topics import topic_of

from ..solve.metrics.gnss_alone import WORSE_RATIO
from .detection import NS, AttackSummary, seconds_in_states, summarise

T = TypeVar("T")
FloatArray = npt.NDArray[np.float64]
WITHOUT_FIX_S = 10.0  # at the end of a run that is healthy; a receiver sends a fix a second
MAX_DELAY_S = 1.0  # median delay of solutions from which a computer is too slow
MISSING_SHARE = 0.1  # of a run without a position, from which it is not usable
PAUSED_SHARE = 0.25  # of a run with paused checks, from which the computer is too slow
HISTORY_SAMPLES = 36_000  # the last hour of what comes ten times a second


@dataclass(frozen=True)
class Summary:
    """The summary of a run. Errors are root mean squares over the run, in metres; 3-D where nothing else is said.

    `gnss_*` and `fusion_at_fixes_*` are errors at the same times, those of the fixes: of the antenna and of the IMU.
    """

    healthy: bool
    duration_s: float
    processes_alive: int
    processes_expected: int
    restarts: int
    messages_per_second: float
    broken_messages: int
    gnss_position_rmse_m: float | None
    gnss_horizontal_rmse_m: float | None
    fusion_at_fixes_position_rmse_m: float | None
    fusion_at_fixes_horizontal_rmse_m: float | None
    fusion_worse_than_gnss: bool | None  # by more than 2 %, horizontally or in three dimensions
    fusion_position_rmse_m: float | None
    fusion_horizontal_rmse_m: float | None
    protection_horizontal_median_m: float | None
    protection_vertical_median_m: float | None
    misleading_horizontal: int  # solutions whose error is above their protection level
    misleading_vertical: int
    fixes: int
    solutions: int
    end_to_end_latency_p50_ms: float | None
    end_to_end_latency_p99_ms: float | None
    worst_topic: str | None
    worst_topic_age_s: float | None
    without_fix_s: float | None  # at the end, since the last GNSS fix with a position; None without any
    trust: dict[str, float]  # seconds in each state
    safe_above_alert_limit_s: float  # time in which the verdict was SAFE and the error above the alert limit
    checks_paused_s: float  # time in which checks were paused because the computer was too slow
    attacks: tuple[AttackSummary, ...]

    @property
    def too_slow(self) -> bool:
        """Whether this computer could not run the unit."""
        late = self.end_to_end_latency_p50_ms is not None and self.end_to_end_latency_p50_ms > MAX_DELAY_S * 1e3
        return late or self.checks_paused_s > PAUSED_SHARE * self.duration_s

    @property
    def position_missing(self) -> bool:
        """Whether the position was lost for a large part of the run."""
        return self.trust.get("no_fix", 0.0) > MISSING_SHARE * self.duration_s

    @property
    def unusable(self) -> bool:
        """Whether the positions of the run could not be used."""
        return self.too_slow or self.position_missing


class Balance:
    """Collects the messages of a run for its figures; with `keep=False` only whether they arrive."""

    def __init__(self, vehicle: VehicleFile, *, keep: bool = True) -> None:
        self._keep = keep
        self._lever_b = np.array(vehicle.facts.gnss.lever_arm_body_m)
        self._truth: list[TruthState] = []
        self._fixes: list[GnssFix] = []
        self._solutions: list[NavigationSolution] = []
        self._latencies: list[float] = []
        self._report: DeadlineReport | None = None
        self._health: dict[str, ProcessHealth] = {}
        self._verdicts: list[TrustState] = []
        self._simulation: SimulationState | None = None
        self._begin_ns: int | None = None  # start of the drive
        self._first_ns = self._last_ns = 0
        self._fixed_ns: int | None = None  # arrival of the last fix with a position
        self._solved = False
        self._paused_since_ns: int | None = None
        self._paused_ns = 0
        self.messages = self.broken_messages = 0

    def add(self, topic: str, message: Message, received_ns: int) -> None:
        """Take one message as it arrived."""
        self._note(message, received_ns)
        match message:
            case TruthState() if self._keep:
                _keep(self._truth, message)
            case GnssFix() if self._keep:
                _keep(self._fixes, message)
            case NavigationSolution() if self._keep:
                _keep(self._solutions, message)
                _keep(self._latencies, (received_ns - message.sampled_ns) * 1e-9)
            case TrustState() if self._keep:
                _keep(self._verdicts, message)
            case SimulationState():
                self._simulation = message
                self._begin_ns = message.sampled_ns if self._begin_ns is None else self._begin_ns
            case DeadlineReport():
                self._report = message
            case ProcessHealth():
                self._health[message.process] = message
            case _ if topic == "imu/raw":
                self.messages += 1
                self._first_ns = self._first_ns or received_ns
                self._last_ns = received_ns
            case _:
                pass

    def _note(self, message: Message, received_ns: int) -> None:
        """Note what even a run whose messages are not kept is judged by."""
        self._solved |= isinstance(message, NavigationSolution)
        if isinstance(message, GnssFix) and _fix_position(message) is not None:
            self._fixed_ns = received_ns
        if isinstance(message, ProcessLoad):
            self._follow_load(message)

    def _follow_load(self, load: ProcessLoad) -> None:
        """Add up the time in which work was paused."""
        if self._paused_since_ns is not None:
            self._paused_ns += load.sampled_ns - self._paused_since_ns
        self._paused_since_ns = load.sampled_ns if load.paused else None

    def summary(self, alive: int, expected: int, restarts: int) -> Summary:
        """Add everything up."""
        judged = [s for s in self._solutions if self._knows(s.sampled_ns)]
        fusion = self._errors([(s.sampled_ns, _position(s)) for s in judged], np.zeros(3))
        levels = np.array([_levels(s) for s in judged]).reshape(-1, 2)
        fixes = [(f.sampled_ns, position) for f in self._fixes if (position := _fix_position(f)) is not None]
        gnss, at_fixes = self._same_epochs(fixes)
        runs = self._simulation.attacks if self._simulation else ()
        ready = [h for h in self._health.values() if h.state == ProcessState.READY]
        dated = [t for t in self._report.topics if _has_deadline(t)] if self._report else []
        worst = max(dated, key=lambda t: t.age_s or 0.0, default=None)
        without_fix_s = None if self._fixed_ns is None else max((self._last_ns - self._fixed_ns) * 1e-9, 0.0)
        located = self._solved and without_fix_s is not None and without_fix_s <= WITHOUT_FIX_S
        summary = Summary(
            healthy=alive == expected and len(ready) >= expected - 1 and located,
            duration_s=round((self._last_ns - self._first_ns) * 1e-9, 1),
            processes_alive=alive,
            processes_expected=expected,
            restarts=restarts,
            messages_per_second=round(sum(t.rate_hz for t in self._report.topics), 1) if self._report else 0.0,
            broken_messages=self.broken_messages,
            gnss_position_rmse_m=_rms(gnss),
            gnss_horizontal_rmse_m=_rms(gnss[:, :2]),
            fusion_at_fixes_position_rmse_m=_rms(at_fixes),
            fusion_at_fixes_horizontal_rmse_m=_rms(at_fixes[:, :2]),
            fusion_worse_than_gnss=_worse(at_fixes, gnss),
            fusion_position_rmse_m=_rms(fusion),
            fusion_horizontal_rmse_m=_rms(fusion[:, :2]),
            protection_horizontal_median_m=_median(levels[:, 0]),
            protection_vertical_median_m=_median(levels[:, 1]),
            misleading_horizontal=int((np.hypot(fusion[:, 0], fusion[:, 1]) > levels[:, 0]).sum()),
            misleading_vertical=int((np.abs(fusion[:, 2]) > levels[:, 1]).sum()),
            fixes=len(self._fixes),
            solutions=len(self._solutions),
            end_to_end_latency_p50_ms=_quantile(self._latencies, 0.5),
            end_to_end_latency_p99_ms=_quantile(self._latencies, 0.99),
            worst_topic=worst.topic if worst else None,
            worst_topic_age_s=round(worst.age_s, 2) if worst and worst.age_s is not None else None,
            without_fix_s=None if without_fix_s is None else round(without_fix_s, 1),
            trust=seconds_in_states(self._verdicts),
            safe_above_alert_limit_s=self._misleading_s([s.sampled_ns for s in judged], fusion),
            checks_paused_s=round(self._paused_ns * 1e-9, 1),
            attacks=summarise(runs, self._verdicts, self._begin_ns or self._first_ns),
        )
        return replace(summary, healthy=summary.healthy and not summary.unusable)

    def _same_epochs(self, fixes: list[tuple[int, tuple[float, float, float]]]) -> tuple[FloatArray, FloatArray]:
        """Errors of fixes and of the solution at their times [m, NED], where both are known, shape (n, 3) each.

        The error of the solution is that at the IMU, interpolated linearly between two solutions.
        """
        judged = {s.sampled_ns: _position(s) for s in self._solutions if self._knows(s.sampled_ns)}
        errors = self._errors(list(judged.items()), np.zeros(3))
        stamps = np.array(sorted(judged), dtype=np.int64)
        if len(stamps) < 2:
            return np.zeros((0, 3)), np.zeros((0, 3))
        errors = errors[np.argsort(np.array(list(judged), dtype=np.int64))]
        kept = [fix for fix in fixes if self._knows(fix[0]) and stamps[0] <= fix[0] <= stamps[-1]]
        after = np.clip(np.searchsorted(stamps, [stamp for stamp, _ in kept]), 1, len(stamps) - 1)
        near = stamps[after] - stamps[after - 1] <= NS
        kept = [fix for fix, is_near in zip(kept, near.tolist(), strict=True) if is_near]
        at = np.array([stamp for stamp, _ in kept], dtype=np.int64)
        return self._errors(kept, self._lever_b), np.column_stack([np.interp(at, stamps, axis) for axis in errors.T])

    def _misleading_s(self, stamps_ns: list[int], errors: FloatArray) -> float:
        """Time [s] for which the newest verdict was SAFE and the error of the solution above the alert limit."""
        judged_ns, seconds = [v.sampled_ns for v in self._verdicts], 0.0
        for i in range(1, len(stamps_ns)):
            last = bisect_right(judged_ns, stamps_ns[i]) - 1
            verdict = self._verdicts[last] if last >= 0 else None
            if verdict is None or verdict.state is not TrustLevel.SAFE:
                continue
            north, east, down = np.abs(errors[i]).tolist()
            over = math.hypot(north, east) > verdict.alert_limit_horizontal_m or down > verdict.alert_limit_vertical_m
            seconds += over * (stamps_ns[i] - stamps_ns[i - 1]) / NS
        return round(seconds, 1)

    def _knows(self, stamp_ns: int) -> bool:
        """Whether the truth is known before and behind an instant."""
        return bool(self._truth) and self._truth[0].sampled_ns < stamp_ns <= self._truth[-1].sampled_ns

    def _errors(self, positions: list[tuple[int, tuple[float, float, float]]], lever_b: FloatArray) -> FloatArray:
        """Compare positions with the truth at their own stamps, in metres north, east, down."""
        stamps = [t.sampled_ns for t in self._truth]
        errors = []
        for stamp_ns, (latitude, longitude, height) in positions:
            after = bisect_left(stamps, stamp_ns)
            if not 0 < after < len(stamps):
                continue
            a, b = self._truth[after - 1], self._truth[after]
            share = (stamp_ns - a.sampled_ns) / (b.sampled_ns - a.sampled_ns)
            true = earth.Geodetic(
                math.radians(a.latitude_deg + share * (b.latitude_deg - a.latitude_deg)),
                math.radians(a.longitude_deg + share * (b.longitude_deg - a.longitude_deg)),
                a.height_ellipsoid_m + share * (b.height_ellipsoid_m - a.height_ellipsoid_m),
            )
            said = earth.Geodetic(math.radians(latitude), math.radians(longitude), height)
            lever_n = rotation.ned_from_body(*(a.attitude_rad or (0.0, 0.0, 0.0))) @ lever_b
            errors.append(np.array(earth.ned_from_geodetic_difference(said, true)) - lever_n)
        return np.array(errors).reshape(-1, 3)


def _worse(fused: FloatArray, gnss: FloatArray) -> bool | None:
    """Whether the solution is worse than the receiver; None without fixes to compare with."""
    if not len(gnss):
        return None
    return any(bool((fused[:, :axes] ** 2).sum() > WORSE_RATIO**2 * (gnss[:, :axes] ** 2).sum()) for axes in (2, 3))


def _has_deadline(age: TopicAge) -> bool:
    topic = topic_of(age.topic)
    return topic is not None and topic.silent_after_s is not None and age.age_s is not None


def _keep(items: list[T], item: T) -> None:
    items.append(item)
    if len(items) > HISTORY_SAMPLES:
        del items[: HISTORY_SAMPLES // 10]


def _position(s: NavigationSolution) -> tuple[float, float, float]:
    return s.latitude_deg, s.longitude_deg, s.height_ellipsoid_m


def _levels(s: NavigationSolution) -> tuple[float, float]:
    """Protection levels [m]; without one nothing was promised."""
    horizontal, vertical = s.protection_level_horizontal_m, s.protection_level_vertical_m
    return math.inf if horizontal is None else horizontal, math.inf if vertical is None else vertical


def _fix_position(f: GnssFix) -> tuple[float, float, float] | None:
    if f.latitude_deg is None or f.longitude_deg is None or f.height_ellipsoid_m is None:
        return None
    return f.latitude_deg, f.longitude_deg, f.height_ellipsoid_m


def _rms(errors: FloatArray) -> float | None:
    return round(float(np.sqrt((errors**2).sum(axis=1).mean())), 3) if len(errors) else None


def _median(levels: FloatArray) -> float | None:
    known = levels[np.isfinite(levels)]
    return round(float(np.median(known)), 3) if len(known) else None


def _quantile(values: list[float], share: float) -> float | None:
    return round(float(np.quantile(values, share)) * 1e3, 2) if values else None

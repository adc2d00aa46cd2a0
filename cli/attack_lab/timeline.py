"""What the unit published during one run, on a common time axis."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from shared.maths.earth import FloatArray
from shared.messages.base import Message, Vector3
from shared.messages.navigation import NavigationSolution, TruthState
from shared.messages.trust import Outcome, TrustLevel, TrustState

from ..campaign import Kept
from ..solve.metrics.errors import errors_against
from ..solve.reference_track import Reference, from_states
from ..solve.track import TrackBuilder

Interval = tuple[float, float]  # [s] since the start of the drive


@dataclass(frozen=True)
class Timeline:
    """Verdicts, accusations and true errors of one run; times in seconds since the start of the drive."""

    duration_s: float
    verdict_s: Kept  # times of trust/state, shape (v,)
    verdicts: list[TrustLevel]
    accused_s: dict[str, list[Interval]]  # intervals in which each monitor accuses
    evaluated_s: dict[str, float]  # time during which each monitor is evaluated
    error_s: Kept  # times of the true errors, shape (n,)
    error_m: Kept  # horizontal and vertical error of the fused position, shape (n, 2)
    level_m: Kept  # horizontal and vertical protection level, shape (n, 2)
    alert_limits_m: tuple[float, float]
    named_s: dict[str, list[Interval]] = field(default_factory=dict)  # intervals in which each source is accused
    excluded_s: dict[str, list[Interval]] = field(default_factory=dict)  # intervals in which each is excluded

    def verdict_at(self, times_s: FloatArray) -> npt.NDArray[np.object_]:
        """Verdict at given times, shape (n,); INITIALISING before the first."""
        known = np.array([TrustLevel.INITIALISING, *self.verdicts], dtype=object)
        return known[np.searchsorted(self.verdict_s, times_s, side="right")]

    def seconds_in(self, levels: Sequence[TrustLevel], begin_s: float, end_s: float) -> float:
        """Time within [begin_s, end_s] in which the verdict is one of `levels` [s]."""
        edges = np.clip(np.r_[self.verdict_s, self.duration_s], begin_s, end_s)
        inside = np.array([level in levels for level in self.verdicts], dtype=bool)
        return float(np.diff(edges)[inside].sum()) if len(self.verdicts) else 0.0


@dataclass
class Collector:
    """Collects the messages of a run."""

    builder: TrackBuilder = field(default_factory=TrackBuilder)
    truth: list[TruthState] = field(default_factory=list)
    states: list[TrustState] = field(default_factory=list)

    def add(self, message: Message) -> None:
        """Keep a message if it is needed."""
        match message:
            case NavigationSolution():
                self.builder.add(message)
            case TruthState():
                self.truth.append(message)
            case TrustState():
                self.states.append(message)

    def timeline(
        self, interval_ns: tuple[int, int], lever_arm_body_m: Vector3, reference: Reference | None
    ) -> Timeline:
        """Compute errors against the truth, and put everything on one time axis.

        Parameters
        ----------
        interval_ns : tuple of int
            Start and end of the drive.
        lever_arm_body_m : tuple of float
            [m, body] From the IMU to the antenna, for a reference at the antenna.
        reference : Reference or None
            Truth; without one, the `truth/state` of the run, if there is any.
        """
        start_ns, end_ns = interval_ns
        reference = reference or (from_states(self.truth) if self.truth else None)
        times: FloatArray = np.zeros(0)
        errors: FloatArray = np.zeros((0, 2))
        levels: FloatArray = np.zeros((0, 2))
        track = self.builder.track().valid()
        if reference is not None and len(track):
            found = errors_against(reference, track, lever_arm_b=lever_arm_body_m)
            if found.position_n is not None and found.protection_m is not None:
                ned = found.position_n
                times = np.asarray((found.stamps_ns - start_ns) * 1e-9, dtype=np.float64)
                errors = np.abs(np.column_stack([np.hypot(ned[:, 0], ned[:, 1]), ned[:, 2]]))
                levels = found.protection_m
        accused, evaluated = _monitors(self.states, start_ns, end_ns)
        named, excluded = _sources(self.states, start_ns, end_ns)
        last = self.states[-1] if self.states else None
        limits = (last.alert_limit_horizontal_m, last.alert_limit_vertical_m) if last else (np.nan, np.nan)
        return Timeline(
            (end_ns - start_ns) * 1e-9,
            np.array([(state.sampled_ns - start_ns) * 1e-9 for state in self.states]),
            [state.state for state in self.states],
            accused, evaluated, times, errors, levels, limits, named, excluded,
        )  # fmt: skip


def _monitors(
    states: Sequence[TrustState], start_ns: int, end_ns: int
) -> tuple[dict[str, list[Interval]], dict[str, float]]:
    """Intervals in which each monitor accuses, and the time in which it is evaluated [s], by trust/state."""
    accused: dict[str, list[Interval]] = {}
    evaluated: dict[str, float] = {}
    for state, (begin_s, end_s) in _lasting(states, start_ns, end_ns):
        for monitor in state.monitors:
            intervals = accused.setdefault(monitor.monitor, [])
            evaluated.setdefault(monitor.monitor, 0.0)
            if monitor.outcome is not Outcome.NOT_EVALUATED:
                evaluated[monitor.monitor] += end_s - begin_s
            if monitor.outcome is not Outcome.ACCUSES:
                continue
            _extend(intervals, begin_s, end_s)
    return accused, evaluated


def _sources(
    states: Sequence[TrustState], start_ns: int, end_ns: int
) -> tuple[dict[str, list[Interval]], dict[str, list[Interval]]]:
    """Intervals in which any monitor accuses each source, and in which the verdict excludes it, by trust/state."""
    named: dict[str, list[Interval]] = {}
    excluded: dict[str, list[Interval]] = {}
    for state, (begin_s, end_s) in _lasting(states, start_ns, end_ns):
        accusing = (monitor for monitor in state.monitors if monitor.outcome is Outcome.ACCUSES)
        for name in {name for monitor in accusing for name in monitor.accused}:
            _extend(named.setdefault(name, []), begin_s, end_s)
        for name, is_excluded in (("gnss", state.gnss_excluded), ("odometer", state.odometer_excluded)):
            if is_excluded:
                _extend(excluded.setdefault(name, []), begin_s, end_s)
    return named, excluded


def _lasting(states: Sequence[TrustState], start_ns: int, end_ns: int) -> Iterator[tuple[TrustState, Interval]]:
    """Yield each state with the interval until the next one."""
    edges_ns = [*(state.sampled_ns for state in states), end_ns]
    for state, next_ns in zip(states, edges_ns[1:], strict=True):
        yield state, ((state.sampled_ns - start_ns) * 1e-9, (next_ns - start_ns) * 1e-9)


def _extend(intervals: list[Interval], begin_s: float, end_s: float) -> None:
    """Add an interval, or extend the last one that it continues."""
    if intervals and intervals[-1][1] == begin_s:
        intervals[-1] = (intervals[-1][0], end_s)
    else:
        intervals.append((begin_s, end_s))

"""The inertial monitors: keeps the last minute of every sensor, and gives the verdicts of both windows."""

from collections import Counter, deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import takewhile
from math import degrees
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from shared.inertial.increments import SECOND_NS, Decimator, Increment
from shared.maths.earth import Geodetic
from shared.maths.rotation import Vector
from shared.messages.explanation import Explanation, explain
from shared.messages.navigation import FilterState, NavigationSolution
from shared.messages.trust import Outcome
from shared.trust.accused import GNSS, IMU
from shared.trust.inputs import Input, absent
from shared.trust.result import Test, dated, judged

from .codes import Code
from .inertial.anchors import anchor_of, filter_anchor_of
from .inertial.tracks import Heights, OdometerSpeed, PositionDifferences, Series, VelocityFix
from .settings import Settings
from .windows.long_window import LENGTHS_S, WINDOW_LENGTHS_S, DistanceTest, LongResult, LongWindow
from .windows.metrics import CONSECUTIVE, UNITS, WINDOW_S, Metric
from .windows.position_step import FALSE_ALARM_RATE, NAME, UNIT, PositionStep, position_step
from .windows.short_window import Window, compare, window_of_fixes

FloatArray = npt.NDArray[np.float64]


class Limits(NamedTuple):
    """Thresholds of one test: inconspicuous below, released below, accusing above."""

    median: float
    release: float
    accuse: float


BY_GNSS, BY_EITHER = (GNSS,), (GNSS, IMU)  # one difference of the two says the same of both
Published = TypeVar("Published", NavigationSolution, FilterState)

MATCH_NS = 20_000_000  # between the stamp of a solution and the end of an increment
ODOMETER_GAP_S = 2.5
RELEASE = 10  # evaluations below the release threshold that end an accusation of a long window
# After the alignment, before the first window of 5 s: its limits hold the uncertainty of attitude and gyroscope biases.
SHORT_WARM_UP_S = 20.0
MAX_BRIDGED_NS = 1_000_000_000  # gap in the inertial samples over which free propagations go on
BREAK_NS = 2_000_000_000  # without a solution, after which the filter has started again
RETENTION_S = 10  # of increments, fixes and solutions
MAX_WAITING = 2000  # batches of samples, where nothing asks for verdicts


class InertialMonitor:
    """Takes stamped measurements and solutions in order of arrival, and gives verdicts once a second."""

    def __init__(self, settings: Settings | None = None, rejected: Counter[str] | None = None) -> None:
        self.settings = s = settings or Settings()
        self.rejected: Counter[str] = Counter() if rejected is None else rejected
        self._decimator = Decimator(
            s.largest_force_m_s2, s.largest_rate_rad_s, self.rejected, bridged_ns=MAX_BRIDGED_NS
        )
        self._heights = Heights()
        self._heights.rejected = self.rejected
        self._lever_arm = np.array(s.vehicle.gnss.lever_arm_body_m)
        self._increments: deque[Increment] = deque(maxlen=RETENTION_S * 12)
        self._new: deque[Increment] = deque(maxlen=RETENTION_S * 12)  # not propagated yet
        self.taken: deque[Increment] = deque(maxlen=RETENTION_S * 12)  # for the other monitors, which clear it
        self._solutions: deque[NavigationSolution] = deque(maxlen=RETENTION_S * 12)
        self._states: deque[FilterState] = deque(maxlen=RETENTION_S)
        self._fixes: deque[VelocityFix] = deque(maxlen=RETENTION_S * 25)
        self._pending: deque[VelocityFix] = deque(maxlen=RETENTION_S * 25)  # not reached by the increments yet
        self._odometer = Series(RETENTION_S * 25, ODOMETER_GAP_S)
        self._resolution = 0.0
        self.long = LongWindow(s)
        self.window: Window | None = None  # newest one of 5 s
        self._window_missing = explain(Code.FEW_VELOCITIES)
        self._step: PositionStep | None = None  # over the same 5 s
        self._decided = False  # the odometer agrees with the inertial sensors, and not with GNSS
        self._fix_ns: int | None = None  # newest stamp, before the delay
        self._evaluated_ns = -SECOND_NS  # fix with which everything was compared last
        self._exceeded: Counter[str] = Counter()  # successive evaluations above the threshold
        self._accusing: dict[str, bool] = {}  # by test of a long window
        self._ways: dict[int, DistanceTest | None] = {}
        self._doubts: Counter[int] = Counter()  # successive evaluations of each way above the threshold of doubt
        self._inconspicuous_ns: dict[str, int] = {}  # newest evaluation of each long window below the median
        self._known: dict[str, Test] = {}
        self._differences = PositionDifferences()
        self._in_conflict = False  # of GNSS with other sensors, by core.trust
        self._aligned_ns: int | None = None  # since when there have been solutions without a break
        self.learning: Explanation | None = None  # why nothing is evaluated, although everything could be compared
        self.long_statistics: dict[str, float] = {}  # newest of each test of the long windows, over its threshold

    def inertial(self, times_ns: Sequence[int], forces_b: Sequence[Vector], rates_b: Sequence[Vector]) -> None:
        """Use inertial samples [m/s², rad/s; body]."""
        if self._decimator.add(times_ns, forces_b, rates_b) > MAX_WAITING:
            self._integrate()

    def _integrate(self) -> None:
        """Make increments of the samples that wait."""
        for increment in self._decimator.take():
            if increment.after_gap:
                self._increments.clear()
                self._new.clear()
                self.long.clear()
            self._new.append(increment)
            if increment.bridges:  # too coarse for what compares rates and 5 s, which go on after the gap
                self._increments.clear()
                continue
            self._increments.append(increment)
            self.taken.append(increment)

    def pressure(self, time_ns: int, pressure_pa: float) -> None:
        """Use the pressure of the barometer."""
        self._heights.pressure(time_ns, pressure_pa)

    def fix(
        self, time_ns: int, velocity_n: Vector | None, sd_n: Vector | None, position: Geodetic | None = None,
        position_sd_m: float = 0.0,
    ) -> None:  # fmt: skip
        """Use the GNSS velocity [m/s, NED] of the antenna and its position; None where the receiver has none."""
        g = self.settings.gnss
        if self._fix_ns is not None and time_ns <= self._fix_ns:
            self.rejected["gnss: stamp is not after the one before"] += 1
            return
        if velocity_n is not None and float(np.linalg.norm(velocity_n)) > g.largest_speed_m_s:
            self.rejected[f"gnss: speed is above {g.largest_speed_m_s:.0f} m/s"] += 1
            return
        self._fix_ns = time_ns
        of_positions = None
        if position is not None:
            of_positions = self._differences.after(
                time_ns - round(g.position_delay_s * SECOND_NS), position, position_sd_m
            )
        sd = np.full(3, np.inf)
        if velocity_n is not None:
            stated = np.array(sd_n) if sd_n is not None else np.full(3, g.velocity_sd_m_s)
            sd = np.maximum(np.where(stated > 0.0, stated, g.velocity_sd_m_s), g.velocity_sd_floor_m_s)
        if velocity_n is not None and float(sd[:2].max()) <= g.largest_velocity_sd_m_s:
            true_ns = time_ns - round(g.velocity_delay_s * SECOND_NS)
            position_ns = time_ns - round(g.position_delay_s * SECOND_NS)
            fix = VelocityFix(true_ns, np.array(velocity_n), sd, position, position_sd_m, position_ns=position_ns)
        elif of_positions is not None:
            fix = replace(of_positions, sd=np.maximum(of_positions.sd, g.velocity_sd_floor_m_s))
        else:
            self.rejected["gnss: fix without a velocity or two positions that could be compared"] += 1
            return
        newest = self._pending[-1] if self._pending else self._fixes[-1] if self._fixes else None
        if newest is None or fix.time_ns > newest.time_ns:
            self._pending.append(fix)

    def odometer(self, time_ns: int, speed: float, resolution: float | None) -> bool:
        """Use the odometer's speed [m/s], if it is plausible; its sign does not say whether the vehicle reverses."""
        newest_ns, true_ns = self._odometer.newest_ns, time_ns - round(self.settings.long.odometer_delay_s * SECOND_NS)
        if newest_ns is not None and true_ns <= newest_ns:
            self.rejected["odometer: stamp is not after the one before"] += 1
        elif not 0.0 <= speed <= 254.5 / 3.6:
            self.rejected["odometer: speed is not within 0 to 254 km/h"] += 1
        else:
            self._odometer.add(true_ns, speed)
            self._resolution = min(max(resolution or 0.0, 0.0), 3.0)
            return True
        return False

    def heed(self, *, odometer: bool, imu: bool, in_conflict: bool) -> None:
        """Follow core.trust: free propagations with an excluded sensor, or of a conflict, start again after it."""
        ends = self._in_conflict and not in_conflict  # the filter had used what was in doubt
        if imu or ends or odometer != self.long.odometer_excluded:
            self.long.clear()
            self._inconspicuous_ns.clear()
        self.long.odometer_excluded, self._in_conflict = odometer, in_conflict

    def solution(self, solution: NavigationSolution) -> None:
        """Use a solution of fusion that has attitude and heading."""
        newest_ns = self._solutions[-1].sampled_ns if self._solutions else None
        if newest_ns is not None and solution.sampled_ns <= newest_ns:
            self.rejected["solution: stamp is not after the one before"] += 1
            return
        if newest_ns is None or solution.sampled_ns - newest_ns > BREAK_NS:
            self._aligned_ns = solution.sampled_ns
        self._solutions.append(solution)

    def _warm_for_s(self, time_ns: int) -> float:
        """Time since the alignment [s]."""
        return 0.0 if self._aligned_ns is None else (time_ns - self._aligned_ns) / SECOND_NS

    def filter_state(self, state: FilterState) -> None:
        """Use a state of fusion's filter that has converged, from which a free propagation may start."""
        if self._warm_for_s(state.sampled_ns) < self.settings.warm_up_s:
            return
        if not self._states or state.sampled_ns > self._states[-1].sampled_ns:
            self._states.append(state)

    def verdicts(self, time_ns: int) -> Mapping[str, Test]:
        """Evaluate everything received; give the six metrics by name, `position_step`, `long_30` and `long_60`.

        A fix counts when the increments have passed it. While a window accuses, propagations start only from solutions
        that have not used GNSS since the suspect time.
        """
        self._integrate()
        self._propagate()
        found: dict[str, Test] = {**self._short(time_ns)}
        found |= {f"long_{length}": self._long(time_ns, length) for length in LENGTHS_S}
        found |= {f"way_{length}": self._way(time_ns, length) for length in WINDOW_LENGTHS_S}
        if self.learning and self._missing(time_ns) is None:
            found = {name: _withheld(test, self.learning) for name, test in found.items()}
        self._known = {name: dated(test, self._known.get(name), time_ns) for name, test in found.items()}
        suspect = [
            test.suspect_since_ns for test in self._known.values() if test.accuses and test.suspect_since_ns is not None
        ]
        if suspect:
            self.long.accuse(min(suspect))
        elif self._acquitted():
            self.long.acquit()
        return self._known

    def _acquitted(self) -> bool:
        """Whether a long window passes, or none is left to decide."""
        results = [self._known[f"long_{length}"].outcome for length in LENGTHS_S]
        return Outcome.PASS in results or self.long.oldest_s == 0.0

    def _propagate(self) -> None:
        """Propagate every free run over the new increments, and compare each fix as it is passed."""
        part: list[Increment] = []
        while self._new:
            increment = self._new.popleft()
            state = _at(self._states, increment.start_ns)
            if state is not None and state.sampled_ns < increment.end_ns:
                self._start(state, part)
            part.append(increment)
            if _ends_second(increment) or self._is_due(increment.end_ns):
                self._advance(part)
        self._advance(part)

    def _start(self, state: FilterState, part: list[Increment]) -> None:
        """Start a free run at a state, after the increments before it."""
        if self.long.wants(state.sampled_ns, state.position_used_ns):
            self._advance(part)
            self.long.start(filter_anchor_of(state))

    def _is_due(self, time_ns: int) -> bool:
        """Whether a fix before a time is to be evaluated."""
        passed = (fix.time_ns for fix in self._pending if fix.time_ns <= time_ns)
        return any(ns // SECOND_NS != self._evaluated_ns // SECOND_NS for ns in passed)

    def _advance(self, part: list[Increment]) -> None:
        """Take increments of one second: fixes before its end are compared before the covariances are propagated."""
        if not part:
            return
        self.long.advance(part)
        compared = sum(self._compare(increment.end_ns) for increment in part[:-1])
        if ends := _ends_second(part[-1]):
            self.long.predict()
        compared += self._compare(part[-1].end_ns)
        if ends:
            self._aid(part[-1])
        part.clear()
        if compared:
            self._evaluate()

    def _compare(self, time_ns: int) -> int:
        """Compare the fixes until a time; give their number."""
        number = 0
        while self._pending and self._pending[0].time_ns <= time_ns:
            fix = self._pending.popleft()
            self._fixes.append(fix)
            self.long.compare(fix, time_ns)
            number += 1
        return number

    def _aid(self, increment: Increment) -> None:
        speed = self._odometer.at(increment.end_ns)
        odometer = None if speed is None else OdometerSpeed(increment.end_ns, speed, self._resolution)
        solution = _at(self._solutions, increment.end_ns)
        stationary = solution is not None and solution.stationary
        self.long.aid(odometer, increment.row[5], stationary=stationary)

    def _evaluate(self) -> None:
        """Compare with the newest fix, at most once a second, and count successive exceedances."""
        newest_ns = self._fixes[-1].time_ns
        if newest_ns // SECOND_NS == self._evaluated_ns // SECOND_NS:
            return
        self._evaluated_ns = newest_ns
        self._evaluate_short(newest_ns)
        self._evaluate_long()

    def _evaluate_short(self, newest_ns: int) -> None:
        """Compare the 5 s before the newest fix."""
        chosen = window_of_fixes(self._fixes)
        if isinstance(chosen, Explanation):
            self._no_window(chosen)
            return
        known = next((s for s in reversed(self._solutions) if s.sampled_ns <= chosen[0].time_ns), None)
        run = [] if known is None else self._since(known.sampled_ns - MATCH_NS)
        if known is None or not run or run[0].start_ns > known.sampled_ns + MATCH_NS or run[-1].end_ns < newest_ns:
            self._no_window(explain(Code.NO_START))
            return
        window = compare(
            chosen, run, anchor_of(known), lever_arm_b=self._lever_arm, height_rate=self._heights.rate
        )  # fmt: skip
        self.window = window
        of_positions = any(fix.of_positions for fix in chosen)  # would be compared with themselves
        self._decided = self._odometer_decides(window)
        self._step = step = None if of_positions else position_step(chosen)
        self._exceeded[NAME] = self._exceeded[NAME] + 1 if step is not None and step.size > step.limit else 0
        profile = self.settings.profile
        for metric in Metric:
            sigma = profile.sigma_of(metric, window)
            difference = window.difference.get(metric)
            above = sigma is not None and difference is not None and abs(difference) > profile.threshold * sigma
            self._exceeded[metric] = self._exceeded[metric] + 1 if above else 0

    def _since(self, time_ns: int) -> list[Increment]:
        """Increments that start at a time or later."""
        newest_first = takewhile(lambda increment: increment.start_ns >= time_ns, reversed(self._increments))
        return list(newest_first)[::-1]

    def _evaluate_long(self) -> None:
        """Compare with the propagations, which go on over a gap of GNSS."""
        self.long_statistics = {}
        velocities = Limits(self.long.median, self.long.release_threshold, self.long.threshold)
        ways = Limits(self.long.way_median, self.long.way_doubt, self.long.way_threshold)
        for length in LENGTHS_S:
            result = self.long.result(length)
            self._decide(f"long_{length}", None if result is None else result.statistic, velocities)
            if result is not None:
                self.long_statistics[f"long_{length}"] = result.statistic / velocities.accuse
        for length in WINDOW_LENGTHS_S:
            way = self.long.way(length)
            self._ways[length] = way
            statistic = None if way is None else way.statistic
            self._decide(f"way_{length}", statistic, ways)
            doubt = statistic is not None and statistic > ways.release
            self._doubts[length] = self._doubts[length] + 1 if doubt else 0
            if statistic is not None:
                self.long_statistics[f"way_{length}"] = statistic / ways.accuse

    def _odometer_decides(self, window: Window) -> bool:
        """Whether the odometer shows the inertial change of speed over a window, and not that of GNSS."""
        begin, end = self._odometer.at(window.start_ns), self._odometer.at(window.end_ns)
        sigma = self.settings.profile.sigma_of(Metric.ACCELERATION, window)
        if begin is None or end is None or sigma is None or not self.settings.long.odometer:
            return False
        duration_s = (window.end_ns - window.start_ns) / SECOND_NS
        by_gnss, inertial = (abs(change - (end - begin)) / duration_s for change in window.speed_change_m_s)
        limit = self.settings.profile.threshold * float(np.hypot(sigma, self._resolution / duration_s / np.sqrt(6.0)))
        return by_gnss > limit and inertial < 0.5 * by_gnss

    def _decide(self, key: str, statistic: float | None, limits: Limits) -> None:
        """Accuse after two evaluations above the threshold; release after ten below a lower one."""
        if statistic is None:
            self._accusing[key] = False
            return
        accusing = self._accusing.get(key, False)
        if not accusing and statistic < limits.median:
            self._inconspicuous_ns[key] = self._fixes[-1].time_ns
        counts = statistic < limits.release if accusing else statistic > limits.accuse
        self._exceeded[key] = self._exceeded[key] + 1 if counts else 0
        if self._exceeded[key] >= (RELEASE if accusing else CONSECUTIVE):
            self._accusing[key] = not accusing
            self._exceeded[key] = 0

    def _suspect_since_ns(self, key: str, anchor_ns: int) -> int:
        """Two windows of 5 s before GNSS last agreed with a propagation of this length, but not before the anchor.

        Before that time an error is too small for the test, as it is while all monitors pass.
        """
        agreed_ns = self._inconspicuous_ns.get(key, anchor_ns)
        return max(anchor_ns, agreed_ns - round(2.0 * WINDOW_S * SECOND_NS))

    def _no_window(self, why: Explanation) -> None:
        self.window, self._window_missing = None, why
        for key in (*Metric, NAME):
            self._exceeded[key] = 0

    def _missing(self, time_ns: int) -> Explanation | None:
        """Why nothing can be compared now, in a window of any length."""
        newest = {
            Input.INERTIAL_SAMPLES: self._increments[-1].end_ns if self._increments else None,
            Input.ATTITUDE: self._solutions[-1].sampled_ns if self._solutions else None,
            Input.GNSS_VELOCITY: self._fixes[-1].time_ns if self._fixes else None,
        }
        limit_s = self.settings.stale_after_s
        missing = absent(newest, time_ns, limit_s, never=Code.NO_INPUT, silent=Code.INPUT_SILENT)
        if missing is not None:
            return missing
        warm_s, needed_s = self._warm_for_s(time_ns), min(SHORT_WARM_UP_S, self.settings.warm_up_s)
        if warm_s < needed_s:
            return explain(Code.WARMING_UP, elapsed_s=round(warm_s), needed_s=round(needed_s))
        return None

    def _short(self, time_ns: int) -> dict[str, Test]:
        missing = self._missing(time_ns) or (None if self.window is not None else self._window_missing)
        return {metric.value: self._metric(metric, missing) for metric in Metric} | {NAME: self._position(missing)}

    def _position(self, missing: Explanation | None) -> Test:
        step = self._step
        base = Test(
            Outcome.NOT_EVALUATED, missing or explain(Code.NO_POSITIONS), UNIT, false_alarm_rate=FALSE_ALARM_RATE,
            window_s=WINDOW_S,
        )  # fmt: skip
        if missing is not None or step is None:
            return base
        base = replace(base, why=explain(Code.POSITION_STEP), accused=BY_GNSS, suspect_since_ns=step.suspect_ns)
        return judged(base, step.size, step.limit, accuses=self._exceeded[NAME] >= CONSECUTIVE)

    def _metric(self, metric: Metric, missing: Explanation | None) -> Test:
        profile, window = self.settings.profile, self.window
        base = Test(
            Outcome.NOT_EVALUATED, missing or self._window_missing, UNITS[metric],
            false_alarm_rate=profile.false_alarm_rate, window_s=WINDOW_S,
        )  # fmt: skip
        if missing is not None or window is None:
            return base
        sigma, difference = profile.sigma_of(metric, window), window.difference.get(metric)
        if difference is None or sigma is None:
            return replace(base, why=window.missing.get(metric, explain(Code.NOT_IN_PROFILE)))
        limit = profile.threshold * sigma
        # A slow error shows in 5 s late: suspect is what the longer windows have not found inconspicuous since.
        suspect_ns = min([window.start_ns - (CONSECUTIVE - 1) * SECOND_NS, *self._inconspicuous_ns.values()])
        base = replace(
            base, why=_compared(metric, difference, limit), accused=BY_GNSS if self._decided else BY_EITHER,
            suspect_since_ns=suspect_ns,
        )  # fmt: skip
        return judged(base, abs(difference), limit, accuses=self._exceeded[metric] >= CONSECUTIVE)

    def _long(self, time_ns: int, length: int) -> Test:
        missing, key = self._missing(time_ns), f"long_{length}"
        result = self.long.result(length)
        base = Test(
            Outcome.NOT_EVALUATED, missing or self._young(length),
            false_alarm_rate=self.settings.long.false_alarm_rate, window_s=float(length),
        )  # fmt: skip
        if missing is not None or result is None:
            return base
        north, east, down = result.difference_n.tolist()
        why = explain(
            Code.VELOCITY_WITHOUT_ODOMETER if self.long.odometer_rejected else Code.VELOCITY,
            north_m_s=north, east_m_s=east, down_m_s=down,
            drag_m_s2=_least_drag(result, self.long.threshold, length),
        )  # fmt: skip
        base = replace(
            base, why=why, accused=BY_GNSS if result.decided else BY_EITHER,
            suspect_since_ns=self._suspect_since_ns(key, result.anchor_ns),
        )  # fmt: skip
        return judged(base, result.statistic, self.long.threshold, accuses=self._accusing.get(key, False))

    def _way(self, time_ns: int, length: int) -> Test:
        missing, way, key = self._missing(time_ns), self._ways.get(length), f"way_{length}"
        base = Test(
            Outcome.NOT_EVALUATED, missing or self._young(length),
            false_alarm_rate=self.settings.long.false_alarm_rate, window_s=float(length), accused=BY_EITHER,
        )  # fmt: skip
        if missing is not None or way is None:
            return base
        north, east = way.difference_n.tolist()
        why = explain(
            Code.WAY, north_m=north, east_m=east, doubt_statistic=self.long.way_doubt
        )  # fmt: skip
        base = replace(
            base, why=why, doubtful=self._doubts[length] >= CONSECUTIVE,
            suspect_since_ns=self._suspect_since_ns(key, way.anchor_ns),
        )  # fmt: skip
        return judged(base, way.statistic, self.long.way_threshold, accuses=self._accusing.get(key, False))

    def _young(self, length_s: int) -> Explanation:
        """Say that no propagation is old enough for a window, or that there are too few fixes at its end."""
        if self.long.oldest_s >= length_s:
            return explain(Code.FEW_VELOCITIES, window_s=WINDOW_S)
        return explain(Code.PROPAGATION_YOUNG, age_s=round(self.long.oldest_s))


def _compared(metric: Metric, difference: float, limit: float) -> Explanation:
    """Difference of a metric [rad/s, m/s², m/s] and its limit."""
    match metric:
        case Metric.HEADING_RATE:
            return explain(
                Code.HEADING_RATE, difference_deg_s=degrees(difference), limit_deg_s=degrees(limit)
            )  # fmt: skip
        case Metric.ALTITUDE_RATE:
            return explain(Code.ALTITUDE_RATE, difference_m_s=difference)
        case _:
            return explain(Code.ACCELERATION, difference_m_s2=difference)


def _withheld(test: Test, why: Explanation) -> Test:
    """A test whose threshold is not known yet; one that needs none of the inertial sensors stands."""
    if test.accuses and test.accused == BY_GNSS and test.unit == UNIT:
        return test
    return replace(
        test, outcome=Outcome.NOT_EVALUATED, why=why, statistic=None, threshold=None, suspect_since_ns=None,
        doubtful=False,
    )  # fmt: skip


def _least_drag(result: LongResult, threshold: float, length_s: int) -> float:
    """Least acceleration [m/s²] of a drag whose velocity exceeds the threshold when a window of this length ends."""
    return float(np.sqrt(threshold) * max(result.sd_n[0], result.sd_n[1])) / length_s


def _at(published: deque[Published], time_ns: int) -> Published | None:
    """The one of a time, None without one."""
    for navigation_solution in reversed(published):
        if navigation_solution.sampled_ns < time_ns - MATCH_NS:
            return None
        if navigation_solution.sampled_ns <= time_ns + MATCH_NS:
            return navigation_solution
    return None


def _ends_second(increment: Increment) -> bool:
    return increment.end_ns // SECOND_NS != increment.start_ns // SECOND_NS

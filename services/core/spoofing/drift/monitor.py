"""Accuses where sums of GNSS innovations over 30, 100 and 300 s are too large to be noise.

A filter that follows a slow drift leaves an innovation of a fraction of a standard deviation, always to the same side.
One of them says nothing; the sum grows with time and its spread with the root of time.

References
----------
B. Kujur, S. Khanafseh, B. Pervan, "Optimal INS monitor for GNSS spoofer tracking error detection", NAVIGATION 71(1),
navi.629, 2024: accumulated innovations of an inertial navigation filter. Windows, limits and the learned spread here
are this project's.
"""

from bisect import bisect_left
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from enum import StrEnum
from math import sqrt
from operator import attrgetter
from typing import NamedTuple

from shared.inertial.increments import SECOND_NS
from shared.messages.explanation import Explanation, explain
from shared.messages.navigation import AidingKind, AidingUpdate, NavigationSolution
from shared.messages.trust import Outcome
from shared.trust.accused import GNSS, IMU, ODOMETER
from shared.trust.result import Test, dated

from ..codes import Code
from ..grade import Grade
from ..settings import Settings
from .innovations import KINDS, InnovationSeconds, Second, sums_over
from .spread import MIN_BLOCKS, Spread, f_limit

LENGTHS_S = (30, 100, 300)
CONSECUTIVE = 2  # evaluations above the limit that accuse
MIN_SHARE = 0.8  # of the seconds of a window that have innovations
STATED_GRADES = (Grade.INDUSTRIAL, Grade.TACTICAL)
SETTLING_NS = 20 * SECOND_NS  # after the alignment: its errors are in the first innovations
MAX_DELAY_S = 1  # of the innovations behind the clock: the filter waits for late fixes
BREAK_NS = 2 * SECOND_NS  # without a solution, after which the filter has started again
DOUBT_RATE = 1e-3  # false-alarm rate below which nothing is learned
# Seconds for which sums over 30 s must be inconspicuous, below a rate of 0.01, to end an episode that they have accused
# in: the longer windows would remember it for minutes.
RECOVERED_S, RECOVERED_RATE = 10, 0.01
ODOMETER_NS = 3 * SECOND_NS  # age of a speed that the prediction may rest on
ALONG_RATE = 1e-3  # of a sum along the vehicle, below which the odometer may be what is wrong
NORTH, EAST, DOWN, ALONG, ACROSS = range(5)
NUMBER = attrgetter("number")  # of a second


class Part(StrEnum):
    """Axes that are tested together.

    A drag keeps its direction on Earth, an error of the odometer that of the vehicle.
    """

    NORTH_AND_EAST = "north_and_east"
    ALONG_AND_ACROSS = "along_and_across"
    DOWN = "down"


PARTS = {Part.NORTH_AND_EAST: (NORTH, EAST), Part.ALONG_AND_ACROSS: (ALONG, ACROSS), Part.DOWN: (DOWN,)}
NAMES = {AidingKind.GNSS_VELOCITY: "velocity", AidingKind.GNSS_POSITION: "position"}


class Sums(NamedTuple):
    """Sums over a window."""

    sums: tuple[float, ...]
    seconds: int
    begin_s: int  # number of the first second


class Result(NamedTuple):
    """The part of a window with the largest ratio to its limit."""

    ratio: float
    limit: float
    part: Part
    sums: Sums
    along: bool  # the odometer would explain it


class DriftMonitor:
    """Takes GNSS innovations of core.fusion, and gives verdicts once a second."""

    def __init__(self, settings: Settings, rejected: Counter[str]) -> None:
        self._rate = settings.drift.false_alarm_rate
        self._may_use = settings.long.odometer
        stated = settings.grade in STATED_GRADES
        self._innovations = {kind: InnovationSeconds(rejected) for kind in KINDS}
        self._spreads = {(kind, length): Spread(5, stated=stated) for kind in KINDS for length in LENGTHS_S}
        self._learned_s: dict[tuple[AidingKind, int], int] = {}  # end of the newest block
        self._heading = 0.0
        self._solution_ns: int | None = None
        self._aligned_ns = 0
        self._odometer_ns: int | None = None
        self._exceeded: Counter[str] = Counter()
        self._inconspicuous_ns: dict[str, int] = {}
        self._known: dict[str, Test] = {}
        self._recovered_s = 0
        self._along = False  # in this episode the odometer would explain a window that accuses
        self._seen_short = False  # a window of 30 s has accused in this episode
        self._suspected_s = 0  # newest second under suspicion
        self.quiet = True  # by the verdict: nothing is in conflict

    def solution(self, solution: NavigationSolution) -> None:
        """Use the heading of a solution; notice an alignment."""
        last_ns, self._solution_ns = self._solution_ns, solution.sampled_ns
        if last_ns is None or not 0 <= solution.sampled_ns - last_ns <= BREAK_NS:
            self._aligned_ns = solution.sampled_ns
            for innovation in self._innovations.values():
                innovation.clear()
        self._heading = solution.yaw_rad

    def speed(self, time_ns: int) -> None:
        """Note a speed of the odometer, which the filter uses if it may."""
        if self._may_use:
            self._odometer_ns = time_ns

    def innovation(self, update: AidingUpdate) -> None:
        """Use an innovation of GNSS."""
        innovations = self._innovations.get(update.kind)
        if innovations is not None and update.sampled_ns - self._aligned_ns >= SETTLING_NS:
            innovations.add(update, self._heading)

    def verdicts(self, time_ns: int) -> Mapping[str, Test]:
        """Test every window."""
        now_s = time_ns // SECOND_NS
        found, doubtful, recovered = {}, False, True
        for kind, innovations in self._innovations.items():
            innovations.complete(now_s - MAX_DELAY_S)
            end_s = innovations.seconds[-1].number + 1 if innovations.seconds else now_s
            for length in LENGTHS_S:
                spread, sums = self._spreads[kind, length], summed(innovations.seconds, end_s, length)
                result = self._result(spread, sums) if sums is not None else None
                name = f"{NAMES[kind]}_{length}"
                found[name] = self._verdict(name, kind, length, result, sums, time_ns)
                if result is not None:
                    share = result.ratio / result.limit
                    doubtful = doubtful or share > self._share_of(DOUBT_RATE, result, spread)
                    if length == LENGTHS_S[0]:
                        recovered = recovered and share < self._share_of(RECOVERED_RATE, result, spread)
        self._known = {name: dated(test, self._known.get(name), time_ns) for name, test in found.items()}
        if doubtful or not self.quiet:
            self._suspected_s = now_s
        self._recover(recovered)
        self._learn(now_s)
        return self._known

    def _share_of(self, rate: float, result: Result, spread: Spread) -> float:
        """Limit of another false-alarm rate over that of the tests."""
        return spread.limit(len(PARTS[result.part]), rate) / result.limit

    def _result(self, spread: Spread, sums: Sums) -> Result | None:
        if not spread.is_known:
            return None
        tests = {part: spread.ratio(sums.sums, sums.seconds, axes) for part, axes in PARTS.items()}
        limits = {part: spread.limit(len(axes), self._rate) for part, axes in PARTS.items()}
        part = max(tests, key=lambda part: tests[part] / limits[part])
        along = spread.ratio(sums.sums, sums.seconds, (ALONG,)) > spread.limit(1, ALONG_RATE)
        return Result(tests[part], limits[part], part, sums, along and part is not Part.DOWN)

    def _verdict(
        self, name: str, kind: AidingKind, length: int, result: Result | None, sums: Sums | None, time_ns: int
    ) -> Test:
        spread = self._spreads[kind, length]
        base = Test(
            Outcome.NOT_EVALUATED, missing(spread, sums), false_alarm_rate=self._rate, window_s=float(length)
        )  # fmt: skip
        if result is None:
            self._exceeded[name] = 0
            return base
        above = result.ratio > result.limit
        self._exceeded[name] = self._exceeded[name] + 1 if above else 0
        if result.ratio < f_limit(len(PARTS[result.part]), spread.blocks, 0.5):
            self._inconspicuous_ns[name] = time_ns
        base = replace(base, statistic=result.ratio, threshold=result.limit, why=summed_up(kind, result, spread))
        if self._exceeded[name] < CONSECUTIVE:
            return replace(base, outcome=Outcome.PASS)
        begin_ns = result.sums.begin_s * SECOND_NS
        quiet_ns = self._inconspicuous_ns.get(name)
        since_ns = begin_ns if quiet_ns is None else min(begin_ns, quiet_ns - length * SECOND_NS)
        used = self._odometer_ns is not None and time_ns - self._odometer_ns <= ODOMETER_NS
        self._along = self._along or (result.along and used)
        accused = (GNSS, IMU, ODOMETER) if self._along else (GNSS, IMU)
        return replace(base, outcome=Outcome.ACCUSES, suspect_since_ns=since_ns, accused=accused)

    def _recover(self, recovered: bool) -> None:
        """Forget what is older than the shortest window when that has been inconspicuous for as long."""
        accusing = [test for test in self._known.values() if test.accuses]
        self._along = self._along and bool(accusing)
        self._seen_short = bool(accusing) and (
            self._seen_short or any(test.window_s == LENGTHS_S[0] for test in accusing)
        )
        self._recovered_s = self._recovered_s + 1 if recovered and self._seen_short else 0
        if self._recovered_s >= RECOVERED_S:
            for innovation in self._innovations.values():
                innovation.keep(LENGTHS_S[0])
            self._recovered_s, self._seen_short = 0, False

    def _learn(self, now_s: int) -> None:
        """Learn from the newest block that ended a window ago, if nothing has been suspected since it began."""
        for kind, innovations in self._innovations.items():
            for length in LENGTHS_S:
                end_s = now_s - LENGTHS_S[0]
                last_s = self._learned_s.get((kind, length), 0)
                if end_s - length < max(last_s, self._suspected_s):
                    continue
                if (block := summed(innovations.seconds, end_s, length)) is not None:
                    self._spreads[kind, length].learn(block.sums, block.seconds)
                    self._learned_s[kind, length] = end_s


def summed(seconds: Sequence[Second], end_s: int, length: int) -> Sums | None:
    """Sums over the seconds of a window that ends before a second, None where too many are missing."""
    begin, end = (bisect_left(seconds, number, key=NUMBER) for number in (end_s - length, end_s))
    if end - begin < MIN_SHARE * length:
        return None
    return Sums(sums_over(seconds[begin], seconds[end - 1]), end - begin, end_s - length)


def missing(spread: Spread, sums: Sums | None) -> Explanation:
    """Why a window is not evaluated."""
    if sums is None:
        return explain(Code.FEW_INNOVATIONS)
    return explain(
        Code.LEARNING_SPREAD, blocks_count=spread.blocks, needed_count=MIN_BLOCKS
    )  # fmt: skip


def summed_up(kind: AidingKind, result: Result, spread: Spread) -> Explanation:
    """What was compared: the sums over their standard deviations."""
    sums = result.sums
    sds = [sums.sums[axis] / sqrt(sums.seconds * spread.variance(axis)) for axis in PARTS[result.part]]
    if result.part is Part.DOWN:
        return explain(Code.INNOVATIONS_DOWN, what=NAMES[kind], sum_statistic=sds[0])
    return explain(
        Code.INNOVATIONS, what=NAMES[kind], part=result.part, first_statistic=sds[0],
        second_statistic=sds[1],
    )  # fmt: skip

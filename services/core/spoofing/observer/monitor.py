"""GNSS course and the filter's gyroscope bias against the observer: what turns too slowly for windows of 30 s."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from itertools import islice
from math import degrees, radians, sin, sqrt

import numpy as np

from shared.inertial.increments import SECOND_NS, Increment
from shared.maths.earth import EARTH_RATE
from shared.maths.quantiles import chi_square_limit
from shared.maths.rotation import Vector
from shared.messages.explanation import explain
from shared.messages.navigation import NavigationSolution
from shared.messages.trust import Outcome
from shared.trust.accused import GNSS, IMU
from shared.trust.result import Test, dated, judged

from ..codes import Code
from ..gyroscope.bias import Bias
from ..gyroscope.sources import Course, Headings
from ..gyroscope.track import dot
from ..gyroscope.vote import Difference, Source, vote
from ..settings import Settings
from .gravity import NAME as GRAVITY
from .gravity import Gravity
from .observer import Observer
from .trend import Trend, row_of, trend

LENGTHS_S = (60, 120, 300)
# Part of a window at its end in which an error must still grow: what has ended is not accused again by long windows.
RECENT_WINDOW_S = {60: 30, 120: 60, 300: 60}
RATE_END_SDS = 3.0  # by which the rate at the end of a window is smaller than that of the window
PERIOD_S = {60: 1, 120: 2, 300: 5}  # a long window changes little in a second
COLUMNS, NEWEST = 8, 10  # of the table of courses; readings that may be new in it
TURNING_M_S = 0.5  # speed of wheels that are sure to turn
CONSECUTIVE = 2  # evaluations above the threshold that accuse
SCALE_FLOOR = 1e-6  # [rad/s] least standard deviation of a rate
BIAS = "observed_bias"
BIAS_WINDOW_S = 60.0  # in which the filter's bias changes by what is another sample of it
RETURNING = 0.9  # of the largest difference of an episode, below which the filter is on its way back to the observer
BY_EITHER = (GNSS, IMU)

OfWheels = Callable[[int, Bias, int], Difference | None]  # gyroscope minus wheels over the seconds before a time


def name_of(length_s: int) -> str:
    """Name of the test of a window."""
    return f"observed_turn_{length_s}"


class ObserverMonitor:
    """Takes increments, wheels and courses in order of arrival, and gives verdicts once a second."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.observer = Observer(settings)
        self.gravity = Gravity(settings)
        self._courses = Headings()
        self._table, self._begin_ns = np.empty((0, COLUMNS)), 0  # of these, for the trends
        self._turns: dict[str, Test] = {}  # newest of each window
        self._filter: NavigationSolution | None = None  # newest: what is compared with the observer
        self._exceeded: Counter[str] = Counter()
        self._doubts: Counter[str] = Counter()
        self._doubt = chi_square_limit(1, settings.long.doubt_rate)
        self._largest = 0.0  # difference of the biases [rad/s] in the present episode
        self._known: dict[str, Test] = {}

    def wheels(self, time_ns: int, speed_m_s: float) -> None:
        """Use the speed of the wheels; one between zero and walking slowly may be the noise of its source."""
        if speed_m_s == 0.0 or speed_m_s > TURNING_M_S:
            self.observer.standstills.wheels(time_ns, turn=speed_m_s > 0.0)

    def courses(self, courses: Iterable[Course]) -> None:
        """Use courses of GNSS, which the observer itself does not see."""
        for course in courses:
            self._courses.add(
                course.time_ns, course.angle, course.variance, ahead_s=course.ahead_s, slip_s=course.slip_s
            )

    def solution(self, solution: NavigationSolution) -> None:
        """Use the filter's gyroscope bias, likewise."""
        self._filter = solution

    def advance(self, increments: Iterable[Increment]) -> None:
        """Integrate increments."""
        increments = tuple(increments)
        if not self.observer.advance(increments):
            self._courses.clear()
        if (known := self._bias_for_gravity()) is not None:
            self.gravity.advance(increments, known[0])
        self._courses.advance(self.observer)
        self._tabulate()

    def _tabulate(self) -> None:
        """Append what is new to the table of courses; the newest of a second takes the place of an earlier one."""
        readings = self._courses.readings
        if not readings:
            self._table = self._table[:0]
            return
        if not len(self._table):
            self._begin_ns = readings[0].turn.time_ns
        last_s = self._table[-1, 0] if len(self._table) else -1.0
        limit_ns = self._begin_ns + round(max(last_s - 1.0, -1.0) * SECOND_NS)
        new = [
            row_of(reading, self._begin_ns)
            for reading in islice(reversed(readings), NEWEST)
            if reading.turn.time_ns > limit_ns
        ]
        if new:
            kept = self._table[(self._table[:, 0] < new[-1][0]) & (self._table[:, 0] > new[0][0] - LENGTHS_S[-1] - 5.0)]
            self._table = np.vstack([kept, new[::-1]])

    def reference(self, latitude_deg: float) -> Bias | None:
        """Bias without the Earth's rate, as the other monitors count it; None before the first standstill.

        GNSS may give the latitude here: a degree of it changes the bias by 1e-6 rad/s.
        """
        bias, variance = self._bias()
        if bias is None or self.observer.down is None:
            return None
        earth = EARTH_RATE * sin(radians(latitude_deg))
        x, y, z = (value + axis * earth for value, axis in zip(bias.value, self.observer.down, strict=True))
        sd = sqrt(variance)
        return Bias(bias.time_ns, (x, y, z), (sd, sd, sd))

    def _bias(self) -> tuple[Bias | None, float]:
        found, newest_ns = self.observer.bias, self.observer.newest_ns
        variance = None if newest_ns is None else self.observer.bias_variance(newest_ns)
        if found is None or variance is None:
            return None, 0.0
        sd = sqrt(variance)
        return Bias(found.time_ns, found.value, (sd, sd, sd)), variance

    def _bias_for_gravity(self) -> tuple[Vector, float] | None:
        """Bias and its variance of an axis for the 12 s over which gravity is carried, None where none is known.

        Before the first standstill that of the filter serves: what an attack teaches it, 0.05 deg/s, is half a degree.
        """
        bias, variance = self._bias()
        if bias is not None:
            return bias.value, variance
        of_filter = self._filter
        if of_filter is None or of_filter.gyroscope_bias_sd_rad_s is None:
            return None
        sd = max(of_filter.gyroscope_bias_sd_rad_s)
        return of_filter.gyroscope_bias_rad_s, sd**2 + self.settings.long.gyroscope_bias_sd_rad_s**2

    def verdicts(self, time_ns: int, of_wheels: OfWheels) -> Mapping[str, Test]:
        """Test every window, and the bias."""
        bias, variance = self._bias()
        found = dict(self._turns)
        for length in LENGTHS_S:
            if (time_ns // SECOND_NS) % PERIOD_S[length] == 0 or name_of(length) not in found:
                found[name_of(length)] = self._turn(length, bias, variance, of_wheels)
        self._turns = dict(found)
        found[BIAS] = self._of_bias(bias, variance)
        known = self._bias_for_gravity()
        rate = self.settings.gyroscope.false_alarm_rate
        found[GRAVITY] = self.gravity.verdict(0.0 if known is None else known[1], rate)
        self._known = {name: dated(test, self._known.get(name), time_ns) for name, test in found.items()}
        return self._known

    def _turn(self, length: int, bias: Bias | None, variance: float, of_wheels: OfWheels) -> Test:
        """Course against the yaw of the observer over one window, with the wheels as a third witness."""
        name, rate = name_of(length), self.settings.gyroscope.false_alarm_rate
        base = Test(
            Outcome.NOT_EVALUATED, explain(Code.NO_STANDSTILL_YET), false_alarm_rate=rate, window_s=float(length)
        )
        end_ns = self.observer.newest_ns
        slope = None if bias is None else self._trend(bias, length)
        if bias is None or slope is None or end_ns is None:
            self._count(name, above=False, doubtful=False)
            return base if bias is None else replace(base, why=explain(Code.NO_COURSES))
        common = self._common(slope, variance)
        differences = {Source.COURSE: Difference(-slope.rate, slope.variance)}
        if (wheels := of_wheels(end_ns, bias, length)) is not None:
            differences[Source.WHEELS] = wheels
        # The course alone is tested: whether the wheels agree with the gyroscope is for shorter windows to say.
        statistic, limit = slope.rate**2 / (slope.variance + common), chi_square_limit(1, rate)
        ballot = vote(differences, common, rate)
        suspects = () if ballot is None else ballot.suspects
        doubtful = statistic > self._doubt and GNSS in suspects
        doubtful = doubtful and not (slope.jumps or self._ended(slope, bias, length, common))
        self._count(name, above=doubtful and statistic > limit, doubtful=doubtful)
        age_s = (end_ns - bias.time_ns) / SECOND_NS
        why = explain(
            Code.OBSERVED_TURN, difference_deg_s=degrees(slope.rate), sd_deg_s=degrees(sqrt(slope.variance + common)),
            age_s=round(age_s),
        )  # fmt: skip
        begin_ns = end_ns - length * SECOND_NS
        base = replace(base, why=why, accused=suspects or BY_EITHER, suspect_since_ns=begin_ns)
        return self._judged(name, base, statistic, limit)

    def _count(self, name: str, *, above: bool, doubtful: bool) -> None:
        """Count successive evaluations above the threshold, and above that of a doubt."""
        self._exceeded[name] = self._exceeded[name] + 1 if above else 0
        self._doubts[name] = self._doubts[name] + 1 if doubtful else 0

    def _judged(self, name: str, base: Test, statistic: float, limit: float) -> Test:
        base = replace(base, doubtful=self._doubts[name] >= CONSECUTIVE)
        return judged(base, statistic, limit, accuses=self._exceeded[name] >= CONSECUTIVE)

    def _trend(self, bias: Bias, length: int) -> Trend | None:
        gnss = self.settings.gnss
        if not self._courses.readings or self._is_late():
            return None
        return trend(
            self._table, bias.value, float(length), correlation_s=gnss.velocity_correlation_s,
            time_sd_s=max(gnss.time_sd_s, self.settings.long.position_time_sd_s),
        )  # fmt: skip

    def _is_late(self) -> bool:
        newest_ns = self.observer.newest_ns
        return newest_ns is None or newest_ns - self._courses.readings[-1].turn.time_ns > 3 * SECOND_NS

    def _common(self, slope: Trend, bias_variance: float) -> float:
        """Variance of the gyroscope's slope: bias, random walk (6/5 of that of its ends), scale times the turn."""
        long = self.settings.long
        walk = 1.2 * long.angle_random_walk_rad_sqrt_s**2 / slope.span_s
        return bias_variance + walk + (long.gyroscope_scale_sd * slope.turn_rate) ** 2 + SCALE_FLOOR**2

    def _ended(self, slope: Trend, bias: Bias, length: int, common: float) -> bool:
        """Whether the course has come back, so that it does not turn away any more at the end of the window."""
        recent = self._trend(bias, RECENT_WINDOW_S[length])
        if recent is None:
            return True
        sd = sqrt(recent.variance + self._common(recent, 0.0) + min(common, slope.variance))
        sign = 1.0 if slope.rate > 0.0 else -1.0
        return sign * (slope.rate - recent.rate) > RATE_END_SDS * sd

    def _of_bias(self, bias: Bias | None, variance: float) -> Test:
        """Bias of the filter, which GNSS teaches, against that of the observer, about the vertical."""
        rate, newest, down = self.settings.gyroscope.false_alarm_rate, self._filter, self.observer.down
        base = Test(
            Outcome.NOT_EVALUATED, explain(Code.NO_STANDSTILL_YET), false_alarm_rate=rate, window_s=BIAS_WINDOW_S,
            accused=BY_EITHER,
        )  # fmt: skip
        if bias is None or newest is None or down is None or newest.gyroscope_bias_sd_rad_s is None:
            self._count(BIAS, above=False, doubtful=False)
            return base
        earth = EARTH_RATE * sin(radians(newest.latitude_deg))
        apart = dot(down, newest.gyroscope_bias_rad_s) - earth - dot(down, bias.value)
        of_filter = max(newest.gyroscope_bias_sd_rad_s) ** 2 + self.settings.long.gyroscope_bias_sd_rad_s**2
        total = of_filter + variance
        statistic, limit = apart**2 / total, chi_square_limit(1, rate)
        self._largest = max(self._largest, abs(apart)) if statistic > self._doubt else 0.0
        doubtful = statistic > self._doubt and abs(apart) > RETURNING * self._largest
        self._count(BIAS, above=doubtful and statistic > limit, doubtful=doubtful)
        why = explain(
            Code.OBSERVED_BIAS, difference_deg_s=degrees(apart), sd_deg_s=degrees(sqrt(total)),
            age_s=round((newest.sampled_ns - bias.time_ns) / SECOND_NS),
        )  # fmt: skip
        since_ns = newest.sampled_ns - round(BIAS_WINDOW_S * SECOND_NS)
        base = replace(base, why=why, suspect_since_ns=since_ns)
        return self._judged(BIAS, base, statistic, limit)

"""The gyroscope's yaw rate against all others: means over 5, 10 and 30 s, evaluated once a second."""

from collections import Counter, deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import atan2, degrees, hypot, sqrt

from shared.inertial.increments import SECOND_NS, Increment
from shared.inertial.strapdown import rotate
from shared.maths.earth import wrap_angle
from shared.maths.rotation import Vector, ned_from_body, quaternion_from_matrix
from shared.messages.explanation import Explanation, explain
from shared.messages.gnss import GnssFix
from shared.messages.navigation import NavigationSolution
from shared.messages.trust import Outcome
from shared.messages.vehicle import WheelSpeeds
from shared.trust.result import Test, dated

from ..codes import Code
from ..settings import Settings
from .axle import Axle, AxleSecond, combined
from .bias import Bias, ReferenceBias
from .sources import MIN_COURSE_M_S, Course, Headings, Reading, Second, WheelSeconds, course_of
from .track import GyroscopeTrack
from .vote import Difference, Source, Vote, vote

# [s] Wheels alone tell 0.5 deg/s from noise over 10 s, not over 5.
LENGTHS_S = (5, 10, 30)
CONSECUTIVE = 2  # evaluations above the threshold that accuse
COURSES = 100  # that wait for the observer
MIN_SHARE = 0.8  # of the seconds of a window that wheel speeds must cover
STANDSTILL_SPEED_M_S = 0.3  # GNSS speed of a vehicle that stands: six times the least standard deviation of an axis
# [rad/s] Mean yaw rate of a vehicle that stands, over 5 s: a body that sways on its springs by a millimetre at the
# bumper, 2 m from its middle, turns by 0.03 deg.
STANDSTILL_RATE_SD = 3e-4
COMPASS_SD = 0.17  # [rad] of a magnetic heading: iron that the vehicle passes turns it by ten degrees
LEARNING_DELAY_S = 30  # for which seconds wait before they are learned, the longest window
USEFUL_SD = 5e-3  # [rad/s] of the wheels' yaw rate over 5 s, above which it is still being learned
USEFUL_SHARE = 0.2  # of the turn, likewise: the track width is known to 0.3 m before it is learned
AGREEMENT_S = 60  # of agreement with the newest bias that end an accusation
DOUBT_RATE = 1e-4  # false-alarm rate below which nothing is learned and the bias of before is kept


class GyroscopeMonitor:
    """Takes stamped measurements and solutions in order of arrival, and gives verdicts once a second."""

    def __init__(self, settings: Settings, rejected: Counter[str]) -> None:
        self.settings = settings
        self.rejected = rejected
        self.track = GyroscopeTrack()
        self.wheels = WheelSeconds(rejected)
        self.rear, self.front = Axle(), Axle()
        self._headings = {source: Headings() for source in (Source.COURSE, Source.ANTENNA, Source.COMPASS)}
        self._reference = ReferenceBias()
        self._to_learn: deque[Second] = deque(maxlen=LEARNING_DELAY_S + 5)
        self._still_since_ns: int | None = None  # since when GNSS has stood
        self._stationary_since_ns: int | None = None  # since when the inertial sensors have been at standstill
        self._stamp_ns: int | None = None  # newest of a fix
        self._fix_ns: int | None = None  # when its velocity was true
        self._field_s = 0  # second of the newest magnetic heading
        self._exceeded: Counter[int] = Counter()
        self._inconspicuous_ns: dict[int, int] = {}
        self._known: dict[str, Test] = {}
        self._suspected = False
        self.observed: Bias | None = None  # by standstills, which no attack has taught
        self._acquitted: set[str] = set()  # by an earlier evaluation of this episode
        self._quiet_s = 0  # since a window accused
        self._agreed_s = 0
        self._courses: deque[Course] = deque(maxlen=COURSES)  # new ones, for the comparison with the observer

    def solution(self, solution: NavigationSolution) -> None:
        """Use tilt and gyroscope bias of fusion."""
        self.track.attitude(solution)
        if not solution.stationary:
            self._stationary_since_ns = None
        elif self._stationary_since_ns is None:
            self._stationary_since_ns = solution.sampled_ns
        self.wheels.stationary_since_ns = self._stationary_since_ns
        self._reference.add(solution.sampled_ns, solution.gyroscope_bias_rad_s, solution.gyroscope_bias_sd_rad_s)

    def speeds(self, message: WheelSpeeds) -> None:
        """Use wheel speeds."""
        self.wheels.add(message.sampled_ns - round(self.settings.long.odometer_delay_s * SECOND_NS), message)

    def fix(self, fix: GnssFix, velocity_n: Vector | None, sd_n: Vector | None) -> None:
        """Use the course of a GNSS velocity [m/s, NED], and the heading of two antennas; stamps must increase."""
        gnss, since_ns = self.settings.gnss, self._stamp_ns
        speed = 0.0 if velocity_n is None else hypot(*velocity_n)
        if (since_ns is not None and fix.sampled_ns <= since_ns) or not speed <= gnss.largest_speed_m_s:
            return  # counted by the inertial monitor
        self._stamp_ns = fix.sampled_ns
        if fix.baseline_heading_rad is not None and fix.baseline_heading_sd_rad:
            time_ns = fix.sampled_ns - round(gnss.position_delay_s * SECOND_NS)
            sd = max(fix.baseline_heading_sd_rad, 1e-3)
            self._headings[Source.ANTENNA].add(time_ns, fix.baseline_heading_rad, sd**2)
        sd = max(max(sd_n[:2]) if sd_n is not None else gnss.velocity_sd_m_s, gnss.velocity_sd_floor_m_s)
        if velocity_n is None or sd > gnss.largest_velocity_sd_m_s:
            return
        time_ns, speed = fix.sampled_ns - round(gnss.velocity_delay_s * SECOND_NS), hypot(*velocity_n[:2])
        self._note_standstill(time_ns, hypot(speed, sd))
        course = course_of(self.settings, time_ns, velocity_n, sd)
        if course is not None:
            self._courses.append(course)
            self._headings[Source.COURSE].add(
                time_ns, course.angle, course.variance, ahead_s=course.ahead_s, slip_s=course.slip_s
            )

    def new_courses(self) -> list[Course]:
        """Courses since the last call."""
        found = list(self._courses)
        self._courses.clear()
        return found

    def of_wheels(self, end_ns: int, bias: Bias, length: int) -> Difference | None:
        """Gyroscope minus wheels over the seconds before a time, with a bias that has the Earth's rate in it."""
        earth = self.track.earth
        x, y, z = (value + axis * earth for value, axis in zip(bias.value, self.track.axis, strict=True))
        found = self._of_wheels(end_ns, bias._replace(value=(x, y, z)), length)
        return None if found is None else found[0]

    def _note_standstill(self, time_ns: int, largest_m_s: float) -> None:
        """Note since when GNSS has stood, by velocities that follow each other within 2 s."""
        if (
            self._fix_ns is None
            or not 0 < time_ns - self._fix_ns <= 2 * SECOND_NS
            or largest_m_s >= STANDSTILL_SPEED_M_S
        ):
            self._still_since_ns = None
        if largest_m_s < STANDSTILL_SPEED_M_S and self._still_since_ns is None:
            self._still_since_ns = time_ns
        self._fix_ns = time_ns

    def field(self, time_ns: int, field_b: Vector, solution: NavigationSolution) -> None:
        """Use the magnetic field in body axes with the tilt of a solution, once a second."""
        if time_ns // SECOND_NS == self._field_s:
            return
        self._field_s = time_ns // SECOND_NS
        tilt = quaternion_from_matrix(ned_from_body(solution.roll_rad, solution.pitch_rad, 0.0))
        ahead, right, _ = rotate(tilt, field_b)
        self._headings[Source.COMPASS].add(time_ns, -atan2(right, ahead), COMPASS_SD**2)

    def verdicts(self, time_ns: int, increments: Sequence[Increment]) -> Mapping[str, Test]:
        """Take the increments since the last call, and test every window."""
        if not self.track.add(increments):
            self._clear()
        for second in self.wheels.advance(self.track):
            self._to_learn.append(second)
        for headings in self._headings.values():
            headings.advance(self.track)
        bias = self._reference.advance(time_ns, suspected=self._suspected)
        bias = self._better(bias)
        votes = {} if bias is None else self._votes(bias)
        self._acquit(votes)
        found = {f"yaw_rate_{length}": self._verdict(time_ns, length, votes.get(length)) for length in LENGTHS_S}
        self._known = {name: dated(test, self._known.get(name), time_ns) for name, test in agreed(found).items()}
        self._suspected = any(vote.exceeds(DOUBT_RATE) for vote in votes.values())
        self._release(votes)
        self._learn()
        return self._known

    def _better(self, of_filter: Bias | None) -> Bias | None:
        """The bias of standstills, unless that of the filter of a minute ago is known better."""
        observed = self.observed
        if observed is None or of_filter is None:
            return of_filter
        sd = hypot(*of_filter.sd, self.settings.long.gyroscope_bias_sd_rad_s)
        return observed if hypot(*observed.sd) < sd else of_filter

    def _acquit(self, votes: Mapping[int, Vote]) -> None:
        """Remember who cannot be wrong in this episode, which ends when nothing has accused for the longest window."""
        accusing = [item for item in votes.values() if item.statistic > item.threshold]
        self._quiet_s = 0 if accusing else self._quiet_s + 1
        if self._quiet_s > LENGTHS_S[-1]:
            self._acquitted.clear()
        for item in accusing:
            self._acquitted.update(item.acquitted)

    def _clear(self) -> None:
        self.wheels.clear()
        self._to_learn.clear()
        for headings in self._headings.values():
            headings.clear()

    def _release(self, votes: Mapping[int, Vote]) -> None:
        """Take the newest bias as the reference when all sources have agreed with it for a minute of suspicion."""
        newest = self._reference.newest
        if not self._suspected or newest is None:
            self._agreed_s = 0
            return
        now = self._votes(newest)
        agrees = len(now) == len(votes) and not any(vote.exceeds(DOUBT_RATE) for vote in now.values())
        self._agreed_s = self._agreed_s + 1 if agrees else 0
        if self._agreed_s >= AGREEMENT_S:
            self._reference.adopt()
            self._agreed_s = 0

    def _learn(self) -> None:
        """Learn from the seconds that no window of an inconspicuous evaluation has called into question."""
        newest = self._reference.newest
        if self._suspected:
            self._to_learn.clear()
        while self._to_learn and newest is not None:
            second = self._to_learn[0]
            if second.number > self.wheels.seconds[-1].number - LEARNING_DELAY_S:
                break
            self._to_learn.popleft()
            if second.still:
                continue
            rate = second.rate_less(newest.value)
            for axle, part in ((self.rear, second.rear), (self.front, second.front)):
                if part is not None:
                    axle.learn(part, rate)

    def _votes(self, bias: Bias) -> dict[int, Vote]:
        """Vote over each window that can be evaluated."""
        end_ns, rate = self.track.newest_ns, self.settings.gyroscope.false_alarm_rate
        found: dict[int, Vote] = {}
        if end_ns is None:
            return found
        for length in LENGTHS_S:
            ballot = vote(*self._differences(end_ns, bias, length), rate)
            if ballot is not None:
                found[length] = ballot
        return found

    def _differences(self, end_ns: int, bias: Bias, length: int) -> tuple[dict[Source, Difference], float]:
        """Gyroscope minus every other source over a window, and the variance of the gyroscope's mean rate."""
        found: dict[Source, Difference] = {}
        rates: list[float] = []
        for source, headings in self._headings.items():
            if (pair := headings.pair(end_ns, float(length))) is not None:
                found[source], rate = self._of_headings(*pair, bias, source)
                rates.append(rate)
        if (still := self._of_gnss_still(end_ns, bias, length)) is not None:
            found[Source.COURSE] = still
        if (by_wheels := self._of_wheels(end_ns, bias, length)) is not None:
            found[Source.WHEELS], rate = by_wheels
            rates.append(rate)
        long = self.settings.long
        bias_sd = hypot(*bias.sd, long.gyroscope_bias_sd_rad_s)
        rate = max(map(abs, rates), default=0.0)
        common = bias_sd**2 + long.angle_random_walk_rad_sqrt_s**2 / length + (long.gyroscope_scale_sd * rate) ** 2
        return found, common

    def _of_headings(self, first: Reading, last: Reading, bias: Bias, source: Source) -> tuple[Difference, float]:
        """Difference by two headings, and the gyroscope's rate between them [rad/s]."""
        span_s = (last.turn.time_ns - first.turn.time_ns) / SECOND_NS
        turned = last.turn.less(bias.value) - first.turn.less(bias.value)
        off = wrap_angle(turned - (last.angle - first.angle))
        late = 0.0
        if source is not Source.COMPASS:
            gnss_s = max(self.settings.gnss.time_sd_s, self.settings.long.position_time_sd_s)
            late = gnss_s * (last.turn.rate - first.turn.rate)
        variance = (first.variance + last.variance + late**2) / span_s**2
        return Difference(off / span_s, variance), turned / span_s

    def _of_gnss_still(self, end_ns: int, bias: Bias, length: int) -> Difference | None:
        """Difference while GNSS stands for the whole window: a vehicle that stands does not turn.

        The inertial sensors must be at standstill too: GNSS does not see a vehicle that creeps around a corner.
        """
        begin_ns, still_ns, quiet_ns = end_ns - length * SECOND_NS, self._still_since_ns, self._stationary_since_ns
        if still_ns is None or quiet_ns is None or self._fix_ns is None or max(still_ns, quiet_ns) > begin_ns:
            return None
        if end_ns - self._fix_ns > 1.5 * SECOND_NS or (turn := self._mean_rate(end_ns, bias, length)) is None:
            return None
        return Difference(turn, STANDSTILL_RATE_SD**2)

    def _mean_rate(self, end_ns: int, bias: Bias, length: int) -> float | None:
        begin, end = self.track.at(end_ns - length * SECOND_NS), self.track.at(end_ns)
        return None if begin is None or end is None else (end.less(bias.value) - begin.less(bias.value)) / length

    def _of_wheels(self, end_ns: int, bias: Bias, length: int) -> tuple[Difference, float] | None:
        """Difference by the wheels over the seconds of a window, and the gyroscope's rate over them [rad/s]."""
        end = end_ns // SECOND_NS
        chosen = [second for second in self.wheels.seconds if second.number >= end - length - 1]
        chosen = chosen[-length:]
        if len(chosen) < MIN_SHARE * length or chosen[-1].number < end - 2:
            return None
        n, moving = len(chosen), [second for second in chosen if not second.still]
        mean = sum(second.rate_less(bias.value) for second in chosen) / n
        still_variance = STANDSTILL_RATE_SD**2 * (n - len(moving)) / n
        if not moving:
            return Difference(mean, still_variance), mean
        rates = []
        for axle, parts in ((self.rear, [s.rear for s in moving]), (self.front, [s.front for s in moving])):
            known = [part for part in parts if part is not None]
            if len(known) == len(moving):
                rates.append((axle.rate(mean_second(known)), len(known)))
        if not rates:
            return None
        share = len(moving) / n
        turns = [second.rate_less(bias.value) for second in moving]
        rate, variance = combined(rates, turns)
        variance = share**2 * variance + still_variance
        if variance > USEFUL_SD**2 + (USEFUL_SHARE * mean) ** 2:
            return None
        return Difference(mean - share * rate, variance), mean

    def _verdict(self, time_ns: int, length: int, ballot: Vote | None) -> Test:
        base = Test(
            Outcome.NOT_EVALUATED, self._missing(time_ns), window_s=float(length),
            false_alarm_rate=self.settings.gyroscope.false_alarm_rate,
        )  # fmt: skip
        if ballot is None:
            self._exceeded[length] = 0
            return base
        above = ballot.statistic > ballot.threshold
        self._exceeded[length] = self._exceeded[length] + 1 if above else 0
        if not ballot.exceeds(0.5):
            self._inconspicuous_ns[length] = time_ns
        left = tuple(name for name in ballot.suspects if name not in self._acquitted)
        base = replace(
            base, statistic=ballot.statistic, threshold=ballot.threshold, accused=left or ballot.suspects,
            why=self._why(ballot, time_ns),
        )  # fmt: skip
        if self._exceeded[length] < CONSECUTIVE:
            return replace(base, outcome=Outcome.PASS)
        since_ns = self._inconspicuous_ns.get(length, time_ns - length * SECOND_NS) - length * SECOND_NS
        return replace(base, outcome=Outcome.ACCUSES, suspect_since_ns=since_ns)

    def _missing(self, time_ns: int) -> Explanation:
        """Why a window cannot be evaluated."""
        if self._reference.newest is None or self.track.newest_ns is None:
            return explain(Code.NO_GYROSCOPE)
        if not self._has_wheels(time_ns):
            return explain(Code.NO_YAW_RATE, limit_m_s=MIN_COURSE_M_S)
        track_sd_m, ratio_sd = self.rear.sds
        return explain(
            Code.NO_YAW_RATE_YET, limit_m_s=MIN_COURSE_M_S, track_sd_m=track_sd_m, wheels_sd_share=ratio_sd
        )  # fmt: skip

    def _has_wheels(self, time_ns: int) -> bool:
        newest_ns = self.wheels.newest_ns
        return newest_ns is not None and time_ns - newest_ns <= 3 * SECOND_NS

    def _why(self, ballot: Vote, time_ns: int) -> Explanation:
        """What was compared: the sources, and the one that differs by the most standard deviations."""
        worst = max(
            ballot.differences, key=lambda source: ballot.differences[source].rate ** 2
            / ballot.differences[source].variance,
        )  # fmt: skip
        difference = ballot.differences[worst]
        compared = {
            "sources": tuple(ballot.differences), "worst": worst,
            "difference_deg_s": degrees(difference.rate), "sd_deg_s": degrees(sqrt(difference.variance)),
        }  # fmt: skip
        if Source.WHEELS in ballot.differences:
            return explain(Code.YAW_RATES, **compared)
        if not self._has_wheels(time_ns):
            return explain(Code.YAW_RATES_WITHOUT_WHEELS, **compared)
        track_sd_m, ratio_sd = self.rear.sds
        return explain(Code.YAW_RATES_LEARNING, **compared, track_sd_m=track_sd_m, wheels_sd_share=ratio_sd)


def mean_second(seconds: Sequence[AxleSecond]) -> AxleSecond:
    """Mean of some seconds."""
    n = len(seconds)
    return AxleSecond(sum(second.difference for second in seconds) / n, sum(second.speed for second in seconds) / n)


def agreed(found: Mapping[str, Test]) -> dict[str, Test]:
    """Tests with the names of all where two windows accuse different sensors."""
    accusing = [set(test.accused) for test in found.values() if test.accuses]
    if not accusing or set.intersection(*accusing):
        return dict(found)
    names = tuple(sorted(set.union(*accusing)))
    return {name: replace(test, accused=names) if test.accuses else test for name, test in found.items()}

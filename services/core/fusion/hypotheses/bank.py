"""The bank of hypotheses: cursors on the log that leave sources out all the time, and a model without inertial sensors.

A cursor without GNSS drifts, so that two of them run from staggered anchors: one has always run for half of the longest
time or more. When trust suspects a source, all of them start anew from a snapshot before the suspect time, for later
anchors may contain what is suspected, and use everything since then again, a part with each step of the horizon.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shared.maths.earth import Geodetic, geodetic_from_ned_difference, ned_from_geodetic_difference
from shared.maths.quantiles import chi_square_limit
from shared.maths.rotation import Vector
from shared.messages.base import Symmetric3
from shared.messages.explanation import Explanation, explain
from shared.messages.navigation import AidingKind
from shared.messages.trust import Hypothesis

from ..aids.base import Outcome
from ..codes import Code
from ..inertial import error_model as em
from ..integrity.disagreement import Pair
from ..integrity.error_monitor import ErrorMonitor
from ..integrity.protection_levels import horizontal_level, vertical_level
from ..integrity.separation import difference_covariance, squared
from ..settings import Settings
from ..solution import UncertaintyCache, upper
from ..timeline.conflict import CONVERGED_S, start_ns
from ..timeline.cursor import Cursor
from ..timeline.engine import Engine
from ..timeline.events import Event, GnssExcluded, OdometerExclusion
from ..timeline.timeline import Timeline
from .motion_model import STANDING_M_S, MotionModel

FloatArray = npt.NDArray[np.float64]
SECOND_NS = 1_000_000_000

USEFUL_LIMITS = 30.0  # alert limits beyond which a solution says nothing
RETENTION_NS = 3 * SECOND_NS  # of snapshots beyond the memory of late measurements
SEPARATION_LIMIT = chi_square_limit(2, 1e-5)
MAX_RATIO = 1e6  # of one innovation
MEAN_OF = 30  # innovations whose mean is published
PART, FASTEST_HZ = 20, 100.0  # samples used again for each new one of this rate: two minutes take 6 s
ODOMETER_SILENT_S = 10.0  # after which there is nothing to leave out
INFINITE_AGE_S = 1e9


class Alternative(NamedTuple):
    """Solution under one hypothesis, at the horizon."""

    hypothesis: Hypothesis
    left_out: tuple[str, ...]
    since_ns: int
    position: Geodetic
    velocity: Vector  # [m/s, NED]
    position_cov: Symmetric3  # [m², NED] upper half
    levels: Pair  # [m] horizontal and vertical
    apart_n: Vector  # [m, NED] published position minus this one
    separation: float | None  # [-] horizontal, squared over the covariance of the difference
    innovations: float | None = None  # [-] mean normalised innovation squared of positions, per axis
    odometer_innovations: float | None = None  # [-] the same of the odometer


class PublishedSolution(NamedTuple):
    """PublishedSolution solution at the horizon, from which the others are so far apart."""

    position: Geodetic
    cov: FloatArray  # [m², NED] shape (3, 3)
    monitor: ErrorMonitor
    with_gnss: bool
    started_ns: int | None

    @classmethod
    def of(cls, engine: Engine) -> "PublishedSolution":
        """That of an engine with a filter."""
        assert engine.filter is not None
        P, monitor = engine.filter.P[em.POSITION, em.POSITION], engine.aids.error_monitor
        with_gnss = engine.exclusions.gnss_since_ns is None
        return cls(engine.filter.published_position, P, monitor, with_gnss, engine.started_ns)

    def separation(self, apart_n: Vector, cov: FloatArray, anchor_ns: int | None) -> float | None:
        """Separation of a solution with this covariance [m², NED], which left the filter at an anchor.

        It uses less than the filter does. One of another model (without an anchor), a filter that has begun after the
        anchor, and one without GNSS contain nothing of it, and the sum of both covariances bounds the difference.
        """
        is_part = self.with_gnss and anchor_ns is not None and (self.started_ns or 0) <= anchor_ns
        S = difference_covariance(cov, self.cov, self.monitor) if is_part else cov + self.cov
        return squared(apart_n, S)


class CursorPlan(NamedTuple):
    """What a hypothesis leaves out, and how its cursors are anchored."""

    hypothesis: Hypothesis
    left_out: tuple[str, ...]
    events: Callable[[int], tuple[Event, ...]]  # of a cursor that starts at a time
    longest_s: float  # life of a cursor; two run, half of it apart
    odometer: bool = False  # it is the filter itself where there is no odometer


def _without_gnss(time_ns: int) -> tuple[Event, ...]:
    return (GnssExcluded(time_ns, time_ns),)


def _without_odometer(time_ns: int) -> tuple[Event, ...]:
    return (OdometerExclusion(time_ns, excluded=True),)


def _alone(time_ns: int) -> tuple[Event, ...]:
    return (*_without_gnss(time_ns), *_without_odometer(time_ns))


# Inertial sensors alone are of use for a minute; a filter that keeps GNSS does not drift and needs no second anchor.
CURSOR_PLANS = (
    CursorPlan(Hypothesis.GNSS, ("gnss",), _without_gnss, 120.0),
    CursorPlan(Hypothesis.GNSS_AND_ODOMETER, ("gnss", "odometer"), _alone, 60.0),
    CursorPlan(Hypothesis.ODOMETER, ("odometer",), _without_odometer, INFINITE_AGE_S, odometer=True),
)


SOLVED = (*(kept.hypothesis for kept in CURSOR_PLANS), Hypothesis.RECEIVER_TIME, Hypothesis.IMU)


class Member:
    """One cursor of a hypothesis."""

    def __init__(self, settings: Settings, kept: CursorPlan, main: Cursor, since_ns: int | None = None) -> None:
        """Start at the place of the main cursor, or at its snapshot before a suspect time."""
        self.kept = kept
        if since_ns is None:
            self.cursor = Cursor(main.engine.unrecorded(), kept.events(main.engine.time_ns + 1))
            self.cursor.forget_all()  # keeps one snapshot of now
        else:
            self.cursor = main.fork(since_ns, kept.events(max(since_ns, main.before(since_ns).time_ns) + 1))
        self.anchor_ns = self.cursor.engine.time_ns
        self.is_behind = since_ns is not None  # it has not caught up yet
        self._uncertainty = UncertaintyCache(settings)
        self._innovations: dict[AidingKind, float] = {}

    def age_s(self, time_ns: int) -> float:
        """Time since its anchor [s]."""
        return (time_ns - self.anchor_ns) * 1e-9

    def see(self, outcomes: Sequence[Outcome]) -> None:
        """Take innovations of positions and odometer into their means; those that are left out are tested as well."""
        for outcome in outcomes:
            if outcome.kind in (AidingKind.GNSS_POSITION, AidingKind.ODOMETER):
                ratios = [
                    (z / sd) ** 2 for z, sd in zip(outcome.innovation, outcome.innovation_sd, strict=True) if sd > 0.0
                ]
                value = min(MAX_RATIO, sum(ratios) / max(1, len(ratios)))
                before = self._innovations.get(outcome.kind, value)
                self._innovations[outcome.kind] = before + (value - before) / MEAN_OF

    def alternative(self, of: PublishedSolution, limits_m: Pair) -> Alternative | Explanation:
        """Its solution against the published position, or why there is none."""
        engine = self.cursor.engine
        if self.is_behind:
            return explain(Code.COMPUTING)
        if engine.filter is None:
            return explain(Code.SOLUTION_LOST)
        position = engine.filter.published_position
        apart = ned_from_geodetic_difference(of.position, position)
        found = self._uncertainty.of(engine.filter, engine.aids.error_monitor)
        levels = found.levels.horizontal, found.levels.vertical
        if not levels[0] <= USEFUL_LIMITS * limits_m[0]:
            return explain(Code.LEVEL_TOO_LARGE, level_m=levels[0])
        P = engine.filter.P[em.POSITION, em.POSITION]
        return Alternative(
            self.kept.hypothesis, self.kept.left_out, self.anchor_ns, position, engine.filter.velocity,
            found.triangles[0], levels, apart, of.separation(apart, P, self.anchor_ns),
            self._innovations.get(AidingKind.GNSS_POSITION), self._innovations.get(AidingKind.ODOMETER),
        )  # fmt: skip


class Bank:
    """All hypotheses' solutions, which follow the horizon of a timeline."""

    def __init__(self, settings: Settings, timeline: Timeline) -> None:
        self._settings, self._timeline = settings, timeline
        self._members: list[Member] = []
        self._uncertainty = UncertaintyCache(settings)  # of the published solution
        self.motion = MotionModel(settings)
        self._log = timeline.log
        self._suspect_ns: int | None = None
        self._horizon_ns = 0
        self._anchored_s = 0  # second in which anchors were looked at
        self._paused = False

    def pause(self, *, paused: bool) -> None:
        """Stop computing all solutions, or start them again; those of a conflict from before its suspect time."""
        if paused == self._paused:
            return
        self._paused = paused
        if paused:
            self._members, self.motion = [], MotionModel(self._settings)
            self._follow()
        else:
            since_ns, self._suspect_ns = self._suspect_ns, None
            self._horizon_ns = self._timeline.verdicts.main.engine.time_ns
            self.suspect(since_ns)

    def advance(self) -> None:
        """Follow the horizon."""
        if self._paused:
            return
        timeline = self._timeline
        if timeline.log is not self._log:  # it began again
            self._log, self._members, self.motion = timeline.log, [], MotionModel(self._settings)
        main = timeline.verdicts.main
        if main.engine.time_ns == self._horizon_ns:
            return
        told_ns, self._horizon_ns = self._horizon_ns, main.engine.time_ns
        horizon_ns = self._horizon_ns
        for entry in timeline.log.entries(told_ns, horizon_ns):
            self.motion.use(entry)
        most = PART * max(1, round((horizon_ns - told_ns) * 1e-9 * FASTEST_HZ))
        for member in self._members:
            if member.is_behind:
                self._advance(member, horizon_ns, most)
        followers = [member for member in self._members if not member.is_behind]
        if followers:  # one after the other: longer batches cost less, and no step has all of them
            self._advance(min(followers, key=lambda member: member.cursor.engine.time_ns), horizon_ns, None)
        if horizon_ns // SECOND_NS != self._anchored_s:
            self._anchored_s = horizon_ns // SECOND_NS
            self._anchor(main, horizon_ns)

    def _advance(self, member: Member, horizon_ns: int, most: int | None) -> None:
        """Advance one cursor to the horizon, or by so many samples towards it."""
        memory_ns = round((self._settings.history_s + self._settings.merge_delay_s) * 1e9) + RETENTION_NS
        used = member.cursor.advance(self._log, horizon_ns, most)
        member.is_behind &= used == most
        member.see(member.cursor.outcomes())
        member.cursor.forget(horizon_ns - memory_ns)

    def _follow_up(self) -> None:
        """Advance all cursors to the horizon that do not catch up with it."""
        for member in self._members:
            if not member.is_behind and member.cursor.engine.time_ns < self._horizon_ns:
                self._advance(member, self._horizon_ns, None)

    def suspect(self, since_ns: int | None) -> None:
        """Start all cursors anew from before a suspect time, when it becomes known or earlier than it was."""
        before_ns, self._suspect_ns = self._suspect_ns, since_ns
        if self._paused:
            return
        main = self._timeline.verdicts.main
        if since_ns is None:
            if before_ns is not None:  # those of the conflict leave out what is used again
                self._members = []
        elif (before_ns is None or since_ns < before_ns) and main.engine.filter is not None:
            self._members = [
                Member(self._settings, kept, main, start_ns(main, since_ns))
                for kept in CURSOR_PLANS[1:]  # the solution without GNSS is that of the conflict
                if self._is_wanted(kept, main.engine)
            ]
        self._follow()

    def _anchor(self, main: Cursor, time_ns: int) -> None:
        """Start cursors that are due, and drop those that are too old."""
        if self._suspect_ns is not None:
            return
        engine = main.engine
        converged = engine.filter is not None and (time_ns - (engine.started_ns or 0)) * 1e-9 >= CONVERGED_S
        for kept in CURSOR_PLANS:
            mine = [member for member in self._members if member.kept is kept]
            over = [
                member
                for member in mine
                if member.cursor.engine.filter is None or member.age_s(time_ns) > kept.longest_s
            ]
            self._members = [member for member in self._members if member not in over]
            youngest_s = min((member.age_s(time_ns) for member in mine if member not in over), default=INFINITE_AGE_S)
            if converged and youngest_s >= 0.5 * kept.longest_s and self._is_wanted(kept, engine):
                self._members.append(Member(self._settings, kept, main))
        self._follow()

    @staticmethod
    def _is_wanted(kept: CursorPlan, engine: Engine) -> bool:
        """Whether there is an odometer that a hypothesis could leave out."""
        age_s = engine.odometer_age_s
        return not kept.odometer or (age_s is not None and age_s < ODOMETER_SILENT_S)

    def _follow(self) -> None:
        self._timeline.followers = tuple(member.cursor for member in self._members)

    def oldest(self, hypothesis: Hypothesis) -> Member | None:
        """Cursor of a hypothesis that has run for the longest time, at the horizon."""
        self._follow_up()
        mine = [member for member in self._members if member.kept.hypothesis is hypothesis]
        return min(mine, key=lambda member: member.anchor_ns, default=None)

    def alternatives(self) -> Iterator[Alternative | tuple[Hypothesis, Explanation]]:
        """The solution of each hypothesis at the horizon, or why there is none."""
        engine = self._timeline.engine
        if engine.filter is None:
            return
        if self._paused:
            yield from ((hypothesis, explain(Code.PAUSED)) for hypothesis in SOLVED)
            return
        limits_m = self._settings.vehicle.alert_limits_m
        published = PublishedSolution.of(engine)
        without_gnss = self._of_gnss(engine, published) or self._of(Hypothesis.GNSS, published, limits_m)
        yield without_gnss
        for kept in CURSOR_PLANS[1:]:
            yield self._of(kept.hypothesis, published, limits_m)
        yield self._free_time(without_gnss, published)
        yield self.without_imu(engine) or (Hypothesis.IMU, explain(Code.NO_MOTION))

    def _free_time(
        self, without_gnss: Alternative | tuple[Hypothesis, Explanation], published: PublishedSolution
    ) -> Alternative | tuple[Hypothesis, Explanation]:
        """The solution if the time of the receiver is not known: the published one across the way, without GNSS along.

        With u the direction of motion, d the published position minus that without GNSS, and P their covariances::

            x = x_published - u uᵀ d,    P = (I - u uᵀ) P_published (I - u uᵀ) + u uᵀ P_without u uᵀ
        """
        if not isinstance(without_gnss, Alternative):
            return Hypothesis.RECEIVER_TIME, without_gnss[1]
        velocity = np.array(without_gnss.velocity)
        speed = float(np.linalg.norm(velocity))
        along = np.zeros((3, 3)) if speed < STANDING_M_S else np.outer(velocity, velocity) / speed**2
        across, apart = np.eye(3) - along, along @ np.array(without_gnss.apart_n)
        nn, ne, nd, ee, ed, dd = without_gnss.position_cov
        P = across @ published.cov @ across + along @ np.array([[nn, ne, nd], [ne, ee, ed], [nd, ed, dd]]) @ along
        north, east, down = apart.tolist()
        engine = self._timeline.engine
        assert engine.filter is not None
        own = self._uncertainty.of(engine.filter, engine.aids.error_monitor).levels
        levels = max(own.horizontal, without_gnss.levels[0]), max(own.vertical, without_gnss.levels[1])
        return Alternative(
            Hypothesis.RECEIVER_TIME, ("receiver time",), without_gnss.since_ns,
            geodetic_from_ned_difference((-north, -east, -down), published.position), without_gnss.velocity,
            upper(P.tolist()), levels, (north, east, down),
            published.separation((north, east, down), P, without_gnss.since_ns),
        )  # fmt: skip

    def alternative(self, hypothesis: Hypothesis) -> Alternative | None:
        """The solution of one hypothesis at the horizon; None without one."""
        engine = self._timeline.engine
        if engine.filter is None:
            return None
        if hypothesis is Hypothesis.IMU:
            return self.without_imu(engine)
        limits_m = self._settings.vehicle.alert_limits_m
        published = PublishedSolution.of(engine)
        if hypothesis is Hypothesis.RECEIVER_TIME:
            without_gnss = self._of_gnss(engine, published) or self._of(Hypothesis.GNSS, published, limits_m)
            found = self._free_time(without_gnss, published)
        else:
            found = self._of(hypothesis, published, limits_m)
        return found if isinstance(found, Alternative) else None

    def _of(
        self, hypothesis: Hypothesis, published: PublishedSolution, limits_m: Pair
    ) -> Alternative | tuple[Hypothesis, Explanation]:
        member = self.oldest(hypothesis)
        if member is None:
            return hypothesis, explain(Code.NOTHING_TO_LEAVE_OUT, needed_s=CONVERGED_S)
        found = member.alternative(published, limits_m)
        return found if isinstance(found, Alternative) else (hypothesis, found)

    def _of_gnss(self, engine: Engine, published: PublishedSolution) -> Alternative | None:
        """The solution without GNSS of an open conflict, which starts before the suspect time."""
        conflict = self._timeline.verdicts.conflict
        if conflict is None or conflict.cursor is None or conflict.cursor.engine.filter is None:
            return None
        without = conflict.cursor.engine.filter
        apart = ned_from_geodetic_difference(published.position, without.published_position)
        P = without.P[em.POSITION, em.POSITION]
        return Alternative(
            Hypothesis.GNSS, ("gnss",), conflict.since_ns, without.published_position, without.velocity,
            upper(P.tolist()), conflict.levels_m, apart, published.separation(apart, P, conflict.since_ns),
        )  # fmt: skip

    def without_imu(self, engine: Engine) -> Alternative | None:
        """Solution of the model without inertial sensors at the time of an engine; None without one."""
        state = self.motion.state(engine.time_ns)
        if state is None or engine.filter is None or self.motion.started_ns is None:
            return None
        apart = ned_from_geodetic_difference(engine.filter.published_position, state.position)
        levels = self.levels(state.position_cov)
        if not levels[0] <= USEFUL_LIMITS * self._settings.vehicle.alert_limit_horizontal_m:
            return None
        separation = PublishedSolution.of(engine).separation(apart, state.position_cov, None)
        return Alternative(
            Hypothesis.IMU, ("imu",), self.motion.started_ns, state.position, state.velocity,
            upper(state.position_cov.tolist()), levels, apart, separation, self.motion.innovations / 3.0,
        )  # fmt: skip

    def levels(self, position_cov: FloatArray) -> Pair:
        """Protection levels [m] of a covariance [m², NED] at the integrity risk."""
        (nn, ne, _), (_, ee, _), (_, _, dd) = position_cov.tolist()
        risk = self._settings.integrity.risk
        return horizontal_level(nn, ne, ee, risk), vertical_level(dd, risk)

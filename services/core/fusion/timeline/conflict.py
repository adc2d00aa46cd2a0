"""Two solutions during a conflict: with GNSS, and without it since it became suspect.

A monitor accuses GNSS 6 to 120 s after the error began. When a conflict begins a second cursor starts from the last
snapshot before the suspect time and uses everything again without GNSS, a part with each step of the horizon, while the
first goes on. From then on both run, and the level of the one that is published reaches to the other. The one without
GNSS is published only if core.trust excludes GNSS and if that solution is good: `Conflict.declined` says why not.
"""

from dataclasses import replace

from shared.maths.earth import ned_from_geodetic_difference
from shared.maths.quantiles import line_factor
from shared.messages.explanation import Explanation, explain

from ..aids.base import Outcome
from ..codes import Code
from ..inertial import error_model as em
from ..integrity.disagreement import NO_DISAGREEMENT, Disagreement, Pair, Vector
from ..integrity.known_place import KnownPlace
from ..integrity.separation import difference_covariance, spreads
from ..settings import Settings
from ..solution import UncertaintyCache
from .contradiction import Contradiction, ResidualOffset, SolutionDifference, sizes
from .cursor import PERIOD_NS, Cursor
from .engine import Engine
from .events import GnssExcluded, GnssReadmitted, HeldOffset, OdometerExclusion
from .log import Log

SAMPLES_PER_STEP = 40  # samples that are used again for each new one: two minutes take 3 s
CONVERGED_S = 30.0  # of the filter before the suspect time, without which GNSS is not excluded
EARLIER_NS = 40_000_000_000  # than the suspect time of a monitor, which sees a slow error late
MAX_LIMITS = 3.0  # alert limits up to which the level of the solution without GNSS may be: beyond it decides nothing
LAST_LIMITS = 30.0  # alert limits beyond which it is given up


def _converged_s(engine: Engine, time_ns: int) -> float:
    """For how long a filter has run at a time [s]; 0 without one."""
    return 0.0 if engine.started_ns is None else max(0.0, (time_ns - engine.started_ns) * 1e-9)


def start_ns(main: Cursor, since_ns: int) -> int:
    """Time from which a solution without a source begins whose suspect time is known.

    What grows slowly has done harm before a window could see it, and some dead reckoning more costs less than a false
    start of it. A filter that has not converged is no start: the solution begins when it has.
    """
    started_ns = main.engine.started_ns
    if started_ns is None:
        return since_ns
    converged_ns = started_ns + round(CONVERGED_S * 1e9)
    earlier_ns = since_ns - EARLIER_NS
    return max(earlier_ns, converged_ns) if converged_ns <= main.engine.time_ns else min(since_ns, converged_ns)


def distance_n(one: Engine, other: Engine) -> Vector | None:
    """Position of one engine minus that of another [m, NED]; None while one has no filter."""
    if one.filter is None or other.filter is None:
        return None
    return ned_from_geodetic_difference(one.filter.position, other.filter.position)


class Conflict:
    """GNSS against the other sensors since a suspect time: the solution without GNSS beside the one with it.

    One that begins again with an earlier suspect time goes on with what the `earlier` one had until its replay is over.
    """

    def __init__(self, suspect_ns: int, main: Cursor, earlier: "Conflict | None" = None) -> None:
        since_ns = start_ns(main, suspect_ns)
        snapshot_ns = main.before(since_ns).time_ns
        # A filter that was restored has used GNSS before its start.
        restored = suspect_ns < (main.engine.started_ns or suspect_ns)
        contaminated_s = max(0.0, (snapshot_ns - (suspect_ns if restored else since_ns)) * 1e-9)
        excluded = GnssExcluded(max(snapshot_ns, since_ns) + 1, min(since_ns, suspect_ns), contaminated_s)
        self.since_ns = since_ns
        self.replay: Cursor | None = main.fork(since_ns, (excluded,))
        self.converged_s = _converged_s(self.replay.engine, since_ns)
        self.cursor: Cursor | None = earlier.cursor if earlier else None  # None until the first replay is over
        # Of the engine with GNSS when the conflict began: its resets, and what its level held.
        self.resets: int = earlier.resets if earlier else main.engine.counts.resets
        self._resets_seen = main.engine.counts.resets
        self.held: Disagreement = earlier.held if earlier else main.engine.aids.error_monitor.held
        self.published: bool = earlier is not None and earlier.published  # whether the solution without GNSS is
        self.declined: Explanation | None = None  # why it is not, although core.trust excludes GNSS
        # Newest: position of the engine with GNSS minus the other, and the levels of the one without it.
        self.apart_n: Vector | None = earlier.apart_n if earlier else None
        self.levels_m: Pair = earlier.levels_m if earlier else (0.0, 0.0)
        self.found: Contradiction = earlier.found if earlier else Contradiction()  # what it has contradicted GNSS by
        self.weight: float = earlier.weight if earlier else 0.0  # probability that it is GNSS, largest since it has
        # Newest: published minus other position, and the levels of the other.
        self.difference: tuple[Vector, Pair] | None = earlier.difference if earlier else None

    @property
    def cursors(self) -> tuple[Cursor, ...]:
        """Cursors without GNSS that read the log."""
        return tuple(cursor for cursor in (self.cursor, self.replay) if cursor is not None)

    def compare(self, main: Engine, *, useful: bool, weight: float) -> None:
        """Compare the two solutions; the one without GNSS decides while it is `useful`, or beyond its own level.

        Its covariance alone is no reason: that of a free run which is wrong is small.
        """
        now = self.apart(main)
        if now is None:  # the one with GNSS aligns again after a reset
            return
        far_h, far_v = sizes(now.vector_n)
        decides = useful or far_h > self.levels_m[0] or far_v > self.levels_m[1]
        stepped, self._resets_seen = main.counts.resets != self._resets_seen, main.counts.resets
        self.apart_n, self.found = now.vector_n, self.found.after(now, decides=decides, stepped=stepped or not useful)
        if self.found.is_any:
            self.weight = max(self.weight, weight)

    def apart(self, main: Engine) -> SolutionDifference | None:
        """Difference of the two solutions of now with its spread; None while one of them has no filter.

        One that has been reset in the conflict has no past in common with the other.
        """
        if self.cursor is None:
            return None
        without = self.cursor.engine
        vector_n = distance_n(main, without)
        if vector_n is None or main.filter is None or without.filter is None:
            return None
        of_sub, of_main = without.filter.P[em.POSITION, em.POSITION], main.filter.P[em.POSITION, em.POSITION]
        nested = main.counts.resets == self.resets
        S = difference_covariance(of_sub, of_main, main.aids.error_monitor) if nested else of_sub + of_main
        return SolutionDifference.of(without.time_ns, vector_n, S)

    def advance(self, log: Log, horizon_ns: int, samples: int) -> bool:
        """Follow the horizon, which went on by so many samples; returns whether a replay is over."""
        if self.cursor is not None:
            self.cursor.advance(log, horizon_ns)
        if self.replay is None:
            return False
        most = SAMPLES_PER_STEP * samples
        if self.replay.advance(log, horizon_ns, most) == most:
            return False
        self.replay.outcomes()  # all were reported before
        self.cursor, self.replay = self.replay, None
        return True


class Verdicts:
    """The cursor with GNSS, and the conflict with the one without it, as core.trust decides."""

    def __init__(self, settings: Settings, log: Log, main: Cursor) -> None:
        self._settings, self._log, self.main = settings, log, main
        self._of_main, self._of_other = UncertaintyCache(settings), UncertaintyCache(settings)
        self.conflict: Conflict | None = None
        # Suspect time, whether GNSS is excluded, and whether the odometer is: as core.trust published.
        self.wanted: tuple[int | None, bool, bool] | None = None
        self._odometer_excluded: bool | None = None  # as applied
        self.unresolved: Explanation | None = None  # why the present conflict goes on without a second solution
        self._decided_ns = self._compared_ns = 0  # seconds of the last decision and comparison
        self.place: KnownPlace | None = None  # where the vehicle was parked before this drive
        self.weight = 1.0  # probability that GNSS is wrong, as core.trust has published; 0 where another source is

    @property
    def cursors(self) -> tuple[Cursor, ...]:
        """All cursors on the log."""
        return (self.main, *(self.conflict.cursors if self.conflict is not None else ()))

    @property
    def published(self) -> Cursor:
        """The cursor whose solution is published."""
        conflict = self.conflict
        return conflict.cursor if conflict and conflict.published and conflict.cursor else self.main

    @property
    def engine(self) -> Engine:
        """The engine whose solution is published."""
        return self.published.engine

    @property
    def other(self) -> Engine | None:
        """The other one, while there are two."""
        conflict = self.conflict
        if conflict is None or conflict.cursor is None:
            return None
        return self.main.engine if conflict.published else conflict.cursor.engine

    @property
    def excluded_test_ratio(self) -> float | None:
        """Test ratio of the newest position against the solution without GNSS; None without one."""
        without = self.conflict.cursor if self.conflict else None
        return (without or self.main).engine.exclusions.test_ratio

    def difference(self) -> tuple[Vector, Pair] | None:
        """Published minus other position [m, NED], and the levels of the other [m]; None without another.

        While the other aligns again after a reset, its last difference stands.
        """
        other, conflict = self.other, self.conflict
        if other is None or conflict is None:
            return None
        apart = distance_n(self.engine, other)
        if apart is None:
            return conflict.difference
        horizontal_m, vertical_m = self._levels(other)
        if other is self.main.engine:  # a reset in this conflict holds the same difference again
            held, before = other.aids.error_monitor.held.bound, conflict.held.bound
            horizontal_m -= max(0.0, held[0] - before[0])
            vertical_m -= max(0.0, held[1] - before[1])
        conflict.difference = apart, (horizontal_m, vertical_m)
        return conflict.difference

    @property
    def without_gnss_m(self) -> Pair | None:
        """Levels of the solution without GNSS in a conflict [m, horizontal and vertical]; None without one."""
        conflict = self.conflict
        return None if conflict is None or conflict.cursor is None else conflict.levels_m

    @property
    def held(self) -> Disagreement:
        """What the level holds, for a later process: with the contradiction of an open conflict."""
        conflict = self.conflict
        held = None if conflict is None else self._left(conflict, None)
        return self.engine.aids.error_monitor.held if held is None else held

    def _levels(self, engine: Engine) -> Pair:
        """Protection levels of an engine with a filter."""
        assert engine.filter is not None
        cache = self._of_main if engine is self.main.engine else self._of_other
        levels = cache.of(engine.filter, engine.aids.error_monitor).levels
        return levels.horizontal, levels.vertical

    def advance(self, horizon_ns: int, samples: int) -> None:
        """Follow the horizon with the cursor without GNSS, and decide once a second which one is published."""
        if self.conflict is not None:
            begins = self.conflict.advance(self._log, horizon_ns, samples)
            if begins or horizon_ns // PERIOD_NS != self._decided_ns:
                self._decided_ns = horizon_ns // PERIOD_NS
                self._decide()
        elif self._odometer_excluded is None:
            self._apply()
        if self.place is not None and horizon_ns // PERIOD_NS != self._compared_ns:
            self._compared_ns = horizon_ns // PERIOD_NS
            self._compare_with(self.place)

    def _compare_with(self, place: KnownPlace) -> None:
        """End what the level holds where the vehicle stands at a known place again."""
        engine = self.main.engine
        if engine.filter is None:
            return
        spread = spreads(engine.filter.P[em.POSITION, em.POSITION])
        position = engine.filter.published_position
        if place.recognised(engine.time_ns, position, spread, stationary=engine.stationary):
            self.confirm()

    def confirm(self) -> bool:
        """Hold no offset any more, because the position was confirmed; returns whether it could be.

        While GNSS contradicts other sensors nothing confirms it.
        """
        if self.conflict is not None or self.unresolved is not None:
            return False
        if self.main.engine.aids.error_monitor.held.is_open:
            self._hold(NO_DISAGREEMENT)
        self.main.engine.end_loss()
        return True

    def outcomes(self) -> list[Outcome]:
        """Outcomes of the published cursor since the last call."""
        found = self.main.outcomes()
        if self.conflict is not None and self.conflict.cursor is not None:
            without = self.conflict.cursor.outcomes()
            found = without if self.conflict.published else found
        return found

    def follow(self, gnss_since_ns: int | None, *, exclude: bool, odometer_excluded: bool) -> None:
        """Follow the verdict.

        Parameters
        ----------
        gnss_since_ns : int or None
            Suspect time of a conflict of GNSS with the other sensors; None without one.
        exclude : bool
            Whether core.trust has decided that GNSS is wrong.
        odometer_excluded : bool
            Whether the odometer is not used.
        """
        self.wanted = gnss_since_ns, exclude, odometer_excluded
        self._apply()

    def _apply(self) -> None:
        """Apply what differs from the verdict, from the horizon on."""
        if self.wanted is None or self.main.engine.last is None:
            return
        since_ns, _, odometer = self.wanted
        known = self.main.engine.exclusions
        if odometer != (known.odometer if self._odometer_excluded is None else self._odometer_excluded):
            self._log.insert(OdometerExclusion(self.next_ns, excluded=odometer))
        self._odometer_excluded = odometer
        if since_ns is None:
            self._end(self.main.engine.time_ns)
        elif known.gnss_since_ns is None and not self.unresolved:
            self._begin(since_ns)
        self._decide()

    @property
    def next_ns(self) -> int:
        """Time behind the horizon, at which an event is the next one."""
        return self.main.engine.time_ns + 1

    def _begin(self, since_ns: int) -> None:
        """Begin a conflict, or begin it again where its suspect time is earlier than was known."""
        conflict = self.conflict
        if conflict is not None and conflict.since_ns <= start_ns(self.main, since_ns):
            return
        oldest_ns = self.main.oldest_ns or 0
        if conflict is not None and oldest_ns > since_ns and conflict.cursor is not None:
            # No snapshot is older: what GNSS may have done between the two times is added to the solution without it.
            span_s = (conflict.since_ns - since_ns) * 1e-9
            conflict.cursor.own = (*conflict.cursor.own, GnssExcluded(self.next_ns, since_ns, span_s))
            conflict.since_ns = since_ns
            return
        self.conflict = Conflict(since_ns, self.main, conflict)

    def _decide(self) -> None:
        """Choose which of the two solutions is published, once a second and with every verdict."""
        conflict = self.conflict
        if conflict is None or conflict.cursor is None or self.wanted is None:
            return
        without = conflict.cursor.engine
        if without.filter is None:
            self._leave(explain(Code.WITHOUT_GNSS_LOST))
            return
        conflict.levels_m = horizontal_m, vertical_m = self._levels(without)
        limits = self._settings.vehicle.alert_limits_m
        share = max(horizontal_m / limits[0], vertical_m / limits[1])
        conflict.compare(self.main.engine, useful=share <= MAX_LIMITS, weight=self.weight)
        if share > LAST_LIMITS:
            self._leave(explain(Code.WITHOUT_GNSS_OF_NO_USE, level_m=horizontal_m))
        elif share > MAX_LIMITS:
            conflict.declined = explain(Code.WITHOUT_GNSS_UNDECIDED, horizontal_m=horizontal_m, vertical_m=vertical_m)
        elif conflict.converged_s < CONVERGED_S:
            conflict.declined = explain(Code.NOT_CONVERGED, converged_s=conflict.converged_s, needed_s=CONVERGED_S)
        else:
            conflict.declined = None
        conflict.published = self.wanted[1] and not conflict.declined

    def _leave(self, why: Explanation) -> None:
        """Give the solution without GNSS up: the level holds what it has contradicted, and how that still grew.

        What the solution with GNSS did since then shows when it comes back.
        """
        conflict, self.conflict, self.unresolved = self.conflict, None, why
        held = None if conflict is None else self._left(conflict, None)
        if conflict is not None and held is not None:
            self._hold(replace(held, growth_m_s=conflict.found.growth_m_s))

    def _end(self, now_ns: int) -> None:
        """End the conflict: what is left of the offset is held, unless a return has closed it; it grows no more.

        The solution with GNSS goes on, but for one that has been reset in the conflict or was not published.
        """
        conflict, self.conflict, self.unresolved = self.conflict, None, None
        main = self.main
        if main.engine.exclusions.gnss_since_ns is not None:  # of a saved state
            self._log.insert(GnssReadmitted(now_ns + 1))
        if conflict is None or conflict.cursor is None:
            if main.engine.aids.error_monitor.held.growth_m_s > 0.0:
                self._hold(replace(main.engine.aids.error_monitor.held, growth_m_s=0.0))
            return
        held = self._left(conflict, conflict.apart(main.engine))
        if conflict.published or main.engine.counts.resets > conflict.resets:
            conflict.cursor.carry(main)
            self.main = conflict.cursor
            self._log.insert(GnssReadmitted(now_ns + 1))
        if held is not None:
            self._hold(held)

    def _left(self, conflict: Conflict, now: SolutionDifference | None) -> Disagreement | None:
        """What the level holds after a conflict, at whose end the two differ by this; None if it was no contradiction.

        The posterior of an offset is the weight of the hypothesis times N(d, s²). The solution without GNSS has seen
        all that began after its anchor, in the conflict or in one before: that is part of the difference, and not added
        to it.
        """
        if not conflict.found.is_any:
            return None
        before = NO_DISAGREEMENT if conflict.held.since_ns >= conflict.since_ns else conflict.held
        risk = self._settings.integrity.risk
        if conflict.weight <= risk:
            return before
        left = conflict.found.left(now, line_factor(min(1.0, risk / conflict.weight)), risk)
        if left == ResidualOffset():
            return before
        return before.after(
            left.vector_n, left.spread, self.main.engine.time_ns, grew=False, slack=left.slack,
            since_ns=conflict.since_ns,
        )  # fmt: skip

    def _hold(self, held: Disagreement) -> None:
        """Let the level of the engine in use hold a disagreement, at once and when late measurements take it back."""
        self.main.engine.hold(held)
        self._log.insert(HeldOffset(self.next_ns, held))

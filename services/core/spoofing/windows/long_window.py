"""The long window: GNSS against free propagations, in velocity after 30 and 60 s, in way after 60 and 120 s.

A drag-off is invisible in 5 s, and the innovations of the navigation filter absorb it. A propagation starts from
fusion's solution every 5 s and never uses GNSS; 30 and 60 s later its velocity is compared. A slow one is invisible in
velocity: the way since the start of a propagation adds it up.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from shared.inertial.increments import SECOND_NS, Increment
from shared.maths.correlated_noise import mean_variance
from shared.maths.earth import ned_from_geodetic_difference
from shared.maths.quantiles import chi_square_limit

from ..inertial.anchors import FilterAnchor
from ..inertial.tracks import OdometerSpeed, VelocityFix
from ..settings import Settings
from .free_propagation import MOVED, FreePropagations
from .metrics import WINDOW_S

FloatArray = npt.NDArray[np.float64]
Rows = npt.NDArray[np.intp]

LENGTHS_S = (30, 60)  # of velocities
WINDOW_LENGTHS_S = (60, 120)
SPACING_S = 5  # between anchors, so that a window is at most this much longer than its name says
WIDE_SPACING_S = 20  # of propagations that are older than the longest length of velocities
FROZEN_S = 180  # age up to which a propagation is kept, if none younger takes its place
RELEASE_RATE = 0.01  # of fault-free evaluations above the threshold of release
MIN_FIXES = 4  # of a mean over 5 s
MIN_PART = 2  # fixes of a part of them that is tested on its own
DIMENSIONS = 3
MAX_DELAY_NS = 1_900_000_000  # age at which a fix is still compared
MIN_POSITION_SD = 0.8  # [m] reflections differ between two places, whatever the receiver states
MIN_SPEED = 2.0  # [m/s] of a comparison of speeds


@dataclass(frozen=True)
class LongResult:
    """Test of one window at one time."""

    statistic: float  # [-] chi-square with 3 degrees of freedom without a fault
    difference_n: FloatArray  # shape (3,) [m/s, NED] GNSS minus free propagation
    sd_n: FloatArray  # shape (3,) [m/s, NED]
    anchor_ns: int
    decided: bool = False  # the speeds differ, and the odometer agrees with the free propagation: GNSS is wrong


@dataclass(frozen=True)
class DistanceTest:
    """Test of the way since an anchor at one time."""

    statistic: float  # [-] chi-square with 2 degrees of freedom without a fault
    difference_n: FloatArray  # shape (2,) [m, north and east] GNSS minus free propagation
    sd_n: FloatArray  # shape (2,) [m]
    anchor_ns: int


@dataclass(frozen=True)
class _Passed:
    """A fix, and what each propagation says of the time of its velocity, or of its position."""

    fix: VelocityFix
    time_ns: int
    rows: dict[int, int]  # of each anchor whose propagation knows that time
    nodes: FloatArray  # shape (n, 6) [m/s, m; NED] velocity of the antenna, and its way since the anchor
    P: FloatArray  # shape (n, 3, 3) [m²/s²] covariances of velocity, at most 1 s older


class _Result(Protocol):
    """What a test has found."""

    @property
    def statistic(self) -> float:
        """Chi-square [-]."""
        ...


Found = TypeVar("Found", bound=_Result)


class _Differences(NamedTuple):
    """What GNSS and one propagation say of the velocity at some fixes."""

    times_s: FloatArray  # shape (n,) since the first one
    gnss_n: FloatArray  # shape (n, 3) [m/s, NED]
    sd_n: FloatArray  # shape (n, 3) [m/s] of GNSS
    free_n: FloatArray  # shape (n, 3) [m/s, NED]
    P: FloatArray  # shape (n, 3, 3) [m²/s²] of the propagation
    position_sd: FloatArray  # shape (n,) [m]
    of_positions: npt.NDArray[np.bool_]  # shape (n,) velocities that are differences of positions

    def part(self, rows: Rows) -> "_Differences":
        """Some of the fixes."""
        return _Differences(
            self.times_s[rows], self.gnss_n[rows], self.sd_n[rows], self.free_n[rows], self.P[rows],
            self.position_sd[rows], self.of_positions[rows],
        )  # fmt: skip

    def parts(self) -> list["_Differences"]:
        """Fixes without the one that is farthest from the propagation, and the two halves of them, if large enough."""
        rows, half = np.arange(len(self.times_s)), len(self.times_s) // 2
        worst = int(np.linalg.norm(self.gnss_n - self.free_n, axis=1).argmax())
        parts = np.delete(rows, worst), rows[:half], rows[half:]
        return [self.part(part) for part in parts if len(part) >= MIN_PART]


def _differences(compared: list[_Passed], anchor_ns: int) -> _Differences:
    """Differences of some fixes from the propagation of an anchor."""
    fixes, rows = [passed.fix for passed in compared], [passed.rows[anchor_ns] for passed in compared]
    return _Differences(
        np.array([fix.time_ns - fixes[0].time_ns for fix in fixes]) / SECOND_NS,
        np.array([fix.velocity_n for fix in fixes]),
        np.array([fix.sd for fix in fixes]),
        np.array([passed.nodes[row, :DIMENSIONS] for passed, row in zip(compared, rows, strict=True)]),
        np.array([passed.P[row] for passed, row in zip(compared, rows, strict=True)]),
        np.array([fix.position_sd for fix in fixes]),
        np.array([fix.of_positions for fix in fixes]),
    )


def _beside(found: Sequence[Found | None], agrees: float) -> Found | None:
    """The first of two results, unless the second one agrees with GNSS: then the smaller one; None without both."""
    known = [item for item in found if item is not None]
    if not known or len(known) < len(found):
        return None
    return min([known[0], *(item for item in known[1:] if item.statistic <= agrees)], key=lambda item: item.statistic)


class LongWindow:
    """The free propagations of the last minutes, and what GNSS differs from them in the last seconds."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self.free = FreePropagations(settings)
        self._anchors_ns: list[int] = []  # of its runs
        self._compared: list[_Passed] = []
        self._first: dict[int, _Passed] = {}  # soon after each anchor
        self._places: list[_Passed] = []  # of the last 5 s
        self._results: dict[int, LongResult] = {}  # of the newest comparison, by anchor
        self.threshold = chi_square_limit(DIMENSIONS, settings.long.false_alarm_rate)
        self.release_threshold = chi_square_limit(DIMENSIONS, RELEASE_RATE)
        self.median = chi_square_limit(DIMENSIONS, 0.5)
        self.way_threshold = chi_square_limit(2, settings.long.false_alarm_rate)
        self.way_doubt = chi_square_limit(2, settings.long.doubt_rate)
        self.way_median = chi_square_limit(2, 0.5)
        self._speed_limit = chi_square_limit(1, settings.long.false_alarm_rate)
        self.suspect_since_ns: int | None = None  # while GNSS is accused
        self.odometer_excluded = False  # by core.trust

    @property
    def oldest_s(self) -> float:
        """Age of the oldest propagation [s], 0 without one."""
        return self._ages_s()[0] if self._anchors_ns else 0.0

    @property
    def odometer_rejected(self) -> bool:
        """Whether the odometer contradicts the inertial sensors in the oldest propagation."""
        return bool(self._anchors_ns) and bool(self.free.runs["odometer_rejections"][0] > 0)

    def _ages_s(self) -> list[float]:
        return [(self.free.end_ns - anchor_ns) / SECOND_NS for anchor_ns in self._anchors_ns]

    def clear(self) -> None:
        """Drop all propagations, because the inertial samples have a gap."""
        self._keep([])

    def _keep(self, rows: list[int]) -> None:
        """Keep some propagations."""
        if len(rows) < len(self._anchors_ns):
            self.free.runs = self.free.runs[rows]
            self._anchors_ns = [self._anchors_ns[row] for row in rows]
            self._first = {ns: place for ns, place in self._first.items() if ns in self._anchors_ns}

    def accuse(self, suspect_since_ns: int) -> None:
        """Keep only propagations from before a suspect time, until `acquit`."""
        if self.suspect_since_ns is None or suspect_since_ns < self.suspect_since_ns:
            self.suspect_since_ns = suspect_since_ns
        limit_ns = self.suspect_since_ns
        self._keep([row for row, anchor_ns in enumerate(self._anchors_ns) if anchor_ns <= limit_ns])

    def acquit(self) -> None:
        """Anchor in every solution again."""
        self.suspect_since_ns = None

    def wants(self, time_ns: int, gnss_used_ns: int | None) -> bool:
        """Whether to start at a state: if the last one is 5 s old, and no accused GNSS has a part in this one."""
        if self._anchors_ns and time_ns - self._anchors_ns[-1] < SPACING_S * SECOND_NS:
            return False
        return self.suspect_since_ns is None or (gnss_used_ns is not None and gnss_used_ns <= self.suspect_since_ns)

    def start(self, anchor: FilterAnchor) -> None:
        """Start a propagation."""
        self.free.start(anchor)
        self._anchors_ns.append(anchor.time_ns)

    def advance(self, increments: Sequence[Increment]) -> None:
        """Propagate by some increments."""
        if self._anchors_ns:
            self.free.advance(increments)

    def predict(self) -> None:
        """Propagate the covariances over the second that has ended, and drop what is too old."""
        if not self._anchors_ns:
            return
        self.free.predict()
        ages = self._ages_s()
        if self.suspect_since_ns is not None:
            self._keep([row for row, age in enumerate(ages) if age <= FROZEN_S])
            return
        newest_whole = max((row for row, age in enumerate(ages) if age >= WINDOW_LENGTHS_S[-1]), default=0)
        kept: list[int] = []
        for row, age in enumerate(ages):
            apart_s = ages[kept[-1]] - age if kept else WIDE_SPACING_S
            if row >= newest_whole and (age <= LENGTHS_S[-1] + SPACING_S or apart_s >= WIDE_SPACING_S):
                kept.append(row)
        self._keep(kept)

    def aid(self, odometer: OdometerSpeed | None, yaw_rate: float, *, stationary: bool) -> None:
        """Aid by odometer, non-holonomic constraint and standstill."""
        if self._anchors_ns and stationary:
            self.free.stand()
        elif self._anchors_ns:
            used = self._settings.long.odometer and not self.odometer_excluded
            self.free.aid(odometer if used else None, yaw_rate)
            if lost := set(self.free.lost()):
                self._keep([row for row in range(len(self._anchors_ns)) if row not in lost])

    def compare(self, fix: VelocityFix, passed_ns: int) -> None:
        """Take the differences of every propagation from a fix that the increment which ends at a time has passed."""
        place = None if fix.position is None else self._passed(fix, fix.position_ns or fix.time_ns, passed_ns)
        if place is not None:
            limit_ns = place.time_ns - round(WINDOW_S * SECOND_NS)
            self._first = dict.fromkeys(place.rows, place) | self._first
            self._places = [place for place in self._places if place.time_ns > limit_ns] + [place]
        passed = self._passed(fix, fix.time_ns, passed_ns)
        if passed is not None:
            limit_ns = fix.time_ns - round((WINDOW_S - 0.1) * SECOND_NS)
            self._compared = [passed for passed in self._compared if passed.time_ns > limit_ns] + [passed]
            self._results.clear()

    def _passed(self, fix: VelocityFix, time_ns: int, passed_ns: int) -> _Passed | None:
        """What the propagations say of a time, None if no one knows it."""
        if passed_ns - time_ns > MAX_DELAY_NS:
            return None
        nodes = self.free.nodes_at(time_ns, passed_ns)
        known = (~np.isnan(nodes[:, 0])).tolist()
        rows = {anchor_ns: row for row, anchor_ns in enumerate(self._anchors_ns) if known[row]}
        P = self.free.runs["P"][:, :DIMENSIONS, :DIMENSIONS].copy()
        return _Passed(fix, time_ns, rows, nodes, P) if rows else None

    def _youngest(self, length_s: int) -> int | None:
        """Row of the youngest propagation of at least a length."""
        return max((row for row, age in enumerate(self._ages_s()) if age >= length_s), default=None)

    def _pair(self, length_s: int) -> list[int]:
        """Rows of the youngest propagation of at least a length, and of the one beside it; empty without the first.

        One run that contradicts GNSS while one from another anchor agrees is a wrong run, of a bad anchor. The second
        one is that from the next anchor, or where there is none the one before. None is beside a run that is the only
        one left of the time before an accusation.
        """
        row, number = self._youngest(length_s), len(self._anchors_ns)
        if row is None or (number == 1 and self.suspect_since_ns is None):
            return []
        if number == 1:
            return [row]
        return [row, row + 1 if row + 1 < number else row - 1]

    def way(self, length_s: int) -> DistanceTest | None:
        """Test the way with the youngest propagation of at least a length, and the one beside it; None without them."""
        return _beside([self._way(row) for row in self._pair(length_s)], self.way_doubt)

    def _way(self, row: int) -> DistanceTest | None:
        """Test the way with one propagation, as the mean of the last 5 s; None without enough fixes.

        Notes
        -----
        With p the positions of GNSS, r the way of the propagation, P its covariance, s the stated standard deviations,
        v the velocities and s_t the error of the age of positions::

            d = mean(p_k - r_k) - (p_0 - r_0),    T = d' S^-1 d,    S = f² (P + (s_0² + s_k²) I + s_t² dv dv')
        """
        anchor_ns = self._anchors_ns[row]
        first, places = self._first.get(anchor_ns), [place for place in self._places if anchor_ns in place.rows]
        if first is None or len(places) < MIN_FIXES:
            return None
        origin = first.nodes[first.rows[anchor_ns]]
        nodes = np.array([place.nodes[place.rows[anchor_ns]] for place in places]) - origin
        start, *ends = [passed.fix.position for passed in (first, *places) if passed.fix.position is not None]
        apart = [ned_from_geodetic_difference(end, start)[:2] for end in ends]
        differences = np.array(apart) - nodes[:, 3:5]
        d = differences.mean(axis=0)
        change = nodes[-1, :2]
        variance = sum(max(passed.fix.position_sd, MIN_POSITION_SD) ** 2 for passed in (first, places[-1]))
        S = (
            self.free.runs["P"][row, MOVED, MOVED][:2, :2]
            + np.eye(2) * variance
            + self._settings.long.position_time_sd_s**2 * np.outer(change, change)
        )
        S = self._settings.profile.long_factor**2 * S
        # One place, or one half of the places, does not make a contradiction.
        worst, half = int(np.hypot(*differences.T).argmax()), len(places) // 2
        means = [d, *(part.mean(axis=0) for part in (np.delete(differences, worst, 0), differences[:half],
                                                    differences[half:]))]  # fmt: skip
        statistic = min(float(mean @ np.linalg.solve(S, mean)) for mean in means)
        return DistanceTest(statistic, d, np.sqrt(np.diag(S)), anchor_ns)

    def result(self, length_s: int) -> LongResult | None:
        """Test with the youngest propagation of at least a length, and the one beside it; None without them."""
        return _beside([self._of(row) for row in self._pair(length_s)], self.release_threshold)

    def _of(self, row: int) -> LongResult | None:
        """Test with one propagation; None with too few fixes."""
        anchor_ns = self._anchors_ns[row]
        compared = [passed for passed in self._compared if anchor_ns in passed.rows]
        if len(compared) < MIN_FIXES:
            return None
        if anchor_ns not in self._results:
            self._results[anchor_ns] = self._result(anchor_ns, compared)
        found = self._results[anchor_ns]
        return replace(found, decided=found.decided and self.free.odometer_agrees(row))

    def _result(self, anchor_ns: int, compared: list[_Passed]) -> LongResult:
        """Test the mean difference over the last 5 s.

        Notes
        -----
        With d the mean difference, P_k the covariance of the free velocity at fix k, R that of the mean of n fixes
        whose errors are correlated over time, a the mean acceleration and s_t the standard deviation of stamps::

            T = d' S^-1 d,    S = f² (1/n sum P_k + R + s_t² a a')

        With f the factor that was learned on this vehicle. Changes of position add up over the window, so that R is
        then that of its two ends. A wrong heading turns the velocity and does not change the speed, which the odometer
        measures as well: where speeds differ, GNSS is wrong and not the IMU; u is the direction of free velocity::

            (|v| - |v_free|)² / (u' S u) > limit with one degree of freedom

        The covariance of a mean is at most the mean of the covariances, whatever the correlation of the errors. One
        fix or one half of the fixes makes no contradiction: the least of the statistics counts, of all fixes, of those
        without the one that is farthest from the run, and of each half.
        """
        whole = _differences(compared, anchor_ns)
        tested = [self._means(part) for part in (whole, *whole.parts())]
        d, S = (np.array(values) for values in zip(*tested, strict=True))
        statistics = np.vecdot(d, np.linalg.solve(S, d[..., None])[..., 0])
        mean = whole.free_n.mean(axis=0)
        differ = self._speeds_differ(mean, mean + d[0], S[0])
        return LongResult(float(statistics.min()), d[0], np.sqrt(np.diag(S[0])), anchor_ns, differ)

    def _means(self, fixes: _Differences) -> tuple[FloatArray, FloatArray]:
        """Mean difference d of some fixes, and its covariance S."""
        gnss, times_s, free_n, sds = self._settings.gnss, fixes.times_s, fixes.free_n, fixes.position_sd
        duration_s = float(times_s[-1] - times_s[0])
        d = fixes.gnss_n.mean(axis=0) - free_n.mean(axis=0)
        R = np.diag(mean_variance(times_s, fixes.sd_n.T, gnss.velocity_correlation_s))
        if fixes.of_positions.any():
            R[0, 0] = R[1, 1] = (sds[0] ** 2 + sds[-1] ** 2) / max(duration_s, 1.0) ** 2
        acceleration = (free_n[-1] - free_n[0]) / duration_s
        S = fixes.P.mean(axis=0) + R + gnss.time_sd_s**2 * np.outer(acceleration, acceleration)
        return d, self._settings.profile.long_factor**2 * S

    def _speeds_differ(self, free_n: FloatArray, gnss_n: FloatArray, S: FloatArray) -> bool:
        speed = float(np.hypot(free_n[0], free_n[1]))
        if speed < MIN_SPEED:
            return False
        along = free_n[:2] / speed
        difference = float(np.hypot(gnss_n[0], gnss_n[1])) - speed
        return difference**2 > self._speed_limit * float(along @ S[:2, :2] @ along)

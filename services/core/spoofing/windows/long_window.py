"""The long window: GNSS against free propagations, in velocity after 30 and 60 s, in way after 60 and 120 s.

A drag-off is invisible in 5 s, and the innovations of the navigation filter absorb it. A propagation starts from
fusion's solution every 5 s and never uses GNSS; 30 and 60 s later its velocity is compared. A slow one is invisible in
velocity: the way since the start of a propagation adds it up.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.inertial.strapdown import SECOND_NS, FilterAnchor, Increment
from shared.maths.correlated_noise import mean_variance
from shared.maths.earth import Geodetic, ned_from_geodetic_difference
from shared.maths.quantiles import chi_square_limit

from ..inertial.tracks import OdometerSpeed, VelocityFix
from ..settings import Settings
from .free_propagation import MOVED, FreePropagation
from .metrics import WINDOW_S

FloatArray = npt.NDArray[np.float64]

LENGTHS_S = (30, 60)  # of velocities
WAYS_S = (60, 120)
SPACING_S = 5  # between anchors, so that a window is at most this much longer than its name says
WIDE_SPACING_S = 20  # of propagations that are older than the longest length of velocities
FROZEN_S = 180  # age up to which a propagation is kept, if none younger takes its place
RELEASE_RATE = 0.01  # of fault-free evaluations above the threshold of release
LEAST_FIXES = 4  # of a mean over 5 s
DIMENSIONS = 3
LEAST_POSITION_SD = 0.8  # [m] reflections differ between two places, whatever the receiver states
LEAST_SPEED = 2.0  # [m/s] of a comparison of speeds


@dataclass(frozen=True)
class LongResult:
    """Test of one window at one time."""

    statistic: float  # [-] chi-square with 3 degrees of freedom without a fault
    difference_n: FloatArray  # shape (3,) [m/s, NED] GNSS minus free propagation
    sd_n: FloatArray  # shape (3,) [m/s, NED]
    anchor_ns: int
    decided: bool = False  # the speeds differ, and the odometer agrees with the free propagation: GNSS is wrong


@dataclass(frozen=True)
class WayResult:
    """Test of the way since an anchor at one time."""

    statistic: float  # [-] chi-square with 2 degrees of freedom without a fault
    difference_n: FloatArray  # shape (2,) [m, north and east] GNSS minus free propagation
    sd_n: FloatArray  # shape (2,) [m]
    anchor_ns: int


@dataclass(frozen=True)
class _Node:
    time_ns: int
    velocity_n: FloatArray  # of the antenna
    moved_n: FloatArray  # of the antenna since the anchor


@dataclass(frozen=True)
class _Place:
    """A position by GNSS, and the way of the propagation at the same time."""

    position: Geodetic
    sd: float  # [m]
    moved_n: FloatArray
    velocity_n: FloatArray
    time_ns: int


@dataclass(frozen=True)
class _Comparison:
    fix: VelocityFix
    free_n: FloatArray  # shape (3,) [m/s, NED] free velocity of the antenna at the fix
    P: FloatArray  # shape (3, 3) [m²/s²] its covariance, at most 1 s older


class FreeRun:
    """One free propagation with its velocities of the last seconds and what GNSS differs from them."""

    def __init__(self, anchor: FilterAnchor, settings: Settings) -> None:
        self.free = FreePropagation(anchor, settings.long, settings.rear_axle_distance_m)
        self._settings = settings
        self._nodes: list[_Node] = []
        self._compared: list[_Comparison] = []
        self._first: _Place | None = None  # soon after the anchor
        self._places: list[_Place] = []  # of the last 5 s
        self._speed_limit = chi_square_limit(1, settings.long.false_alarm_rate)

    @property
    def anchor_ns(self) -> int:
        """Start of the propagation."""
        return self.free.anchor.time_ns

    def advance(self, increment: Increment, lever_velocity_b: FloatArray) -> None:
        """Propagate by one increment; the antenna moves against the IMU by a velocity [m/s, body]."""
        self.free.advance(increment)
        nominal = self.free.nominal
        velocity = nominal.velocity + nominal.ned_from_body @ lever_velocity_b
        before = self._nodes[-1].velocity_n if self._nodes else velocity
        self.free.moved_n = self.free.moved_n + 0.5 * increment.duration * (before + velocity)
        self._nodes.append(_Node(increment.end_ns, velocity, self.free.moved_n))
        del self._nodes[:-20]

    def compare(self, fix: VelocityFix) -> None:
        """Take the differences of a fix that the increments have just passed."""
        self._place(fix)
        if len(self._nodes) < 2 or not self._nodes[0].time_ns <= fix.time_ns <= self._nodes[-1].time_ns:
            return
        times = [node.time_ns - fix.time_ns for node in self._nodes]
        velocities = np.array([node.velocity_n for node in self._nodes])
        free = np.array([np.interp(0.0, times, velocities[:, axis]) for axis in range(DIMENSIONS)])
        self._compared.append(_Comparison(fix, free, self.free.P[:3, :3].copy()))
        limit_ns = fix.time_ns - round((WINDOW_S - 0.1) * SECOND_NS)
        self._compared = [compared for compared in self._compared if compared.fix.time_ns > limit_ns]

    def _place(self, fix: VelocityFix) -> None:
        """Keep the position of a fix beside the way of the propagation at its time."""
        time_ns, nodes = fix.position_ns or fix.time_ns, self._nodes
        if fix.position is None or len(nodes) < 2 or not nodes[0].time_ns <= time_ns <= nodes[-1].time_ns:
            return
        later = next(k for k in range(1, len(nodes)) if nodes[k].time_ns >= time_ns)
        begin, end = nodes[later - 1], nodes[later]
        share = (time_ns - begin.time_ns) / (end.time_ns - begin.time_ns)
        moved = begin.moved_n + share * (end.moved_n - begin.moved_n)
        velocity = begin.velocity_n + share * (end.velocity_n - begin.velocity_n)
        place = _Place(fix.position, fix.position_sd, moved, velocity, time_ns)
        self._first = self._first or place
        self._places = [one for one in self._places if time_ns - one.time_ns < WINDOW_S * SECOND_NS] + [place]

    def way(self) -> WayResult | None:
        """Test the way since the anchor, as the mean of the last 5 s; None without positions.

        Notes
        -----
        With p the positions of GNSS, r the way of the propagation, P its covariance, s the stated standard deviations,
        v the velocities and s_t the error of the age of positions::

            d = mean(p_k - r_k) - (p_0 - r_0),    T = d' S^-1 d,    S = f² (P + (s_0² + s_k²) I + s_t² dv dv')
        """
        first, places = self._first, self._places
        if first is None or len(places) < LEAST_FIXES:
            return None
        apart = [
            np.array(ned_from_geodetic_difference(one.position, first.position)[:2]) - (one.moved_n - first.moved_n)[:2]
            for one in places
        ]
        d = np.mean(apart, axis=0)
        change = (places[-1].velocity_n - first.velocity_n)[:2]
        variance = sum(max(one.sd, LEAST_POSITION_SD) ** 2 for one in (first, places[-1]))
        S = (
            self.free.P[MOVED, MOVED][:2, :2]
            + np.eye(2) * variance
            + self._settings.long.position_time_sd_s**2 * np.outer(change, change)
        )
        S = self._settings.profile.long_factor**2 * S
        return WayResult(float(d @ np.linalg.solve(S, d)), d, np.sqrt(np.diag(S)), self.anchor_ns)

    def result(self) -> LongResult | None:
        """Test the mean difference over the last 5 s; None with too few fixes.

        Notes
        -----
        With d the mean difference, P_k the covariance of the free velocity at fix k, R that of the mean of n fixes
        whose errors are correlated over time, a the mean acceleration and s_t the standard deviation of stamps::

            T = d' S^-1 d,    S = f² (1/n sum P_k + R + s_t² a a')

        With f the factor that was learned on this vehicle. Changes of position add up over the window, so that R is
        then that of its two ends. A wrong heading turns the velocity and does not change the speed, which the odometer
        measures as well: where speeds differ, GNSS is wrong and not the IMU; u is the direction of free velocity::

            (|v| - |v_free|)² / (u' S u) > limit with one degree of freedom

        The covariance of a mean is at most the mean of the covariances, whatever the correlation of the errors.
        """
        if len(self._compared) < LEAST_FIXES:
            return None
        gnss = self._settings.gnss
        fixes = [compared.fix for compared in self._compared]
        times = np.array([(fix.time_ns - fixes[0].time_ns) / SECOND_NS for fix in fixes])
        free = np.array([compared.free_n for compared in self._compared])
        sd = np.array([fix.sd for fix in fixes])
        d = np.mean(np.array([fix.velocity_n for fix in fixes]) - free, axis=0)
        R = np.diag([mean_variance(times, sd[:, axis], gnss.velocity_correlation_s) for axis in range(DIMENSIONS)])
        if any(fix.of_positions for fix in fixes):
            ends = fixes[0].position_sd, fixes[-1].position_sd
            R[0, 0] = R[1, 1] = (ends[0] ** 2 + ends[1] ** 2) / max(times[-1], 1.0) ** 2
        acceleration = (free[-1] - free[0]) / times[-1]
        P = np.mean([compared.P for compared in self._compared], axis=0)
        S = P + R + gnss.time_sd_s**2 * np.outer(acceleration, acceleration)
        S = self._settings.profile.long_factor**2 * S
        mean = np.mean(free, axis=0)
        decided = self.free.odometer_agrees and self._speeds_differ(mean, mean + d, S)
        return LongResult(float(d @ np.linalg.solve(S, d)), d, np.sqrt(np.diag(S)), self.anchor_ns, decided)

    def _speeds_differ(self, free_n: FloatArray, gnss_n: FloatArray, S: FloatArray) -> bool:
        speed = float(np.hypot(free_n[0], free_n[1]))
        if speed < LEAST_SPEED:
            return False
        along = free_n[:2] / speed
        difference = float(np.hypot(gnss_n[0], gnss_n[1])) - speed
        return difference**2 > self._speed_limit * float(along @ S[:2, :2] @ along)


class LongWindow:
    """The free propagations of the last minute."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._runs: list[FreeRun] = []  # oldest anchor first
        self.threshold = chi_square_limit(DIMENSIONS, settings.long.false_alarm_rate)
        self.release_threshold = chi_square_limit(DIMENSIONS, RELEASE_RATE)
        self.median = chi_square_limit(DIMENSIONS, 0.5)
        self.way_threshold = chi_square_limit(2, settings.long.false_alarm_rate)
        self.way_doubt = chi_square_limit(2, settings.long.doubt_rate)
        self.way_median = chi_square_limit(2, 0.5)
        self.suspect_since_ns: int | None = None  # while GNSS is accused

    @property
    def oldest_s(self) -> float:
        """Age of the oldest propagation [s], 0 without one."""
        return self._runs[0].free.age_s(self._runs[0].free.nominal.time_ns) if self._runs else 0.0

    @property
    def odometer_rejected(self) -> bool:
        """Whether the odometer contradicts the inertial sensors in the oldest propagation."""
        return bool(self._runs) and self._runs[0].free.odometer_rejections > 0

    def clear(self) -> None:
        """Drop all propagations, because the inertial samples have a gap."""
        self._runs = []

    def accuse(self, suspect_since_ns: int) -> None:
        """Keep only propagations from before a suspect time, until `acquit`."""
        if self.suspect_since_ns is None or suspect_since_ns < self.suspect_since_ns:
            self.suspect_since_ns = suspect_since_ns
        self._runs = [run for run in self._runs if run.anchor_ns <= self.suspect_since_ns]

    def acquit(self) -> None:
        """Anchor in every solution again."""
        self.suspect_since_ns = None

    def anchor(self, anchor: FilterAnchor) -> None:
        """Start a propagation if the last one is 5 s old and no accused GNSS has a part in the solution."""
        if self._runs and anchor.time_ns - self._runs[-1].anchor_ns < SPACING_S * SECOND_NS:
            return
        if self.suspect_since_ns is not None:
            since_s = (anchor.time_ns - self.suspect_since_ns) / SECOND_NS
            if anchor.gnss_age_s is None or anchor.gnss_age_s < since_s:
                return
        self._runs.append(FreeRun(anchor, self._settings))

    def advance(self, increment: Increment) -> None:
        """Propagate by one increment."""
        lever_velocity_b = np.cross(increment.rate_b, self._settings.vehicle.gnss.lever_arm_body_m)
        for run in self._runs:
            if run.free.nominal.time_ns < increment.end_ns:
                run.advance(increment, lever_velocity_b)

    def predict(self) -> None:
        """Propagate the covariances over the second that has ended, and drop what is too old."""
        for run in self._runs:
            run.free.predict()
        ages = [run.free.age_s(run.free.nominal.time_ns) for run in self._runs]
        if self.suspect_since_ns is not None:
            self._runs = [run for run, age in zip(self._runs, ages, strict=True) if age <= FROZEN_S]
            return
        newest_whole = max((i for i, age in enumerate(ages) if age >= WAYS_S[-1]), default=0)
        kept: list[FreeRun] = []
        for i, (run, age) in enumerate(zip(self._runs, ages, strict=True)):
            apart_s = (run.anchor_ns - kept[-1].anchor_ns) / SECOND_NS if kept else WIDE_SPACING_S
            if i >= newest_whole and (age <= LENGTHS_S[-1] + SPACING_S or apart_s >= WIDE_SPACING_S):
                kept.append(run)
        self._runs = kept

    def aid(self, odometer: OdometerSpeed | None, yaw_rate: float, *, stationary: bool) -> None:
        """Aid by odometer, non-holonomic constraint and standstill."""
        for run in self._runs:
            if stationary:
                run.free.stand()
            else:
                self._aid(run.free, odometer if self._settings.long.odometer else None, yaw_rate)

    def _aid(self, free: FreePropagation, odometer: OdometerSpeed | None, yaw_rate: float) -> None:
        s = self._settings.long
        if odometer is None:
            free.aid(None, s.odometer_sd_m_s, yaw_rate)
            return
        change = abs(free.nominal.ned_from_body[:, 0] @ free.acceleration)
        sd = np.hypot(s.odometer_sd_m_s, s.odometer_time_sd_s * change)
        sd = np.hypot(sd, odometer.resolution / np.sqrt(12.0))
        if odometer.speed == 0.0 and odometer.resolution > 0.0:
            sd = np.hypot(sd, s.odometer_dead_zone_m_s)
        free.aid(odometer.speed, float(sd), yaw_rate)

    def compare(self, fix: VelocityFix) -> None:
        """Compare a fix with every propagation."""
        for run in self._runs:
            run.compare(fix)

    def way(self, length_s: int) -> WayResult | None:
        """Test the way with the youngest propagation of at least a length; None without one."""
        old = [run for run in self._runs if run.free.age_s(run.free.nominal.time_ns) >= length_s]
        return old[-1].way() if old else None

    def result(self, length_s: int) -> LongResult | None:
        """Test with the youngest propagation of at least a length; None without one, or with too few fixes."""
        old = [run for run in self._runs if run.free.age_s(run.free.nominal.time_ns) >= length_s]
        return old[-1].result() if old else None

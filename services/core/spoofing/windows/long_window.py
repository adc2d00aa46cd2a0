"""The long window: GNSS velocity against free propagations that started 30 and 60 s ago.

A drag-off is invisible in 5 s, and the innovations of the navigation filter absorb it. A propagation starts from
fusion's solution every 5 s and never uses GNSS; 30 and 60 s later its velocity is compared.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.maths.correlated_noise import mean_variance
from shared.maths.quantiles import chi_square_limit

from ..inertial.strapdown import SECOND_NS, FilterAnchor, Increment
from ..inertial.tracks import OdometerSpeed, VelocityFix
from ..settings import Settings
from .free_propagation import FreePropagation
from .metrics import WINDOW_S

FloatArray = npt.NDArray[np.float64]

LENGTHS_S = (30, 60)
SPACING_S = 5  # between anchors, so that a window is at most this much longer than its name says
FROZEN_S = 180  # age up to which a propagation is kept, if none younger takes its place
RELEASE_RATE = 0.01  # of fault-free evaluations above the threshold of release
LEAST_FIXES = 4  # of a mean over 5 s
DIMENSIONS = 3
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
class _Node:
    time_ns: int
    velocity_n: FloatArray  # of the antenna


@dataclass(frozen=True)
class _Comparison:
    fix: VelocityFix
    free_n: FloatArray  # shape (3,) [m/s, NED] free velocity of the antenna at the fix
    P: FloatArray  # shape (3, 3) [m²/s²] its covariance, at most 1 s older


class FreeRun:
    """One free propagation with its velocities of the last seconds and what GNSS differs from them."""

    def __init__(self, anchor: FilterAnchor, settings: Settings) -> None:
        self.free = FreePropagation(anchor, settings.long)
        self._settings = settings
        self._nodes: list[_Node] = []
        self._compared: list[_Comparison] = []
        self._speed_limit = chi_square_limit(1, settings.long.false_alarm_rate)

    @property
    def anchor_ns(self) -> int:
        """Start of the propagation."""
        return self.free.anchor.time_ns

    def advance(self, increment: Increment, lever_velocity_b: FloatArray) -> None:
        """Propagate by one increment; the antenna moves against the IMU by a velocity [m/s, body]."""
        self.free.advance(increment)
        nominal = self.free.nominal
        self._nodes.append(_Node(increment.end_ns, nominal.velocity + nominal.ned_from_body @ lever_velocity_b))
        del self._nodes[:-20]

    def compare(self, fix: VelocityFix) -> None:
        """Take the difference of a fix that the increments have just passed."""
        if len(self._nodes) < 2 or not self._nodes[0].time_ns <= fix.time_ns <= self._nodes[-1].time_ns:
            return
        times = [node.time_ns - fix.time_ns for node in self._nodes]
        velocities = np.array([node.velocity_n for node in self._nodes])
        free = np.array([np.interp(0.0, times, velocities[:, axis]) for axis in range(DIMENSIONS)])
        self._compared.append(_Comparison(fix, free, self.free.P[:3, :3].copy()))
        limit_ns = fix.time_ns - round((WINDOW_S - 0.1) * SECOND_NS)
        self._compared = [compared for compared in self._compared if compared.fix.time_ns > limit_ns]

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
        lever_velocity_b = np.cross(increment.rate_b, self._settings.gnss.lever_arm_body_m)
        for run in self._runs:
            if run.free.nominal.time_ns < increment.end_ns:
                run.advance(increment, lever_velocity_b)

    def predict(self) -> None:
        """Propagate the covariances over the second that has ended, and drop what is too old."""
        for run in self._runs:
            run.free.predict()
        ages = [run.free.age_s(run.free.nominal.time_ns) for run in self._runs]
        newest_whole = max((i for i, age in enumerate(ages) if age >= LENGTHS_S[-1]), default=0)
        oldest = 0 if self.suspect_since_ns is not None else newest_whole
        self._runs = [run for run, age in zip(self._runs[oldest:], ages[oldest:], strict=True) if age <= FROZEN_S]

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

    def result(self, length_s: int) -> LongResult | None:
        """Test with the youngest propagation of at least a length; None without one, or with too few fixes."""
        old = [run for run in self._runs if run.free.age_s(run.free.nominal.time_ns) >= length_s]
        return old[-1].result() if old else None

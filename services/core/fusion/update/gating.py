"""Gating by the normalised innovation squared, down-weighting, exclusion and readmission of devices."""

from copy import copy
from math import radians
from typing import NamedTuple

from shared.maths.kalman import Correction
from shared.maths.quantiles import chi_square_limit
from shared.messages.navigation import AidingKind

from ..alignment.heading import Heading
from ..alignment.velocity_matching import Comparison, Corrections
from ..filter import error_model as em
from ..filter.eskf import ErrorStateFilter
from ..measurements.base import Height, Measurement, Observation, Outcome
from ..measurements.gnss import GnssPosition, GnssVelocity, antenna_velocity
from ..settings import Settings
from . import lever_arm_monitor
from .lever_arm_monitor import FloatArray

# Standard deviations by which the covariance is inflated at a rejected GNSS measurement [m, m/s].
WIDENING = {
    AidingKind.GNSS_POSITION: {"position_sd": 0.1, "velocity_sd": 0.1},
    AidingKind.GNSS_VELOCITY: {"position_sd": 0.0, "velocity_sd": 0.1},
}
TURNED_SD = radians(3.0)  # smallest standard deviation of a corrected heading
# Rejected wheel speeds inflate it as well, along the vehicle and with time: spinning wheels are rejected rightly.
DOUBT_M_S_SQRT_S = 0.1
DOUBT_AFTER_NS, DOUBT_STEP_NS = 2_000_000_000, 1_000_000_000
TOLD_LIMIT = 9.0  # times the gate: innovations beyond it are no evidence on the lever arm
FORGIVEN_S = 60.0  # without a fault, after which the ones before are forgotten


class Standing(NamedTuple):
    """Fault status of a device for one kind of observation."""

    wrong_ns: int | None = None  # since when all have been rejected
    sound_ns: int | None = None  # since when a device at fault agrees again
    faults: int = 0
    fault_ns: int = 0  # when the newest began or ended
    excluded: bool = False

    def after(self, time_ns: int, agrees: bool, settings: Settings) -> "Standing":
        """Status after an observation that was within the gate or not.

        A device rejected for `gating.fault_after_s` is at fault and excluded until all its observations have
        agreed for `gating.readmission_s`, twice as long after each further fault within a minute, but not longer than
        `gating.readmission_max_s`.
        """
        if not agrees:
            since = time_ns if self.wrong_ns is None else self.wrong_ns
            if self.excluded or time_ns - since < settings.gating.fault_after_s * 1e9:
                return self._replace(wrong_ns=since, sound_ns=None)
            recent = time_ns - self.fault_ns < FORGIVEN_S * 1e9
            return Standing(since, None, 1 + (self.faults if recent else 0), time_ns, excluded=True)
        if not self.excluded:
            return self if self.wrong_ns is None else self._replace(wrong_ns=None)
        since = time_ns if self.sound_ns is None else self.sound_ns
        needed_s = min(settings.gating.readmission_s * 2.0 ** (self.faults - 1), settings.gating.readmission_max_s)
        if time_ns - since >= needed_s * 1e9:
            return Standing(faults=self.faults, fault_ns=time_ns)
        return self._replace(wrong_ns=None, sound_ns=since)


class Judge:
    """Tests and uses observations; its state is replaced and never changed in place."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self.corrections = Corrections()
        self.comparison = Comparison()  # of the filter's heading with GNSS
        self.arm = lever_arm_monitor.begun()
        self._height_ns: int | None = None  # since when heights have been rejected
        self._doubt_ns: int | None = None  # when the next inflation is due, while wheel speeds are rejected
        self._standings: dict[tuple[str, AidingKind], Standing] = {}

    def acquit(self, comparison: Comparison) -> None:
        """Start without faults of devices: the filter was wrong, and is a new one."""
        self._standings, self.corrections, self.arm = {}, Corrections(), lever_arm_monitor.begun()
        self.comparison = comparison

    def compare(self, seen: GnssPosition | GnssVelocity, navigation: ErrorStateFilter) -> Heading | None:
        """Turn by which the filter's heading is wrong; None if it is not."""
        corrections = self.corrections.at(seen.time_ns)
        (an, ae, _), (vn, ve, _) = antenna_velocity(navigation, seen.lever_arm), navigation.velocity
        self.corrections = Corrections(corrections.time_ns, corrections.velocity, corrections.tilt)
        pure = complex(an + vn, ae + ve) + corrections.velocity
        self.comparison = self.comparison.turned(-corrections.yaw).after(seen, pure)
        if not self.comparison.is_wrong(seen.time_ns):
            return None
        turn, sd = self.comparison.result()
        return Heading(turn, max(sd, TURNED_SD), "matched accelerations")

    def judge(self, navigation: ErrorStateFilter, measurement: Measurement, seen: Observation) -> Outcome:
        """Use an observation if its d² is within the limit, with less weight up to `gating.robust_limit` times it.

        A position that is beyond it, but within what the receiver states, has another time-correlated error than those
        before. One whose height alone is beyond it is used without its height.
        """
        correction, ratio = self._weigh(navigation, seen)
        limit = self._settings.gating.robust_limit if seen.kind in WIDENING else 1.0
        if ratio > limit and isinstance(measurement, GnssPosition) and seen.H[:, em.GNSS_ERROR].any():
            other = copy(navigation)
            other.recorder = None
            other.reset_gnss_error()
            anew = measurement.observe(other)
            if self._weigh(other, anew)[1] <= 1.0:
                navigation.reset_gnss_error()
                seen = anew
                correction, ratio = self._weigh(navigation, seen)
        if ratio > limit and seen.kind is AidingKind.GNSS_POSITION and len(seen.z) == 3:
            level = Observation(seen.kind, seen.z[:2], seen.H[:2], seen.R[:2, :2])
            flat, flat_ratio = self._weigh(navigation, level)
            if flat_ratio <= 1.0:
                outcome = self._judge(navigation, measurement, level, flat, flat_ratio, self._height(seen))
                taken_over = self._follow_height(navigation, seen, measurement.time_ns)
                height = Height(float(seen.z[2]), float(correction.innovation_sd[2]), taken_over)
                return outcome._replace(height=height)
        return self._judge(navigation, measurement, seen, correction, ratio, None)

    def compare_only(
        self, navigation: ErrorStateFilter, measurement: Measurement, seen: Observation, why: str
    ) -> Outcome:
        """Test an observation and do not use it; nothing is remembered of it."""
        correction, ratio = self._weigh(navigation, seen)
        return _outcome(measurement, seen, correction, ratio, why, 0.0)

    def _weigh(self, navigation: ErrorStateFilter, seen: Observation) -> tuple[Correction, float]:
        correction = navigation.innovate(seen.z, seen.H, seen.R)
        limit = chi_square_limit(len(seen.z), self._settings.gating.false_alarm_probability)
        return correction, float(correction.distance2) / limit

    def _height(self, seen: Observation) -> str:
        return f"height beyond the gate by {-float(seen.z[2]):.0f} m: used without it"

    def _follow_height(self, navigation: ErrorStateFilter, seen: Observation, time_ns: int) -> bool:
        """Reset the height to one that has been rejected for as long as a reset needs; returns whether it was."""
        self._height_ns = time_ns if self._height_ns is None else self._height_ns
        if time_ns - self._height_ns < self._settings.gating.reset_after_s * 1e9:
            return False
        self._height_ns = None
        navigation.inflate(height_sd=abs(float(seen.z[2])))
        return True

    def _follow_speed(self, navigation: ErrorStateFilter, seen: Observation, time_ns: int, refused: bool) -> None:
        """Inflate the velocity that wheel speeds have contradicted for long: once a second, along the vehicle only."""
        if not refused:
            self._doubt_ns = None
            return
        if self._doubt_ns is None:
            self._doubt_ns = time_ns + DOUBT_AFTER_NS
        if time_ns >= self._doubt_ns:
            self._doubt_ns = time_ns + DOUBT_STEP_NS
            navigation.inflate_along(em.VELOCITY, DOUBT_M_S_SQRT_S * seen.H[0, em.VELOCITY])

    def _judge(
        self,
        navigation: ErrorStateFilter,
        measurement: Measurement,
        seen: Observation,
        correction: Correction,
        ratio: float,
        remark: str | None,
    ) -> Outcome:
        gnss = seen.kind in WIDENING
        if gnss and ratio < TOLD_LIMIT:
            self._watch_arm(navigation, measurement, seen, correction.S)
        limit = self._settings.gating.robust_limit if gnss else 1.0
        excluded = gnss and self._is_excluded(measurement, seen.kind, ratio <= limit)
        refused = "beyond the gate" if ratio > limit else "not admitted again yet" if excluded else None
        refused = seen.unfit or refused
        weight = 0.0 if refused else _weight(ratio, limit)
        if not refused:
            lighter = correction if weight == 1.0 else navigation.innovate(seen.z, seen.H, seen.R / weight)
            navigation.apply(lighter)
            self.corrections = self.corrections.after(measurement.time_ns, lighter.x[:5].tolist())
        if gnss and refused and ratio > 1.0:
            navigation.inflate(**WIDENING[seen.kind])
        if seen.kind is AidingKind.ODOMETER:
            self._follow_speed(navigation, seen, measurement.time_ns, refused is not None and seen.unfit is None)
        if seen.kind is AidingKind.GNSS_POSITION and len(seen.z) == 3 and not refused:
            self._height_ns = None
        return _outcome(measurement, seen, correction, ratio, refused or remark, weight)

    def _watch_arm(
        self, navigation: ErrorStateFilter, measurement: Measurement, seen: Observation, S: FloatArray
    ) -> None:
        gain = 1.0 - (seen.R.item(0, 0) + seen.R.item(1, 1)) / (S.item(0, 0) + S.item(1, 1))
        position = seen.kind is AidingKind.GNSS_POSITION
        self.arm = self.arm.after(measurement.time_ns, navigation, seen.z, S, gain=gain, position=position)

    def _is_excluded(self, measurement: Measurement, kind: AidingKind, agrees: bool) -> bool:
        """Update the fault status of GNSS; returns whether it is excluded now."""
        key = measurement.source, kind
        before = self._standings.get(key, Standing())
        after = before.after(measurement.time_ns, agrees, self._settings)
        if after is not before:
            self._standings = {**self._standings, key: after}
        return after.excluded


def _outcome(
    measurement: Measurement, seen: Observation, correction: Correction, ratio: float, why: str | None, weight: float
) -> Outcome:
    """Outcome of an observation, which was used where its weight is not zero."""
    z, sd = tuple(seen.z.tolist()), tuple(correction.innovation_sd.tolist())
    return Outcome(
        measurement.time_ns, measurement.source, seen.kind, z, sd, ratio, weight > 0.0, why, weight, type(measurement)
    )


def _weight(ratio: float, limit: float) -> float:
    """Full weight within the gate, none at the limit, and Tukey's biweight between them."""
    return 1.0 if ratio <= 1.0 else max(1e-3, ((limit - ratio) / (limit - 1.0)) ** 2)

"""The motion monitor: takes stamped speeds of GNSS and odometer, and gives ten separate verdicts.

A sample of the tachograph's tests is the first GNSS speed at or after a multiple of 10 s with the odometer's speed
interpolated to its stamp. The paper takes the first odometer speed at or after that time, which adds the
synchronisation error ΔT · dS/dt.
"""

from collections import Counter, deque
from dataclasses import fields, replace
from math import isfinite, radians

from scipy.special import ndtri

from . import fast
from .aligned import SECOND_NS, SLOPE_NS, OdometerTrack
from .calibration import LEARNED_DELAY_SD_S, SCALE_LIMIT, STEP_LIMIT, Calibration, CalibrationEstimator, RecentScale
from .held import USUAL_HOLD_S, HeldSpeed
from .settings import Settings
from .tachograph import (
    DISTANCE_PERIOD_S,
    EVENT_S,
    KM_H,
    MOTION_SENSOR_WINDOW_S,
    PERIOD_S,
    SAMPLES,
    THRESHOLD_M_S,
    DistanceRule,
    MotionSensorRule,
    SpeedWindow,
    WindowMode,
)
from .verdicts import EITHER, Accused, MotionVerdicts, State, Verdict

PERIOD_NS = int(PERIOD_S * SECOND_NS)
WINDOW_S = PERIOD_S * SAMPLES
SLOPE_S = SLOPE_NS / SECOND_NS
Epoch = tuple[int, float, float]  # stamp, speed and standard deviation of GNSS
INCONSPICUOUS = 1.0  # expected value of the fast statistic: a window below it shows no sign of a fault


def judged(statistic: float, threshold: float, verdict: Verdict) -> Verdict:
    """Compare a statistic with its threshold: strictly greater accuses, else nobody is accused."""
    if statistic > threshold:
        return replace(verdict, state=State.ACCUSES, statistic=statistic, threshold=threshold)
    return replace(
        verdict, state=State.PASS, statistic=statistic, threshold=threshold, accused=(), suspect_since_ns=None
    )


def not_evaluated(reason: str, verdict: Verdict) -> Verdict:
    """Verdict of a test that has nothing to compare."""
    return replace(verdict, state=State.NOT_EVALUATED, reason=reason, accused=(), suspect_since_ns=None)


class MotionMonitor:
    """Compares GNSS speed with odometer speed.

    Stamps are on one time line; each source's stamps increase. A speed that is implausible or not newer than the one
    before is rejected and counted in `rejected`. `calibration.frozen` stops learning.
    """

    def __init__(self, settings: Settings | None = None, *, start: Calibration | None = None) -> None:
        self.settings = s = settings or Settings()
        self.rejected: Counter[str] = Counter()
        self.raw = SpeedWindow(s.window, still_m_s=s.still_m_s)
        self.compensated = SpeedWindow(WindowMode.MOVING, still_m_s=s.still_m_s)
        self.calibration = CalibrationEstimator(delay_limits_s=s.delay_limits_s, start=start)
        self.held = HeldSpeed()
        self.distance = DistanceRule(gap_s=s.pairing_s)
        self.motion_sensor = MotionSensorRule(moving_m_s=s.motion_sensor_moving_m_s, gap_s=s.pairing_s)
        self._odometer = OdometerTrack(gap_s=s.pairing_s)
        self._pending: deque[Epoch] = deque(maxlen=256)  # not reached by the odometer yet
        self._window: deque[Epoch] = deque(maxlen=256)  # of the fast test
        self._learnable: deque[Epoch] = deque(maxlen=256)  # not reached with the largest delay yet
        self._gnss_ns: int | None = None  # newest epoch
        self._speed_ns: int | None = None  # newest epoch with a speed that is measured
        self._slot: int | None = None
        self._candidate: tuple[int, float] | None = None  # GNSS sample of the slot
        self._sampled = False
        self._compensated_slot: int | None = None
        self._statistic: tuple[int, float] | None = None  # of the fast test, with the stamp of its window's end
        self._inconspicuous_ns: int | None = None  # start of the newest window without a sign of a fault
        self._newest = MotionVerdicts(**{field.name: self._base(0.0, "") for field in fields(MotionVerdicts)})
        self._fast_limit = fast.threshold(s.fast_false_alarm_rate)

    def gnss(self, time_ns: int, speed_m_s: float | None, sd_m_s: float | None = None) -> None:
        """Use a GNSS speed over ground; None when the receiver has no fix, whatever number it reports."""
        if not self._acceptable("gnss", time_ns, self._gnss_ns, speed_m_s, self.settings.largest_gnss_m_s):
            return
        if sd_m_s is not None and not (isfinite(sd_m_s) and sd_m_s > 0.0):
            self.rejected["gnss: accuracy is not a positive number"] += 1
            return
        self._advance(time_ns)
        self._gnss_ns = time_ns
        self.held.gnss(time_ns, speed_m_s)
        held_since_ns = self.held.since_ns
        if held_since_ns is not None and self.held.held_s <= USUAL_HOLD_S:
            speed_m_s = None
            self._forget_held(held_since_ns)
        self.motion_sensor.update(time_ns, speed_m_s, self._odometer.newest(time_ns))
        if speed_m_s is None:
            return
        self._speed_ns = time_ns
        sd = max(self.settings.gnss_sd_floor_m_s, sd_m_s if sd_m_s is not None else self.settings.gnss_sd_m_s)
        if self._candidate is None and not self._sampled and time_ns % PERIOD_NS <= self.settings.pairing_s * SECOND_NS:
            self._candidate = (time_ns, speed_m_s)
        self._pending.append((time_ns, speed_m_s, sd))
        self._pair()

    def odometer(self, time_ns: int, speed_m_s: float | None, resolution_m_s: float | None = None) -> None:
        """Use an odometer speed as the vehicle reports it, with its step (None: 1 km/h, OBD-II PID 0x0D)."""
        limit = self.settings.largest_odometer_m_s
        if speed_m_s is None or not self._acceptable("odometer", time_ns, self._odometer.newest_ns, speed_m_s, limit):
            return
        resolution = 1.0 * KM_H if resolution_m_s is None else resolution_m_s
        if not (isfinite(resolution) and 0.0 <= resolution < 3.0):
            self.rejected["odometer: resolution is not within 0 to 3 m/s"] += 1
            return
        self._advance(time_ns)
        self._odometer.add(time_ns, speed_m_s, resolution)
        self.held.odometer(speed_m_s, resolution)
        self.distance.odometer(time_ns, speed_m_s)
        self._pair()

    def position(self, time_ns: int, latitude_deg: float, longitude_deg: float) -> None:
        """Use a GNSS position with a valid fix, for the distance rule."""
        if not (abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 180.0):
            self.rejected["gnss: position is outside the Earth's coordinates"] += 1
            return
        self.distance.position(time_ns, radians(latitude_deg), radians(longitude_deg))

    def ferry(self, duration_s: float) -> None:
        """Allow for time spent aboard a ferry or train since the last comparison of distances."""
        self.distance.ferry_s += max(0.0, duration_s)

    def _acceptable(self, source: str, time_ns: int, last_ns: int | None, speed: float | None, limit: float) -> bool:
        reason = None
        if last_ns is not None and time_ns <= last_ns:
            reason = "stamp is not after the one before"
        elif speed is not None and not isfinite(speed):
            reason = "speed is not a number"
        elif speed is not None and not 0.0 <= speed <= limit:
            reason = f"speed is not within 0 to {limit:.0f} m/s"
        if reason is not None:
            self.rejected[f"{source}: {reason}"] += 1
        return reason is None

    def _advance(self, time_ns: int) -> None:
        """Close the sample times that have passed without both speeds."""
        slot, grace_ns = time_ns // PERIOD_NS, 2 * int(self.settings.pairing_s * SECOND_NS)
        if self._slot is None:
            self._slot = slot
        self._slot = max(self._slot, slot - SAMPLES)  # after a long silence one window of missing samples is enough
        while self._slot < slot:
            self._close()
            self._slot, self._sampled = self._slot + 1, False
        if time_ns > self._slot * PERIOD_NS + grace_ns:
            self._close()

    def _close(self) -> None:
        if self._slot is not None and not self._sampled:
            self.raw.add(self._slot * PERIOD_NS, None, None)
        self._candidate, self._sampled = None, True

    def _forget_held(self, since_ns: int) -> None:
        """Drop what has been queued of a speed before it was recognised as held."""
        for queue in (self._pending, self._window, self._learnable):
            while queue and queue[-1][0] >= since_ns:
                queue.pop()
        if self._candidate is not None and self._candidate[0] >= since_ns:
            self._candidate = None
        self._statistic = None

    def _pair(self) -> None:
        """Complete the sample of this sample time, and every aligned pair that the odometer's samples reach."""
        newest_ns = self._odometer.newest_ns
        if self._candidate is not None and newest_ns is not None and newest_ns >= self._candidate[0]:
            time_ns, speed = self._candidate
            self.raw.add(time_ns, speed, self._odometer.at(time_ns))
            self._candidate, self._sampled = None, True
        known = self.calibration.calibration
        while self._pending and self._odometer.reaches(self._pending[0][0], known.delay_s + SLOPE_S):
            epoch = self._pending.popleft()
            self._window.append(epoch)
            self._learnable.append(epoch)
            self._test(epoch, known)
        longest_s = max(float(self.calibration.delays_s[-1]), known.delay_s + SLOPE_S)
        while self._learnable and self._odometer.reaches(self._learnable[0][0], longest_s):
            self._learn(self._learnable.popleft())

    def _test(self, epoch: Epoch, known: Calibration) -> None:
        time_ns, speed, sd = epoch
        pair = self._odometer.pair(time_ns, known.delay_s, (speed, sd))
        if pair is None:
            return
        self._test_fast(known)
        if time_ns // PERIOD_NS != self._compensated_slot:
            self._compensated_slot = time_ns // PERIOD_NS
            self.compensated.add(time_ns, speed, known.scale * pair.odometer)

    def _learn(self, epoch: Epoch) -> None:
        time_ns, speed, sd = epoch
        series = self._odometer.series(time_ns, self.calibration.delays_s)
        pair = self._odometer.pair(time_ns, self.calibration.calibration.delay_s, (speed, sd))
        if series is not None and pair is not None:
            self.calibration.update(pair, series)

    def _test_fast(self, calibration: Calibration) -> None:
        newest_ns = self._window[-1][0]
        while newest_ns - self._window[0][0] > fast.WINDOW_S * SECOND_NS:
            self._window.popleft()
        aligned = [self._odometer.pair(t, calibration.delay_s, (speed, sd)) for t, speed, sd in self._window]
        pairs = [pair for pair in aligned if pair is not None]
        if len(pairs) < fast.LEAST_SAMPLES:
            return
        odometer = sum(pair.odometer for pair in pairs) / len(pairs)
        slope = sum(pair.slope for pair in pairs) / len(pairs)
        statistic = fast.fast_statistic(
            pairs,
            scale=calibration.scale,
            calibration_variance=self.calibration.speed_variance(odometer, slope),
            correlation_s=self.settings.gnss_correlation_s,
            dead_zone_m_s=self.settings.dead_zone_m_s,
        )
        if statistic <= INCONSPICUOUS or self._inconspicuous_ns is None:
            self._inconspicuous_ns = pairs[0].time_ns
        self._statistic = (newest_ns, statistic)

    def verdicts(self, time_ns: int) -> MotionVerdicts:
        """Give all verdicts at a time that is not before any stamp used."""
        self._advance(time_ns)
        missing = self._missing(time_ns, self.settings.stale_after_s)
        found = MotionVerdicts(
            trimmed_mean=self._over_window(self.raw, missing, "trimmed mean"),
            median=self._over_window(self.raw, missing, "median"),
            event=self._event(missing),
            distance=self._distance(),
            motion_sensor=self._motion_sensor(time_ns, missing),
            calibrated=self._calibrated(missing),
            scale_step=self._scale_step(missing),
            scale_range=self._scale_range(missing),
            held_speed=self._held_speed(time_ns),
            fast=self._fast(time_ns),
        )
        self._newest = MotionVerdicts(
            **{f.name: _dated(getattr(found, f.name), getattr(self._newest, f.name), time_ns) for f in fields(found)}
        )
        return self._newest

    def _base(self, window_s: float, reason: str, unit: str = "m/s", **others: object) -> Verdict:
        return replace(Verdict(State.NOT_EVALUATED, reason, unit, window_s), **others)  # type: ignore[arg-type]

    def _missing(self, time_ns: int, limit_s: float) -> str | None:
        """Why the two speeds cannot be compared now."""
        for name, newest_ns in (("GNSS", self._speed_ns), ("odometer", self._odometer.newest_ns)):
            if newest_ns is None:
                return f"no {name} speed received yet"
            if time_ns - newest_ns > limit_s * SECOND_NS:
                held = " (the receiver repeats its last speed)" if name == "GNSS" and self.held.since_ns else ""
                return f"no {name} speed for {(time_ns - newest_ns) / SECOND_NS:.0f} s{held}"
        return None

    def _over_window(self, window: SpeedWindow, missing: str | None, name: str) -> Verdict:
        base = self._base(WINDOW_S, "", accused=EITHER, suspect_since_ns=window.suspect_since_ns)
        if missing is not None:
            return not_evaluated(missing, base)
        if not window.complete:
            return not_evaluated(_warming(window), base)
        value = window.median() if name == "median" else window.trimmed_mean()
        reason = f"{name} of |GNSS - odometer| is {value / KM_H:.1f} km/h, limit {THRESHOLD_M_S / KM_H:.0f} km/h"
        return judged(value, THRESHOLD_M_S, replace(base, reason=reason))

    def _event(self, missing: str | None) -> Verdict:
        window = self.raw
        base = self._base(WINDOW_S, "", "s", accused=EITHER, suspect_since_ns=window.suspect_since_ns)
        if missing is not None:
            return not_evaluated(missing, base)
        if not window.complete:
            return not_evaluated(_warming(window), base)
        reason = f"trimmed mean above 10 km/h for {window.exceeded_s:.0f} s of movement, limit {EVENT_S:.0f} s"
        return judged(window.exceeded_s, EVENT_S, replace(base, reason=reason))

    def _distance(self) -> Verdict:
        base = self._base(DISTANCE_PERIOD_S, "", "m", accused=EITHER)
        if self.distance.compared is None:
            return not_evaluated("no 15 minutes between two positions with an uninterrupted odometer yet", base)
        distance_m, limit_m, start_ns, _ = self.distance.compared
        reason = f"distance between two positions is {distance_m / 1000.0:.2f} km, limit {limit_m / 1000.0:.2f} km"
        return judged(distance_m, limit_m, replace(base, reason=reason, suspect_since_ns=start_ns))

    def _motion_sensor(self, time_ns: int, missing: str | None) -> Verdict:
        total_s, limit_s = self.motion_sensor.contradiction_s(time_ns), self.settings.motion_sensor_s
        reason = f"odometer at zero while GNSS moved for {total_s:.0f} s of three hours, limit {limit_s:.0f} s"
        since_ns = self.motion_sensor.suspect_since_ns
        base = self._base(MOTION_SENSOR_WINDOW_S, reason, "s", accused=(Accused.ODOMETER,), suspect_since_ns=since_ns)
        return not_evaluated(missing, base) if missing is not None else judged(total_s, limit_s, base)

    def _calibrated(self, missing: str | None) -> Verdict:
        known = self.calibration.calibration
        verdict = self._over_window(self.compensated, missing, "trimmed mean")
        if missing is None and not known.learned:
            return not_evaluated(f"scale is known to {100.0 * known.scale_sd:.1f} % only", verdict)
        text = f"{verdict.reason}, with scale {known.scale:.3f} and delay {known.delay_s:.2f} s"
        return replace(verdict, reason=text)

    def _recent(self, missing: str | None) -> RecentScale | str:
        recent = self.calibration.recent()
        if missing is not None:
            return missing
        return recent if recent is not None else "less than 5 min of learning or 1 min of movement at speed"

    def _scale_limit(self, limit: float, recent: RecentScale) -> float:
        return limit - float(ndtri(self.settings.scale_false_alarm_rate / 2.0)) * recent.scale_sd

    def _scale_step(self, missing: str | None) -> Verdict:
        base = self._base(120.0, "", "-", false_alarm_rate=self.settings.scale_false_alarm_rate, accused=EITHER)
        recent = self._recent(missing)
        if isinstance(recent, str):
            return not_evaluated(recent, base)
        step = abs(recent.scale / recent.reference - 1.0)
        limit = self._scale_limit(STEP_LIMIT, recent)
        text = f"scale {recent.scale:.3f} of two minutes against {recent.reference:.3f} learned: "
        reason = f"{text}{100 * step:.1f} %, limit {100 * limit:.1f} %"
        return judged(step, limit, replace(base, reason=reason, suspect_since_ns=recent.oldest_ns))

    def _scale_range(self, missing: str | None) -> Verdict:
        base = self._base(120.0, "", "-", false_alarm_rate=self.settings.scale_false_alarm_rate, accused=EITHER)
        recent = self._recent(missing)
        if isinstance(recent, str):
            return not_evaluated(recent, base)
        deviation, limit = abs(recent.scale - 1.0), self._scale_limit(SCALE_LIMIT, recent)
        reason = (
            f"scale {recent.scale:.3f} of two minutes is {100 * deviation:.1f} % off one, limit {100 * limit:.1f} %"
        )
        return judged(deviation, limit, replace(base, reason=reason, suspect_since_ns=recent.oldest_ns))

    def _held_speed(self, time_ns: int) -> Verdict:
        base = self._base(USUAL_HOLD_S, "", "s", accused=(Accused.GNSS,), suspect_since_ns=self.held.since_ns)
        if self._gnss_ns is None or time_ns - self._gnss_ns > self.settings.stale_after_s * SECOND_NS:
            return not_evaluated("no GNSS epoch received", base)
        duration_s = self.held.held_s if self.held.since_ns is not None else 0.0
        reason = f"receiver has repeated its last speed for {duration_s:.0f} s, limit {USUAL_HOLD_S:.0f} s"
        return judged(duration_s, USUAL_HOLD_S, replace(base, reason=reason))

    def _fast(self, time_ns: int) -> Verdict:
        rate = self.settings.fast_false_alarm_rate
        base = self._base(fast.WINDOW_S, "", "-", false_alarm_rate=rate, accused=EITHER)
        missing = self._missing(time_ns, self.settings.fast_stale_after_s)
        if missing is not None:
            return not_evaluated(missing, base)
        delay_sd_s = self.calibration.calibration.delay_sd_s
        if delay_sd_s > LEARNED_DELAY_SD_S:
            return not_evaluated(f"delay of the odometer is known to {delay_sd_s:.2f} s only", base)
        if self._statistic is None or time_ns - self._statistic[0] > self.settings.fast_stale_after_s * SECOND_NS:
            return not_evaluated("fewer than 4 pairs of speeds in 5 s", base)
        statistic = self._statistic[1]
        reason = f"mean speed difference over 5 s: chi-square {statistic:.1f}, limit {self._fast_limit:.1f}"
        return judged(
            statistic, self._fast_limit, replace(base, reason=reason, suspect_since_ns=self._inconspicuous_ns)
        )


def _warming(window: SpeedWindow) -> str:
    kind = "moving samples" if window.mode is WindowMode.MOVING else "samples with both speeds"
    return f"warming up: {len(window.differences)} of {SAMPLES} {kind}"


def _dated(new: Verdict, old: Verdict, time_ns: int) -> Verdict:
    """Carry over since when a state lasts and, while a test accuses, the earliest suspect time."""
    if new.state is not old.state or old.since_ns is None:
        return replace(new, since_ns=time_ns)
    suspect = [t for t in (old.suspect_since_ns, new.suspect_since_ns) if t is not None]
    if new.state is State.ACCUSES and suspect:
        new = replace(new, suspect_since_ns=min(suspect))
    return replace(new, since_ns=old.since_ns)

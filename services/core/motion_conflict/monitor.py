"""The motion monitor: ten separate verdicts on GNSS speed against odometer speed."""

from dataclasses import fields, replace

from scipy.special import ndtri

from shared.maths.quantiles import chi_square_limit

from . import fast
from .aligned import SECOND_NS
from .calibration import LEARNED_DELAY_SD_S, SCALE_LIMIT, STEP_LIMIT, STEP_WINDOW_S, Calibration, RecentScale
from .comparison import SpeedComparison
from .held import USUAL_HOLD_S
from .settings import Settings
from .tachograph import (
    DISTANCE_PERIOD_S,
    EVENT_S,
    KM_H,
    MOTION_SENSOR_WINDOW_S,
    PERIOD_S,
    SAMPLES,
    THRESHOLD_M_S,
    SpeedWindow,
    WindowMode,
)
from .verdicts import EITHER, Accused, MotionVerdicts, State, Verdict

WINDOW_S = PERIOD_S * SAMPLES


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


class MotionMonitor(SpeedComparison):
    """Takes stamped speeds by `gnss` and `odometer`, and gives verdicts on them."""

    def __init__(self, settings: Settings | None = None, *, start: Calibration | None = None) -> None:
        super().__init__(settings, start=start)
        self._newest = MotionVerdicts(**{field.name: self._base(0.0, "") for field in fields(MotionVerdicts)})
        self._fast_limit = chi_square_limit(1, self.settings.fast_false_alarm_rate)

    def verdicts(self, time_ns: int) -> MotionVerdicts:
        """Give all verdicts at a time that is not before any stamp used."""
        self.advance(time_ns)
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
        for name, newest_ns in (("GNSS", self.speed_ns), ("odometer", self.track.newest_ns)):
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
        base = self._base(STEP_WINDOW_S, "", "-", false_alarm_rate=self.settings.scale_false_alarm_rate, accused=EITHER)
        recent = self._recent(missing)
        if isinstance(recent, str):
            return not_evaluated(recent, base)
        step = abs(recent.scale / recent.reference - 1.0)
        limit = self._scale_limit(STEP_LIMIT, recent)
        text = f"scale {recent.scale:.3f} of two minutes against {recent.reference:.3f} learned: "
        reason = f"{text}{100 * step:.1f} %, limit {100 * limit:.1f} %"
        return judged(step, limit, replace(base, reason=reason, suspect_since_ns=recent.oldest_ns))

    def _scale_range(self, missing: str | None) -> Verdict:
        base = self._base(STEP_WINDOW_S, "", "-", false_alarm_rate=self.settings.scale_false_alarm_rate, accused=EITHER)
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
        if self.gnss_ns is None or time_ns - self.gnss_ns > self.settings.stale_after_s * SECOND_NS:
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
        if (
            self.fast_statistic is None
            or time_ns - self.fast_statistic[0] > self.settings.fast_stale_after_s * SECOND_NS
        ):
            return not_evaluated("fewer than 4 pairs of speeds in 5 s", base)
        statistic = self.fast_statistic[1]
        reason = f"mean speed difference over 5 s: chi-square {statistic:.1f}, limit {self._fast_limit:.1f}"
        return judged(statistic, self._fast_limit, replace(base, reason=reason, suspect_since_ns=self.inconspicuous_ns))


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

"""The motion monitor: eleven separate verdicts on GNSS speed against odometer speed."""

from collections.abc import Callable
from dataclasses import replace
from math import degrees

from scipy.special import ndtri

from shared.maths.quantiles import chi_square_limit
from shared.messages.explanation import Explanation, explain
from shared.messages.trust import Outcome
from shared.trust.accused import GNSS, ODOMETER
from shared.trust.inputs import Input, absent
from shared.trust.result import Test, dated, judged

from . import carried, fast
from .aligned import SECOND_NS
from .calibration import LEARNED_DELAY_SD_S, SCALE_LIMIT, STEP_LIMIT, STEP_WINDOW_S, Calibration, RecentScale
from .carried import Carried
from .codes import Code
from .comparison import SpeedComparison
from .held import USUAL_HOLD_S
from .settings import Settings
from .tachograph import (
    DISTANCE_PERIOD_S,
    EVENT_S,
    MOTION_SENSOR_WINDOW_S,
    PERIOD_S,
    SAMPLES,
    THRESHOLD_M_S,
    SpeedWindow,
    WindowMode,
)
from .verdicts import EITHER_SOURCE, MotionVerdicts

WINDOW_S = PERIOD_S * SAMPLES
LONG_CROSSING_S = 24.0 * 3600.0  # [s] a crossing that is open for longer was rather forgotten, or is abused


class MotionMonitor(SpeedComparison):
    """Takes stamped speeds by `gnss` and `odometer`, and gives verdicts on them."""

    def __init__(self, settings: Settings | None = None, *, start: Calibration | None = None) -> None:
        super().__init__(settings, start=start)
        self._newest: dict[str, Test] = {}
        self.carried = Carried()
        self.crossing_since_ns: int | None = None  # of the crossing that is open
        self._fast_limit = chi_square_limit(1, self.settings.fast_false_alarm_rate)

    def verdicts(self, time_ns: int) -> MotionVerdicts:
        """Give all verdicts at a time that is not before any stamp used."""
        self.advance(time_ns)
        missing = self._missing(time_ns, self.settings.stale_after_s)
        found = MotionVerdicts(
            trimmed_mean=self._over_window(self.raw, missing, self.raw.trimmed_mean, Code.TRIMMED_MEAN),
            median=self._over_window(self.raw, missing, self.raw.median, Code.MEDIAN),
            event=self._event(missing),
            distance=self._distance(),
            motion_sensor=self._motion_sensor(time_ns, missing),
            calibrated=self._calibrated(missing),
            scale_step=self._scale_step(missing),
            scale_range=self._scale_range(missing),
            held_speed=self._held_speed(time_ns),
            fast=self._fast(time_ns),
            carried=self._carried(time_ns),
        )
        self._newest = {name: dated(test, self._newest.get(name), time_ns) for name, test in found.named().items()}
        return MotionVerdicts(**self._newest)

    def cross(self, time_ns: int, since_ns: int | None) -> None:
        """Begin (with its stamp) or end (None) a crossing; in one no speed of GNSS is compared with the odometer's."""
        if (since_ns is None) is not (self.crossing_since_ns is None):
            self.distance.crossing(time_ns, since_ns is not None)
        self.crossing_since_ns = since_ns

    def _carried(self, time_ns: int) -> Test:
        """Whether a ferry or train may carry the vehicle: a question to the driver, which silences nothing."""
        base = _test(explain(Code.NOT_CARRIED), "rad", carried.WINDOW_S, accused=())
        if self.crossing_since_ns is not None:
            why = self._doubt_in_crossing(time_ns, self.crossing_since_ns)
            known = why or explain(Code.CARRIED, since_ns=self.crossing_since_ns)
            return replace(base, outcome=Outcome.PASS, why=known, doubtful=why is not None)
        missing = self._missing(time_ns, self.settings.stale_after_s)
        if missing is not None:
            return replace(base, why=missing)
        finding = self.carried.finding(time_ns)
        if finding is None:
            return replace(base, outcome=Outcome.PASS)
        why = explain(
            Code.CARRIED_OR_SPOOFED, moved_s=finding.moved_s, speed_m_s=finding.speed,
            turn_deg=degrees(finding.turn_difference),
        )  # fmt: skip
        return replace(base, outcome=Outcome.PASS, why=why, doubtful=True)

    def _doubt_in_crossing(self, time_ns: int, since_ns: int) -> Explanation | None:
        """What contradicts a crossing that is open; a manipulated odometer at zero would never close it."""
        wheels = {Input.ODOMETER_SPEED: self.track.newest_ns}
        limit_s = self.settings.stale_after_s
        if absent(wheels, time_ns, limit_s, never=Code.NO_INPUT, silent=Code.INPUT_SILENT) is not None:
            return explain(Code.CROSSING_WITHOUT_WHEELS, since_ns=since_ns)
        moved = self.carried.movement(time_ns)
        if moved is not None and not moved.turns_agree:
            return explain(Code.CROSSING_TURNS, turn_deg=degrees(moved.turn_difference))
        open_s = (time_ns - since_ns) / SECOND_NS
        if open_s > LONG_CROSSING_S:
            return explain(Code.CROSSING_LONG, open_s=open_s, limit_s=LONG_CROSSING_S)
        return None

    def _missing(self, time_ns: int, limit_s: float) -> Explanation | None:
        """Why the two speeds cannot be compared now."""
        if self.crossing_since_ns is not None:
            return explain(Code.CROSSING, since_ns=self.crossing_since_ns)
        gnss, odometer = {Input.GNSS_SPEED: self.speed_ns}, {Input.ODOMETER_SPEED: self.track.newest_ns}
        silent = Code.INPUT_SILENT if self.held.since_ns is None else Code.SPEED_REPEATED
        return absent(gnss, time_ns, limit_s, never=Code.NO_INPUT, silent=silent) or absent(
            odometer, time_ns, limit_s, never=Code.NO_INPUT, silent=Code.INPUT_SILENT
        )

    def _over_window(
        self, window: SpeedWindow, missing: Explanation | None, mean: Callable[[], float], code: Code, **values: float
    ) -> Test:
        missing = missing or _warming(window)
        value = 0.0 if missing is not None else mean()
        why = missing or explain(code, **values)
        base = _test(why, "m/s", WINDOW_S, suspect_since_ns=window.suspect_since_ns)
        return base if missing is not None else judged(base, value, THRESHOLD_M_S)

    def _event(self, missing: Explanation | None) -> Test:
        window = self.raw
        missing = missing or _warming(window)
        why = missing or explain(Code.EVENT, speed_limit_m_s=THRESHOLD_M_S)
        base = _test(why, "s", WINDOW_S, suspect_since_ns=window.suspect_since_ns)
        return base if missing is not None else judged(base, window.exceeded_s, EVENT_S)

    def _distance(self) -> Test:
        if self.distance.compared is None:
            return _test(explain(Code.NO_DISTANCE), "m", DISTANCE_PERIOD_S)
        distance_m, limit_m, start_ns, _ = self.distance.compared
        return judged(
            _test(explain(Code.DISTANCE), "m", DISTANCE_PERIOD_S, suspect_since_ns=start_ns), distance_m, limit_m
        )

    def _motion_sensor(self, time_ns: int, missing: Explanation | None) -> Test:
        total_s, limit_s = self.motion_sensor.contradiction_s(time_ns), self.settings.motion_sensor_s
        why = missing or explain(Code.ODOMETER_STANDS)
        since_ns = self.motion_sensor.suspect_since_ns
        base = _test(why, "s", MOTION_SENSOR_WINDOW_S, accused=(ODOMETER,), suspect_since_ns=since_ns)
        return base if missing is not None else judged(base, total_s, limit_s)

    def _calibrated(self, missing: Explanation | None) -> Test:
        known = self.calibration.calibration
        window = self.compensated
        test = self._over_window(
            window, missing, window.trimmed_mean, Code.CALIBRATED, scale_ratio=known.scale, delay_s=known.delay_s
        )
        if missing is None and not known.learned:
            why = explain(Code.SCALE_UNKNOWN, sd_share=known.scale_sd)
            return replace(test, outcome=Outcome.NOT_EVALUATED, why=why)
        return test

    def _scale_limit(self, limit: float, recent: RecentScale) -> float:
        return limit - float(ndtri(self.settings.scale_false_alarm_rate / 2.0)) * recent.scale_sd

    def _scale_step(self, missing: Explanation | None) -> Test:
        rate, recent = self.settings.scale_false_alarm_rate, self.calibration.recent()
        if missing is not None or recent is None:
            return _test(missing or explain(Code.SCALE_NOT_LEARNED), "-", STEP_WINDOW_S, rate)
        step, limit = abs(recent.scale / recent.reference - 1.0), self._scale_limit(STEP_LIMIT, recent)
        why = explain(Code.SCALE_STEP, scale_ratio=recent.scale, reference_ratio=recent.reference)
        return judged(_test(why, "-", STEP_WINDOW_S, rate, suspect_since_ns=recent.oldest_ns), step, limit)

    def _scale_range(self, missing: Explanation | None) -> Test:
        rate, recent = self.settings.scale_false_alarm_rate, self.calibration.recent()
        if missing is not None or recent is None:
            return _test(missing or explain(Code.SCALE_NOT_LEARNED), "-", STEP_WINDOW_S, rate)
        deviation, limit = abs(recent.scale - 1.0), self._scale_limit(SCALE_LIMIT, recent)
        why = explain(Code.SCALE_RANGE, scale_ratio=recent.scale)
        return judged(_test(why, "-", STEP_WINDOW_S, rate, suspect_since_ns=recent.oldest_ns), deviation, limit)

    def _held_speed(self, time_ns: int) -> Test:
        if self.gnss_ns is None or time_ns - self.gnss_ns > self.settings.stale_after_s * SECOND_NS:
            return _test(explain(Code.NO_EPOCH), "s", USUAL_HOLD_S)
        duration_s = self.held.held_s if self.held.since_ns is not None else 0.0
        base = _test(explain(Code.HELD_SPEED), "s", USUAL_HOLD_S, accused=(GNSS,), suspect_since_ns=self.held.since_ns)
        return judged(base, duration_s, USUAL_HOLD_S)

    def _fast(self, time_ns: int) -> Test:
        statistic, rate = self._fast_statistic(time_ns), self.settings.fast_false_alarm_rate
        if isinstance(statistic, Explanation):
            return _test(statistic, "-", fast.WINDOW_S, rate)
        base = _test(explain(Code.FAST), "-", fast.WINDOW_S, rate, suspect_since_ns=self.inconspicuous_ns)
        return judged(base, statistic, self._fast_limit)

    def _fast_statistic(self, time_ns: int) -> float | Explanation:
        """Statistic of the fast test, or why there is none."""
        limit_s, known = self.settings.fast_stale_after_s, self.calibration.calibration
        missing = self._missing(time_ns, limit_s)
        if missing is not None:
            return missing
        if known.delay_sd_s > LEARNED_DELAY_SD_S:
            return explain(Code.DELAY_UNKNOWN, sd_s=known.delay_sd_s)
        if self.fast_statistic is None or time_ns - self.fast_statistic[0] > limit_s * SECOND_NS:
            return explain(Code.FEW_PAIRS, least_count=fast.MIN_SAMPLES)
        return self.fast_statistic[1]


def _test(
    why: Explanation, unit: str, window_s: float, false_alarm_rate: float | None = None, *,
    accused: tuple[str, ...] = EITHER_SOURCE, suspect_since_ns: int | None = None,
) -> Test:  # fmt: skip
    """A test that has no result yet."""
    return Test(
        Outcome.NOT_EVALUATED, why, unit, false_alarm_rate=false_alarm_rate, window_s=window_s, accused=accused,
        suspect_since_ns=suspect_since_ns,
    )  # fmt: skip


def _warming(window: SpeedWindow) -> Explanation | None:
    """Why a window has no result, None of a complete one."""
    if window.complete:
        return None
    code = Code.WARMING_UP_MOVING if window.mode is WindowMode.MOVING else Code.WARMING_UP
    return explain(code, samples_count=len(window.differences), needed_count=SAMPLES)

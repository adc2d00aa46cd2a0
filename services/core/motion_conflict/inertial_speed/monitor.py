"""Accuses GNSS and odometer if both are scaled alike, by the centripetal speed of the inertial sensors in bends."""

from collections import Counter, deque
from collections.abc import Sequence

from shared.inertial.increments import SECOND_NS, Decimator, Increment
from shared.maths.rotation import Vector
from shared.messages.explanation import Explanation, explain
from shared.messages.trust import Outcome
from shared.trust.accused import GNSS, IMU, ODOMETER
from shared.trust.inputs import Input, absent
from shared.trust.result import Test, lasting

from ..codes import Code
from .bend_fit import ARM_SD, Arm
from .bends import Bend, BendRecorder, Geometry
from .levelling import Levelling
from .scale_change import FALSE_ALARM_RATE, LIMIT, MIN_BENDS, SHARED_CHANGE, Change, ScaleChange

LARGEST_FORCE_M_S2, LARGEST_RATE_RAD_S = 80.0, 20.0  # of each axis, as in core.spoofing: beyond every vehicle's motion
SPEED_TIMEOUT_NS = 4 * SECOND_NS  # for a speed that covers an increment; odometers are up to 3 s late
MAX_WAITING = 100  # increments, 10 s between two verdicts
SILENCE_TIMEOUT_S = 5.0  # without inertial samples or speeds
STALE_AFTER_NS = 600 * SECOND_NS  # since the last bend: a motorway has none for so long
RESTART_NS = 5 * SECOND_NS  # by which a stamp is earlier than the newest one where a time line starts again


def geometry_of(rear_axle_body_m: Vector | None, antenna_body_m: Vector) -> Geometry:
    """IMU and antenna relative to the rear axle, from lever arms of the IMU [m, body: forward, right, down]."""
    if rear_axle_body_m is None:
        return Geometry()
    forward, right, _ = rear_axle_body_m
    return Geometry(
        Arm(-forward, -right, ARM_SD, ARM_SD), antenna_body_m[0] - forward, antenna_body_m[1] - right
    )  # fmt: skip


class InertialSpeed:
    """Takes inertial samples and speeds, and tests the scale of the speeds."""

    def __init__(
        self, *, geometry: Geometry | None = None, common_sd: float = 0.02, rejected: Counter[str] | None = None
    ) -> None:
        self.rejected: Counter[str] = Counter() if rejected is None else rejected
        self._geometry = geometry or Geometry()
        self.change = ScaleChange(common_sd)
        self.bends: deque[Bend] = deque(maxlen=256)  # of this drive, newest last
        self._known: Test | None = None
        self._start()

    def _start(self) -> None:
        self._decimator = Decimator(LARGEST_FORCE_M_S2, LARGEST_RATE_RAD_S, self.rejected)
        self._levelling, self._recorder = Levelling(), BendRecorder(self._geometry)
        self._pending: deque[Increment] = deque(maxlen=MAX_WAITING)
        self._imu_ns: int | None = None

    def inertial(self, times_ns: Sequence[int], forces_b: Sequence[Vector], rates_b: Sequence[Vector]) -> None:
        """Use a batch of samples [m/s², rad/s; body]."""
        if self._imu_ns is not None and self._imu_ns - times_ns[-1] > RESTART_NS:
            self.rejected["imu: time line started again"] += 1
            self._start()
        self._imu_ns = max(times_ns[-1], self._imu_ns or times_ns[-1])
        if self._decimator.add(times_ns, forces_b, rates_b) > MAX_WAITING:
            self.advance()

    def gnss(self, time_ns: int, speed: float, sd: float) -> None:
        """Use a GNSS speed and its standard deviation [m/s] at its true time."""
        self._recorder.gnss.add(time_ns, speed, sd)

    def odometer(self, time_ns: int, speed: float) -> None:
        """Use an odometer speed [m/s] at its true time."""
        self._recorder.odometer.add(time_ns, speed, 0.0)

    def advance(self) -> None:
        """Use what has been received, up to the newest speed."""
        self._pending.extend(self._decimator.take())
        recorder = self._recorder
        while self._pending:
            increment = self._pending[0]
            speed = recorder.gnss.at(increment.end_ns)
            waited_ns = self._pending[-1].end_ns - increment.end_ns
            if waited_ns < SPEED_TIMEOUT_NS and (speed is None or not self._odometer_reaches(increment.end_ns)):
                return
            self._pending.popleft()
            self._use(increment, speed)

    def _odometer_reaches(self, time_ns: int) -> bool:
        newest_ns = self._recorder.odometer.newest_ns
        return newest_ns is None or newest_ns >= time_ns

    def _use(self, increment: Increment, known: tuple[float, float] | None) -> None:
        speed, acceleration = (None, None) if known is None else known
        levelled = self._levelling.step(increment, speed, acceleration)
        if levelled is None:
            return
        for bend in self._recorder.add(levelled, speed):
            self.bends.append(bend)
            self.change.add(bend)

    def verdict(self, time_ns: int) -> Test:
        """Test the scale at a time."""
        self.advance()
        self._known = lasting(self._tested(time_ns), self._known, time_ns)
        return self._known

    def _tested(self, time_ns: int) -> Test:
        change = self.change.change
        if change is not None and self.change.accusing:
            return self._judged(change)
        missing = self._missing(time_ns)
        if missing is None and change is not None:
            return self._judged(change)
        few = explain(Code.FEW_BENDS, bends_count=len(self.change.window), needed_count=MIN_BENDS)
        return Test(Outcome.NOT_EVALUATED, missing or few, false_alarm_rate=FALSE_ALARM_RATE)

    def _missing(self, time_ns: int) -> Explanation | None:
        """Why the scale cannot be judged now."""
        newest_ns = {Input.INERTIAL_SAMPLES: self._imu_ns, Input.GNSS_SPEED: self._recorder.gnss.newest_ns}
        missing = absent(newest_ns, time_ns, SILENCE_TIMEOUT_S, never=Code.NO_INPUT, silent=Code.INPUT_SILENT)
        if missing is not None:
            return missing
        if not self._levelling.ready:
            return explain(Code.NO_STANDSTILL)
        if self.bends and time_ns - self.bends[-1].end_ns > STALE_AFTER_NS:
            return explain(Code.NO_BEND, age_s=round((time_ns - self.bends[-1].end_ns) / SECOND_NS))
        return None

    def _judged(self, change: Change) -> Test:
        accusing, limit = self.change.accusing, LIMIT * change.sd
        why = explain(
            _found(change, accusing=accusing), difference_share=change.difference, sd_share=change.sd,
            bends_count=change.bends,
        )  # fmt: skip
        window = list(self.change.window)[-change.bends :]
        return Test(
            Outcome.ACCUSES if accusing else Outcome.PASS, why, statistic=abs(change.difference), threshold=limit,
            false_alarm_rate=FALSE_ALARM_RATE, window_s=(window[-1].end_ns - window[0].start_ns) / SECOND_NS,
            accused=_falsified(change), suspect_since_ns=change.suspect_since_ns,
        )  # fmt: skip


def _found(change: Change, *, accusing: bool) -> Code:
    """What the bends show; an accusation outlasts the change that it was made for."""
    if not accusing:
        return Code.SCALE_OF_GNSS if change.odometer is None else Code.SCALE_OF_BOTH
    if change.size <= LIMIT:
        return Code.SCALED_BEFORE
    if ODOMETER in _falsified(change):
        return Code.BOTH_SCALED
    return Code.GNSS_OR_IMU_SCALED if change.odometer is None else Code.GNSS_SCALED


def _falsified(change: Change) -> tuple[str, ...]:
    """Who is at fault: both speeds if the odometer shows the change too, GNSS if it agrees with the inertial sensors.

    Without an odometer one difference says the same of GNSS and of the inertial sensors.
    """
    if change.odometer is None:
        return (GNSS, IMU)
    return (GNSS, ODOMETER) if change.odometer * change.difference > SHARED_CHANGE * change.difference**2 else (GNSS,)

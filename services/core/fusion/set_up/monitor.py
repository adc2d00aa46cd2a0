"""All checks of the set-up, once in ten seconds; a finding holds until a later evaluation contradicts it."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import hypot
from typing import NamedTuple

from shared.maths.rotation import Vector
from shared.messages.explanation import explain

from ..aids.base import Measurement
from ..codes import Code, Direction
from ..integrity.set_up_spread import CheckDifference, SetUpSpread
from ..settings import Settings
from . import axes, receiver
from .delay import check_delay, lag_of, lag_of_positions
from .findings import Check, Verdict
from .motion import Motion, MotionLog, Velocities, intervals_of
from .odometer import check_odometer_scale

PERIOD_NS = 10_000_000_000
MIN_VELOCITIES = 20
DELAYS = "gnss_delay", "gnss_velocity_delay"  # checks
BESIDE_VELOCITY_S = 0.05  # standard deviation of the delay of positions, where that of velocities is known alone


class ArmError(NamedTuple):
    """Error of the lever arm [m, forward and right] by the filter's innovations, and whether it is significant."""

    error: tuple[float, float]
    sds: float
    wrong: bool


class SetUpMonitor:
    """Collects motion, and evaluates the checks.

    Parameters
    ----------
    settings : Settings
        Of the filter: lever arm, delays, scale and priors that the checks refer to.
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._log = MotionLog()
        self._due_ns: int | None = None
        self._suspects: dict[str, Verdict] = {}  # verdict of the last evaluation
        self.checks: dict[str, tuple[Check, int]] = {}  # newest known result of each, and since when its verdict holds

    def samples(self, stamps_ns: Sequence[int], forces: Sequence[Vector], rates: Sequence[Vector]) -> None:
        """Take the next inertial samples [m/s², rad/s; body]."""
        self._log.samples(stamps_ns, forces, rates)

    def see(self, measurement: Measurement) -> None:
        """Take a position, velocity or speed."""
        self._log.see(measurement)

    def is_due(self, time_ns: int) -> bool:
        """Whether an evaluation is due at a stamp of the samples."""
        self._due_ns = time_ns + PERIOD_NS if self._due_ns is None else self._due_ns
        return time_ns >= self._due_ns

    def evaluate(self, time_ns: int, arm: ArmError | None) -> None:
        """Evaluate all checks."""
        self._due_ns = time_ns + PERIOD_NS
        motion = self._log.motion()
        if motion is None:
            return
        for check in evaluate(self._settings, motion, arm, delay_known=self.delay_known):
            self._adopt(check, time_ns)
        if any(self.delays) and self.checks["lever_arm"][0].verdict is not Verdict.UNKNOWN:
            self.checks["lever_arm"] = Check("lever_arm"), time_ns  # it was of late fixes

    @property
    def turn(self) -> tuple[float, float] | None:
        """Turn of the vehicle's axes against the published ones about the axis down, and its 1 σ [rad], if found."""
        return next((c.turn for c in self._known("imu_axes", "imu_mounting") if c.verdict is Verdict.CONTRADICTS), None)

    @property
    def heights_wrong(self) -> bool:
        """Whether heights of GNSS have the wrong sign."""
        return any(check.verdict is Verdict.CONTRADICTS for check in self._known("gnss_height"))

    @property
    def height_known(self) -> bool:
        """Whether it has been seen which way heights of GNSS count."""
        return bool(self._known("gnss_height"))

    @property
    def delay_known(self) -> bool:
        """Whether stamps are known to agree with the settings, so that what turns show is of the lever arm."""
        return self._agreed(*DELAYS) is not None

    @property
    def delays(self) -> tuple[float, float]:
        """Delays [s] of positions and of velocities that contradict the settings; 0 where none does."""
        found = [
            check.statistic or 0.0 if check.verdict is Verdict.CONTRADICTS else 0.0 for check in self._known(*DELAYS)
        ] or [0.0]
        return found[0], found[-1]

    def spread(self, corrected_s: float | None = None) -> SetUpSpread:
        """What lever arm and delay may be off by: as assumed, until their checks agree or the delay is corrected.

        Parameters
        ----------
        corrected_s : float, optional
            [s] Delay of positions that the filter corrects beyond the settings.
        """
        spread = SetUpSpread.of(self._settings, self._agreed("lever_arm"), self._agreed(*DELAYS))
        if corrected_s is None:
            return spread
        found = next((check for check in self._known(*DELAYS) if check.verdict is Verdict.CONTRADICTS), None)
        if found is None or found.statistic is None or found.sd is None:
            return spread
        beside_s = 0.0 if found.name == DELAYS[0] else BESIDE_VELOCITY_S
        return replace(spread, delay_s=hypot(found.statistic - corrected_s, found.sd, beside_s))

    def _known(self, *names: str) -> list[Check]:
        """Checks of some names that are not unknown, in that order."""
        known = (self.checks[name][0] for name in names if name in self.checks)
        return [check for check in known if check.verdict is not Verdict.UNKNOWN]

    def _agreed(self, *names: str) -> CheckDifference | None:
        """Error and standard deviation by the first of some checks that is known, if it agrees."""
        first = next(iter(self._known(*names)), Check(names[0]))
        if first.verdict is not Verdict.AGREES or first.statistic is None or first.sd is None:
            return None
        return CheckDifference(first.statistic, first.sd)

    def _adopt(self, check: Check, time_ns: int) -> None:
        """Keep what is known: a finding needs two evaluations in a row, and ignorance replaces nothing."""
        last, self._suspects[check.name] = self._suspects.get(check.name), check.verdict
        known = self.checks.get(check.name)
        if known is None:
            known = self.checks[check.name] = (Check(check.name), time_ns)
        if check.verdict is Verdict.UNKNOWN or (check.verdict is Verdict.CONTRADICTS and last is not check.verdict):
            return
        since_ns = known[1] if known[0].verdict is check.verdict else time_ns
        self.checks[check.name] = (check, since_ns)


def evaluate(
    settings: Settings, motion: Motion, arm: ArmError | None = None, *, delay_known: bool = False
) -> Iterator[Check]:
    """Evaluate all checks on one window of motion; later ones rest on what the earlier ones have found.

    Parameters
    ----------
    settings : Settings
        Of the filter.
    motion : Motion
        Of the window.
    arm : ArmError, optional
        By the innovations of the filter.
    delay_known : bool
        Whether the delay has agreed with the settings before: while it is open, a late fix looks in turns like an
        antenna that is elsewhere.
    """
    by_receiver, by_positions = motion.of_receiver(), motion.of_positions()
    same = receiver.check_velocity_axes(motion)
    has_velocity = len(by_receiver.begin) >= MIN_VELOCITIES
    delays = tuple(_delays(settings, motion, by_receiver if has_velocity else None, by_positions))
    chosen, delay = by_positions, delays[0]
    if has_velocity and same.verdict is not Verdict.CONTRADICTS:
        chosen, delay = by_receiver, delays[1]
    late = delay.verdict is Verdict.CONTRADICTS
    lag_s = delay.statistic if late and delay.statistic is not None else 0.0
    intervals = intervals_of(motion, chosen, lag_s) if len(chosen.begin) >= MIN_VELOCITIES else None
    fit = axes.fit_axes(motion, intervals, settings.vehicle.imu.body_from_sensor)
    of_imu = (
        axes.check_accelerometer_scale(fit),
        axes.check_upright(fit),
        axes.check_axes(fit),
        axes.check_mounting(fit, 3.0 * settings.non_holonomic.mounting_sd_rad),
        axes.check_gyroscope(fit),
        axes.check_gyroscope_bias(fit, settings.imu.gyroscope_bias_sd_rad_s),
    )
    yield from of_imu
    yield same
    yield from receiver.check_vertical(motion, intervals, axes.forward_of(fit))
    yield from delays
    yield check_odometer_scale(motion, chosen, settings.odometer.scale)
    delay_open = not delay_known and delay.verdict is not Verdict.AGREES
    misled = delay_open or any(check.verdict is Verdict.CONTRADICTS for check in (*of_imu, same, *delays))
    yield Check("lever_arm") if misled or arm is None else check_arm(settings, arm)


def _delays(
    settings: Settings, motion: Motion, by_receiver: Velocities | None, by_positions: Velocities
) -> Iterator[Check]:
    """Compare the stamps of positions, and of velocities, with the inertial sensors."""
    gnss = settings.gnss
    enough = len(by_positions.begin) >= MIN_VELOCITIES
    key = "core.fusion.gnss.delay_s", gnss.delay_s
    position = None
    if enough:  # velocities of a receiver tell the delay better than positions twice as far apart
        lag = lag_of(motion, by_positions) if by_receiver is not None else lag_of_positions(motion)
        position = check_delay("gnss_delay", "position", lag, key)
    yield position or Check("gnss_delay")
    late_s = position.statistic if position is not None and position.verdict is Verdict.CONTRADICTS else None
    if by_receiver is None:
        yield Check("gnss_velocity_delay")
        return
    if position is not None and position.verdict is not Verdict.UNKNOWN:
        key = "core.fusion.gnss.velocity_delay_s", gnss.velocity_delay_s - (late_s or 0.0)
    yield check_delay("gnss_velocity_delay", "velocity", lag_of(motion, by_receiver), key)


def check_arm(settings: Settings, arm: ArmError) -> Check:
    """Put the filter's own comparison of the antenna with its prediction in turns into a finding."""
    forward, right = arm.error
    x, y, z = settings.vehicle.gnss.lever_arm_body_m
    size = (forward**2 + right**2) ** 0.5
    values = size, size / max(arm.sds, 1e-9), 0.0, 0.5, "m"
    if arm.wrong:
        setting = f"vehicle.gnss.lever_arm_body_m = [{x + forward:.2f}, {y + right:.2f}, {z:.2f}]"
        why = explain(
            Code.LEVER_ARM_WRONG, along_m=abs(forward), across_m=abs(right),
            along=Direction.FORWARD if forward > 0.0 else Direction.BACKWARD,
            across=Direction.RIGHT if right > 0.0 else Direction.LEFT,
        )  # fmt: skip
        return Check("lever_arm", Verdict.CONTRADICTS, why, *values, setting)
    if arm.sds > 0.0 and size / arm.sds < 0.2 and size < 0.5:
        return Check("lever_arm", Verdict.AGREES, explain(Code.LEVER_ARM_AGREES), *values)
    return Check("lever_arm")

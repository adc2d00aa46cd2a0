"""Compares the speeds of GNSS and odometer as the smart tachograph does, faster, and both with inertial sensors."""

from collections import Counter
from collections.abc import Iterator
from math import hypot

from pydantic import ValidationInfo, model_validator

from shared.chosen import ChosenSource, gnss_choice, imu_choice, speed_choice
from shared.messages.base import Tick
from shared.messages.gnss import FixType, GnssFix
from shared.messages.imu import ImuSamples
from shared.messages.operation import Crossing, HostClock, ModeState
from shared.messages.tachograph import TachographEvent, TachographRecords
from shared.messages.trust import LearnedScale, TrustLevel, TrustMonitor, TrustState
from shared.messages.vehicle import VehicleSpeed
from shared.runtime.config import VehicleFile, vehicle_in
from shared.trust.result import statement

from .calibration import LEARNED_DELAY_SD_S
from .inertial_speed.monitor import InertialSpeed, geometry_of
from .inertial_speed.scale_change import MIN_BENDS, BendScale
from .monitor import MotionMonitor
from .settings import Settings
from .statements import statements
from .tachograph_events.recorder import TachographRecorder

In = (
    ImuSamples | GnssFix | VehicleSpeed | TrustState | LearnedScale | ModeState | Crossing | HostClock
    | TachographRecords | Tick
)  # fmt: skip
Out = TrustMonitor | LearnedScale | TachographEvent | TachographRecords
# Fixes whose velocity is measured by satellites; dead reckoning of a receiver may come from the same wheels.
MEASURED = (FixType.TWO_D, FixType.THREE_D, FixType.GNSS_DEAD_RECKONING)
# Learning stops while the position is in doubt: a spoofed speed must not become the odometer's scale.
NO_LEARNING = (TrustLevel.UNSAFE, TrustLevel.DEAD_RECKONING, TrustLevel.NO_FIX)
SECOND_NS = 1_000_000_000
OWN = ("motion", "motion_fast", "coherent_scale")  # statements, which accuse GNSS or the odometer for a change of scale


class Config(Settings):
    """Settings of core.motion_conflict."""

    @model_validator(mode="before")
    @classmethod
    def _as_fusion(cls, given: object, info: ValidationInfo) -> object:
        """Use the delay of core.fusion; an odometer that fusion may not use is not compared either."""
        vehicle = vehicle_in(info.context)
        if not isinstance(given, dict) or vehicle is None:
            return given
        odometer = vehicle.tables.get("core.fusion", {}).get("odometer", {})
        disabled = isinstance(odometer, dict) and odometer.get("enabled") is False
        return _delay_of_fusion(vehicle) | ({"odometer": False} if disabled else {}) | given


def _delay_of_fusion(vehicle: VehicleFile) -> dict[str, object]:
    """Age of a GNSS velocity at its stamp, from the section of core.fusion."""
    gnss = vehicle.tables.get("core.fusion", {}).get("gnss", {})
    delays = [gnss.get(key) for key in ("delay_s", "velocity_delay_s")] if isinstance(gnss, dict) else []
    known = [delay for delay in delays if isinstance(delay, int | float)]
    return {"velocity_delay_s": sum(known)} if known else {}


class Process:
    """Publishes the statements `motion`, `motion_fast` and `coherent_scale` once a second, and what bends teach."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._monitor = MotionMonitor(config)
        facts = config.vehicle
        self.inertial = InertialSpeed(
            geometry=geometry_of(facts.rear_axle_body_m, facts.gnss.lever_arm_body_m),
            common_sd=config.inertial_scale_sd, rejected=self._monitor.rejected,
        )  # fmt: skip
        self._newest_ns, self._odometer = 0, config.odometer
        self._speed, self._imu, self._fix = (
            ChosenSource(function) for function in (speed_choice, imu_choice, gnss_choice)
        )
        self._imu_source = ""  # of the newest samples
        self._earlier: LearnedScale | None = None  # of an earlier drive, until the first inertial sample
        self._tachograph = TachographRecorder()
        self._taught = 0  # bends in what was published

    @property
    def rejects(self) -> Counter[str]:
        """Rejected speeds by reason."""
        return self._monitor.rejected

    def handle(self, message: In) -> Iterator[Out]:
        """Use a speed; publish with each tick."""
        match message:
            case ImuSamples() if self._imu.takes(message.source, message.received_ns):
                self._use_samples(message)
            case ModeState():
                for chosen in (self._speed, self._imu, self._fix):
                    chosen.follow(message)
            case GnssFix() if self._fix.takes(message.source, message.received_ns):
                self._newest_ns = max(self._newest_ns, message.sampled_ns)
                self._use_fix(message)
            case VehicleSpeed() if self._odometer and self._speed.takes(message.source, message.received_ns):
                self._newest_ns = max(self._newest_ns, message.sampled_ns)
                self._use_odometer(message)
            case TrustState():
                self._tachograph.trust(message)
                self._monitor.calibration.frozen = self.inertial.change.frozen = forbids_learning(message)
            case Crossing() | HostClock() | TachographRecords():
                self._follow(message)
            case LearnedScale() if not self._imu_source:  # later ones are its own
                self._earlier = message
            case Tick():
                time_ns = max(self._newest_ns, message.now_ns)
                verdicts = self._monitor.verdicts(time_ns)
                yield from statements(verdicts, time_ns)
                yield from self._tachograph.events(verdicts, self._monitor.raw.exceeded_s, time_ns)
                yield statement("coherent_scale", self.inertial.verdict(time_ns), time_ns)
                yield from self._lesson(time_ns)

    def _follow(self, message: Crossing | HostClock | TachographRecords) -> None:
        if isinstance(message, Crossing):
            since_ns = message.since_ns if message.is_open else None
            self._monitor.cross(max(self._newest_ns, message.sampled_ns), since_ns)
        else:
            self._tachograph.follow(message)

    def _lesson(self, time_ns: int) -> Iterator[LearnedScale]:
        """What the bends of this vehicle have taught, once for every five of them."""
        learned = self.inertial.change.lesson()
        if learned is None or learned.bends < self._taught + MIN_BENDS:
            return
        self._taught = learned.bends
        yield LearnedScale(
            sampled_ns=time_ns, imu=self._imu_source, bends=learned.bends, gnss=learned.mean, gnss_sd=learned.sd,
            odometer=learned.odometer, spread=learned.spread,
        )  # fmt: skip

    def _adopt(self, source: str) -> None:
        """Begin with what an earlier drive has taught, if it had the same inertial sensors."""
        earlier, self._imu_source = self._earlier, source
        if earlier is None:
            return
        if earlier.imu != source:
            self.rejects["learned scale of another IMU"] += 1
            return
        self._taught = earlier.bends
        self.inertial.change.adopt(
            BendScale(earlier.gnss, earlier.gnss_sd, earlier.odometer, earlier.bends, earlier.spread)
        )  # fmt: skip

    def _use_samples(self, batch: ImuSamples) -> None:
        if not self._imu_source:
            self._adopt(batch.source)
        if batch.saturated:
            self.rejects["imu: saturated"] += 1
            return
        self.inertial.inertial(batch.sampled_ns, batch.specific_force_body_m_s2, batch.angular_rate_body_rad_s)
        for time_ns, rate in zip(batch.sampled_ns, batch.angular_rate_body_rad_s, strict=True):
            self._monitor.carried.gyroscope(time_ns, rate[2])

    def _use_odometer(self, message: VehicleSpeed) -> None:
        """Use a speed; its delay against GNSS has to be known before it is compared in bends."""
        if not self._monitor.odometer(message.sampled_ns, message.speed_m_s, message.resolution_m_s):
            return
        if message.speed_m_s is not None:
            self._monitor.carried.wheels(message.sampled_ns, message.speed_m_s)
            self._tachograph.conditions.speed(message.sampled_ns, message.speed_m_s)
        known = self._monitor.calibration.calibration
        if message.speed_m_s is not None and known.delay_sd_s <= LEARNED_DELAY_SD_S:
            late_ns = round((known.delay_s + self._config.velocity_delay_s) * SECOND_NS)
            self.inertial.odometer(message.sampled_ns - late_ns, message.speed_m_s)

    def _use_fix(self, fix: GnssFix) -> None:
        """Use the horizontal speed; without velocity, or without satellites, there is no speed, and no standstill."""
        if fix.fix_type not in MEASURED:
            self._monitor.gnss(fix.sampled_ns, None)
            return
        speed, sd = fix.ground_speed_m_s, None
        if fix.velocity_ned_m_s is not None:
            speed = hypot(*fix.velocity_ned_m_s[:2])
        if fix.velocity_sd_ned_m_s is not None:
            sd = max(fix.velocity_sd_ned_m_s[:2]) or None
        self._monitor.carried.gnss(fix.sampled_ns, fix.velocity_ned_m_s)
        if self._monitor.crossing_since_ns is not None:
            speed = sd = None  # a ferry's: it is not compared with the wheels
        if self._monitor.gnss(fix.sampled_ns, speed, sd) and speed is not None:
            true_ns = fix.sampled_ns - round(self._config.velocity_delay_s * SECOND_NS)
            self.inertial.gnss(true_ns, speed, max(self._config.gnss_sd_floor_m_s, sd or self._config.gnss_sd_m_s))
        if fix.latitude_deg is not None and fix.longitude_deg is not None:
            self._tachograph.conditions.position(fix.sampled_ns, fix.utc_ns)
            self._monitor.position(fix.sampled_ns, fix.latitude_deg, fix.longitude_deg)


def forbids_learning(verdict: TrustState) -> bool:
    """Whether a speed may be wrong: the state says so, the odometer is excluded, or another monitor accuses GNSS.

    CAUTION for want of an evaluation does not forbid it: a unit without raw measurements would never learn.
    """
    gnss_accused = any("gnss" in monitor.accused for monitor in verdict.monitors if monitor.monitor not in OWN)
    return verdict.state in NO_LEARNING or verdict.gnss_excluded or verdict.odometer_excluded or gnss_accused

"""Compares the speeds of GNSS and odometer as the smart tachograph does, and faster."""

from collections import Counter
from collections.abc import Iterator
from math import hypot

from pydantic import ValidationInfo, model_validator

from shared.chosen import ChosenSource
from shared.messages.base import Tick
from shared.messages.gnss import FixType, GnssFix
from shared.messages.trust import TrustLevel, TrustMonitor, TrustState
from shared.messages.vehicle import VehicleSpeed
from shared.runtime.config import vehicle_in

from .monitor import MotionMonitor
from .settings import Settings
from .statements import statements

In = GnssFix | VehicleSpeed | TrustState | Tick
# Fixes whose velocity is measured by satellites; dead reckoning of a receiver may come from the same wheels.
MEASURED = (FixType.TWO_D, FixType.THREE_D, FixType.GNSS_DEAD_RECKONING)
# Learning stops while the position is in doubt: a spoofed speed must not become the odometer's scale.
NO_LEARNING = (TrustLevel.UNSAFE, TrustLevel.DEAD_RECKONING, TrustLevel.NO_FIX)
OWN = ("motion", "motion_fast")  # statements, which accuse GNSS or the odometer for a change of scale


class Config(Settings):
    """Settings of core.motion_conflict."""

    @model_validator(mode="before")
    @classmethod
    def _as_fusion(cls, given: object, info: ValidationInfo) -> object:
        """An odometer that the vehicle's file does not let fusion use is not compared either."""
        vehicle = vehicle_in(info.context)
        if not isinstance(given, dict) or vehicle is None:
            return given
        odometer = vehicle.tables.get("core.fusion", {}).get("odometer", {})
        disabled = isinstance(odometer, dict) and odometer.get("enabled") is False
        return {"odometer": False, **given} if disabled else given


class Process:
    """Publishes the statements `motion` and `motion_fast` once a second."""

    def __init__(self, config: Config) -> None:
        self._monitor = MotionMonitor(config)
        self._newest_ns, self._odometer = 0, config.odometer
        self._speed = ChosenSource()

    @property
    def rejects(self) -> Counter[str]:
        """Rejected speeds by reason."""
        return self._monitor.rejected

    def handle(self, message: In) -> Iterator[TrustMonitor]:
        """Use a speed; publish with each tick."""
        match message:
            case GnssFix():
                self._newest_ns = max(self._newest_ns, message.sampled_ns)
                self._use_fix(message)
            case VehicleSpeed() if self._odometer and self._speed.takes(message.source, message.received_ns):
                self._newest_ns = max(self._newest_ns, message.sampled_ns)
                self._monitor.odometer(message.sampled_ns, message.speed_m_s, message.resolution_m_s)
            case TrustState():
                self._monitor.calibration.frozen = forbids_learning(message)
            case Tick():
                time_ns = max(self._newest_ns, message.now_ns)
                yield from statements(self._monitor.verdicts(time_ns), time_ns)

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
        self._monitor.gnss(fix.sampled_ns, speed, sd)
        if fix.latitude_deg is not None and fix.longitude_deg is not None:
            self._monitor.position(fix.sampled_ns, fix.latitude_deg, fix.longitude_deg)


def forbids_learning(verdict: TrustState) -> bool:
    """Whether a speed may be wrong: the state says so, the odometer is excluded, or another monitor accuses GNSS.

    CAUTION for want of an evaluation does not forbid it: a unit without raw measurements would never learn.
    """
    gnss_accused = any("gnss" in monitor.accused for monitor in verdict.monitors if monitor.monitor not in OWN)
    return verdict.state in NO_LEARNING or verdict.gnss_excluded or verdict.odometer_excluded or gnss_accused

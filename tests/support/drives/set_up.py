"""Inputs of the set-up monitor from a drive, with faults of axes, signs, stamps and scales."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from services.core.fusion.aids.gnss.aid import of_fix
from services.core.fusion.aids.gnss.fix import Reading, Stamp, gnss_measurements
from services.core.fusion.aids.kinds import measurements_of
from services.core.fusion.aids.odometer.aid import WheelSpeed
from services.core.fusion.set_up.findings import Check
from services.core.fusion.set_up.monitor import ArmError, evaluate
from services.core.fusion.set_up.motion import MotionLog
from services.core.fusion.settings import Settings
from services.sensors.simulator.drive import Drive
from shared.maths.earth import Geodetic
from shared.messages.base import Message
from shared.messages.gnss import GnssFix
from shared.messages.imu import ImuSamples
from shared.messages.vehicle import VehicleSpeed, WheelSpeeds

FloatArray = npt.NDArray[np.float64]
HEIGHT_SD = 0.1


class Fix(NamedTuple):
    time_ns: int
    position: FloatArray  # [rad, rad, m]
    velocity: FloatArray | None  # [m/s, NED]; down is NaN where it is not measured


@dataclass(frozen=True)
class RecordedDrive:
    """Samples, fixes and speeds with their stamps."""

    stamps_ns: npt.NDArray[np.int64]
    force: FloatArray
    rate: FloatArray
    fixes: Sequence[Fix]
    speeds: Sequence[tuple[int, float]] = ()


@dataclass(frozen=True)
class Faults:
    """Faults that are applied to a correct recording."""

    axes: tuple[str, str, str] = ("x", "y", "z")  # published axes by those of the vehicle
    gyroscope_axes: tuple[str, str, str] | None = None  # if they differ
    yaw_rad: float = 0.0
    bias_rad_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    height_sign: float = 1.0
    velocity_axes: tuple[str, str, str] = ("x", "y", "z")
    late_s: float = 0.0
    odometer: float = 1.0
    accelerometer: float = 1.0
    arm: ArmError | None = None

    def checks(self, drive: RecordedDrive, settings: Settings | None = None) -> dict[str, Check]:
        """Evaluate all checks on the drive with the faults."""
        settings = settings or Settings()
        c, s = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        skew = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        force = self.accelerometer * drive.force @ (skew @ matrix_of(self.axes)).T
        rate = drive.rate @ (skew @ matrix_of(self.gyroscope_axes or self.axes)).T + np.array(self.bias_rad_s)
        log = MotionLog()
        late_ns = round(self.late_s * 1e9)
        events: list[tuple[int, Fix | float]] = [(fix.time_ns + late_ns, fix) for fix in drive.fixes]
        events += drive.speeds
        events.sort(key=lambda event: event[0])
        place = 0
        for time_ns, f, w in zip(drive.stamps_ns.tolist(), force.tolist(), rate.tolist(), strict=True):
            log.samples((time_ns,), (f,), (w,))
            while place < len(events) and events[place][0] <= time_ns:
                self._show(log, settings, *events[place])
                place += 1
        motion = log.motion()
        assert motion is not None
        return {check.name: check for check in evaluate(settings, motion, self.arm)}

    def _show(self, log: MotionLog, settings: Settings, time_ns: int, event: Fix | float) -> None:
        if not isinstance(event, Fix):
            log.see(WheelSpeed(time_ns, time_ns, "wheels", self.odometer * event, 0.0, True, True, settings))
            return
        latitude, longitude, height = event.position.tolist()
        velocity = None
        if event.velocity is not None:
            axes = 3 if np.isfinite(event.velocity[2]) else 2
            north, east, down = (matrix_of(self.velocity_axes) @ np.nan_to_num(event.velocity)).tolist()
            velocity = Reading((north, east, down), None, axes)
        stamp, still = Stamp(time_ns, time_ns, "gnss"), Reading((0.0, 0.0, 0.0), None)
        position = Geodetic(latitude, longitude, self.height_sign * height)
        for measurement in gnss_measurements(settings, stamp, position, still, velocity):
            log.see(measurement)


def matrix_of(axes: Sequence[str]) -> FloatArray:
    """Signed permutation whose rows are named: ("-y", "x", "z")."""
    unit = dict(zip("xyz", np.eye(3), strict=True))
    return np.array([-unit[name[1]] if name[0] == "-" else unit[name] for name in axes])


def simulated(drive: Drive, *, exact_heights: bool = False) -> RecordedDrive:
    """Take the measurements of a simulated drive, on request with heights of an RTK receiver."""
    rng = np.random.default_rng(7)
    heights = drive.fix_position[:, 2].copy()
    if exact_heights:
        heights += drive.fix_error_n[:, 2] + HEIGHT_SD * rng.standard_normal(len(heights))
    fixes = [
        Fix(int(time_ns), np.array([*drive.fix_position[k, :2], heights[k]]), drive.fix_velocity_n[k])
        for k, time_ns in enumerate(drive.fix_ns)
        if drive.fix_valid[k]
    ]
    speeds = [(int(t), float(v)) for t, v in zip(drive.odometer_ns, drive.odometer, strict=True)]
    return RecordedDrive(drive.t_ns, drive.force_b, drive.rate_b, fixes, speeds)


def recorded(messages: Sequence[Message], settings: Settings) -> RecordedDrive:
    """Take the measurements of a recording."""
    batches = [message for message in messages if isinstance(message, ImuSamples)]
    fixes, speeds = [], []
    for message in messages:
        if isinstance(message, GnssFix):
            seen = {type(measurement).__name__: measurement for measurement in of_fix(message, settings)}
            if (position := seen.get("GnssPosition")) is not None:
                fixes.append(Fix(message.sampled_ns, np.array(position.position), _velocity(seen.get("GnssVelocity"))))  # type: ignore[attr-defined]
        elif isinstance(message, VehicleSpeed | WheelSpeeds):
            found = (
                measurement for measurement in measurements_of(message, settings) if isinstance(measurement, WheelSpeed)
            )
            speeds += [(wheel_speed.time_ns, wheel_speed.speed) for wheel_speed in found]
    return RecordedDrive(
        np.array([t for batch in batches for t in batch.sampled_ns], dtype=np.int64),
        np.array([f for batch in batches for f in batch.specific_force_body_m_s2]),
        np.array([w for batch in batches for w in batch.angular_rate_body_rad_s]),
        fixes,
        speeds,
    )


def _velocity(seen: object) -> FloatArray | None:
    if seen is None:
        return None
    north, east, down = seen.velocity  # type: ignore[attr-defined]
    return np.array([north, east, down if seen.axes == 3 else np.nan])  # type: ignore[attr-defined]

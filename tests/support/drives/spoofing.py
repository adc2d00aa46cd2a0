"""Simulated drives as messages through core.fusion and core.spoofing, with GNSS velocities and positions changed."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from math import degrees, pi

import numpy as np
import numpy.typing as npt

from services.core.fusion.process import Config as FusionConfig
from services.core.fusion.process import Process as Fusion
from services.core.spoofing.grade import Grade
from services.core.spoofing.inertial.compass import barometric_pressure
from services.core.spoofing.process import Config, Process
from services.core.spoofing.windows.short_window import Window
from services.sensors.simulator.drive import Drive
from shared.maths.earth import Geodetic, geodetic_from_ned_difference
from shared.messages.base import Tick
from shared.messages.gnss import FixType, GnssFix
from shared.messages.imu import ImuSamples
from shared.messages.navigation import FilterState, NavigationSolution
from shared.messages.trust import LearnedGrade, Outcome, TrustMonitor
from shared.messages.vehicle import VehicleSpeed

FloatArray = npt.NDArray[np.float64]
SECOND_NS = 1_000_000_000
BAROMETER_SD = 0.12  # [m]
BATCH = 10  # inertial samples a message
# The simulated IMU is of industrial grade. These drives are too short for a minute of warm-up.
GRADED = Config(grade=Grade.INDUSTRIAL, warm_up_s=0.0)
Input = ImuSamples | GnssFix | VehicleSpeed | Tick
Fused = tuple[Input, list[NavigationSolution | FilterState]]  # a message, and what core.fusion publishes for it


@dataclass
class Result:
    """Statements of both monitors, and what they are made of."""

    process: Process
    statements: dict[str, list[TrustMonitor]] = field(default_factory=dict)
    windows: list[Window] = field(default_factory=list)

    def first_s(self, monitor: str, after_s: float = 0.0) -> float | None:
        """Time [s] of the first accusation after a time."""
        times = [s.sampled_ns / SECOND_NS for s in self.statements[monitor] if s.outcome is Outcome.ACCUSES]
        return next((time_s for time_s in times if time_s > after_s), None)

    def share(self, monitor: str, outcome: Outcome) -> float:
        """Share of the statements with an outcome."""
        found = self.statements[monitor]
        return sum(statement.outcome is outcome for statement in found) / len(found)

    def episodes(self, monitor: str) -> int:
        """Number of uninterrupted accusations."""
        accused = np.array([s.outcome is Outcome.ACCUSES for s in self.statements[monitor]], dtype=int)
        return int((np.diff(accused, prepend=0) == 1).sum())


def drag_off(drive: Drive, begin_s: float, acceleration: float, speed: float, *, across: bool = False) -> Drive:
    """Add a velocity that grows along the course, or across it, up to a speed [m/s]; positions follow."""
    elapsed = np.maximum(drive.fix_ns / SECOND_NS - begin_s, 0.0)
    size = np.minimum(acceleration * elapsed, speed)
    first = int(np.searchsorted(drive.t_ns, begin_s * SECOND_NS))
    moving = first + int(np.argmax(np.hypot(*drive.velocity_n[first:, :2].T) > 1.0))
    yaw = drive.attitude[moving, 2] + (0.5 * pi if across else 0.0)
    added = size[:, None] * np.array([np.cos(yaw), np.sin(yaw), 0.0])
    step = np.diff(drive.fix_ns, prepend=0) / SECOND_NS
    moved = np.cumsum(added * step[:, None], axis=0)
    position = [
        geodetic_from_ned_difference((float(n), float(e), float(d)), Geodetic(*place))
        for (n, e, d), place in zip(moved, drive.fix_position.tolist(), strict=True)
    ]
    return replace(drive, fix_velocity_n=drive.fix_velocity_n + added, fix_position=np.array(position))


def inputs(drive: Drive, *, odometer: bool = True, resolution_m_s: float = 0.0) -> Iterator[Input]:
    """Messages of a drive in order of time, with a tick a second."""
    k = j = 0
    rng = np.random.default_rng((drive.seed, 99))
    for i in range(0, len(drive.t_ns) - BATCH + 1, BATCH):
        now_ns = int(drive.t_ns[i + BATCH - 1])
        yield ImuSamples(
            received_ns=now_ns,
            source="imu0",
            sampled_ns=tuple(drive.t_ns[i : i + BATCH].tolist()),
            specific_force_body_m_s2=tuple(map(tuple, drive.force_b[i : i + BATCH].tolist())),
            angular_rate_body_rad_s=tuple(map(tuple, drive.rate_b[i : i + BATCH].tolist())),
            pressure_pa=barometric_pressure(float(drive.position[i + BATCH - 1, 2]) + BAROMETER_SD * rng.normal()),
        )
        while odometer and j < len(drive.odometer_ns) and drive.odometer_ns[j] <= now_ns:
            speed = max(0.0, float(drive.odometer[j]))
            if resolution_m_s:
                speed = round(speed / resolution_m_s) * resolution_m_s
            stamp_ns = int(drive.odometer_ns[j])
            yield VehicleSpeed(
                sampled_ns=stamp_ns, received_ns=now_ns, source="can0", speed_m_s=speed,
                resolution_m_s=resolution_m_s or None,
            )  # fmt: skip
            j += 1
        while k < len(drive.fix_ns) and drive.fix_ns[k] <= now_ns:
            yield fix_of(drive, k)
            k += 1
        if now_ns % SECOND_NS == 0:
            yield Tick(now_ns=now_ns)


def fix_of(drive: Drive, k: int) -> GnssFix:
    """One fix of a drive; without position and velocity where the receiver had none."""
    stamp_ns, valid = int(drive.fix_ns[k]), bool(drive.fix_valid[k])
    latitude, longitude, height = drive.fix_position[k].tolist()
    return GnssFix(
        sampled_ns=stamp_ns,
        received_ns=stamp_ns,
        source="gnss0",
        fix_type=FixType.THREE_D if valid else FixType.NONE,
        latitude_deg=degrees(latitude) if valid else None,
        longitude_deg=degrees(longitude) if valid else None,
        height_ellipsoid_m=height if valid else None,
        velocity_ned_m_s=tuple(drive.fix_velocity_n[k].tolist()) if valid else None,
        velocity_sd_ned_m_s=tuple(drive.fix_velocity_sd_n[k].tolist()) if valid else None,
        position_sd_ned_m=tuple(drive.fix_position_sd_n[k].tolist()) if valid else None,
    )


def monitored(
    drive: Drive, config: Config | None = None, *, odometer: bool = True, resolution_m_s: float = 0.0
) -> Result:
    """Run a drive through both processes."""
    return watched(process_of(drive, config), fused(drive, odometer=odometer, resolution_m_s=resolution_m_s))


def process_of(drive: Drive, config: Config | None = None) -> Process:
    """The monitors of the vehicle that drove."""
    return Process((config or GRADED).with_values({"vehicle.gnss.lever_arm_body_m": tuple(drive.lever_arm_b)}))


def fused(drive: Drive, *, odometer: bool = True, resolution_m_s: float = 0.0) -> Iterator[Fused]:
    """Run a drive through core.fusion, which takes most of the time and does not depend on the monitors' settings."""
    fusion = Fusion(FusionConfig().with_values({"vehicle.gnss.lever_arm_body_m": tuple(drive.lever_arm_b)}))
    return solved(fusion, inputs(drive, odometer=odometer, resolution_m_s=resolution_m_s))


def solved(fusion: Fusion, messages: Iterable[Input]) -> Iterator[Fused]:
    """Deliver messages to core.fusion."""
    for message in messages:
        published = () if isinstance(message, Tick) else fusion.handle(message)
        yield message, [item for item in published if isinstance(item, NavigationSolution | FilterState)]


def run(fusion: Fusion, process: Process, messages: Iterator[Input]) -> Result:
    """Deliver messages to both processes, and fusion's solutions to the second."""
    return watched(process, solved(fusion, messages))


def watched(process: Process, received: Iterable[Fused]) -> Result:
    """Deliver messages to the monitors, each behind the solutions that it led to."""
    result = Result(process)
    for message, solutions in received:
        for solution in solutions:
            list(process.handle(solution))
        for statement in process.handle(message):
            if isinstance(statement, LearnedGrade):
                continue
            result.statements.setdefault(statement.monitor, []).append(statement)
        window = process.monitor.window
        if isinstance(message, Tick) and window is not None and window not in result.windows[-1:]:
            result.windows.append(window)
    return result

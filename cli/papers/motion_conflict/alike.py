"""GNSS and odometer falsified by the same factor: the verdicts of the tachograph's test and of the inertial sensors."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from services.core.motion_conflict.inertial_speed.monitor import InertialSpeed
from services.sensors.simulator.drive import Drive, simulate

from .drives import ALIKE_FACTORS, DURATION_S, DriveResult, result_of, speeds_of
from .sweeps import Statistics, with_scale

FloatArray = npt.NDArray[np.float64]

SECOND_NS = 1_000_000_000
BEGIN_S = DURATION_S / 2.0  # of the falsification: bends before it are the reference


@dataclass(frozen=True)
class ScaledDrive:
    """One drive with both speeds times a factor, from its middle on."""

    factor: float
    tachograph: Statistics
    bends: int | None  # falsified bends until both speeds are accused; None: never
    after_s: float | None
    total: int  # bends of the whole drive
    before: bool  # the suspect time is before the falsification


@dataclass(frozen=True)
class DriveMeasurements:
    """All that is measured on one simulated drive."""

    result: DriveResult
    alike: list[ScaledDrive]


def measure(job: tuple[str, int]) -> DriveMeasurements:
    """Simulate, sweep and falsify one drive."""
    scenario, seed = job
    drive = simulate(scenario, seed, DURATION_S)
    return DriveMeasurements(result_of(scenario, speeds_of(drive)), falsified_alike(drive))


def falsified_alike(drive: Drive) -> list[ScaledDrive]:
    """Falsify both speeds of a simulated drive by each factor; 1 is the drive as it was."""
    return [_falsified(drive, factor) for factor in ALIKE_FACTORS]


def _falsified(drive: Drive, factor: float) -> ScaledDrive:
    begin_ns = round(BEGIN_S * SECOND_NS)
    changed = replace(
        drive,
        fix_velocity_n=drive.fix_velocity_n * np.where(drive.fix_ns >= begin_ns, factor, 1.0)[:, None],
        odometer=drive.odometer * np.where(drive.odometer_ns >= begin_ns, factor, 1.0),
    )
    tachograph = with_scale(speeds_of(changed), 0.0)
    monitor, first = _monitored(changed, begin_ns)
    if first is None:
        return ScaledDrive(factor, tachograph, None, None, len(monitor.bends), before=True)
    time_ns, suspect_ns = first
    bends = sum(begin_ns < bend.end_ns < time_ns for bend in monitor.bends)
    after_s = (time_ns - begin_ns) / SECOND_NS
    return ScaledDrive(factor, tachograph, bends, after_s, len(monitor.bends), before=suspect_ns < begin_ns)


def _monitored(drive: Drive, begin_ns: int) -> tuple[InertialSpeed, tuple[int, int] | None]:
    """Run the monitor; give the time and the suspect time of the first accusation."""
    monitor, first = InertialSpeed(), None
    valid = np.flatnonzero(drive.fix_valid)
    speed = np.hypot(drive.fix_velocity_n[:, 0], drive.fix_velocity_n[:, 1])
    sd = drive.fix_velocity_sd_n[:, :2].max(axis=1)
    for end_ns in range(SECOND_NS, int(drive.t_ns[-1]) + 1, SECOND_NS):
        chosen = _second(drive.t_ns, end_ns)
        monitor.inertial(
            drive.t_ns[chosen].tolist(), drive.force_b[chosen].tolist(), drive.rate_b[chosen].tolist()
        )  # fmt: skip
        for k in valid[_second(drive.fix_ns[valid], end_ns)].tolist():
            monitor.gnss(int(drive.fix_ns[k]), float(speed[k]), float(sd[k]))
        wheels = _second(drive.odometer_ns, end_ns)
        for time_ns, value in zip(drive.odometer_ns[wheels].tolist(), drive.odometer[wheels].tolist(), strict=True):
            monitor.odometer(time_ns, value)
        verdict = monitor.verdict(end_ns)
        if verdict.accuses and verdict.suspect_since_ns is not None and first is None:
            first = (end_ns, verdict.suspect_since_ns)
    return monitor, first


def _second(stamps_ns: npt.NDArray[np.int64], end_ns: int) -> slice:
    """Stamps within the second that ends at a time."""
    first, last = np.searchsorted(stamps_ns, [end_ns - SECOND_NS, end_ns], side="right").tolist()
    return slice(first, last)

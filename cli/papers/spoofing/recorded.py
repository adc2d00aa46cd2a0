"""Drives that phones recorded at 1 Hz: GNSS speed and bearing, and means over 1 s of the sensors."""

import csv
from datetime import datetime
from pathlib import Path

import numpy as np
import numpy.typing as npt

from services.core.spoofing.inertial.compass import barometric_height, device_from_enu
from services.core.spoofing.profile import FORCE_EDGES_M_S2
from shared.maths.earth import STANDARD_GRAVITY

from .campaign import DriveRates, Mode
from .method import CUT_OFF_HZ, attitude_rates, mounting_of, paper_rates, sensor_rates

FloatArray = npt.NDArray[np.float64]

RECORDING = "phone_drives_1hz"
MIN_DURATION_S = 600  # of uninterrupted GNSS


def phone_drives(folder: Path) -> dict[str, DriveRates]:
    """Read every drive of the folder, by the day it was recorded."""
    return {path.stem[:10]: read(path) for path in sorted(folder.glob("*.csv"))}


def read(path: Path) -> DriveRates:
    """Read the longest part of a drive that has GNSS in every second.

    The specific force, the platform's gravity and the magnetic field have device axes with the same signs: gravity
    points up, as Android's accelerometer at rest.
    """
    with path.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))

    def column(name: str) -> FloatArray:
        return np.array([float(row[name] or "nan") for row in rows])

    def vectors(name: str) -> FloatArray:
        return np.column_stack([column(f"{name}_{axis}") for axis in "xyz"])

    stamps = np.array([datetime.fromisoformat(row["time"]).timestamp() for row in rows])
    speed, bearing, pressure = column("speed"), np.radians(column("bearing")), column("pressure")
    force, gravity, rate, field = vectors("acc"), vectors("grav"), vectors("gyro"), vectors("mag")
    complete = np.isfinite(np.column_stack([speed, bearing, pressure, force, gravity, rate, field])).all(axis=1)
    good = complete & (speed >= 0.0) & (bearing >= 0.0)
    chosen = longest_run(good, stamps)
    if chosen.stop - chosen.start < MIN_DURATION_S:
        raise ValueError(
            f"{path.name} has {chosen.stop - chosen.start} s of uninterrupted GNSS; {MIN_DURATION_S} s are needed"
        )
    climb = np.gradient(column("altitude")[chosen])
    velocity = np.column_stack([speed * np.sin(bearing), speed * np.cos(bearing)])[chosen]
    height = np.array([barometric_height(100.0 * value) for value in pressure[chosen].tolist()])
    force, gravity, rate, field = force[chosen], gravity[chosen], rate[chosen], field[chosen]
    d_from_enu = device_from_enu(gravity, field)
    mounting = mounting_of(force, gravity, np.column_stack([velocity, climb]))
    sensors = {
        (Mode.PAPER, CUT_OFF_HZ): paper_rates(force, field, height, 1, mounting),
        (Mode.MATCHED, CUT_OFF_HZ): sensor_rates(force, field, height, 1),
        (Mode.GYROSCOPE, CUT_OFF_HZ): attitude_rates(force, rate, height, d_from_enu, 1),
    }
    excess = np.abs(np.linalg.norm(force, axis=1) - STANDARD_GRAVITY)
    return DriveRates(
        np.column_stack([velocity, climb]), None, sensors, np.searchsorted(FORCE_EDGES_M_S2, excess)[:-1]
    )  # fmt: skip


def longest_run(good: npt.NDArray[np.bool_], stamps: FloatArray) -> slice:
    """Longest part in which every second is there and good."""
    broken = np.flatnonzero(~(good[1:] & good[:-1] & (np.abs(np.diff(stamps) - 1.0) < 0.5))) + 1
    edges = np.concatenate([[0], broken, [len(good)]])
    begin = int(np.diff(edges).argmax())
    return slice(int(edges[begin]), int(edges[begin + 1]))


def halves(drive: DriveRates) -> tuple[DriveRates, DriveRates]:
    """Split a drive in the middle: to learn of, and to validate with."""
    middle = len(drive.velocity) // 2
    return _part(drive, slice(0, middle)), _part(drive, slice(middle, len(drive.velocity)))


def _part(drive: DriveRates, rows: slice) -> DriveRates:
    seconds = slice(rows.start, rows.stop - 1)
    sensors = {key: rates.part(seconds) for key, rates in drive.sensors.items()}
    return DriveRates(drive.velocity[rows], None, sensors, drive.force_class[seconds])

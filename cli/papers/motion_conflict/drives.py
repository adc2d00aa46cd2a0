"""Both speeds of simulated and of recorded drives, for the nominal statistics and the sweeps."""

from dataclasses import dataclass
from math import ceil, floor
from pathlib import Path

import numpy as np
import numpy.typing as npt

from services.core.motion_conflict.tachograph import KM_H
from services.sensors.simulator.drive import Drive

from .profiles import PERIOD_S
from .sweeps import Statistics, delay_break_points, scale_break_points, with_delay, with_scale

FloatArray = npt.NDArray[np.float64]

SCENARIOS = ("highway", "urban")
DURATION_S = 900.0
RESPONSE_S = 0.25  # of the vehicle to the OBD request
FAULTS = {
    "none": (0.0, 0.0),
    "delay 2 s": (2.0, 0.0),
    "delay 5 s": (5.0, 0.0),
    "delay 10 s": (10.0, 0.0),
    "scale -5 %": (0.0, 0.05),
    "scale -10 %": (0.0, 0.10),
    "scale -30 %": (0.0, 0.30),
}  # delay [s] and reduction of the odometer's scale
RECORDING = "canedge_obd_gnss"
ALIKE_FACTORS = (1.0, 1.03, 1.10)  # of both speeds alike


@dataclass(frozen=True)
class DriveSpeeds:
    """Speeds [km/h] over seconds; between two stamps they are interpolated."""

    times_s: range
    gnss_s: FloatArray
    gnss_km_h: FloatArray
    wheels_s: FloatArray
    wheels_km_h: FloatArray

    def gnss(self, time_s: float) -> float:
        """Speed of GNSS."""
        return float(np.interp(time_s, self.gnss_s, self.gnss_km_h))

    def odometer(self, time_s: float, scale: float = 1.0) -> float:
        """Wheel speed at the vehicle's response, in steps of 1 km/h as OBD-II reports it."""
        speed = scale * float(np.interp(time_s + RESPONSE_S, self.wheels_s, self.wheels_km_h))
        return float(min(255, max(0, floor(speed + 0.5))))

    def differences(self) -> list[float]:
        """Odometer minus GNSS [km/h] at the sample times."""
        return [self.odometer(t) - self.gnss(t) for t in self.times_s]


def speeds_of(drive: Drive) -> DriveSpeeds:
    """Speeds of a simulated drive of 15 minutes."""
    valid = drive.fix_valid
    return DriveSpeeds(
        range(PERIOD_S, int(DURATION_S), PERIOD_S),
        drive.fix_ns[valid].astype(np.float64) * 1e-9,
        np.hypot(drive.fix_velocity_n[valid, 0], drive.fix_velocity_n[valid, 1]) / KM_H,
        drive.odometer_ns.astype(np.float64) * 1e-9,
        drive.odometer / KM_H,
    )


def recorded(folder: Path) -> DriveSpeeds:
    """Read speeds of a recorded drive with OBD-II and GNSS, from the first fix that stays valid."""
    gnss = np.loadtxt(folder / "drive164" / "gnss_speed.csv", delimiter=",", skiprows=1)
    wheels = np.loadtxt(folder / "drive164" / "obd_speed.csv", delimiter=",", skiprows=1)
    gnss = gnss[np.flatnonzero(gnss[:, 1] == 0.0)[-1] + 1 :]
    start, end = max(gnss[0, 0], wheels[0, 0]), min(gnss[-1, 0], wheels[-1, 0])
    times = range(ceil(start / PERIOD_S) * PERIOD_S, floor(end), PERIOD_S)
    return DriveSpeeds(times, gnss[:, 0], gnss[:, 2] / KM_H, wheels[:, 0], wheels[:, 1])


@dataclass(frozen=True)
class DriveResult:
    """Nominal differences [km/h], statistics with each of `FAULTS`, and the break-points of a drive."""

    kind: str
    differences: list[float]
    faults: dict[str, Statistics]
    delay_s: tuple[float | None, float | None]  # MT, median
    scale: tuple[float | None, float | None]


def result_of(kind: str, drive: DriveSpeeds) -> DriveResult:
    """Sweep a drive."""
    faults = {
        name: with_delay(drive, delay_s) if delay_s else with_scale(drive, reduction)
        for name, (delay_s, reduction) in FAULTS.items()
    }
    return DriveResult(kind, drive.differences(), faults, delay_break_points(drive), scale_break_points(drive))

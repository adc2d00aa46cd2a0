"""What the devices of a simulated drive tell a navigation filter."""

import numpy as np

from services.core.fusion.aids.base import Measurement
from services.core.fusion.aids.gnss.fix import Reading, Stamp, gnss_measurements
from services.core.fusion.aids.odometer.aid import WheelSpeed
from services.core.fusion.settings import Settings
from services.sensors.simulator.drive import Drive
from shared.maths.earth import Geodetic


def fixes_of(drive: Drive, settings: Settings) -> list[Measurement]:
    """Velocities and positions, as the receiver states them."""
    found: list[Measurement] = []
    for k in np.flatnonzero(drive.fix_valid).tolist():
        time_ns = int(drive.fix_ns[k])
        north, east, down = drive.fix_velocity_n[k].tolist()
        moving = Reading((north, east, down), np.diag(drive.fix_velocity_sd_n[k] ** 2))
        stated = Reading((0.0, 0.0, 0.0), np.diag(drive.fix_position_sd_n[k] ** 2))
        place = Geodetic(*drive.fix_position[k].tolist())
        found += gnss_measurements(settings, Stamp(time_ns, time_ns, "gnss"), place, stated, moving)
    return found


def speeds_of(drive: Drive, settings: Settings) -> list[Measurement]:
    """Speeds of the wheels."""
    readings = zip(drive.odometer_ns.tolist(), drive.odometer.tolist(), strict=True)
    return [WheelSpeed(time_ns, time_ns, "wheels", speed, 0.0, True, True, settings) for time_ns, speed in readings]

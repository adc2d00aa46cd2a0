"""A simulated drive as the lines of a phone, through the whole unit: it navigates by them alone."""

from collections.abc import Iterator
from math import degrees, hypot

import numpy as np
import pytest

from services.sensors.simulator.drive import Drive, simulate
from shared.maths.earth import Geodetic, ned_from_geodetic_difference
from shared.messages.gnss import GnssRaw
from shared.messages.navigation import NavigationPhase, NavigationSolution
from shared.runtime.config import parse_vehicle
from shared.runtime.offline import OfflineUnit

pytestmark = pytest.mark.slow

NS, MS = 1_000_000_000, 1_000_000
START_NS = 1_790_000_000 * NS  # UTC of the beginning, and OBU time
ELAPSED_NS = 77_000 * NS  # of the phone's clock
DELAY_NS = 60 * MS  # of the network
VEHICLE = """
[vehicle]
name = "by-phone"

[vehicle.imu]
body_from_sensor = [[0, 1, 0], [1, 0, 0], [0, 0, -1]]

[vehicle.gnss]
lever_arm_body_m = [0.3, 0.0, -1.2]

[sensors.gnss]
device = "tcp://127.0.0.1:1"
source = "phone"

[parsers.gnss]
use_receiver_imu = true

[controller.mode]
configure_gnss = false
"""


def lines(drive: Drive) -> Iterator[tuple[int, str]]:
    """Lines and their times [ns] since the beginning: sensors at 100 Hz in device axes, fixes at 1 Hz."""
    for k, time_ns in enumerate(drive.t_ns.tolist()):
        stamps = f"{(START_NS + time_ns) // MS},{ELAPSED_NS + time_ns}"
        for kind, (forward, right, down) in (("UncalAccel", drive.force_b[k]), ("UncalGyro", drive.rate_b[k])):
            yield time_ns, f"{kind},{stamps},{right:.6f},{forward:.6f},{-down:.6f},0,0,0"
    for k, time_ns in enumerate(drive.fix_ns.tolist()):
        latitude, longitude, height = drive.fix_position[k].tolist()
        north, east, _ = drive.fix_velocity_n[k].tolist()
        radius, vertical = 1.51 * drive.fix_position_sd_n[k, 0], drive.fix_position_sd_n[k, 2]
        yield (
            time_ns,
            (
                f"Fix,GPS,{degrees(latitude):.9f},{degrees(longitude):.9f},{height:.3f},{hypot(north, east):.3f},"
                f"{radius:.3f},{degrees(np.arctan2(east, north)) % 360.0:.3f},{(START_NS + time_ns) // MS},0.1,1.0,"
                f"{ELAPSED_NS + time_ns},{vertical:.3f}"
            ),
        )


def pieces(drive: Drive) -> Iterator[GnssRaw]:
    """Bytes as they arrive, ten times a second."""
    waiting: dict[int, list[str]] = {}
    for time_ns, line in lines(drive):
        waiting.setdefault(time_ns // (100 * MS), []).append(line)
    for slot, found in sorted(waiting.items()):
        received_ns = START_NS + (slot + 1) * 100 * MS + DELAY_NS
        yield GnssRaw(received_ns=received_ns, source="phone", data="".join(f"{line}\n" for line in found).encode())


def test_a_phone_alone_navigates() -> None:
    drive, unit = simulate("parking_lot", 4, 120.0), OfflineUnit(parse_vehicle(VEHICLE))
    solutions = [message for message in unit.run(pieces(drive)) if isinstance(message, NavigationSolution)]
    last = [one for one in solutions if one.phase is NavigationPhase.NAVIGATING][-200:]
    assert len(last) == 200, {one.phase for one in solutions}
    errors = []
    for one in last:
        k = int(np.argmin(np.abs(drive.t_ns - (one.sampled_ns - START_NS))))
        true = Geodetic(*drive.position[k].tolist())
        here = Geodetic(np.radians(one.latitude_deg), np.radians(one.longitude_deg), one.height_ellipsoid_m)
        errors.append(ned_from_geodetic_difference(here, true))
    horizontal = np.hypot(*np.array(errors).T[:2])
    assert horizontal.max() < 5.0 and np.median(horizontal) < 2.0

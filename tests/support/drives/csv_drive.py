"""A simulated drive as CSV files in other units and axes, and their mapping."""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from services.sensors.simulator.drive import Drive
from shared.maths.earth import STANDARD_GRAVITY

LATE_S = 0.03  # by which the stamps of the IMU are late
BACK_RIGHT_UP = np.array([-1.0, 1.0, -1.0])
MAPPING = f"""
name = "made"
vehicle_file = "made.toml"
start_utc_s = 1700000000.0
truth_is = "recorded"

[imu]
file = "imu.csv"
separator = ";"
time = {{ column = "t_ms", unit = "ms" }}
stamps_late_s = {LATE_S}
specific_force = {{ columns = ["ax_g", "ay_g", "az_g"], unit = "g" }}
angular_rate = {{ columns = ["gx_dps", "gy_dps", "gz_dps"], unit = "deg/s" }}
axes = ["backward", "right", "up"]

[gnss]
file = "fix.csv"
time = {{ column = "t", unit = "s" }}
latency_s = 0.12
latitude = {{ column = "lat", unit = "1e-7 deg" }}
longitude = {{ column = "lon", unit = "1e-7 deg" }}
height = {{ column = "h", unit = "mm", kind = "ellipsoid" }}
velocity = {{ columns = ["ve", "vn", "vu"], unit = "km/h", axes = "enu" }}
position_sd = {{ columns = ["se", "sn", "su"], axes = "enu" }}
velocity_sd = {{ constant_ned = [0.05, 0.05, 0.08] }}

[speed]
file = "speed.csv"
time = {{ column = "t", unit = "s" }}
column = "v"
unit = "km/h"

[truth]
file = "truth.csv"
time = {{ column = "t", unit = "s" }}
latitude = {{ column = "lat", unit = "deg" }}
longitude = {{ column = "lon", unit = "deg" }}
height = {{ column = "h", unit = "m", kind = "ellipsoid" }}
velocity = {{ columns = ["vn", "ve", "vd"], unit = "m/s", axes = "ned" }}
attitude = {{ columns = ["roll", "pitch", "yaw"], unit = "deg" }}
angular_rate = {{ columns = ["wx", "wy", "wz"], unit = "rad/s" }}
"""


def write_drive(folder: Path, drive: Drive) -> Path:
    """Write files, mapping and vehicle into a folder; give the mapping."""
    time_s = drive.t_ns * 1e-9
    _csv(folder / "imu.csv", ["t_ms", "ax_g", "ay_g", "az_g", "gx_dps", "gy_dps", "gz_dps"], ";",
         (time_s + LATE_S) * 1e3, drive.force_b * BACK_RIGHT_UP / STANDARD_GRAVITY,
         np.degrees(drive.rate_b * BACK_RIGHT_UP))  # fmt: skip
    fixes = drive.fix_valid
    position, velocity = drive.fix_position[fixes], drive.fix_velocity_n[fixes] * 3.6
    _csv(folder / "fix.csv", ["t", "lat", "lon", "h", "ve", "vn", "vu", "se", "sn", "su"], ",",
         drive.fix_ns[fixes] * 1e-9, np.degrees(position[:, :2]) * 1e7, position[:, 2] * 1e3,
         velocity[:, [1, 0]], -velocity[:, 2], drive.fix_position_sd_n[fixes][:, [1, 0, 2]])  # fmt: skip
    _csv(folder / "speed.csv", ["t", "v"], ",", drive.odometer_ns * 1e-9, drive.odometer * 3.6)
    tenth = slice(None, None, 10)
    _csv(folder / "truth.csv",
         ["t", "lat", "lon", "h", "vn", "ve", "vd", "roll", "pitch", "yaw", "wx", "wy", "wz"], ",",
         time_s[tenth], np.degrees(drive.position[tenth, :2]), drive.position[tenth, 2], drive.velocity_n[tenth],
         np.degrees(drive.attitude[tenth]), drive.ideal_rate_b[tenth])  # fmt: skip
    (folder / "made.toml").write_text(
        f'[vehicle]\nname = "made"\n\n[vehicle.gnss]\nlever_arm_body_m = {list(drive.lever_arm_b)}\n'
    )
    (folder / "mapping.toml").write_text(MAPPING)
    return folder / "mapping.toml"


def _csv(path: Path, header: list[str], separator: str, *columns: npt.NDArray[np.floating[Any]]) -> None:
    np.savetxt(
        path, np.column_stack(columns), fmt="%.10f", delimiter=separator, header=separator.join(header), comments=""
    )

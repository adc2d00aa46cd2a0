"""EKF2 of the PX4 autopilot in C++ (BSD-3-Clause)."""

from pathlib import Path

import numpy as np

from shared.maths.earth import FloatArray

from .common import START_S, Peer, PeerInput, thinned

HOW = (
    "EKF2 is a library without a program that reads files: link one of your own with src/modules/ekf2/EKF of "
    "github.com/PX4/PX4-Autopilot, and set OBU_PX4_EKF2 to it. It is called with a folder that holds imu.csv (time_us, "
    "dt_us, three increments of angle [rad], three of velocity [m/s]), gnss.csv (time_us, latitude, longitude [deg], "
    "height, velocity NED, sd horizontal, sd vertical, sd of the speed) and start.csv (latitude, longitude, height, "
    "velocity NED, roll, pitch, yaw [deg]), and writes result.csv there (time_us, latitude, longitude, height, "
    "velocity NED, roll, pitch, yaw [deg]), nothing with a heading line."
)


class Px4(Peer):
    """Whatever program the reader has made of it."""

    name, variable, how = "PX4 EKF2", "OBU_PX4_EKF2", HOW

    def prepare(self, data: PeerInput, folder: Path, program: str) -> list[str]:
        """Write CSV files."""
        imu, gnss = data.imu[data.imu[:, 0] >= START_S], data.gnss[data.gnss[:, 0] >= START_S]
        lengths = np.full(len(imu), 1e6 / data.rate_hz)
        columns = np.column_stack([np.round((imu[:, 0] - START_S) * 1e6), lengths, imu[:, 1:]])
        np.savetxt(folder / "imu.csv", columns, fmt=["%d", "%d"] + ["%.12e"] * 6, delimiter=",")
        stamps = np.round((gnss[:, 0] - START_S) * 1e6)
        fixes = np.column_stack([stamps, gnss[:, 1:4], gnss[:, 7:10], gnss[:, 4], gnss[:, 6], gnss[:, 10]])
        np.savetxt(folder / "gnss.csv", fixes, fmt=["%d", "%.12f", "%.12f"] + ["%.5f"] * 7, delimiter=",")
        np.savetxt(folder / "start.csv", data.initial[None, :], fmt="%.12f", delimiter=",")
        return [program, str(folder)]

    def result(self, folder: Path) -> FloatArray:
        """Rows with microseconds since the start."""
        rows = np.loadtxt(folder / "result.csv", delimiter=",")
        rows[:, 0] = START_S + rows[:, 0] * 1e-6
        return thinned(rows)

"""OB_GINS: factor graph over a sliding window in C++ with odometer, i2Nav group, Wuhan University (GPL-3.0)."""

from pathlib import Path

import numpy as np

from shared.maths.earth import FloatArray

from .common import ACCEL_BIAS, ARW, CORRELATION_H, GYRO_BIAS, LEVER_M, START_S, VRW, Peer, PeerInput, thinned

METRES_PER_DEGREE = 111_200.0  # of latitude; good to 0.5 %, for a way of millimetres
HOW = (
    "Clone github.com/i2Nav-WHU/OB_GINS (known here: 622b0e6d), install Ceres, yaml-cpp and abseil, then "
    "`mkdir build && cd build && cmake .. -DCMAKE_BUILD_TYPE=Release && make`, and set OBU_OB_GINS to its bin/ob_gins."
)


class ObGins(Peer):
    """It takes increments, speed in an eighth column, and GNSS positions at whole seconds alone."""

    name, variable, how = "OB_GINS", "OBU_OB_GINS", HOW

    def prepare(self, data: PeerInput, folder: Path, program: str) -> list[str]:
        """Write its text files and its YAML."""
        speed = np.interp(data.imu[:, 0], data.odometer[:, 0], data.odometer[:, 1])
        np.savetxt(folder / "imu.txt", np.column_stack([data.imu, speed]), fmt=["%.6f"] + ["%.12e"] * 6 + ["%.4f"])
        np.savetxt(folder / "gnss.txt", at_whole_seconds(data.gnss), fmt=["%.6f", "%.12f", "%.12f"] + ["%.4f"] * 4)
        (folder / "ob_gins.yaml").write_text(configuration(data, folder), encoding="utf-8")
        return [program, str(folder / "ob_gins.yaml")]

    def result(self, folder: Path) -> FloatArray:
        """Week, seconds, position, velocity, attitude."""
        return thinned(np.loadtxt(folder / "OB_GINS_TXT.nav", usecols=range(1, 11)))


def at_whole_seconds(gnss: FloatArray) -> FloatArray:
    """Positions carried by their velocity to the whole second that is a few milliseconds off; others are left out."""
    seconds = np.round(gnss[:, 0])
    late = gnss[:, 0] - seconds
    near = np.abs(late) < 0.01
    rows, late = gnss[near, :7].copy(), late[near, None]
    metres = np.array([METRES_PER_DEGREE, METRES_PER_DEGREE * np.cos(np.radians(gnss[0, 1])), -1.0])
    rows[:, 1:4] -= late * gnss[near, 7:10] / metres
    rows[:, 0] = seconds[near]
    return rows


def configuration(data: PeerInput, folder: Path) -> str:
    """Its YAML: the true state at the start, the noise as published, its odometer's noise as it comes."""
    velocity, attitude = data.initial[3:6].tolist(), data.initial[6:].tolist()
    return f"""imufile: "{folder / "imu.txt"}"
gnssfile: "{folder / "gnss.txt"}"
outputpath: "{folder}"
windows: 30
starttime: {START_S:.0f}
endtime: {data.imu[-1, 0] - 1.0:.0f}
num_iterations: 20
is_outlier_culling: false
initvel: {velocity}
initatt: {attitude}
initgb: [0, 0, 0]
initab: [0, 0, 0]
imudatalen: 8
imudatarate: {data.rate_hz}
isearth: true
antlever: {list(LEVER_M)}
odolever: [0, 0, 0]
bodyangle: [0, 0, 0]
odometer:
  isuseodo: true
  std: [0.05, 0.05, 0.05]
  srw: 100
imumodel:
  arw: {ARW}
  vrw: {VRW}
  gbstd: {GYRO_BIAS}
  abstd: {ACCEL_BIAS}
  corrtime: {CORRELATION_H}
isuseoutage: false
outagetime: 0
outagelen: 0
outageperiod: 1
gnssthreshold: 100
"""

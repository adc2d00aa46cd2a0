"""KF-GINS: error-state filter with 21 states in C++, i2Nav group, Wuhan University (GPL-3.0)."""

from pathlib import Path

import numpy as np

from shared.maths.earth import FloatArray

from .common import ACCEL_BIAS, ARW, CORRELATION_H, GYRO_BIAS, LEVER_M, SCALE, START_S, VRW, Peer, PeerInput, thinned

HOW = "`python -m benchmarks.navigation.peers.build` builds it, or set OBU_KF_GINS to its bin/KF-GINS."


class KfGins(Peer):
    """It takes increments and GNSS positions, no velocity, and begins with a state that is given."""

    name, variable, how, built = "KF-GINS", "OBU_KF_GINS", HOW, "KF-GINS/bin/KF-GINS"

    def prepare(self, data: PeerInput, folder: Path, program: str) -> list[str]:
        """Write its text files and its YAML."""
        np.savetxt(folder / "imu.txt", data.imu, fmt=["%.6f"] + ["%.12e"] * 6)
        np.savetxt(folder / "gnss.txt", data.gnss[:, :7], fmt=["%.6f", "%.12f", "%.12f"] + ["%.4f"] * 4)
        (folder / "kf-gins.yaml").write_text(configuration(data, folder), encoding="utf-8")
        return [program, str(folder / "kf-gins.yaml")]

    def result(self, folder: Path) -> FloatArray:
        """Week, seconds, position, velocity, attitude."""
        return thinned(np.loadtxt(folder / "KF_GINS_Navresult.nav", usecols=range(1, 11)))


def configuration(data: PeerInput, folder: Path) -> str:
    """Its YAML: the true state at the start, and the noise as published."""
    place, velocity, attitude = data.initial[:3], data.initial[3:6], data.initial[6:]

    def three(values: object) -> str:
        return str(np.broadcast_to(np.asarray(values, dtype=float), 3).tolist())

    return f"""imupath: "{folder / "imu.txt"}"
gnsspath: "{folder / "gnss.txt"}"
outputpath: "{folder}"
imudatalen: 7
imudatarate: {data.rate_hz}
starttime: {START_S}
endtime: -1
initpos: {three(place)}
initvel: {three(velocity)}
initatt: {three(attitude)}
initgyrbias: {three(0.0)}
initaccbias: {three(0.0)}
initgyrscale: {three(0.0)}
initaccscale: {three(0.0)}
initposstd: {three(data.gnss[0, 4:7])}
initvelstd: {three(0.05)}
initattstd: [0.1, 0.1, 1.0]
imunoise:
  arw: {three(ARW)}
  vrw: {three(VRW)}
  gbstd: {three(GYRO_BIAS)}
  abstd: {three(ACCEL_BIAS)}
  gsstd: {three(SCALE)}
  asstd: {three(SCALE)}
  corrtime: {CORRELATION_H}
antlever: {three(LEVER_M)}
"""

"""Run by a Python that has pyins: `given.npz` of a folder in, `result.npy` out."""

import sys
from pathlib import Path

import numpy as np
import pandas as pd  # type: ignore[import-not-found, import-untyped, unused-ignore]  # of pyins's environment alone
from pyins import filters, inertial_sensor, measurements  # type: ignore[import-not-found, unused-ignore]  # the same

LEVER_M = (0.136, -0.301, -0.184)
ARW, VRW = np.radians(0.1) / 60.0, 0.1 / 60.0
GYRO_BIAS, ACCEL_BIAS, SCALE, CORRELATION_S = np.radians(25.0) / 3600.0, 200e-5, 1e-3, 3600.0


def main(folder: Path) -> None:
    """Feed position and velocity, scale factors estimated, from the given state on."""
    given = np.load(folder / "given.npz")
    imu, gnss, initial, start = given["imu"], given["gnss"], given["initial"], float(given["start"])
    lengths = np.diff(np.r_[start, imu[:, 0]])
    increments = pd.DataFrame(
        np.column_stack([lengths, imu[:, 1:7]]),
        index=imu[:, 0],
        columns=["dt", "theta_x", "theta_y", "theta_z", "dv_x", "dv_y", "dv_z"],
    )
    state = ["lat", "lon", "alt", "VN", "VE", "VD", "roll", "pitch", "heading"]
    place, velocity = (pd.DataFrame(gnss[:, columns], index=gnss[:, 0], columns=names)
                       for columns, names in ((slice(1, 4), state[:3]), (slice(7, 10), state[3:6])))  # fmt: skip
    found = filters.run_feedback_filter(
        pd.Series(initial, index=state, name=start), 0.02, 0.05, 0.1, 1.0, increments,
        _sensor(GYRO_BIAS, ARW), _sensor(ACCEL_BIAS, VRW),
        [measurements.Position(place, float(gnss[0, 4]), LEVER_M),
         measurements.NedVelocity(velocity, float(gnss[0, 10]), LEVER_M)],
    )  # fmt: skip
    trajectory = found.trajectory
    np.save(folder / "result.npy", np.column_stack([trajectory.index, trajectory[state]]))


def _sensor(bias: float, noise: float) -> object:
    """Bias as a walk that is worth its correlation time, and scale factors; the class has had two names."""
    model = getattr(inertial_sensor, "EstimationModel", None) or inertial_sensor.InertialSensorModel
    return model(bias, noise, bias * np.sqrt(2.0 / CORRELATION_S), SCALE * np.eye(3))


if __name__ == "__main__":
    main(Path(sys.argv[1]))

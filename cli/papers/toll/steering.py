"""The steering angle of a CAM as a measurement of CTRV: what it adds to the yaw rate, and what a wrong gain costs.

A CAM may state the angle of the steering wheel in steps of 1.5 degrees. With the gear ratio i and the wheelbase L::

    yaw rate = speed/L · tan(angle/i)

Neither i nor L is part of a CAM: the gain 1/(i L) is the receiver's assumption.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import radians

import numpy as np
import numpy.typing as npt

from services.core.toll.trackers.filters import Tracker
from services.core.toll.trackers.models import Ctrv
from services.core.toll.trackers.observation import SPEED, YAW_RATE, Observation

from ..report import Table
from .filters import follow
from .trajectory import Trajectory, cam_of, mixed

FloatArray = npt.NDArray[np.float64]

RATIO, WHEELBASE_M = 16.0, 2.7  # of the simulated vehicle
STEP_RAD = radians(1.5)  # steeringWheelAngleValue of TS 102 894-2
LARGEST_RAD = radians(511 * 1.5)
WHITE_M = 3.0  # white error of the positions
GAINS = (1.0, 1.1, 0.9, 1.5)  # assumed over true
NONE, YAW = "neither", "yaw rate of the CAM"
FLOOR_RAD_S = radians(0.4)


@dataclass(frozen=True)
class SteeringResult:
    """MSE [m²] of CTRV by what it measures the turn with; in the whole drive and in the roundabout."""

    whole: dict[str, float]
    roundabout: dict[str, float]


def steering_angle(trajectory: Trajectory) -> FloatArray:
    """Angle [rad] of the steering wheel as a CAM states it, shape (n,); 0 at standstill."""
    speed, rate = trajectory.states[:, SPEED], trajectory.states[:, YAW_RATE]
    moving = speed > 0.1
    angle = np.where(moving, RATIO * np.arctan(WHEELBASE_M * rate / np.where(moving, speed, 1.0)), 0.0)
    stated: FloatArray = np.clip(np.round(angle / STEP_RAD) * STEP_RAD, -LARGEST_RAD, LARGEST_RAD)
    return stated


def with_steering(cams: Sequence[Observation], angle: FloatArray, gain: float) -> list[Observation]:
    """CAM whose yaw rate follows from the steering angle with an assumed gain."""
    found = []
    for cam, stated in zip(cams, angle.tolist(), strict=True):
        z, R = cam.z.copy(), cam.R.copy()
        scale = z[:, SPEED] / WHEELBASE_M
        z[:, YAW_RATE] = gain * scale * np.tan(stated / RATIO)
        quantum = scale * STEP_RAD / RATIO / np.sqrt(12.0)
        R[:, YAW_RATE, YAW_RATE] = FLOOR_RAD_S**2 + quantum**2
        found.append(replace(cam, z=z, R=R))
    return found


def without_turn(cams: Sequence[Observation]) -> list[Observation]:
    """CAM without a yaw rate."""
    columns = np.arange(cams[0].z.shape[1]) != YAW_RATE
    return [replace(cam, available=cam.available & columns) for cam in cams]


def compare_steering(runs: int, seed: int) -> SteeringResult:
    """MSE of CTRV with the yaw rate, with the steering angle at each of `GAINS`, and with neither."""
    trajectory, rng = mixed(), np.random.default_rng(seed)
    error = WHITE_M * rng.standard_normal((runs, len(trajectory.time_s), 2))
    cams, angle = cam_of(trajectory, error, WHITE_M, rng), steering_angle(trajectory)
    given = {NONE: without_turn(cams), YAW: cams}
    given |= {f"steering angle, gain {gain:g}": with_steering(cams, angle, gain) for gain in GAINS}
    tracker, inside = Tracker((Ctrv(),)), trajectory.during("roundabout")
    squares = {
        name: ((follow(tracker, one).states[..., :2] - trajectory.states[:, None, :2]) ** 2).sum(axis=2)
        for name, one in given.items()
    }
    return SteeringResult(
        {name: float(square.mean()) for name, square in squares.items()},
        {name: float(square[inside].mean()) for name, square in squares.items()},
    )


def steering_table(result: SteeringResult) -> Table:
    """What each measurement of the turn gives."""
    rows = [(name, f"{result.whole[name]:.3f}", f"{result.roundabout[name]:.3f}") for name in result.whole]
    title = f"EKF CTRV with the steering angle [m²]: white errors of {WHITE_M:g} m, gain assumed over true"
    return Table(title, ("turn measured by", "whole drive", "roundabout"), rows)

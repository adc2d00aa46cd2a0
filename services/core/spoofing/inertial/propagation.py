"""Inertial states, one or several, carried over the same increments by the strapdown mechanisation of core.fusion."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from shared.inertial.increments import Increment
from shared.inertial.strapdown import local_earth, mechanise
from shared.maths.compiled import COMPILED, compiled
from shared.maths.rotation import matrix_from_quaternion

FloatArray = npt.NDArray[np.float64]
Table = Sequence[Sequence[float]] | FloatArray

# A state: attitude, NED from body; velocity [m/s, NED]; latitude, longitude, height [rad, rad, m]; errors of the IMU.
QUATERNION, VELOCITY, POSITION = slice(0, 4), slice(4, 7), slice(7, 10)
MOTION = slice(0, 10)
ACCELEROMETER_BIAS, GYROSCOPE_BIAS = slice(10, 13), slice(13, 16)  # [m/s²], [rad/s], body
GYROSCOPE_SCALE = slice(16, 19)  # [-] measured over true rate, minus one
STATE = 19
FORCE = slice(10, 13)  # [m/s², NED] of a step
RATE, DURATION = slice(3, 6), 6  # of an increment


@compiled
def _carry(states: Table, increments: Table, steps: list[tuple[float, ...]] | FloatArray) -> None:
    """Fill rows of motion and mean specific force after each increment, of the first state, then of the second."""
    k = 0
    for state in states:
        quaternion = state[0], state[1], state[2], state[3]
        velocity, position = (state[4], state[5], state[6]), (state[7], state[8], state[9])
        earth = local_earth(position[0])
        for increment in increments:
            force = increment[0] - state[10], increment[1] - state[11], increment[2] - state[12]
            wx, wy, wz = increment[3], increment[4], increment[5]
            rate = (
                wx - state[13] - state[16] * wx,
                wy - state[14] - state[17] * wy,
                wz - state[15] - state[18] * wz,
            )
            quaternion, velocity, position, earth, force_n, _ = mechanise(
                quaternion, velocity, position, earth, force, rate, increment[6]
            )
            steps[k] = quaternion + velocity + position + force_n
            k += 1


def table_of(increments: Sequence[Increment]) -> FloatArray:
    """Rows of some increments, shape (k, 7): mean force [m/s²] and rate [rad/s] (body), duration [s]."""
    return np.array([increment.row for increment in increments])


def carried(states: FloatArray, increments: FloatArray) -> FloatArray:
    """Motion and mean specific force of each state after each increment.

    Parameters
    ----------
    states : ndarray, shape (n, 19)
        At the start of the first increment.
    increments : ndarray, shape (k, 7)
        Those that follow, by `table_of`.

    Returns
    -------
    ndarray, shape (n, k, 13)
        `MOTION` after an increment, `FORCE` over it.
    """
    count = len(states) * len(increments)
    if COMPILED:
        steps = np.empty((count, FORCE.stop))
        _carry(np.ascontiguousarray(states), increments, steps)
    else:
        found: list[tuple[float, ...]] = [()] * count
        _carry(states.tolist(), increments.tolist(), found)
        steps = np.array(found)
    return steps.reshape(len(states), len(increments), FORCE.stop)


def matrices(quaternions: FloatArray) -> FloatArray:
    """Rotation matrices, shape (..., 3, 3), of quaternions, shape (..., 4)."""
    w, x, y, z = quaternions.reshape(-1, 4).T
    stack = matrix_from_quaternion((w, x, y, z))  # type: ignore[arg-type]  # its elements are arrays
    return stack.T.mT.reshape(*quaternions.shape[:-1], 3, 3)

"""What the CAM of several vehicles say about their motion."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .motion import FloatArray

BoolArray = npt.NDArray[np.bool_]

X, Y, HEADING, SPEED, ACCELERATION, YAW_RATE = range(6)
SIZE = 6


@dataclass(frozen=True)
class Observation:
    """One measurement of each of n vehicles, in the order x, y, heading, speed, acceleration, yaw rate.

    Components that a CAM calls unavailable are False in `available`; their values have no meaning.
    """

    z: FloatArray  # shape (n, k) [m, m, rad, m/s, m/s², rad/s], local tangent plane
    R: FloatArray  # shape (n, k, k)
    available: BoolArray  # shape (n, k)

    def __getitem__(self, rows: npt.NDArray[np.intp] | BoolArray | slice) -> "Observation":
        """Observation of some of the vehicles."""
        return Observation(self.z[rows], self.R[rows], self.available[rows])

    def components(self, columns: list[int]) -> "Observation":
        """Observation of some of the components."""
        return Observation(self.z[:, columns], self.R[:, columns][:, :, columns], self.available[:, columns])

    @classmethod
    def of(cls, z: FloatArray, sd: FloatArray, available: BoolArray | None = None) -> "Observation":
        """Observation with independent components of the standard deviations `sd`, shape (n, k) or (k,)."""
        R = np.broadcast_to(sd, z.shape)[..., None] ** 2 * np.eye(z.shape[-1])
        return cls(z, R, np.ones(z.shape, dtype=bool) if available is None else available)


def cartesian(observation: Observation, *, acceleration: bool) -> Observation:
    """Position, velocity and, where asked for, acceleration on the axes x and y.

    Parameters
    ----------
    observation : Observation
        Of n vehicles.
    acceleration : bool
        Whether the result has the components ax and ay.

    Returns
    -------
    Observation
        Of x, y, vx, vy and ax, ay. Velocity needs heading and speed, acceleration also acceleration and yaw rate; what
        lacks one of them is not available.

    Notes
    -----
    ::

        vx = v cos θ,  ax = a cos θ - v w sin θ
        vy = v sin θ,  ay = a sin θ + v w cos θ

    R follows from the Jacobian of these equations.
    """
    heading, v, a, w = observation.z[:, HEADING:].T
    c, s = np.cos(heading), np.sin(heading)
    zero, one = np.zeros_like(c), np.ones_like(c)
    values = [observation.z[:, X], observation.z[:, Y], v * c, v * s]
    rows = [
        [one, zero, zero, zero, zero, zero],
        [zero, one, zero, zero, zero, zero],
        [zero, zero, -v * s, c, zero, zero],
        [zero, zero, v * c, s, zero, zero],
    ]
    if acceleration:
        values += [a * c - v * w * s, a * s + v * w * c]
        rows += [
            [zero, zero, -a * s - v * w * c, -w * s, c, -v * s],
            [zero, zero, a * c - v * w * s, w * c, s, v * c],
        ]
    J = np.array(rows).transpose(2, 0, 1)
    has = observation.available
    moving = has[:, HEADING] & has[:, SPEED]
    available = [has[:, X], has[:, Y], moving, moving]
    if acceleration:
        available += [moving & has[:, ACCELERATION] & has[:, YAW_RATE]] * 2
    return Observation(np.column_stack(values), J @ observation.R @ J.mT, np.column_stack(available))

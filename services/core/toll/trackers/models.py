"""Motion models of the tracked vehicles: how a state moves in a step, and which components of a CAM observe it.

Every function works on n vehicles at once: states have shape (n, size), steps shape (n,).
"""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from shared.maths.earth import wrap_angles

from .motion import FloatArray, arc, integrated_noise
from .observation import ACCELERATION, HEADING, SIZE, SPEED, YAW_RATE, Observation, X, Y, cartesian

JERK_DENSITY = 0.225  # [m²/s⁵] of white jerk: as much as 1.5 m/s³ that is drawn anew every 0.1 s
YAW_ACCELERATION_DENSITY = 0.009  # [rad²/s³] of white yaw acceleration: as 0.3 rad/s² drawn anew every 0.1 s


class Transition(NamedTuple):
    """States after a step, with the transition matrices and the noise of the step."""

    x: FloatArray  # shape (n, size)
    Phi: FloatArray  # shape (n, size, size)
    Q: FloatArray  # shape (n, size, size)


class Model(Protocol):
    """One motion model. The first two components of every state are x and y."""

    @property
    def size(self) -> int:
        """Number of components of the state."""
        ...

    @property
    def heading(self) -> int | None:
        """Index of the component that is an angle."""
        ...

    def transition(self, x: FloatArray, dt: FloatArray) -> Transition:
        """Move states by a step [s]."""
        ...

    def observed(self, observation: Observation) -> Observation:
        """Express a CAM in the components of the state."""
        ...


@dataclass(frozen=True)
class LinearMotion:
    """Constant velocity (order 2) or constant acceleration (order 3) on each axis, driven by white noise.

    The state is (x, y, vx, vy) or (x, y, vx, vy, ax, ay).
    """

    order: int
    density: float  # [m²/s³] of white acceleration, or [m²/s⁵] of white jerk
    position_only: bool = False  # whether only x and y of a CAM are used
    heading: int | None = None

    @property
    def size(self) -> int:
        """Number of components of the state."""
        return 2 * self.order

    def transition(self, x: FloatArray, dt: FloatArray) -> Transition:
        """Move states by a step: the Taylor series of each axis."""
        Phi: FloatArray = np.eye(self.order) + np.zeros((len(dt), 1, 1))
        for row in range(self.order):
            for column in range(row + 1, self.order):
                Phi[:, row, column] = dt ** (column - row) / (column - row)  # dt and dt²/2: order is 3 at most
        Q = self.density * integrated_noise(self.order, dt)
        Phi, Q = _of_both_axes(Phi), _of_both_axes(Q)
        return Transition(np.matvec(Phi, x), Phi, Q)

    def observed(self, observation: Observation) -> Observation:
        """Express a CAM in the components of the state."""
        seen = cartesian(observation, acceleration=self.order == 3)
        if self.position_only:
            seen.available[:, 2:] = False
        return seen


@dataclass(frozen=True)
class Ctra:
    """Constant turn rate and acceleration; the state is (x, y, heading, speed, acceleration, yaw rate).

    White jerk drives the acceleration, white yaw acceleration the yaw rate.
    """

    jerk_density: float = JERK_DENSITY
    yaw_acceleration_density: float = YAW_ACCELERATION_DENSITY
    size: int = SIZE
    heading: int | None = HEADING

    def transition(self, x: FloatArray, dt: FloatArray) -> Transition:
        """Move states along an arc."""
        heading, speed, acceleration, yaw_rate = x[:, HEADING:].T
        moved = x.copy()
        displacement, jacobian = arc(heading, speed, acceleration, yaw_rate, dt)
        moved[:, :2] += displacement
        moved[:, HEADING] = wrap_angles(heading + yaw_rate * dt)
        moved[:, SPEED] += acceleration * dt
        Phi = np.eye(SIZE) + np.zeros((len(x), 1, 1))
        Phi[:, :2, HEADING:] = jacobian
        Phi[:, HEADING, YAW_RATE] = dt
        Phi[:, SPEED, ACCELERATION] = dt
        along = _along_track(heading + 0.5 * yaw_rate * dt, speed)
        chains = integrated_noise(3, dt)
        noise = np.zeros((len(x), SIZE, SIZE))
        for position, columns, density in (
            (along[..., 0], [SPEED, ACCELERATION], self.jerk_density),
            (along[..., 1], [HEADING, YAW_RATE], self.yaw_acceleration_density),
        ):
            G = _chain(position, columns)
            noise += density * G @ chains @ G.mT
        return Transition(moved, Phi, noise)

    def observed(self, observation: Observation) -> Observation:
        """A CAM observes every component."""
        return observation


@dataclass(frozen=True)
class Ctrv:
    """Constant turn rate and velocity; the state is (x, y, heading, speed, yaw rate).

    White acceleration drives the speed, white yaw acceleration the yaw rate.
    """

    acceleration_density: float = 0.4  # [m²/s³]: as 2 m/s² drawn anew every 0.1 s
    yaw_acceleration_density: float = YAW_ACCELERATION_DENSITY
    size: int = SIZE - 1
    heading: int | None = HEADING

    def transition(self, x: FloatArray, dt: FloatArray) -> Transition:
        """Move states along an arc at constant speed."""
        heading, speed, yaw_rate = x[:, HEADING:].T
        moved = x.copy()
        displacement, jacobian = arc(heading, speed, np.zeros_like(speed), yaw_rate, dt)
        moved[:, :2] += displacement
        moved[:, HEADING] = wrap_angles(heading + yaw_rate * dt)
        Phi = np.eye(self.size) + np.zeros((len(x), 1, 1))
        Phi[:, :2, HEADING:] = jacobian[..., [0, 1, 3]]
        Phi[:, HEADING, self.size - 1] = dt
        along = _along_track(heading + 0.5 * yaw_rate * dt, speed)
        G_speed = _chain(along[..., 0], [SPEED], self.size)
        G_turn = _chain(along[..., 1], [HEADING, self.size - 1], self.size)
        Q = self.acceleration_density * G_speed @ integrated_noise(2, dt) @ G_speed.mT
        Q = Q + self.yaw_acceleration_density * G_turn @ integrated_noise(3, dt) @ G_turn.mT
        return Transition(moved, Phi, Q)

    def observed(self, observation: Observation) -> Observation:
        """A CAM observes every component; its acceleration is not used."""
        return observation.components([X, Y, HEADING, SPEED, YAW_RATE])


@dataclass(frozen=True)
class Cruise:
    """Constant velocity in the state of `Ctra`: the mode of the IMM in which acceleration and yaw rate are zero.

    White acceleration drives the speed and white yaw rate the heading; acceleration and yaw rate are zero up to the
    standard deviations below.
    """

    acceleration_density: float = 0.0025  # [m²/s³]
    yaw_rate_density: float = 1e-6  # [rad²/s]
    acceleration_sd: float = 0.05  # [m/s²]
    yaw_rate_sd: float = 0.002  # [rad/s]
    size: int = SIZE
    heading: int | None = HEADING

    def transition(self, x: FloatArray, dt: FloatArray) -> Transition:
        """Move states along a straight line; acceleration and yaw rate become zero."""
        heading, speed = x[:, HEADING], x[:, SPEED]
        zero = np.zeros_like(speed)
        moved = x.copy()
        displacement, jacobian = arc(heading, speed, zero, zero, dt)
        moved[:, :2] += displacement
        moved[:, ACCELERATION:] = 0.0
        Phi = np.diag([1.0, 1.0, 1.0, 1.0, 0.0, 0.0]) + np.zeros((len(x), 1, 1))
        Phi[:, :2, [HEADING, SPEED]] = jacobian[..., :2]
        along = _along_track(heading, speed)
        chains = integrated_noise(2, dt)
        Q = np.diag([0.0, 0.0, 0.0, 0.0, self.acceleration_sd**2, self.yaw_rate_sd**2]) + np.zeros((len(x), 1, 1))
        for position, column, density in (
            (along[..., 0], SPEED, self.acceleration_density),
            (along[..., 1], HEADING, self.yaw_rate_density),
        ):
            G = _chain(position, [column])
            Q = Q + density * G @ chains @ G.mT
        return Transition(moved, Phi, Q)

    def observed(self, observation: Observation) -> Observation:
        """A CAM observes every component."""
        return observation


@dataclass(frozen=True)
class FourState:
    """The paper's switching: CTRA in which a small acceleration, a small yaw rate, or both are set to zero.

    The four states are therefore constant velocity, constant acceleration, CTRV and CTRA. For comparison only: the
    hard switch has no probability, and errs on either side of its thresholds.
    """

    ctra: Ctra = Ctra()
    acceleration_limit: float = 0.3  # [m/s²]
    yaw_rate_limit: float = 0.02  # [rad/s]
    size: int = SIZE
    heading: int | None = HEADING

    def transition(self, x: FloatArray, dt: FloatArray) -> Transition:
        """Set what is small to zero, then move states along an arc."""
        keep = np.ones_like(x)
        keep[:, ACCELERATION] = np.abs(x[:, ACCELERATION]) > self.acceleration_limit
        keep[:, YAW_RATE] = np.abs(x[:, YAW_RATE]) > self.yaw_rate_limit
        moved, Phi, Q = self.ctra.transition(x * keep, dt)
        return Transition(moved, Phi * keep[:, None, :], Q)

    def observed(self, observation: Observation) -> Observation:
        """A CAM observes every component."""
        return observation


def _of_both_axes(matrix: FloatArray) -> FloatArray:
    """Matrix of one axis, shape (n, k, k), for x and y in turn, shape (n, 2k, 2k)."""
    return np.asarray(np.kron(matrix, np.eye(2)), dtype=np.float64)


def _along_track(heading: FloatArray, speed: FloatArray) -> FloatArray:
    """Position change for a unit along the track, and for a unit of the integral of the heading, shape (n, 2, 2)."""
    c, s = np.cos(heading), np.sin(heading)
    return np.stack([np.stack([c, -speed * s], axis=-1), np.stack([s, speed * c], axis=-1)], axis=-2)


def _chain(position: FloatArray, columns: list[int], size: int = SIZE) -> FloatArray:
    """Map a chain of integrators, whose first state is a displacement, to a vehicle's state, shape (n, size, k)."""
    G = np.zeros((len(position), size, len(columns) + 1))
    G[:, :2, 0] = position
    for k, column in enumerate(columns, 1):
        G[:, column, k] = 1.0
    return G

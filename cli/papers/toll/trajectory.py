"""The mixed trajectory of the comparison of filters, and the CAM of a vehicle on it."""

from dataclasses import dataclass
from functools import cache
from math import radians
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from services.core.toll.trackers.motion import arc
from services.core.toll.trackers.observation import ACCELERATION, HEADING, SPEED, YAW_RATE, Observation
from shared.maths.earth import wrap_angles

FloatArray = npt.NDArray[np.float64]

STEP_S = 0.1
RADIUS_M = 18.0  # of the roundabout
TURN_SPEED_M_S = 7.0
TURN_RAD = radians(270.0)
ENTRY_S = 1.2  # linear entry and exit of the yaw rate
# Standard deviations of what a CAM says of speed, acceleration, yaw rate and heading, and its quantisation.
NOISE_SD = {SPEED: 0.15, ACCELERATION: 0.15, YAW_RATE: radians(0.3), HEADING: radians(1.0)}
QUANTUM = {SPEED: 0.01, ACCELERATION: 0.1, YAW_RATE: radians(0.01), HEADING: radians(0.1)}
# Standard deviations that the filters use for heading, speed, acceleration and yaw rate.
TUNED_SD = (radians(1.0), 0.15, 0.2, radians(0.4))


class Phase(NamedTuple):
    """A part of the trajectory."""

    name: str
    duration_s: float
    acceleration_m_s2: float
    turns: bool = False


def _turn_duration() -> float:
    """Duration of the roundabout: the full yaw rate for the angle less that of entry and exit."""
    rate = TURN_SPEED_M_S / RADIUS_M
    return TURN_RAD / rate + ENTRY_S


PHASES = (
    Phase("rest", 3.0, 0.0),
    Phase("acceleration", 14.0 / 1.5, 1.5),
    Phase("cruise", 12.0, 0.0),
    Phase("braking", 7.0 / 2.0, -2.0),
    Phase("roundabout", _turn_duration(), 0.0, turns=True),
    Phase("straight", 2.0, 0.0),
    Phase("acceleration", 18.0 / 1.5, 1.5),
    Phase("cruise", 15.0, 0.0),
    Phase("braking", 25.0 / 2.5, -2.5),
    Phase("rest", 4.0, 0.0),
)


@dataclass(frozen=True)
class Trajectory:
    """True states of a vehicle, one a step."""

    time_s: FloatArray  # shape (n,)
    states: FloatArray  # shape (n, 6): x, y, heading, speed, acceleration, yaw rate
    phases: tuple[str, ...]

    def during(self, name: str) -> npt.NDArray[np.bool_]:
        """Samples of the phases of a name, without the first and the last second of each."""
        here = np.array([phase == name for phase in self.phases])
        margin = round(1.0 / STEP_S)
        inside = here.copy()
        for shift in range(1, margin + 1):
            inside &= np.roll(here, shift) & np.roll(here, -shift)
        return inside

    @property
    def length_m(self) -> float:
        """Length of the track."""
        return float(np.hypot(*np.diff(self.states[:, :2], axis=0).T).sum())


@cache
def mixed(fine: int = 10) -> Trajectory:
    """Integrate the phases in steps of 0.1 s / `fine`, and keep every tenth of a second."""
    ends = np.cumsum([phase.duration_s for phase in PHASES])
    count = int(np.floor(ends[-1] / STEP_S + 1e-9)) + 1
    dt = STEP_S / fine
    state = np.zeros((1, 6))
    rows, names = [], []
    for k in range((count - 1) * fine + 1):
        t = k * dt
        index = min(int(np.searchsorted(ends, t + 1e-9, side="right")), len(PHASES) - 1)
        phase = PHASES[index]
        start = ends[index] - phase.duration_s
        state[0, ACCELERATION] = phase.acceleration_m_s2
        state[0, YAW_RATE] = _yaw_rate(t - start, phase.duration_s) if phase.turns else 0.0
        if k % fine == 0:
            rows.append(state[0].copy())
            names.append(phase.name)
        length = np.full(1, min(dt, max(ends[index] - t, 0.0)) or dt)
        _advance(state, length)
        rest = dt - length[0]
        if rest > 1e-12 and index + 1 < len(PHASES):
            state[0, ACCELERATION] = PHASES[index + 1].acceleration_m_s2
            state[0, YAW_RATE] = 0.0
            _advance(state, np.full(1, rest))
    return Trajectory(np.arange(count, dtype=np.float64) * STEP_S, np.array(rows), tuple(names))


def _advance(state: FloatArray, dt: FloatArray) -> None:
    heading, speed, acceleration, yaw_rate = state[:, HEADING:].T
    state[:, :2] += arc(heading, speed, acceleration, yaw_rate, dt).displacement
    state[:, HEADING] = wrap_angles(state[:, HEADING] + state[:, YAW_RATE] * dt)
    state[:, SPEED] = np.maximum(state[:, SPEED] + state[:, ACCELERATION] * dt, 0.0)


def _yaw_rate(since_s: float, duration_s: float) -> float:
    """Left turn with linear entry and exit."""
    share = min(since_s / ENTRY_S, (duration_s - since_s) / ENTRY_S, 1.0)
    return TURN_SPEED_M_S / RADIUS_M * max(share, 0.0)


def cam_of(
    trajectory: Trajectory, position_error: FloatArray, position_sd: float, rng: np.random.Generator
) -> list[Observation]:
    """CAM of several runs along one trajectory, one observation a step.

    Parameters
    ----------
    trajectory : Trajectory
        The truth.
    position_error : ndarray, shape (runs, n, 2)
        [m] Errors of the positions.
    position_sd : float
        [m] Standard deviation of their white part, which the filters use.
    rng : numpy.random.Generator
        Source of the other noise.

    Returns
    -------
    list of Observation
        Quantised as in a CAM; each of all runs.
    """
    runs = len(position_error)
    z = np.repeat(trajectory.states[None], runs, axis=0)
    z[..., :2] += position_error
    quantised(z, rng)
    sd = np.array([position_sd, position_sd, *TUNED_SD])
    return [Observation.of(z[:, k], sd) for k in range(z.shape[1])]


def quantised(z: FloatArray, rng: np.random.Generator) -> None:
    """Add noise to heading, speed, acceleration and yaw rate of true states, shape (runs, n, 6), and quantise them."""
    for column, sd in NOISE_SD.items():
        noisy = z[..., column] + sd * rng.standard_normal(z.shape[:2])
        z[..., column] = np.round(noisy / QUANTUM[column]) * QUANTUM[column]

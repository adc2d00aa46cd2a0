"""Compares the filters on the mixed trajectory: the paper's table III, and three other models of the GNSS error."""

from collections.abc import Sequence
from dataclasses import dataclass
from time import process_time

import numpy as np
import numpy.typing as npt

from services.core.toll.trackers.filters import Estimates, Tracker, imm
from services.core.toll.trackers.models import Ctra, Ctrv, FourState, LinearMotion
from services.core.toll.trackers.observation import Observation

from .lane_decisions import gauss_markov
from .trajectory import STEP_S, Trajectory, cam_of, mixed

FloatArray = npt.NDArray[np.float64]

TRACKERS = {
    "KF CV, x y only": Tracker((LinearMotion(2, 1.5, position_only=True),)),
    "KF CV": Tracker((LinearMotion(2, 1.5),)),
    "KF CA, x y only": Tracker((LinearMotion(3, 1.0, position_only=True),)),
    "KF CA": Tracker((LinearMotion(3, 1.0),)),
    "EKF CTRV": Tracker((Ctrv(),)),
    "EKF CTRA": Tracker((Ctra(),)),
    "four states": Tracker((FourState(),)),
    "IMM of CV and CTRA": imm(),
}
SINGLE = [name for name in TRACKERS if "IMM" not in name and "four" not in name]
PAPER_MSE = {"KF CV": 36.18, "KF CA": 37.74, "EKF CTRV": 37.76, "EKF CTRA": 35.40}  # [m²], table III
PAPER_RAW = 37.76
BIAS_M, BIAS_WHITE_M = 5.94, 1.13  # fitted to table III


@dataclass(frozen=True)
class Noise:
    """One model of the GNSS error, and the ratios MSE/raw of the reference simulation by filter."""

    name: str
    white_m: float
    reference: dict[str, float]
    bias_m: float = 0.0
    correlated: tuple[tuple[float, float], ...] = ()  # standard deviation [m] and correlation time [s]

    def errors(self, runs: int, count: int, rng: np.random.Generator) -> FloatArray:
        """Errors [m], shape (runs, count, 2).

        The second half of the runs has the white noise of the first half and the opposite of its other errors: their
        products, which would dominate the scatter of the ratios, cancel.
        """
        half = (runs + 1) // 2
        angle = rng.uniform(0.0, 2.0 * np.pi, (half, 1, 1))
        slow = self.bias_m * np.concatenate([np.cos(angle), np.sin(angle)], axis=-1) + np.zeros((half, count, 2))
        for sd, tau_s in self.correlated:
            slow += gauss_markov(rng, slow.shape, sd, tau_s)
        white = self.white_m * rng.standard_normal(slow.shape)
        return np.concatenate([white + slow, white - slow])[:runs]


def _reference(*ratios: float) -> dict[str, float]:
    names = [name for name in TRACKERS if name != "four states"]
    return dict(zip(names, ratios, strict=True))


NOISES = (
    Noise("white 3 m", 3.0, _reference(0.172, 0.0150, 0.173, 0.0147, 0.0136, 0.0135, 0.0126)),
    Noise("table III", BIAS_WHITE_M, _reference(0.949, 0.936, 0.949, 0.936, 0.936, 0.936, 0.935), bias_m=BIAS_M),
    Noise(
        "300 s",
        1.13,
        _reference(0.902, 0.853, 0.903, 0.851, 0.844, 0.844, 0.844),
        correlated=((4.2, 300.0),),
    ),
    Noise(
        "open sky",
        0.5,
        _reference(0.880, 0.802, 0.867, 0.800, 0.788, 0.787, 0.789),
        correlated=((1.4, 600.0), (0.4, 20.0)),
    ),
)


@dataclass(frozen=True)
class Result:
    """What the filters make of one model of the GNSS error."""

    noise: Noise
    raw: float  # [m²] MSE of x and y together
    mse: dict[str, float]  # [m²] by filter
    manoeuvre: dict[str, float]  # mean probability of CTRA in the IMM, by phase


@dataclass(frozen=True)
class Run:
    """Estimates along the trajectory."""

    states: FloatArray  # shape (n, runs, size)
    probability: FloatArray  # shape (n, runs) of the last mode
    step_s: float  # processor time of a prediction and correction of all runs


def follow(tracker: Tracker, cams: Sequence[Observation]) -> Run:
    """Track all runs along the trajectory."""
    estimates = tracker.start(cams[0])
    found: list[Estimates] = [estimates]
    dt = np.full(len(cams[0].z), STEP_S)
    begin = process_time()
    for cam in cams[1:]:
        estimates = tracker.update(tracker.predict(estimates, dt), cam)
        found.append(estimates)
    step_s = (process_time() - begin) / (len(cams) - 1)
    return Run(
        np.array([estimates.mean for estimates in found]),
        np.array([estimates.probability[:, -1] for estimates in found]),
        step_s,
    )


def compare(noise: Noise, runs: int, seed: int) -> Result:
    """Mean square errors of every filter with the same CAM."""
    trajectory = mixed()
    rng = np.random.default_rng(seed)
    errors = noise.errors(runs, len(trajectory.time_s), rng)
    cams = cam_of(trajectory, errors, noise.white_m, rng)
    mse, phases = {}, {}
    for name, tracker in TRACKERS.items():
        run = follow(tracker, cams)
        mse[name] = _mean_square(run.states[..., :2], trajectory)
        phases = {phase: float(run.probability[trajectory.during(phase)].mean()) for phase in PHASES}
    return Result(noise, float((errors**2).sum(axis=2).mean()), mse, phases)


PHASES = ("roundabout", "braking", "cruise")


def with_mercator_scale(scale: float, seed: int) -> tuple[float, float]:
    """MSE [m²] of CTRA with a noise of 0.2 m, in a tangent plane and in Mercator coordinates that are not scaled."""
    trajectory = mixed()
    rng = np.random.default_rng(seed)
    cams = cam_of(trajectory, 0.2 * rng.standard_normal((10, len(trajectory.time_s), 2)), 0.2, rng)
    stretched = [
        Observation(np.column_stack([cam.z[:, :2] * scale, cam.z[:, 2:]]), cam.R, cam.available) for cam in cams
    ]
    tracker = TRACKERS["EKF CTRA"]
    plane = _mean_square(follow(tracker, cams).states[..., :2], trajectory)
    return plane, _mean_square(follow(tracker, stretched).states[..., :2] / scale, trajectory)


def step_times(seed: int, vehicles: Sequence[int]) -> dict[str, list[float]]:
    """Processor time [s] of one step of each filter for so many vehicles at once."""
    trajectory = mixed()
    times: dict[str, list[float]] = {name: [] for name in TRACKERS}
    for count in vehicles:
        rng = np.random.default_rng(seed)
        cams = cam_of(trajectory, rng.standard_normal((count, len(trajectory.time_s), 2)), 1.0, rng)[:300]
        for name, tracker in TRACKERS.items():
            times[name].append(min(follow(tracker, cams).step_s for _ in range(2)))
    return times


def _mean_square(position: FloatArray, trajectory: Trajectory) -> float:
    return float(((position - trajectory.states[:, None, :2]) ** 2).sum(axis=2).mean())

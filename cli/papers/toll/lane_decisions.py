"""Simulates lane decisions at a gate with and without delta position: ours, the paper does not evaluate them."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr

from services.core.toll.delta import DeltaEstimator, ErrorModel
from services.core.toll.lanes import LaneGeometry, lane_likelihood
from services.core.toll.location import Agreement, Fixes, Location, locate
from services.core.toll.trackers.filters import imm
from services.core.toll.trackers.observation import Observation
from shared.messages.explanation import Explanation
from shared.words.words import reason

from .trajectory import TUNED_SD, quantised

FloatArray = npt.NDArray[np.float64]

LANES, WIDTH_M, IN_LANE_M = 3, 3.5, 0.3
DURATION_S, STEP_S, SPEED_M_S = 45.0, 0.1, 20.0
WINDOW_S, LATENCY_S = 30.0, 1.0
CONFIDENT = 0.99
CARELESS_SD = 0.2  # [m]


@dataclass(frozen=True)
class Errors:
    """Standard deviations [m] of the error model of one row."""

    common: float
    vehicle: float
    white: float
    unit: float

    @property
    def model(self) -> ErrorModel:
        """The a priori error model of core.toll with these values."""
        return replace(
            ErrorModel(), common_sd=self.common, vehicle_sd=self.vehicle, unit_sd=self.unit, white_sd=self.white
        )

    @property
    def raw_sd(self) -> float:
        """Standard deviation [m] of an axis of a raw position."""
        return float(np.sqrt(self.common**2 + self.vehicle**2 + self.white**2))


def expected_raw(errors: Errors, *, ends_are_open: bool = False) -> float:
    """Expected share of raw positions in the right lane, by the normal distribution.

    A lane of width w has two bounds: P = mean over the place d in it of Φ((w/2 - d)/σ) - Φ((-w/2 - d)/σ). With open
    ends, the outer two of n lanes have one bound, and what is beside the road counts for them.
    """
    places = np.linspace(-IN_LANE_M, IN_LANE_M, 61)
    inside = ndtr((0.5 * WIDTH_M - places) / errors.raw_sd)
    two = float((inside - ndtr((-0.5 * WIDTH_M - places) / errors.raw_sd)).mean())
    return two if not ends_are_open else ((LANES - 2) * two + 2.0 * float(inside.mean())) / LANES


ROWS = (Errors(3.0, 0.6, 0.4, 0.3), Errors(3.0, 1.0, 0.8, 0.4), Errors(1.5, 0.4, 0.3, 0.2), Errors(4.2, 0.6, 1.13, 0.3))
# Shares of right lanes [%] of the reference: raw, raw + delta, filtered, filtered + delta.
REFERENCE = ((51, 92, 49, 95), (51, 78, 49, 89), (81, 100, 84, 100), (36, 74, 37, 93))


@dataclass(frozen=True)
class Decisions:
    """Shares of the runs of one row. A position is in the right lane if it is within half a width of its centre."""

    errors: Errors
    raw: float
    raw_delta: float
    filtered: float
    filtered_delta: float
    wrong_sign: float  # filtered, with the delta subtracted
    lateral_rms_m: float  # filtered, with delta
    most_probable: float  # most probable lane is right, filtered with delta
    decided: float  # its probability is above 0.99
    decided_wrong: float  # share of the decided
    careless_decided: float  # filtered, with a posterior that claims a GNSS error of 0.2 m
    careless_wrong: float


def gauss_markov(rng: np.random.Generator, shape: tuple[int, ...], sd: float, tau_s: float) -> FloatArray:
    """Stationary first-order Gauss-Markov processes along the last but one axis, steps of 0.1 s."""
    keep = float(np.exp(-STEP_S / tau_s))
    noise = rng.standard_normal(shape) * sd * np.sqrt(1.0 - keep**2)
    process = np.empty(shape)
    process[..., 0, :] = sd * rng.standard_normal(shape[:-2] + shape[-1:])
    for k in range(1, shape[-2]):
        process[..., k, :] = keep * process[..., k - 1, :] + noise[..., k, :]
    return process


def road() -> LaneGeometry:
    """Three straight lanes to the east; the gate is at x = 0."""
    centres = [np.array([[-2000.0, y], [500.0, y]]) for y in WIDTH_M * (np.arange(LANES) - 1)]
    return LaneGeometry.of(centres, [WIDTH_M] * LANES, [(1500.0, 2000.0, 2050.0)] * LANES)


def simulate(errors: Errors, runs: int, seed: int, *, corrected: bool = False) -> Decisions:
    """Simulate vehicles on their last 45 s before the gate, each with a common error of its own.

    `corrected` vehicles have no common error, and state so; the unit's receiver has it.
    """
    rng = np.random.default_rng(seed)
    count = round(DURATION_S / STEP_S) + 1
    lane = rng.integers(0, LANES, runs)
    truth = np.zeros((runs, count, 6))
    truth[..., 0] = SPEED_M_S * STEP_S * (np.arange(count) - (count - 1))
    truth[..., 1] = (WIDTH_M * (lane - 1) + rng.uniform(-IN_LANE_M, IN_LANE_M, runs))[:, None]
    truth[..., 3] = SPEED_M_S
    shape = (runs, count, 2)
    common = gauss_markov(rng, shape, errors.common, 600.0)
    own = gauss_markov(rng, shape, errors.vehicle, 20.0) + errors.white * rng.standard_normal(shape)
    unit = common + gauss_markov(rng, shape, errors.unit, 60.0)
    z = truth.copy()
    z[..., :2] += own if corrected else own + common
    raw = z[:, -1, 1].copy()
    quantised(z, rng)
    sd = np.array([errors.white, errors.white, *TUNED_SD])
    tracker = imm()
    estimates = tracker.start(Observation.of(z[:, 0], sd))
    for k in range(1, count):
        estimates = tracker.update(tracker.predict(estimates, np.full(runs, STEP_S)), Observation.of(z[:, k], sd))
    shift = np.array([_delta(errors, unit[run]) for run in range(runs)])  # east, north, sd
    honest = np.linalg.norm([errors.vehicle, errors.white, 0.0 if corrected else errors.common])
    fixes = Fixes(
        estimates.mean[:, :2],
        estimates.cov[:, :2, :2],
        np.full(runs, honest),
        np.ones(runs, dtype=bool),
        shift[:, :2],
        shift[:, 2],
    )
    with_delta = _locate(fixes, errors)
    most_probable = with_delta.lanes.argmax(axis=1)
    lateral = with_delta.left + WIDTH_M * (most_probable - 1) - truth[:, -1, 1]
    decided = with_delta.lanes.max(axis=1) >= CONFIDENT
    left = road().project(fixes.position).left
    careless = lane_likelihood(left, fixes.cov[:, 1, 1, None] + CARELESS_SD**2, np.full(left.shape, 1.0 / LANES))
    sure = careless.max(axis=1) >= CONFIDENT * careless.sum(axis=1)
    filtered, correction = fixes.position[:, 1], shift[:, 1]
    lateral_positions = (raw, raw + correction, filtered, filtered + correction, filtered - correction)
    right = [float((np.abs(y - WIDTH_M * (lane - 1)) < 0.5 * WIDTH_M).mean()) for y in lateral_positions]
    return Decisions(
        errors,
        right[0],
        right[1],
        right[2],
        right[3],
        right[4],
        float(np.sqrt((lateral**2).mean())),
        float((most_probable == lane).mean()),
        float(decided.mean()),
        float((decided & (most_probable != lane)).sum() / max(decided.sum(), 1)),
        float(sure.mean()),
        float((sure & (careless.argmax(axis=1) != lane)).sum() / max(sure.sum(), 1)),
    )


def _locate(fixes: Fixes, errors: Errors) -> Location:
    projection = road().project(fixes.position)
    return locate(projection, fixes, np.ones((len(fixes.position), LANES), dtype=bool), errors.model, Agreement())


def _delta(errors: Errors, unit: FloatArray) -> tuple[float, float, float]:
    """Delta position (east, north, standard deviation) from a fix a second of the unit, until 1 s before the end."""
    estimator = DeltaEstimator(errors.model, window_s=WINDOW_S, least_s=10.0, max_age_s=10.0)
    last_s = DURATION_S - LATENCY_S
    for second in range(int(last_s) + 1):
        estimator.add(second * 10**9, *unit[round(second / STEP_S)].tolist())
    delta = estimator.delta(round(last_s * 1e9))
    if isinstance(delta, Explanation):
        raise ValueError(reason(delta))
    return delta.east, delta.north, float(np.sqrt(delta.sd**2 + errors.model.change_variance(LATENCY_S)))

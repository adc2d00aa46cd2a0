"""Tracks many vehicles at once: Kalman filters of one motion model, and the interacting multiple model (IMM)."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from shared.maths.earth import wrap_angles
from shared.maths.kalman import correct, predict

from .models import Cruise, Ctra, Model
from .motion import FloatArray
from .observation import ACCELERATION, HEADING, SIZE, SPEED, BoolArray, Observation

# Standard deviations at the start of what the first CAM does not say, by component of a CAM.
START_SD = np.array([100.0, 100.0, np.pi, 30.0, 3.0, 0.5])  # [m, m, rad, m/s, m/s², rad/s]
MODE_HOLDING_S = 3.3  # [s] time constant of the Markov chain of the modes
CRUISE, MANOEUVRE = range(2)  # modes of `imm`


@dataclass(frozen=True)
class Estimates:
    """States of n vehicles by each of m motion models, and the probability of each model."""

    x: FloatArray  # shape (n, m, size)
    P: FloatArray  # shape (n, m, size, size)
    probability: FloatArray  # shape (n, m), sum 1
    heading: int | None  # index of the component that is an angle

    def __getitem__(self, rows: npt.NDArray[np.intp] | BoolArray | slice) -> "Estimates":
        """Estimates of some of the vehicles."""
        return Estimates(self.x[rows], self.P[rows], self.probability[rows], self.heading)

    @property
    def mean(self) -> FloatArray:
        """Mean of the mixture of the models, shape (n, size)."""
        return _mixture(self, self.probability[:, None, :])[0][:, 0]

    @property
    def cov(self) -> FloatArray:
        """Covariance of the mixture of the models, shape (n, size, size)."""
        return _mixture(self, self.probability[:, None, :])[1][:, 0]


@dataclass(frozen=True)
class Tracker:
    """An interacting multiple model of two motion models; with one it is the (extended) Kalman filter of that model.

    Notes
    -----
    With the probabilities μ of the modes and their transition probabilities p over a step::

        c_j = Σ_i p_ij μ_i,   w_ij = p_ij μ_i / c_j
        x0_j = Σ_i w_ij x_i,  P0_j = Σ_i w_ij (P_i + (x_i - x0_j)(x_i - x0_j)^T)      (mixing, then prediction)
        μ_j = c_j L_j / Σ,    L_j = N(z - H x_j; 0, S_j)                             (after the correction)

    p_ii = (1 + exp(-2 dt / 3.3 s)) / 2 is that of a continuous Markov chain of two modes: 0.97 at 10 Hz, and never
    below one half.

    References
    ----------
    H. Blom, Y. Bar-Shalom, "The interacting multiple model algorithm for systems with Markovian switching
    coefficients", IEEE Trans. Automatic Control 33(8), 1988.
    """

    models: tuple[Model] | tuple[Model, Model]

    def start(self, observation: Observation) -> Estimates:
        """Estimates from the first CAM of each vehicle; what it does not say has the deviations of START_SD."""
        has = observation.available
        first = Observation(
            np.where(has, observation.z, 0.0),
            _without(observation.R, has) + np.eye(has.shape[1]) * np.where(has, 0.0, START_SD**2)[:, None, :],
            np.ones_like(has),
        )
        seen = [model.observed(first) for model in self.models]
        count = len(self.models)
        return Estimates(
            np.stack([observation.z for observation in seen], axis=1),
            np.stack([observation.R for observation in seen], axis=1),
            np.full((len(has), count), 1.0 / count),
            self.models[0].heading,
        )

    def predict(self, before: Estimates, dt: FloatArray) -> Estimates:
        """Estimates after a step of dt [s], shape (n,), which may differ from vehicle to vehicle."""
        stay = 0.5 * (1.0 + np.exp(-2.0 * dt / MODE_HOLDING_S))[:, None, None]
        one_mode = len(self.models) == 1
        transition = np.ones((1, 1)) if one_mode else np.where(np.eye(2) > 0, stay, 1.0 - stay)
        joint = transition * before.probability[:, :, None]  # p_ij μ_i, shape (n, i, j)
        c = joint.sum(axis=1)
        x0, P0 = _mixture(before, (joint / c[:, None, :]).mT)
        steps = [model.transition(x0[:, j], dt) for j, model in enumerate(self.models)]
        P = predict(P0, np.stack([s.Phi for s in steps], axis=1), np.stack([s.Q for s in steps], axis=1))
        return Estimates(np.stack([s.x for s in steps], axis=1), P, c, before.heading)

    def update(self, predicted: Estimates, observation: Observation) -> Estimates:
        """Estimates after a CAM of each vehicle; components that are not available change nothing."""
        seen = [model.observed(observation) for model in self.models]
        has = np.stack([observation.available for observation in seen], axis=1)
        measured = np.stack([observation.z for observation in seen], axis=1)
        if predicted.heading is not None:
            predicted = _turned(predicted, measured, has)
        z = measured - predicted.x
        if predicted.heading is not None:
            z[..., predicted.heading] = wrap_angles(z[..., predicted.heading])
        R = np.stack([observation.R for observation in seen], axis=1)
        H = np.eye(z.shape[-1]) * has[..., None, :]
        # A row of zeros in z and H with unit noise of its own changes neither the state nor the ratio of likelihoods.
        R = _without(R, has) + np.eye(z.shape[-1]) * ~has[..., None, :]
        correction = correct(predicted.P, np.where(has, z, 0.0), H, R)
        x = predicted.x + correction.x
        if predicted.heading is not None:
            x[..., predicted.heading] = wrap_angles(x[..., predicted.heading])
        log_likelihood = -0.5 * (correction.distance2 + np.linalg.slogdet(correction.S)[1])
        weight = predicted.probability * np.exp(log_likelihood - log_likelihood.max(axis=1, keepdims=True))
        return Estimates(x, correction.P, weight / weight.sum(axis=1, keepdims=True), predicted.heading)


def imm() -> Tracker:
    """The tracker of core.toll: constant velocity on a straight line (`Cruise`) and `Ctra`."""
    return Tracker((Cruise(), Ctra()))


def _turned(predicted: Estimates, z: FloatArray, has: BoolArray) -> Estimates:
    """Express states whose heading is more than 90 degrees off the measured one by the opposite heading.

    The heading of a CAM is that of the movement: it turns by 180 degrees when a vehicle begins to reverse. The states
    (θ, v, a, w) and (θ + π, -v, -a, w) describe the same motion, so this changes no prediction.
    """
    heading = predicted.x[..., HEADING]
    opposite = has[..., HEADING] & (np.abs(wrap_angles(z[..., HEADING] - heading)) > 0.5 * np.pi)
    sign = np.ones_like(predicted.x)
    sign[..., SPEED] = np.where(opposite, -1.0, 1.0)
    if predicted.x.shape[-1] == SIZE:
        sign[..., ACCELERATION] = sign[..., SPEED]
    x = predicted.x * sign
    x[..., HEADING] = np.where(opposite, wrap_angles(heading + np.pi), heading)
    return replace(predicted, x=x, P=predicted.P * sign[..., :, None] * sign[..., None, :])


def _without(R: FloatArray, has: BoolArray) -> FloatArray:
    """Covariance with zeros in the rows and columns that are not available."""
    return np.where(has[..., :, None] & has[..., None, :], R, 0.0)


def _mixture(estimates: Estimates, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Means and covariances of mixtures of the models; `weights` has shape (n, mixtures, m), sums 1 over m.

    Headings are averaged as differences from that of the first model.
    """
    reference = estimates.x[:, :1]
    away = estimates.x - reference
    if estimates.heading is not None:
        away[..., estimates.heading] = wrap_angles(away[..., estimates.heading])
    mean = weights @ away
    spread = away[:, None] - mean[:, :, None]  # shape (n, mixtures, m, size)
    P = estimates.P[:, None] + spread[..., :, None] * spread[..., None, :]
    x = mean + reference
    if estimates.heading is not None:
        x[..., estimates.heading] = wrap_angles(x[..., estimates.heading])
    return x, np.einsum("njm,njmab->njab", weights, P)

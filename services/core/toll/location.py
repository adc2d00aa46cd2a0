"""Probability of each lane, with the GNSS error that the delta position leaves, and whether a track agrees with it."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from .delta import ErrorModel
from .lanes import Projection, lane_likelihood

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

COMMON, CORRECTED, INDEPENDENT = range(3)  # hypotheses on the error of a vehicle's receiver
MAX_OFFSET_M = 30.0  # width over which a vehicle that is in no lane is sought


@dataclass(frozen=True)
class Agreement:
    """How vehicles' receivers err, a priori, and how well they know it."""

    corrected_prior: float = 0.1  # the receiver is corrected already (RTK, SBAS, PPP): the delta would spoil it
    independent_prior: float = 0.005  # other satellites or another correction model: the delta does not fit
    beside_prior: float = 0.01  # the vehicle is in no lane
    stated_log_sd: float = 0.5  # natural logarithm of stated over actual standard deviation


class Fixes(NamedTuple):
    """What is known of n vehicles' positions."""

    position: FloatArray  # shape (n, 2) [m] front point, filtered, not corrected
    cov: FloatArray  # shape (n, 2, 2) [m²] of the filter: white noise only
    stated_sd: FloatArray  # shape (n,) [m] larger standard deviation that the vehicle states
    states_sd: BoolArray  # shape (n,) whether it states one
    shift: FloatArray  # shape (n, 2) [m] delta position; zero where there is none
    shift_sd: FloatArray  # shape (n,) [m] of its error; the common error's where there is none


class Location(NamedTuple):
    """Where n vehicles are."""

    lanes: FloatArray  # shape (n, L) probability of each lane; what is missing to 1 is beside the road
    hypotheses: FloatArray  # shape (n, 3) probability of COMMON, CORRECTED, INDEPENDENT
    shift: FloatArray  # shape (n, 2) [m] correction by the most probable hypothesis: the delta or zero
    sd: FloatArray  # shape (n,) [m] of the error that the position has under it, the filter's not included
    along: FloatArray  # shape (n,) [m] after the gate line, in the most probable lane, corrected
    along_sd: FloatArray  # shape (n,) [m]
    left: FloatArray  # shape (n,) [m] from the centre of the most probable lane
    by_hypothesis: FloatArray  # shape (n, 3, L) probability of each hypothesis and lane
    along_by_hypothesis: FloatArray  # shape (n, 3) [m] after the gate line, in the most probable lane
    along_sd_by_hypothesis: FloatArray  # shape (n, 3) [m]


def locate(
    projection: Projection, fixes: Fixes, allowed: BoolArray, model: ErrorModel, agreement: Agreement
) -> Location:
    """Compute lane probabilities, and whether the delta position is applied.

    Parameters
    ----------
    projection : Projection
        The positions of `fixes`, relative to L lanes.
    fixes : Fixes
        n vehicles.
    allowed : ndarray, shape (n, L)
        Lanes of the vehicle's direction; at least one of each vehicle.
    model, agreement : ErrorModel, Agreement
        A priori knowledge.

    Returns
    -------
    Location
        Where each vehicle is.

    Notes
    -----
    A vehicle's receiver errs as the unit's (the delta applies), is corrected already, or errs independently. With the
    own error σ_o of the vehicle, its white noise σ_w, what the delta leaves σ_Δ and the common error σ_c::

        hypothesis    added   variance of what is left     honest statement of the vehicle
        common        Δ       σ_o² + σ_Δ²                  σ_c² + σ_o² + σ_w²
        corrected     0       σ_o²                         σ_o² + σ_w²
        independent   0       σ_o² + σ_c²                  σ_c² + σ_o² + σ_w²

    The white noise left after filtering is in P_lat. A vehicle that states more than is honest has a larger σ_o.

        P(h, lane) ~ P(h) · N(log stated; log honest, 0.5) · P(lane) · N(left + added; 0, P_lat + left + 0.3²/3)

    The lanes' probabilities are the sums over h, those of h the sums over the lanes and "beside the road". Where there
    is no delta, `shift_sd` is the common error's, and nothing is added.
    """
    prior = (1.0 - agreement.beside_prior) * allowed / allowed.sum(axis=1, keepdims=True)
    beside = agreement.beside_prior / MAX_OFFSET_M
    d = projection.direction
    left_of = np.stack([-d[..., 1], d[..., 0]], axis=-1)
    filter_cov = fixes.cov[:, None]
    across_variance = np.vecdot(left_of, np.matvec(filter_cov, left_of))
    stated = np.where(fixes.states_sd, fixes.stated_sd, 0.0) ** 2
    common, own, white = model.common_sd**2, model.vehicle_sd**2, model.white_sd**2
    own_uncorrected = np.maximum(own, stated - common - white)
    own_corrected = np.maximum(own, stated - white)
    shift = np.array([1.0, 0.0, 0.0])[:, None, None] * fixes.shift
    variance = np.stack([own_uncorrected + fixes.shift_sd**2, own_corrected, own_uncorrected + common])
    honest = np.sqrt([common + own + white, own + white, common + own + white])[:, None]
    stated_sd = np.clip(np.where(fixes.states_sd, fixes.stated_sd, honest), honest[CORRECTED], honest[COMMON])
    surprise = (np.log(stated_sd) - np.log(honest)) / agreement.stated_log_sd
    weight = np.exp(-0.5 * surprise**2) * _priors(agreement)[:, None]
    joint = np.stack(
        [
            weight[h][:, None]
            * lane_likelihood(
                projection.left + np.vecdot(left_of, shift[h][:, None]), across_variance + variance[h][:, None], prior
            )
            for h in range(3)
        ]
    )  # shape (hypothesis, n, L)
    # One axis after the other: a sum over both adds in an order that depends on n, and evidence is derived with n = 1.
    total = joint.sum(axis=2).sum(axis=0) + (weight * beside).sum(axis=0)
    lanes = joint.sum(axis=0) / total[:, None]
    hypotheses = ((joint.sum(axis=2) + weight * beside) / total).T
    n = np.arange(len(total))
    best, lane = hypotheses.argmax(axis=1), np.where(allowed, lanes, -1.0).argmax(axis=1)
    own_direction, best_shift = d[n, lane], shift[best, n]
    filtered_variance = np.vecdot(own_direction, np.matvec(fixes.cov, own_direction))
    along_variance = filtered_variance + variance[best, n]
    return Location(
        lanes,
        hypotheses,
        best_shift,
        np.sqrt(variance[best, n]),
        projection.along[n, lane] + np.vecdot(own_direction, best_shift),
        np.sqrt(along_variance),
        projection.left[n, lane] + np.vecdot(left_of[n, lane], best_shift),
        (joint / total[:, None]).transpose(1, 0, 2),
        projection.along[n, lane][:, None] + np.vecdot(own_direction[:, None], shift.transpose(1, 0, 2)),
        np.sqrt(filtered_variance[:, None] + variance.T),
    )


def _priors(agreement: Agreement) -> FloatArray:
    rest = 1.0 - agreement.corrected_prior - agreement.independent_prior
    return np.array([rest, agreement.corrected_prior, agreement.independent_prior])

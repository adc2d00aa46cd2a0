"""Positions of vehicles relative to the lanes of a plaza, and the probability of each lane."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

CENTRE_VARIANCE = 0.3**2 / 3.0  # [m²] of a vehicle's place in its lane: uniform within 0.3 m of the centre


class Projection(NamedTuple):
    """Positions of n vehicles relative to L lanes."""

    along: FloatArray  # shape (n, L) [m] along the centre line, zero at the gate line
    left: FloatArray  # shape (n, L) [m] from the centre line, positive to the left of the driving direction
    direction: FloatArray  # shape (n, L, 2) unit vector of the driving direction there


@dataclass(frozen=True)
class LaneGeometry:
    """Centre lines of L lanes of at most S segments in the tangent plane (x east, y north)."""

    start: FloatArray  # shape (L, S, 2) [m]
    direction: FloatArray  # shape (L, S, 2) unit vectors; the last segment is repeated
    length: FloatArray  # shape (L, S) [m]; a lane's last segment has no end
    begin: FloatArray  # shape (L, S) [m] coordinate along the lane of the segment's start, zero at the gate line
    half_width: FloatArray  # shape (L,) [m]
    approach: FloatArray  # shape (L,) [m] coordinate of the approach line, negative
    exit: FloatArray  # shape (L,) [m] of the exit line, positive

    @classmethod
    def of(
        cls, centres: Sequence[FloatArray], widths: Sequence[float], lines: Sequence[tuple[float, float, float]]
    ) -> "LaneGeometry":
        """Geometry of centre lines, each of shape (k, 2); `lines` are the distances of approach, gate and exit."""
        most = max(len(centre) for centre in centres) - 1
        padded = [np.vstack([c[:-1], np.repeat(c[-2:-1], most + 1 - len(c), axis=0)]) for c in centres]
        steps = [np.diff(c, axis=0) for c in centres]
        steps = [np.vstack([s, np.repeat(s[-1:], most - len(s), axis=0)]) for s in steps]
        length = np.hypot(*np.moveaxis(np.array(steps), -1, 0))
        begin = np.empty_like(length)
        for k, (centre, (_, gate, _)) in enumerate(zip(centres, lines, strict=True)):
            own = len(centre) - 1
            distance = np.concatenate([[0.0], np.cumsum(length[k, : own - 1])])
            begin[k] = np.concatenate([distance, np.repeat(distance[-1:], most - own)]) - gate
        unit = np.array(steps) / length[..., None]
        for k, centre in enumerate(centres):
            length[k, len(centre) - 2 :] = np.inf
        return cls(
            np.array(padded),
            unit,
            length,
            begin,
            0.5 * np.array(widths),
            np.array([approach - gate for approach, gate, _ in lines]),
            np.array([leave - gate for _, gate, leave in lines]),
        )

    def project(self, position: FloatArray) -> Projection:
        """Project positions, shape (n, 2) [m], on the nearest point of each centre line.

        Before its first point and after its last one a centre line goes on straight.
        """
        away = position[:, None, None] - self.start
        along = np.vecdot(away, self.direction)
        low = np.where(np.arange(along.shape[-1]) == 0, -np.inf, 0.0)
        along = np.clip(along, low, self.length)
        foot = away - along[..., None] * self.direction
        nearest = np.argmin(np.vecdot(foot, foot), axis=-1)[..., None]
        direction = np.take_along_axis(self.direction[None], nearest[..., None], axis=2)[:, :, 0]
        offset = np.take_along_axis(foot, nearest[..., None], axis=2)[:, :, 0]
        along = np.take_along_axis(along + self.begin, nearest, axis=2)[..., 0]
        return Projection(along, direction[..., 0] * offset[..., 1] - direction[..., 1] * offset[..., 0], direction)


def lane_likelihood(left: FloatArray, variance: FloatArray, prior: FloatArray) -> FloatArray:
    """Joint density of a lateral position and each lane.

    Parameters
    ----------
    left : ndarray, shape (n, L)
        [m] Distance of the measured position from the centre of each lane.
    variance : ndarray, shape (n, L)
        [m²] Of that distance: of the track, and of the GNSS error that is left in it.
    prior : ndarray, shape (n, L)
        [-] Prior probability of each lane.

    Returns
    -------
    ndarray, shape (n, L)
        [1/m] prior · N(left; 0, variance + 0.3²/3); divided by its sum it is the posterior of the lanes.
    """
    total = variance + CENTRE_VARIANCE
    density: FloatArray = prior * np.exp(-0.5 * left**2 / total) / np.sqrt(2.0 * np.pi * total)
    return density

"""Centre line of the road as a polyline, and the nearest point on it."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..measurements import FloatArray


class CentreLinePoint(NamedTuple):
    """Nearest points of the centre line: the leading axes are those of the positions."""

    position_n: FloatArray  # [m, NED] shape (..., 3)
    along: FloatArray  # [-, NED] shape (..., 3), unit vector along the line, level
    across: FloatArray  # [-, NED] shape (..., 3), unit vector to the right, level
    distance: FloatArray  # [m] shape (...), horizontal


@dataclass(frozen=True)
class Road:
    """A centre line through points [m, NED of the local origin], shape (m, 3), m >= 2, none twice in a row.

    Raises
    ------
    ValueError
        There are fewer than two points, or two successive ones coincide on the ground.
    """

    points_n: FloatArray

    def __post_init__(self) -> None:
        if len(self.points_n) < 2 or (self._lengths2() == 0.0).any():
            raise ValueError("a road needs two points, and successive ones must differ on the ground")

    def _lengths2(self) -> FloatArray:
        lengths2: FloatArray = (np.diff(self.points_n[:, :2], axis=0) ** 2).sum(axis=1)
        return lengths2

    def foot(self, position_n: FloatArray) -> CentreLinePoint:
        """Project positions, shape (..., 3), onto the nearest segment; beyond the ends the end segments continue."""
        start, step = self.points_n[:-1], np.diff(self.points_n, axis=0)
        away = position_n[..., np.newaxis, :2] - start[:, :2]
        share = np.einsum("...mi,mi->...m", away, step[:, :2]) / self._lengths2()
        low, high = np.zeros(len(step)), np.ones(len(step))
        low[0], high[-1] = -np.inf, np.inf
        share = np.clip(share, low, high)
        off = away - share[..., np.newaxis] * step[:, :2]
        distance2 = np.einsum("...i,...i", off, off)
        nearest = distance2.argmin(axis=-1)
        along_share = np.take_along_axis(share, nearest[..., np.newaxis], axis=-1)
        at = start[nearest] + along_share * step[nearest]
        unit = np.zeros_like(at)
        unit[..., :2] = step[nearest][..., :2] / np.sqrt(self._lengths2())[nearest][..., np.newaxis]
        across = np.stack([-unit[..., 1], unit[..., 0], unit[..., 2]], axis=-1)
        distance = np.sqrt(np.take_along_axis(distance2, nearest[..., np.newaxis], axis=-1)[..., 0])
        return CentreLinePoint(at, unit, across, distance)

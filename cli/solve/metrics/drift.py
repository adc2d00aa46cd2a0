"""Horizontal drift of a solution in each GNSS outage."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from shared.maths.earth import FloatArray

from ..outages import Gap
from .errors import Errors

MINIMUM_GAP_SHARE = 0.8  # an outage is evaluated if its last truth is after this fraction of it
SHORTEST_M = 10.0  # shortest distance for an error relative to distance


@dataclass(frozen=True)
class Drift:
    """Horizontal error in one outage."""

    gap: Gap
    end_m: float  # at the last truth before a fix after the outage takes effect
    largest_m: float
    distance_m: float  # distance travelled in the outage

    @property
    def end_share(self) -> float | None:
        """Error at the end over the distance travelled; None below `SHORTEST_M`."""
        return self.end_m / self.distance_m if self.distance_m >= SHORTEST_M else None


def drifts(errors: Errors, gaps: Sequence[Gap]) -> list[Drift]:
    """Compute the drift of each outage; outages without a truth near their end are omitted.

    Parameters
    ----------
    errors : Errors
        Solution minus reference over the whole drive.
    gaps : sequence of Gap
        [ns] Start and end of each outage.

    Returns
    -------
    list of Drift
        In the order of the gaps.
    """
    return list(_drifts(errors, gaps))


def _drifts(errors: Errors, gaps: Sequence[Gap]) -> Iterator[Drift]:
    if errors.position_n is None or errors.distance_m is None:
        return
    horizontal = horizontal_error(errors.position_n)
    for first, last in gaps:
        # Fixes after the gap must have no effect: both interpolated solutions are before its end.
        rows = np.flatnonzero((errors.stamps_ns >= first) & (errors.next_solution_ns < last))
        if len(rows) and errors.stamps_ns[rows[-1]] - first >= MINIMUM_GAP_SHARE * (last - first):
            distance = float(errors.distance_m[rows[-1]] - errors.distance_m[rows[0]])
            yield Drift((first, last), float(horizontal[rows[-1]]), float(horizontal[rows].max()), distance)


def horizontal_error(errors_n: FloatArray) -> FloatArray:
    """Magnitude of the horizontal part of NED errors, shape (n,)."""
    found: FloatArray = np.hypot(errors_n[:, 0], errors_n[:, 1])
    return found


def drift_lines(found: Sequence[Drift], first_ns: int) -> Iterator[str]:
    """Format outages as CSV, one line each; times are relative to the first input."""
    yield "start_s,end_s,end_error_m,largest_error_m,distance_m\n"
    for drift in found:
        start, end = ((stamp - first_ns) * 1e-9 for stamp in drift.gap)
        yield f"{start:.3f},{end:.3f},{drift.end_m:.4f},{drift.largest_m:.4f},{drift.distance_m:.2f}\n"

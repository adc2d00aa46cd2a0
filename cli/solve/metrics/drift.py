"""How far a solution drifted in each outage of GNSS."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from shared.maths.earth import FloatArray

from ..outages import Gap
from .errors import Errors

MINIMUM_GAP_SHARE = 0.8  # a gap whose last truth is earlier than that tells nothing about its end
SHORTEST_M = 10.0  # of a way that an error is a share of: one that stands in an outage would divide by nothing


@dataclass(frozen=True)
class Drift:
    """Horizontal error in one outage."""

    gap: Gap
    end_m: float  # at the last truth that nothing behind the outage has corrected
    largest_m: float
    distance_m: float  # that the vehicle went meanwhile

    @property
    def end_share(self) -> float | None:
        """Error at the end over the distance, where the vehicle went far enough."""
        return self.end_m / self.distance_m if self.distance_m >= SHORTEST_M else None


def drifts(errors: Errors, gaps: Sequence[Gap]) -> list[Drift]:
    """Judge each outage by the truth within it; one without a truth near its end is left out.

    Parameters
    ----------
    errors : Errors
        Solution minus reference over the whole drive.
    gaps : sequence of Gap
        [ns] First and last instant of each outage.

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
        # What is behind the gap must not help: both solutions around the instant lie before its end.
        rows = np.flatnonzero((errors.stamps_ns >= first) & (errors.next_solution_ns < last))
        if len(rows) and errors.stamps_ns[rows[-1]] - first >= MINIMUM_GAP_SHARE * (last - first):
            way = float(errors.distance_m[rows[-1]] - errors.distance_m[rows[0]])
            yield Drift((first, last), float(horizontal[rows[-1]]), float(horizontal[rows].max()), way)


def horizontal_error(errors_n: FloatArray) -> FloatArray:
    """Length of the horizontal part of errors in north, east and down, shape (n,)."""
    found: FloatArray = np.hypot(errors_n[:, 0], errors_n[:, 1])
    return found


def drift_lines(found: Sequence[Drift], first_ns: int) -> Iterator[str]:
    """Print outages as CSV, one line each; times count from the first input."""
    yield "start_s,end_s,end_error_m,largest_error_m,distance_m\n"
    for drift in found:
        start, end = ((stamp - first_ns) * 1e-9 for stamp in drift.gap)
        yield f"{start:.3f},{end:.3f},{drift.end_m:.4f},{drift.largest_m:.4f},{drift.distance_m:.2f}\n"

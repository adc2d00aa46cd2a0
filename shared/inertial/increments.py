"""Inertial samples as increments of 100 ms: what the propagations of the windows take in place of each sample."""

from collections import Counter
from collections.abc import Sequence
from itertools import chain
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..maths.earth import STANDARD_GRAVITY
from ..maths.rotation import Vector

FloatArray = npt.NDArray[np.float64]

SECOND_NS = 1_000_000_000
PERIOD_NS = 100_000_000  # of the increments
GAP_NS = 100_000_000  # between two samples, beyond which the motion between them is not known
NO_TIME_NS = -(2**62)


class Increment(NamedTuple):
    """Means of specific force and angular rate over 100 ms; the first of a contiguous run follows a gap.

    One that bridges a gap spans it, and has the means of the samples at its two ends.
    """

    start_ns: int
    end_ns: int
    row: Sequence[float]  # mean force [m/s², body], mean rate [rad/s, body], duration [s]: 7 numbers
    excess_force: float  # [m/s²] magnitude of the mean specific force minus standard gravity
    after_gap: bool
    bridges: bool = False


class Decimator:
    """Integrates samples into increments, which end with the first sample at or after each multiple of 100 ms.

    A sample is the mean over the interval since the one before. Samples wait until `take`, since arrays are cheaper
    than samples one by one. Those that are not newer, not finite or beyond every sensor's range are counted and left
    out.
    """

    def __init__(
        self, largest_force: float, largest_rate: float, rejected: Counter[str], *, bridged_ns: int = 0
    ) -> None:
        """Take limits [m/s², rad/s] of each axis, where rejected samples are counted, and the longest gap to bridge."""
        self._limits = np.repeat([largest_force, largest_rate], 3)
        self._rejected, self._bridged_ns = rejected, bridged_ns
        self._waiting: list[tuple[Sequence[int], Sequence[Vector], Sequence[Vector]]] = []
        self._times, self._rows = np.empty(0, np.int64), np.empty((0, 6))  # since the last end, its sample included
        self._newest_ns, self._after_gap = NO_TIME_NS, True

    def add(self, times_ns: Sequence[int], forces_b: Sequence[Vector], rates_b: Sequence[Vector]) -> int:
        """Keep a batch of samples [m/s², rad/s; body]; give the number of batches that wait."""
        self._waiting.append((times_ns, forces_b, rates_b))
        return len(self._waiting)

    def take(self) -> list[Increment]:
        """Give the increments that the waiting samples complete."""
        if not self._waiting:
            return []
        stamps, forces, rates = (chain.from_iterable(part) for part in zip(*self._waiting, strict=True))
        new_ns = np.array(list(stamps))
        new = np.hstack([np.fromiter(chain.from_iterable(part), float).reshape(-1, 3) for part in (forces, rates)])
        self._waiting.clear()
        usable = self._usable(new_ns, new)
        times, rows = np.concatenate([self._times, new_ns[usable]]), np.concatenate([self._rows, new[usable]])
        step_ns = np.diff(times)
        gaps = step_ns > GAP_NS
        ends = 1 + np.flatnonzero(gaps | (times[1:] // PERIOD_NS != times[:-1] // PERIOD_NS))
        last = int(ends[-1]) if len(ends) else 0
        self._times, self._rows = times[last:], rows[last:]
        if not last:
            return []
        begins = np.concatenate([[0], ends[:-1]])
        sums = np.add.reduceat(rows[1 : last + 1] * (step_ns[:last, None] / SECOND_NS), begins)
        durations = (times[ends] - times[begins]) / SECOND_NS
        bridged = gaps[ends - 1] & (step_ns[ends - 1] <= self._bridged_ns)
        between = 0.5 * (rows[begins] + rows[ends]) * durations[:, None]  # trapezoidal rule
        sums = np.where(bridged[:, None], between, sums)
        means = np.column_stack([sums / durations[:, None], durations])
        excess = np.sqrt((means[:, :3] ** 2).sum(axis=1)) - STANDARD_GRAVITY
        table = zip(
            times[begins].tolist(), times[ends].tolist(), means.tolist(), excess.tolist(), gaps[ends - 1].tolist(),
            bridged.tolist(), strict=True,
        )  # fmt: skip
        found = []
        for start_ns, end_ns, row, force, is_gap, bridges in table:
            if bridges or not is_gap:
                found.append(Increment(start_ns, end_ns, row, force, self._after_gap, bridges))
            self._after_gap = is_gap and not bridges
        return found

    def _usable(self, times_ns: npt.NDArray[np.int64], rows: FloatArray) -> npt.NDArray[np.bool_]:
        """Which samples are in order and plausible, shape (n,); the others are counted."""
        beyond, finite = (np.abs(rows) > self._limits).any(axis=1), np.isfinite(rows).all(axis=1)
        reached = np.maximum.accumulate(
            np.concatenate([[self._newest_ns], np.where(finite & ~beyond, times_ns, NO_TIME_NS)])
        )
        self._newest_ns, late = int(reached[-1]), times_ns <= reached[:-1]
        usable: npt.NDArray[np.bool_] = finite & ~beyond & ~late
        if not usable.all():
            for reason, item in (
                ("imu: value is beyond every sensor's range", beyond),
                ("imu: stamp is not after the one before", late & ~beyond),
                ("imu: value is not a number", ~(finite | late | beyond)),
            ):
                self._rejected.update({reason: int(item.sum())} if item.any() else {})
        return usable

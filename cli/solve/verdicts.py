"""The verdicts of core.trust over a drive: which held when, and what was excluded."""

from array import array
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.maths.earth import FloatArray
from shared.messages.navigation import NavigationState
from shared.messages.trust import TrustLevel, TrustState

Stamps = npt.NDArray[np.int64]
# A verdict is published once a second. In a gap of all inputs, where an offline unit makes no tick, it holds as long as
# that of a live unit, whose verdict is NO_FIX after `solution_silent_after_s` of core.trust.
HOLD_TIME_NS = 2_000_000_000


@dataclass(frozen=True)
class Verdicts:
    """Adjacent intervals of one verdict each, from the first input to the last."""

    edges_ns: Stamps  # begin of each interval and end of the last, shape (n + 1,)
    states: tuple[TrustLevel, ...]  # n of them
    gnss_excluded: npt.NDArray[np.bool_]  # shape (n,)

    def seconds(self, since_ns: int) -> Mapping[TrustLevel, float]:
        """Seconds of each verdict from a time on, in the order of `TrustLevel`."""
        lengths, found = self._lengths_s(since_ns), dict.fromkeys(TrustLevel, 0.0)
        for state, length in zip(self.states, lengths.tolist(), strict=True):
            found[state] += length
        return found

    def excluded_s(self) -> float:
        """Seconds during which GNSS was excluded."""
        return float(self._lengths_s(int(self.edges_ns[0]))[self.gnss_excluded].sum())

    def exclusions(self) -> list[tuple[int, int]]:
        """Begin and end [ns] of each exclusion of GNSS."""
        steps = np.diff(np.r_[False, self.gnss_excluded, False].astype(np.int8))
        begins, ends = self.edges_ns[np.flatnonzero(steps == 1)], self.edges_ns[np.flatnonzero(steps == -1)]
        return list(zip(begins.tolist(), ends.tolist(), strict=True))

    def at(self, stamps_ns: Stamps) -> list[TrustLevel]:
        """The verdict of each time; before the first and after the last interval that of the nearest."""
        rows = np.searchsorted(self.edges_ns, stamps_ns, side="right") - 1
        return [self.states[row] for row in np.clip(rows, 0, len(self.states) - 1).tolist()]

    def _lengths_s(self, since_ns: int) -> FloatArray:
        lengths: FloatArray = np.diff(np.maximum(self.edges_ns, since_ns)) * 1e-9
        return lengths


class VerdictLog:
    """Collects the verdicts of a run, and whether any source was excluded in it."""

    def __init__(self) -> None:
        self.excluded = False  # GNSS or the odometer, at any time
        self._stamps, self._states, self._gnss = array("q"), list[TrustLevel](), list[bool]()

    def __len__(self) -> int:
        return len(self._stamps)

    def add(self, message: TrustState | NavigationState) -> None:
        """Append a verdict, or notice what fusion excludes."""
        if isinstance(message, NavigationState):
            self.excluded |= message.gnss_excluded_since_ns is not None or message.odometer_excluded
            return
        self.excluded |= message.gnss_excluded or message.odometer_excluded
        self._stamps.append(message.sampled_ns)
        self._states.append(message.state)
        self._gnss.append(message.gnss_excluded)

    def verdicts(self, first_ns: int, last_ns: int) -> Verdicts:
        """The verdicts between the first input and the last: INITIALISING before the first verdict.

        Parameters
        ----------
        first_ns, last_ns : int
            [ns] Arrival of the first and of the last input.

        Returns
        -------
        Verdicts
            A verdict that is not followed by another one within `HOLD_TIME_NS` is NO_FIX from then on.
        """
        stamps = np.maximum.accumulate(np.array(self._stamps, dtype=np.int64))  # a tick may be a little behind
        edges, states, gnss = [first_ns], [TrustLevel.INITIALISING], [False]
        ends = [*stamps[1:].tolist(), last_ns]
        for begin, end, state, excluded in zip(stamps.tolist(), ends, self._states, self._gnss, strict=True):
            edges.append(begin)
            states.append(state)
            gnss.append(excluded)
            if end - begin > HOLD_TIME_NS:
                edges.append(begin + HOLD_TIME_NS)
                states.append(TrustLevel.NO_FIX)
                gnss.append(excluded)
        bounded = np.clip(np.array([*edges, last_ns], dtype=np.int64), first_ns, last_ns)
        return Verdicts(bounded, tuple(states), np.array(gnss, dtype=bool))

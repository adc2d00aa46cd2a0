"""Collects the filter's diagnostics over a drive: phases, counts, innovations."""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from shared.maths.earth import FloatArray
from shared.messages.navigation import AidingKind, AidingUpdate, NavigationPhase, NavigationState, SetUpState


@dataclass(frozen=True)
class Updates:
    """All measurement updates of one kind, one row each."""

    stamps_ns: npt.NDArray[np.int64]
    innovation: FloatArray  # measured - predicted, NED, shape (n, 3)
    innovation_sd: FloatArray  # shape (n, 3)
    test_ratio: FloatArray  # normalised innovation squared over its gate: above 1 the measurement is rejected
    used: npt.NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.stamps_ns)


@dataclass
class Counters:
    """Collects aiding updates, phases and the newest state."""

    aligned_ns: int | None = None
    state: NavigationState | None = None
    set_up: SetUpState | None = None
    _updates: dict[AidingKind, list[AidingUpdate]] = field(default_factory=dict)

    def add_state(self, state: NavigationState) -> None:
        """Store the newest state, and the time at which the filter first navigated."""
        self.state = state
        if self.aligned_ns is None and state.phase == NavigationPhase.NAVIGATING:
            self.aligned_ns = state.sampled_ns

    def add_update(self, update: AidingUpdate) -> None:
        """Store a GNSS measurement update."""
        if update.kind in (AidingKind.GNSS_POSITION, AidingKind.GNSS_VELOCITY) and len(update.innovation) == 3:
            self._updates.setdefault(update.kind, []).append(update)

    def updates(self, kind: AidingKind) -> Updates:
        """All updates of a kind."""
        found = self._updates.get(kind, [])
        return Updates(
            np.array([u.sampled_ns for u in found], dtype=np.int64),
            np.array([u.innovation for u in found]).reshape(-1, 3),
            np.array([u.innovation_sd for u in found]).reshape(-1, 3),
            np.array([u.test_ratio for u in found], dtype=float),
            np.array([u.used for u in found], dtype=bool),
        )

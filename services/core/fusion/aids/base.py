"""Base of all measurements. A new kind is one file with one class that has these members."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from shared.messages.navigation import AidingKind

from ..inertial.filter import ErrorStateFilter

FloatArray = npt.NDArray[np.float64]


class Observation(NamedTuple):
    """One observation of a measurement: z = measured - predicted = H x + noise of covariance R."""

    kind: AidingKind
    z: FloatArray
    H: FloatArray
    R: FloatArray
    unfit: str | None = None  # why it is published and not used


class Measurement(Protocol):
    """Something that was measured at an instant."""

    @property
    def time_ns(self) -> int:
        """When it was true, on the clock of the inertial samples."""
        ...

    @property
    def received_ns(self) -> int:
        """When it arrived at the driver."""
        ...

    @property
    def source(self) -> str:
        """Which device."""
        ...

    def observers(self) -> Iterator[Callable[[ErrorStateFilter], Observation]]:
        """Functions that give its observations, each to be called after the one before has been used."""
        ...


@dataclass(frozen=True)
class FilterEvent:
    """An event in the order of the measurements that is none itself, such as a found delay."""

    time_ns: int

    @property
    def received_ns(self) -> int:
        """When it became known; not used."""
        return self.time_ns

    @property
    def source(self) -> str:
        """Process that found it."""
        return "core.fusion"

    def observers(self) -> Iterator[Callable[[ErrorStateFilter], Observation]]:
        """Nothing is measured."""
        yield from ()


class Height(NamedTuple):
    """Innovation [m] of a height without which a position was used, and whether the filter gives way to it."""

    innovation: float
    innovation_sd: float
    taken_over: bool


class Outcome(NamedTuple):
    """What became of one observation."""

    time_ns: int
    source: str
    kind: AidingKind
    innovation: tuple[float, ...]
    innovation_sd: tuple[float, ...]
    test_ratio: float
    used: bool
    reason: str | None = None
    weight: float = 1.0  # on the inverse of R
    measurement: type = object  # class of what was observed
    height: Height | None = None  # left out


class Counts(NamedTuple):
    """What was used and what was not."""

    fixes_used: int = 0
    fixes_rejected: int = 0
    imu_gaps: int = 0
    resets: int = 0
    epochs_repeated: int = 0  # by a receiver: left out

    def with_position(self, used: bool) -> "Counts":
        """Count one more position."""
        if used:
            return self._replace(fixes_used=self.fixes_used + 1)
        return self._replace(fixes_rejected=self.fixes_rejected + 1)

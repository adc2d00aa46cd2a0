"""Base of all measurements. A new kind is one folder, and one row of `AIDS` in `kinds.py`."""

from collections.abc import Callable, Iterator, Mapping
from enum import Enum, auto
from types import MappingProxyType
from typing import TYPE_CHECKING, ClassVar, NamedTuple, Protocol, Self

import numpy as np
import numpy.typing as npt

from shared.maths.earth import Geodetic
from shared.maths.rotation import Vector
from shared.messages.navigation import AidingKind

from ..inertial.filter import ErrorStateFilter

if TYPE_CHECKING:
    from .dual_antenna.aid import BaselineHeading
    from .gnss.fix import GnssPosition, GnssVelocity
    from .odometer.aid import WheelSpeed

FloatArray = npt.NDArray[np.float64]


class Sensor(Enum):
    """Sensor that a measurement is of, as far as it can be excluded."""

    GNSS = auto()
    ODOMETER = auto()
    OTHER = auto()


class Observation(NamedTuple):
    """One observation of a measurement: z = measured - predicted = H x + noise of covariance R."""

    kind: AidingKind
    z: FloatArray
    H: FloatArray
    R: FloatArray
    unfit: str | None = None  # why it is published and not used


class Start(Protocol):
    """What a measurement can tell an alignment."""

    def use_velocity(self, measurement: "GnssVelocity") -> None:
        """Use a velocity for heading and initial velocity."""

    def use_heading(self, measurement: "BaselineHeading", sd: float) -> None:
        """Use the heading of two antennas with its standard deviation [rad]."""

    def start_at(self, fix: "GnssPosition") -> ErrorStateFilter | None:
        """Use a position; returns the filter if it can start."""


class MotionSink(Protocol):
    """What a measurement can tell the checks of the set-up."""

    def see_position(self, position: Geodetic) -> None:
        """Take a position."""

    def see_velocity(self, velocity: Vector, axes: int) -> None:
        """Take a velocity [m/s, NED], of which so many axes were measured."""

    def see_speed(self, speed: float) -> None:
        """Take a speed [m/s]."""


class NonInertial(Protocol):
    """What a measurement can tell a model of the vehicle's motion that has no inertial sensors."""

    def use_position(self, fix: "GnssPosition") -> None:
        """Use a position."""

    def use_velocity(self, fix: "GnssVelocity") -> None:
        """Use a velocity."""

    def use_speed(self, wheels: "WheelSpeed") -> None:
        """Use a speed of the vehicle."""


class Kind:
    """What a kind of measurement may override; a measurement of another kind does nothing of it."""

    sensor: ClassVar[Sensor] = Sensor.OTHER
    is_fix: ClassVar[bool] = False  # it is a position: counted, and after many rejected ones the filter is reset
    epoch: ClassVar[bool] = False  # it is of an epoch of a receiver, which a fault-free fix may replace
    quantity: ClassVar[str] = ""  # of which one value in a period is used
    period_ns: ClassVar[int] = 0  # 0: all
    # Standard deviations by which each rejected one inflates the covariance, as `ErrorStateFilter.inflate` names them;
    # not empty of measurements of GNSS: those are down-weighted beyond the gate, and their receiver may be excluded.
    inflation: ClassVar[Mapping[str, float]] = MappingProxyType({})
    left_out: tuple[str, ...] = ()  # satellites; not empty of a fault-free fix

    def implausible(self) -> str | None:
        """Plausibility limit that it violates, or None."""
        return None

    def corrected(self, position_s: float, velocity_s: float) -> Self:
        """At its time of validity, where positions and velocities of GNSS are late by these times [s]."""
        return self

    def without_height(self) -> Self:
        """Without what it says of the height."""
        return self

    def align(self, start: Start) -> ErrorStateFilter | None:
        """Tell an alignment what it measures; returns the filter if it can start."""
        return None

    def show(self, sink: MotionSink) -> None:
        """Tell the checks of the set-up what it measures."""

    def tell(self, model: NonInertial) -> None:
        """Tell a model of motion without inertial sensors what it measures."""


class Measurement(Protocol):
    """Something that was measured at an instant; its class is a `Kind`."""

    sensor: ClassVar[Sensor]
    is_fix: ClassVar[bool]
    epoch: ClassVar[bool]
    quantity: ClassVar[str]
    period_ns: ClassVar[int]
    inflation: ClassVar[Mapping[str, float]]

    @property
    def left_out(self) -> tuple[str, ...]:
        """Satellites that a fault-free fix is without."""
        ...

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

    def implausible(self) -> str | None:
        """See `Kind`."""
        ...

    def corrected(self, position_s: float, velocity_s: float) -> Self:
        """See `Kind`."""
        ...

    def without_height(self) -> Self:
        """See `Kind`."""
        ...

    def align(self, start: Start) -> ErrorStateFilter | None:
        """See `Kind`."""
        ...

    def show(self, sink: MotionSink) -> None:
        """See `Kind`."""
        ...

    def tell(self, model: NonInertial) -> None:
        """See `Kind`."""
        ...


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

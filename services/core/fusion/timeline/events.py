"""Events on the timeline: what is found between measurements, and applied in the order of the stamps."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from operator import methodcaller
from typing import TYPE_CHECKING, ClassVar

from ..aids.base import Kind, Observation, Sensor
from ..aids.gnss.heights import inflate_for_wrong_heights
from ..inertial.filter import ErrorStateFilter
from ..inertial.imu_gaps import inflate_for_lost_time
from ..integrity.disagreement import Disagreement

if TYPE_CHECKING:
    from .engine import Engine

TURN_RATE, ACCELERATION = 0.1, 2.0  # [rad/s, m/s²] of a car: what a wrong delay errs by, per second


@dataclass(frozen=True)
class Event(Kind, ABC):
    """Something that is no measurement and changes the engine at its stamp."""

    time_ns: int
    excludes: ClassVar[Sensor | None] = None  # source that it leaves out or takes back

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

    @abstractmethod
    def apply(self, engine: "Engine") -> None:
        """Change the engine."""


@dataclass(frozen=True)
class LostTime(Event):
    """Samples of the time `span_s` [s] before this instant were rejected."""

    span_s: float

    def apply(self, engine: "Engine") -> None:
        """Inflate the covariance."""
        engine.attempt(partial(inflate_for_lost_time, span_s=self.span_s))


@dataclass(frozen=True)
class WrongHeights(Event):
    """Heights of GNSS up to this instant had the wrong sign; later ones are not used."""

    def apply(self, engine: "Engine") -> None:
        """Inflate the covariance."""
        engine.attempt(inflate_for_wrong_heights)


@dataclass(frozen=True)
class GnssDelay(Event):
    """Delays of GNSS [s] that the check of the set-up has found and no setting corrects; zero ends them."""

    position_s: float
    velocity_s: float
    change_s: float

    @property
    def of_stamps(self) -> tuple[float, float]:
        """Delays of positions and velocities [s] by which stamps are corrected.

        Positions that lag while velocities are in time are smoothed, by nobody knows what: they are not moved.
        """
        return (self.position_s, self.velocity_s) if self.velocity_s else (0.0, 0.0)

    @property
    def left_s(self) -> float:
        """Delay of positions [s] that is not corrected."""
        return abs(self.position_s - self.of_stamps[0])

    def apply(self, engine: "Engine") -> None:
        """Correct late fixes from now on, and inflate the covariance for what earlier ones have done."""
        engine.aids.use_delay(self.of_stamps, self.left_s)
        engine.attempt(self._correct)

    def _correct(self, navigation: ErrorStateFilter) -> None:
        navigation.correct_delay(*self.of_stamps)
        navigation.inflate(attitude_sd=TURN_RATE * self.change_s, velocity_sd=ACCELERATION * self.change_s)


@dataclass(frozen=True)
class GnssExcluded(Event):
    """From this instant on GNSS is not used.

    `since_ns` is the suspect time; no GNSS with a later stamp is used. `contaminated_s` [s] is the time since then of
    which GNSS is in the state already, because no snapshot is old enough: the covariance is inflated by its largest
    effect.
    """

    excludes = Sensor.GNSS

    since_ns: int
    contaminated_s: float = 0.0

    def apply(self, engine: "Engine") -> None:
        """Leave GNSS out; a second exclusion keeps the earlier suspect time."""
        known_ns = engine.exclusions.gnss_since_ns
        since_ns = self.since_ns if known_ns is None else min(self.since_ns, known_ns)
        engine.exclusions = replace(engine.exclusions, gnss_since_ns=since_ns, readmitted_after_s=None)
        if self.contaminated_s > 0.0:
            engine.attempt(partial(engine.aids.undetected_shift.inflate, span_s=self.contaminated_s))


@dataclass(frozen=True)
class GnssReadmitted(Event):
    """From this instant on GNSS is used again."""

    excludes = Sensor.GNSS

    def apply(self, engine: "Engine") -> None:
        """Use GNSS again; its first position tells how far dead reckoning was off."""
        since_ns = engine.exclusions.gnss_since_ns
        if since_ns is not None:
            outage_s = (self.time_ns - since_ns) * 1e-9
            engine.exclusions = replace(
                engine.exclusions, gnss_since_ns=None, test_ratio=None, readmitted_after_s=outage_s
            )


@dataclass(frozen=True)
class OdometerExclusion(Event):
    """From this instant on the odometer is excluded, or used again."""

    excludes = Sensor.ODOMETER

    excluded: bool

    def apply(self, engine: "Engine") -> None:
        """Leave the odometer out; its scale is estimated anew."""
        begins = self.excluded and not engine.exclusions.odometer
        engine.exclusions = replace(engine.exclusions, odometer=self.excluded)
        if begins:
            engine.attempt(methodcaller("reset_block", "odometer_scale"))


@dataclass(frozen=True)
class ReturnAfterInterference(Event):
    """The last return of GNSS was one after interference: what it may be off by is held as an offset."""

    def apply(self, engine: "Engine") -> None:
        """Hold it."""
        engine.hold_after_interference()


@dataclass(frozen=True)
class HeldOffset(Event):
    """From this instant on the level holds a disagreement of two solutions."""

    disagreement: Disagreement

    def apply(self, engine: "Engine") -> None:
        """Hold it."""
        engine.hold(self.disagreement)

"""Corrects the stamps of measurements by their estimated delays.

The filter estimates the delay of each kind of measurement (`error_model.DELAYS`) to first order only, so stamps are
corrected as soon as the estimate is larger than `WORTH_S`. The decision uses the oldest snapshot, which no
out-of-sequence measurement can change any more, and takes effect on stamps that are not yet in use. The result
therefore depends on stamps alone.
"""

from dataclasses import dataclass, replace
from math import hypot, sqrt
from typing import TYPE_CHECKING

from shared.maths.rotation import Vector

from ..inertial import error_model as em
from ..aids.base import FilterEvent, Measurement
from ..aids.dual_antenna import BaselineHeading
from ..aids.gnss.fix import GnssPosition, GnssVelocity
from ..aids.odometer import WheelSpeed
from ..settings import Settings
from .delay_search import DelaySearch

if TYPE_CHECKING:
    from ..inertial.filter import ErrorStateFilter

WORTH_S = 0.005  # smallest correction of a stamp
KNOWN_S = 0.05  # standard deviation above which a delay counts as unknown
AHEAD_NS = 2_500_000_000  # stamps in use are less far ahead of the inertial samples
BEYOND_S = 0.15  # difference from which the search replaces the linear estimate of the filter
KEPT = 8  # corrections; older ones concern stamps before the oldest snapshot
VELOCITY_SD_S = 0.1  # of the difference between the delays of position and velocity
TURN_RATE, ACCELERATION, SPEED = 0.1, 2.0, 15.0  # [rad/s, m/s², m/s] of a car: what a wrong delay errs by, per second


@dataclass(frozen=True)
class FoundDelay(FilterEvent):
    """New delay of GNSS, found by the search."""

    delay_s: float
    sd_s: float
    change_s: float

    def apply(self, navigation: "ErrorStateFilter") -> None:
        """Set the delay of velocities to the one found, and inflate the covariance for the error of the old one."""
        navigation.set_parameter(em.GNSS_VELOCITY_DELAY, 0.0, VELOCITY_SD_S)
        navigation.set_parameter(em.GNSS_DELAY, self.delay_s, hypot(self.sd_s, VELOCITY_SD_S))
        P = navigation.P.copy()  # the sum of the two is better known than each
        P[em.GNSS_DELAY, em.GNSS_VELOCITY_DELAY] = P[em.GNSS_VELOCITY_DELAY, em.GNSS_DELAY] = -(VELOCITY_SD_S**2)
        navigation.P = P
        wrong_s = abs(self.change_s)
        navigation.inflate(
            attitude_sd=TURN_RATE * wrong_s, velocity_sd=ACCELERATION * wrong_s, position_sd=SPEED * wrong_s
        )


@dataclass(frozen=True)
class SuspectedDelay(FilterEvent):
    """Delays of GNSS [s] that the check of the set-up has found and no setting corrects; zero ends them."""

    position_s: float
    velocity_s: float
    change_s: float

    @property
    def corrected(self) -> tuple[float, float]:
        """Delays of positions and velocities [s] by which stamps are corrected.

        Positions that lag while velocities are in time are smoothed, by nobody knows what: they are not moved.
        """
        return (self.position_s, self.velocity_s) if self.velocity_s else (0.0, 0.0)

    @property
    def left_s(self) -> float:
        """Delay of positions [s] that is not corrected."""
        return abs(self.position_s - self.corrected[0])

    def apply(self, navigation: "ErrorStateFilter") -> None:
        """Correct late fixes from now on, and inflate the covariance for what earlier ones have done."""
        navigation.correct_delay(*self.corrected)
        navigation.inflate(attitude_sd=TURN_RATE * self.change_s, velocity_sd=ACCELERATION * self.change_s)

    def begin(self, started: "ErrorStateFilter") -> None:
        """Correct late fixes of a filter that starts at the place that a corrected one has given."""
        place = started.inertial.position
        started.correct_delay(*self.corrected)
        started.inertial = started.inertial._replace(position=place)


class Timing:
    """Corrections of stamps by kind of measurement, each valid from a stamp on."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._search = DelaySearch(settings.history_s) if settings.estimate_delays else None
        self._removed: dict[type, list[tuple[int, float]]] = {}
        self._found_s = 0.0  # by the search
        self._frozen = False  # while GNSS is excluded

    def at(self, time_ns: int) -> "Timing":
        """Copy with only the corrections that are valid from a time or earlier; the search begins anew."""
        twin = Timing(self._settings)
        twin._removed = {kind: [one for one in steps if one[0] <= time_ns] for kind, steps in self._removed.items()}
        twin._found_s = self._found_s
        return twin

    def freeze(self, *, frozen: bool) -> None:
        """Learn nothing while GNSS is excluded; the search begins anew."""
        self._frozen = frozen
        self._search = DelaySearch(self._settings.history_s) if self._settings.estimate_delays else None

    def sample(self, time_ns: int, force: Vector, rate: Vector) -> None:
        """Pass the next inertial sample to the search."""
        if self._search is not None:
            self._search.sample(time_ns, force, rate)

    def corrected(self, measurement: Measurement) -> Measurement:
        """Correct the stamp of a measurement by the delay known for it."""
        if self._search is None and not self._removed:
            return measurement
        if self._search is not None and isinstance(measurement, GnssVelocity) and not self._frozen:
            self._search.see(measurement)
        if isinstance(measurement, GnssPosition | GnssVelocity | WheelSpeed):
            removed_s = self._at(type(measurement), measurement.time_ns)
            return replace(measurement, time_ns=measurement.time_ns - round(removed_s * 1e9), removed_s=removed_s)
        if isinstance(measurement, BaselineHeading):
            removed_s = self._at(GnssPosition, measurement.time_ns)
            return replace(measurement, time_ns=measurement.time_ns - round(removed_s * 1e9))
        return measurement

    def suspect(self, delay: SuspectedDelay) -> None:
        """Correct stamps that are not in use yet by delays that the check of the set-up has found."""
        for kind, delay_s in zip((GnssPosition, GnssVelocity), delay.corrected, strict=True):
            self._remove(kind, delay.time_ns + AHEAD_NS, delay_s)

    def learn(self, now_ns: int, navigation: "ErrorStateFilter | None") -> FoundDelay | None:
        """Decide the corrections of stamps later than `AHEAD_NS` from now.

        Parameters
        ----------
        now_ns : int
            Stamp of the newest sample.
        navigation : ErrorStateFilter or None
            Of the oldest snapshot.

        Returns
        -------
        FoundDelay or None
            To be applied to the filter at its time.
        """
        if self._search is None or self._frozen:
            return None
        from_ns, current_s = now_ns + AHEAD_NS, self._found_s
        if navigation is not None:
            current_s = navigation.parameter(em.GNSS_DELAY) + navigation.parameter(em.GNSS_VELOCITY_DELAY)
        newest_ns = max((steps[-1][0] for steps in self._removed.values() if steps), default=0)
        waiting = newest_ns + 2 * AHEAD_NS > now_ns  # the oldest snapshot does not contain it yet
        found = self._search.result(current_s)
        if abs(found.delay_s - current_s) > max(BEYOND_S, 2.0 * found.sd_s) and not waiting:
            delay_s = round(found.delay_s, 3)
            self._found_s = delay_s
            for kind in (GnssPosition, GnssVelocity):
                self._remove(kind, from_ns, delay_s)
            early_ns = from_ns - round(max(0.0, delay_s) * 1e9)
            return FoundDelay(early_ns, delay_s, found.sd_s, delay_s - current_s)
        if navigation is not None and not waiting:
            self._follow(from_ns, navigation)
        return None

    def _follow(self, from_ns: int, navigation: "ErrorStateFilter") -> None:
        gnss, velocity, odometer = (em.GNSS_DELAY,), (em.GNSS_DELAY, em.GNSS_VELOCITY_DELAY), (em.ODOMETER_DELAY,)
        for kind, places in ((GnssPosition, gnss), (GnssVelocity, velocity), (WheelSpeed, odometer)):
            variance = float(sum(navigation.P[i, j] for i in places for j in places))
            delay_s = round(sum(navigation.parameter(place) for place in places), 3)
            if variance < KNOWN_S**2 and abs(delay_s - self._at(kind, from_ns)) > WORTH_S:
                self._remove(kind, from_ns, delay_s)

    def _remove(self, kind: type, from_ns: int, delay_s: float) -> None:
        self._removed[kind] = [*self._removed.get(kind, ())[-KEPT:], (from_ns, delay_s)]

    def _at(self, kind: type, stamp_ns: int) -> float:
        return next((s for from_ns, s in reversed(self._removed.get(kind, ())) if from_ns <= stamp_ns), 0.0)


def known_delays(navigation: "ErrorStateFilter | None") -> tuple[tuple[float, float], ...] | None:
    """Delay and its standard deviation [s] of GNSS, odometer and GNSS velocity, from a filter that estimates them."""
    if navigation is None:
        return None
    variances = navigation.P.diagonal()
    return tuple((navigation.parameter(place), sqrt(variances[place])) for place in em.DELAYS.tolist())

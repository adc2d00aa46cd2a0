"""Takes the delays that were found out of the stamps of measurements, so that each is used when it was true.

The filter estimates by how much older a measurement is than its stamp says (`error_model.DELAYS`). What is left of it
after the stamp was moved, it takes into account to first order only; so stamps are moved as soon as that is worth it.
Decided is by what no late measurement can change any more, the filter at the end of the memory, and it takes effect on
stamps that are not yet in use. So the result still depends on stamps alone.
"""

from dataclasses import dataclass, replace
from math import hypot, sqrt
from typing import TYPE_CHECKING

from shared.maths.rotation import Vector

from ..filter import error_model as em
from ..measurements.base import Measurement, News
from ..measurements.dual_antenna import BaselineHeading
from ..measurements.gnss import GnssPosition, GnssVelocity
from ..measurements.odometer import WheelSpeed
from ..settings import Settings
from .delay_search import DelaySearch

if TYPE_CHECKING:
    from ..filter.eskf import ErrorStateFilter

WORTH_S = 0.005  # that the stamps are moved by it
KNOWN_S = 0.05  # standard deviation above which it is not known
AHEAD_NS = 2_500_000_000  # no stamp in use is so far ahead of the inertial samples
BEYOND_S = 0.15  # that a search finds, and a filter that is linear does not
KEPT = 8  # steps; older ones are of stamps that no memory holds
VELOCITY_SD_S = 0.1  # by which position and velocity may differ in age


@dataclass(frozen=True)
class FoundDelay(News):
    """From this instant on GNSS is known to be older than was thought."""

    delay_s: float
    sd_s: float
    change_s: float

    def tell(self, navigation: "ErrorStateFilter") -> None:
        """Take the delay of velocities for the one found, and what was learned with the wrong one for doubtful."""
        navigation.set_parameter(em.GNSS_VELOCITY_DELAY, 0.0, VELOCITY_SD_S)
        navigation.set_parameter(em.GNSS_DELAY, self.delay_s, hypot(self.sd_s, VELOCITY_SD_S))
        P = navigation.P.copy()  # the sum of the two is known better than each
        P[em.GNSS_DELAY, em.GNSS_VELOCITY_DELAY] = P[em.GNSS_VELOCITY_DELAY, em.GNSS_DELAY] = -(VELOCITY_SD_S**2)
        navigation.P = P
        wrong_s = abs(self.change_s)
        navigation.inflate(attitude_sd=0.1 * wrong_s, velocity_sd=2.0 * wrong_s, position_sd=15.0 * wrong_s)


class Timing:
    """What was taken out of the stamps, by what they are stamps of, and from which stamp on."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._search = DelaySearch(settings.history_s) if settings.estimate_delays else None
        self._removed: dict[type, list[tuple[int, float]]] = {}
        self._told_s = 0.0  # by the search
        self._frozen = False  # while GNSS is excluded

    def at(self, time_ns: int) -> "Timing":
        """Copy with only what was taken out of stamps until a time; the search begins anew."""
        twin = Timing(self._settings)
        twin._removed = {kind: [one for one in steps if one[0] <= time_ns] for kind, steps in self._removed.items()}
        twin._told_s = self._told_s
        return twin

    def freeze(self, *, frozen: bool) -> None:
        """Learn nothing while GNSS is excluded; the search begins anew."""
        self._frozen = frozen
        self._search = DelaySearch(self._settings.history_s) if self._settings.estimate_delays else None

    def sample(self, time_ns: int, force: Vector, rate: Vector) -> None:
        """Show the next inertial sample to the search."""
        if self._search is not None:
            self._search.sample(time_ns, force, rate)

    def corrected(self, measurement: Measurement) -> Measurement:
        """Give a measurement with the stamp at which it was true, as far as that is known."""
        if self._search is None:
            return measurement
        if isinstance(measurement, GnssVelocity) and not self._frozen:
            self._search.see(measurement)
        if isinstance(measurement, GnssPosition | GnssVelocity | WheelSpeed):
            removed_s = self._at(type(measurement), measurement.time_ns)
            return replace(measurement, time_ns=measurement.time_ns - round(removed_s * 1e9), removed_s=removed_s)
        if isinstance(measurement, BaselineHeading):
            removed_s = self._at(GnssPosition, measurement.time_ns)
            return replace(measurement, time_ns=measurement.time_ns - round(removed_s * 1e9))
        return measurement

    def learn(self, now_ns: int, navigation: "ErrorStateFilter | None") -> FoundDelay | None:
        """Decide what is taken out of stamps beyond `AHEAD_NS` from now on.

        Parameters
        ----------
        now_ns : int
            Stamp of the newest sample.
        navigation : ErrorStateFilter or None
            As it was at the end of the memory.

        Returns
        -------
        FoundDelay or None
            What the filter has to be told at its time.
        """
        if self._search is None or self._frozen:
            return None
        from_ns, told_s = now_ns + AHEAD_NS, self._told_s
        if navigation is not None:
            told_s = navigation.parameter(em.GNSS_DELAY) + navigation.parameter(em.GNSS_VELOCITY_DELAY)
        newest_ns = max((steps[-1][0] for steps in self._removed.values() if steps), default=0)
        waiting = newest_ns + 2 * AHEAD_NS > now_ns  # the filter of the end of the memory does not know of it yet
        found = self._search.result(told_s)
        if abs(found.delay_s - told_s) > max(BEYOND_S, 2.0 * found.sd_s) and not waiting:
            delay_s = round(found.delay_s, 3)
            self._told_s = delay_s
            for kind in (GnssPosition, GnssVelocity):
                self._remove(kind, from_ns, delay_s)
            early_ns = from_ns - round(max(0.0, delay_s) * 1e9)
            return FoundDelay(early_ns, delay_s, found.sd_s, delay_s - told_s)
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

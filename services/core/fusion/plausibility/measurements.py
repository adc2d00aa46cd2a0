"""What no measurement of a road vehicle says, whatever its form: it is counted and does not come to the filter."""

from collections import Counter
from collections.abc import Callable
from math import hypot, isfinite

from shared.maths.earth import Geodetic

from ..filter.propagation import FASTEST_M_S, HIGHEST_LATITUDE
from ..measurements.base import Measurement
from ..measurements.gnss import GnssPosition, GnssVelocity
from ..measurements.magnetometer import MagneticHeading
from ..measurements.odometer import WheelSpeed

LOWEST_M, HIGHEST_M = -10_000.0, 50_000.0  # no road, and no balloon of a test either
STRONGEST_FIELD = 100.0  # times the Earth's
LATE_PERIODS = 100  # by which a value may come after a newer one; more, and the clock of its device was set back
SILENT_NS = 3_600_000_000_000  # after which a device is not there any more, or has another name
DEVICES = 32  # no vehicle has more; what is learnt of each takes memory


class Devices:
    """Who is heard: those who spoke first, as many as a vehicle can have; the others are counted in `rejects`.

    One that was silent for an hour makes room, by the clock of the inertial samples: stamps of devices may be anything.
    """

    def __init__(self, rejects: Counter[str], clock: Callable[[], int]) -> None:
        self._rejects, self._clock = rejects, clock
        self._heard: dict[str, int] = {}  # when each was heard last
        self._used: dict[tuple[str, str], int] = {}  # period of the newest value that was taken

    def is_known(self, source: str) -> bool:
        """Whether a device is heard."""
        now_ns = self._clock()
        if source not in self._heard and len(self._heard) >= DEVICES:
            self._forget_the_silent(now_ns)
            if len(self._heard) >= DEVICES:
                self._rejects["more devices than a vehicle has"] += 1
                return False
        self._heard[source] = now_ns
        return True

    def _forget_the_silent(self, now_ns: int) -> None:
        self._heard = {name: at for name, at in self._heard.items() if abs(now_ns - at) <= SILENT_NS}
        self._used = {key: period for key, period in self._used.items() if key[0] in self._heard}

    def is_due(self, source: str, quantity: str, time_ns: int, period_ns: int) -> bool:
        """Whether it is the first value of its period to come: by the stamps, whenever the device was switched on."""
        if not self.is_known(source):
            return False
        key, period = (source, quantity), time_ns // period_ns
        used = self._used.get(key)
        if used is not None and 0 <= used - period < LATE_PERIODS:
            return False
        self._used[key] = period
        return True


def impossible(measurement: Measurement) -> str | None:
    """Say why a measurement cannot be true, or None if it can."""
    match measurement:
        case GnssPosition():
            return _no_place(measurement.position)
        case GnssVelocity() if not hypot(*measurement.velocity) < FASTEST_M_S:
            return "velocity of no vehicle"
        case WheelSpeed() if not (abs(measurement.speed) < FASTEST_M_S and abs(measurement.resolution) < FASTEST_M_S):
            return "speed of no vehicle"
        case MagneticHeading() if not hypot(*measurement.field_b) < STRONGEST_FIELD:
            return "magnetic field of no vehicle"
    return None


def _no_place(position: Geodetic) -> str | None:
    if not isfinite(sum(position)):
        return "position not finite"
    if not abs(position.latitude) < HIGHEST_LATITUDE:
        return "position too near a pole"
    return None if LOWEST_M <= position.height <= HIGHEST_M else "height of no road"

"""What lies between a device and the on-board unit: a clock of its own, and a delay on the way."""

from math import inf

import numpy as np

MAXIMUM_DRIFT_PPM = 20.0  # of a crystal in a car


class DeviceClock:
    """A device's own time: it starts anywhere and runs a little fast or slow.

    Times are offsets [ns] from the start of the simulation, on the time line of the on-board unit.
    """

    def __init__(self, rng: np.random.Generator, *, latest_start_ns: int) -> None:
        self.drift_ppm = float(rng.uniform(-MAXIMUM_DRIFT_PPM, MAXIMUM_DRIFT_PPM))
        self._start_ns = int(rng.integers(latest_start_ns))

    def period_ns(self, nominal_ns: int) -> int:
        """How long what the device takes for `nominal_ns` really lasts."""
        return round(nominal_ns * (1.0 + self.drift_ppm * 1e-6))

    def true_ns(self, device_ns: int) -> int:
        """When the device's clock shows so much: the inverse of `reading_ns`."""
        return round((device_ns - self._start_ns) * (1.0 + self.drift_ppm * 1e-6))

    def reading_ns(self, true_ns: int) -> int:
        """What the device's clock shows."""
        return self._start_ns + round(true_ns / (1.0 + self.drift_ppm * 1e-6))


class Delay:
    """The way of bytes: never shorter than a minimum, now and then longer, and never overtaking.

    The part above the minimum is exponential, cut off at a maximum.
    """

    def __init__(self, minimum_s: float, mean_excess_s: float, maximum_s: float, rng: np.random.Generator) -> None:
        self._minimum_s, self._mean_s, self._maximum_s = minimum_s, mean_excess_s, maximum_s
        self._rng = rng
        self._last_ns = -inf

    def arrival_ns(self, sent_ns: int) -> int:
        """When something that was sent arrives."""
        delay_s = min(self._maximum_s, self._minimum_s + self._mean_s * self._rng.standard_exponential())
        arrival_ns = max(sent_ns + round(delay_s * 1e9), int(max(self._last_ns, 0)))
        self._last_ns = arrival_ns
        return arrival_ns

"""Device clock (offset and drift) and transmission delay between a simulated device and the on-board unit."""

from math import inf

import numpy as np

MAXIMUM_DRIFT_PPM = 20.0  # frequency error of a crystal oscillator over the automotive temperature range


class DeviceClock:
    """A device clock with a random offset and a constant frequency error.

    True times are offsets [ns] from the start of the simulation, in the time of the on-board unit.
    """

    def __init__(self, rng: np.random.Generator, *, latest_start_ns: int) -> None:
        self.drift_ppm = float(rng.uniform(-MAXIMUM_DRIFT_PPM, MAXIMUM_DRIFT_PPM))
        self._start_ns = int(rng.integers(latest_start_ns))

    def period_ns(self, nominal_ns: int) -> int:
        """True duration of `nominal_ns` as counted by the device's clock."""
        return round(nominal_ns * (1.0 + self.drift_ppm * 1e-6))

    def true_ns(self, device_ns: int) -> int:
        """True time of a reading of the device's clock: the inverse of `reading_ns`."""
        return round((device_ns - self._start_ns) * (1.0 + self.drift_ppm * 1e-6))

    def reading_ns(self, true_ns: int) -> int:
        """Reading of the device's clock at a true time."""
        return self._start_ns + round(true_ns / (1.0 + self.drift_ppm * 1e-6))


class Delay:
    """Random transmission delay that preserves the order.

    The delay is a minimum plus an exponentially distributed part, limited to a maximum.
    """

    def __init__(self, minimum_s: float, mean_excess_s: float, maximum_s: float, rng: np.random.Generator) -> None:
        self._minimum_s, self._mean_s, self._maximum_s = minimum_s, mean_excess_s, maximum_s
        self._rng = rng
        self._last_ns = -inf

    def arrival_ns(self, sent_ns: int) -> int:
        """Arrival time of data sent at `sent_ns`."""
        delay_s = min(self._maximum_s, self._minimum_s + self._mean_s * self._rng.standard_exponential())
        arrival_ns = max(sent_ns + round(delay_s * 1e9), int(max(self._last_ns, 0)))
        self._last_ns = arrival_ns
        return arrival_ns

"""A simulated drive for the motion monitor: true speed, a GNSS receiver and an OBD-II odometer."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from math import exp, floor, sqrt

import numpy as np

from services.core.motion_conflict.monitor import MotionMonitor
from services.core.motion_conflict.verdicts import MotionVerdicts

SECOND_NS = 1_000_000_000
KM_H = 1.0 / 3.6
Speed = Callable[[float], float]
Gnss = Callable[[float, float], float | None]


def drives_and_stops(seed: int, duration_s: float) -> Speed:
    """Piecewise linear speed [m/s] between levels of 0 to 120 km/h, with accelerations of 0.7 to 2 m/s²."""
    rng = np.random.default_rng(seed)
    times, speeds = [0.0], [0.0]
    while times[-1] < duration_s:
        level = 0.0 if rng.random() < 0.15 else rng.uniform(20.0, 120.0) * KM_H
        times.append(times[-1] + abs(level - speeds[-1]) / rng.uniform(0.7, 2.0) + 0.1)
        times.append(times[-1] + rng.uniform(5.0, 40.0))
        speeds += [level, level]
    known = (np.array(times), np.array(speeds))
    return lambda time_s: float(np.interp(time_s, *known))


@dataclass
class World:
    """Feeds a monitor: GNSS at 1 Hz with time-correlated noise, the odometer at 2 Hz in steps of 1 km/h.

    The odometer indicates the true speed over `scale`, `delay_s` late. `gnss` and `odometer` change what is
    reported: they take the time [s] and the fault-free speed [m/s].
    """

    speed: Speed
    monitor: MotionMonitor = field(default_factory=MotionMonitor)
    seed: int = 1
    scale: float = 1.0
    delay_s: float = 0.0
    gnss_sd: float = 0.1
    correlation_s: float = 2.0
    gnss: Gnss = lambda _, speed: speed
    odometer: Callable[[float, float], float] = lambda _, speed: speed
    time_s: float = 0.0

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)
        self._error = float(self._rng.normal(0.0, self.gnss_sd))

    def run(self, duration_s: float) -> Iterator[MotionVerdicts]:
        """Give the verdicts once a second."""
        keep = exp(-1.0 / self.correlation_s)
        for _ in range(round(duration_s)):
            t = self.time_s
            for at in (t, t + 0.5):
                indicated = self.speed(at - self.delay_s) / self.scale
                reported = self.odometer(at, indicated)
                self.monitor.odometer(self._ns(at), floor(reported / KM_H + 0.5) * KM_H, KM_H)
            true = self.speed(t + 0.3)
            measured = max(0.0, true + self._error) if true > 0.0 else abs(self._error) * 0.2
            self.monitor.gnss(self._ns(t + 0.3), self.gnss(t, measured), self.gnss_sd)
            self._error = keep * self._error + float(self._rng.normal(0.0, self.gnss_sd * sqrt(1.0 - keep**2)))
            self.time_s += 1.0
            yield self.monitor.verdicts(self._ns(t + 0.5))

    def after(self, duration_s: float) -> MotionVerdicts:
        """Give the last verdicts of a run."""
        *_, last = self.run(duration_s)
        return last

    def accusing(self, duration_s: float) -> set[str]:
        """Names of the tests that accused at any time in a run."""
        return {name for verdicts in self.run(duration_s) for name in verdicts.accusing()}

    @staticmethod
    def _ns(time_s: float) -> int:
        return round(time_s * SECOND_NS)

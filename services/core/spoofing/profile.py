"""Standard deviations of the metrics of an IMU in a vehicle, by dynamics, and how they are learned."""

from collections.abc import Iterable, Mapping

import numpy as np
from pydantic import Field, model_validator

from shared.runtime.config import Section

from .metrics import CONSECUTIVE, Metric
from .short_window import Window

FORCE_EDGES_M_S2 = (0.3, 1.0, 2.0)  # of | |f| - g |, between the dynamics classes of accelerations
SPEED_EDGES_M_S = (5.0, 10.0, 20.0)  # between those of heading and altitude rate
CLASSES = len(FORCE_EDGES_M_S2) + 1
LEAST_WINDOWS = 100  # of a class; with fewer it takes the largest standard deviation of all classes
SPEED_METRICS = (Metric.HEADING_RATE, Metric.ALTITUDE_RATE)


class Profile(Section):
    """Standard deviations of the 5 s metrics for each dynamics class, and where they come from."""

    sigma: Mapping[Metric, tuple[float, ...]] = Field(
        description="standard deviation of each metric for each dynamics class, noise of the GNSS velocity apart"
    )
    threshold: float = Field(gt=0.0, description="number of standard deviations above which a metric accuses")
    false_alarm_rate: float = Field(ge=0.0, le=1.0, description="share of fault-free evaluations above the threshold")
    provenance: str = Field(max_length=400, description="drives, duration and date of the data that it was learned of")

    @model_validator(mode="after")
    def _complete(self) -> "Profile":
        for metric, values in self.sigma.items():
            if len(values) != CLASSES or min(values) <= 0.0:
                raise ValueError(f"{metric} needs {CLASSES} positive standard deviations")
        return self

    def sigma_of(self, metric: Metric, window: Window) -> float | None:
        """Standard deviation of a metric in the worst dynamics class that a window visits; None without one."""
        values = self.sigma.get(metric)
        if values is None:
            return None
        first, last = classes_of(metric, window)
        return float(np.hypot(max(values[first : last + 1]), window.noise.get(metric, 0.0)))


def classes_of(metric: Metric, window: Window) -> tuple[int, int]:
    """Lowest and highest dynamics class that a window visits."""
    if metric in SPEED_METRICS:
        edges, extremes = SPEED_EDGES_M_S, window.speed_m_s
    else:
        edges, extremes = FORCE_EDGES_M_S2, (window.force_m_s2, window.force_m_s2)
    lowest, highest = np.searchsorted(edges, extremes).tolist()
    return lowest, highest


def learn(windows: Iterable[Window], *, threshold: float, provenance: str, floor: float = 1e-3) -> Profile:
    """Learn a profile of the windows of fault-free drives.

    Parameters
    ----------
    windows : iterable of Window
        Of recorded drives, in order; overlapping windows may be among them.
    threshold : float
        [-] Number of standard deviations above which a metric is to accuse.
    provenance : str
        Which drives, of which device and configuration.
    floor : float
        [unit of the metric] Least standard deviation.

    Returns
    -------
    Profile
        A metric that was never evaluated is missing. `false_alarm_rate` is that of the same drives: the share of
        windows in which any metric exceeds the threshold in two successive evaluations, one more than was counted.

    Raises
    ------
    ValueError
        There are fewer than 100 windows.

    Notes
    -----
    The variance of a class is the mean square of its windows less the known one of the GNSS velocity::

        sigma² = mean(C²) - mean(noise²)
    """
    known = list(windows)
    if len(known) < LEAST_WINDOWS:
        raise ValueError(f"{len(known)} windows of 5 s are too few to learn from; drive for ten minutes or more")
    sigma = {}
    for metric in Metric:
        found: list[list[tuple[float, float]]] = [[] for _ in range(CLASSES)]
        for window in known:
            if metric in window.difference:
                pair = (window.difference[metric], window.noise.get(metric, 0.0))
                found[classes_of(metric, window)[1 if metric not in SPEED_METRICS else 0]].append(pair)
        enough = [_sigma(pairs, floor) for pairs in found if len(pairs) >= LEAST_WINDOWS]
        if enough:
            sigma[metric] = tuple(
                _sigma(pairs, floor) if len(pairs) >= LEAST_WINDOWS else max(enough) for pairs in found
            )
    draft = Profile(sigma=sigma, threshold=threshold, false_alarm_rate=0.0, provenance=provenance)
    run = alarms = 0
    for window in known:
        run = run + 1 if exceeding(window, draft) else 0
        alarms += run >= CONSECUTIVE
    return draft.model_copy(update={"false_alarm_rate": (alarms + 1) / (len(known) + 1)})


def exceeding(window: Window, profile: Profile) -> list[Metric]:
    """Metrics of a window above the profile's threshold."""
    found = []
    for metric, difference in window.difference.items():
        sigma = profile.sigma_of(metric, window)
        if sigma is not None and abs(difference) > profile.threshold * sigma:
            found.append(metric)
    return found


def _sigma(pairs: list[tuple[float, float]], floor: float) -> float:
    difference, noise = np.array(pairs).T
    return float(np.sqrt(max(np.mean(difference**2) - np.mean(noise**2), floor**2)))


# Learned values are 0.001 to 0.004 rad/s, 0.006 to 0.012 m/s² and 0.02 m/s; a real vehicle bends and shakes more.
UNIT_IMU = Profile(
    sigma={
        Metric.HEADING_RATE: (0.006, 0.004, 0.003, 0.003),
        Metric.ACCELERATION_EAST: (0.015, 0.015, 0.02, 0.02),
        Metric.ACCELERATION_NORTH: (0.015, 0.015, 0.02, 0.02),
        Metric.ACCELERATION_UP: (0.01, 0.015, 0.02, 0.02),
        Metric.ACCELERATION: (0.015, 0.015, 0.02, 0.02),
        Metric.ALTITUDE_RATE: (0.03, 0.03, 0.03, 0.03),
    },
    threshold=5.0,
    false_alarm_rate=5e-4,
    provenance=(
        "simulated drives parking_lot 6, urban 5, highway 4 and tunnel 3, 2340 s with an IMU of MTi-630 grade and GNSS "
        "at 1 Hz: learned standard deviations, rounded up by 1.3 to 3; no alarm in 2021 windows"
    ),
)

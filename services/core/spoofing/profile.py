"""Standard deviations of the metrics of an IMU in a vehicle, by dynamics, and how they are learned."""

from bisect import bisect_left
from collections.abc import Iterable, Mapping, Sequence
from enum import StrEnum
from itertools import chain, pairwise
from math import hypot, sqrt

import numpy as np
from pydantic import Field, model_validator

from shared.runtime.config import Section

from .windows.metrics import CONSECUTIVE, Metric
from .windows.short_window import Window

FORCE_EDGES_M_S2 = (0.3, 1.0, 2.0)  # of | |f| - g |, between the dynamics classes of accelerations
SPEED_EDGES_M_S = (5.0, 10.0, 20.0)  # between those of heading and altitude rate
CLASSES = len(FORCE_EDGES_M_S2) + 1
MIN_WINDOWS = 100  # of a class; with fewer it takes the largest standard deviation of all classes
MIN_THRESHOLD = 5.0  # [standard deviations] as of the built-in profile
SHORT_S, LONG_S = 5.0, 60.0  # of independent windows; they are evaluated once a second
MAX_GRADES = 3.0  # by which what is learned may exceed the stated grade
MAX_THRESHOLD = 50.0  # [standard deviations] beyond it a metric tells nothing
MAD = 1.4826  # standard deviation over median magnitude of a normal variable
SPEED_METRICS = (Metric.HEADING_RATE, Metric.ALTITUDE_RATE)


class ProfileCondition(StrEnum):
    """What a profile depends on."""

    IMU = "imu"
    GNSS = "gnss"
    IMU_RATE = "imu_rate"
    GNSS_RATE = "gnss_rate"
    CONFIGURATION = "configuration"


TRAITS = {ProfileCondition.IMU: "IMU", ProfileCondition.GNSS: "GNSS receiver",
          ProfileCondition.IMU_RATE: "IMU rate", ProfileCondition.GNSS_RATE: "GNSS rate",
          ProfileCondition.CONFIGURATION: "configuration"}  # fmt: skip


class LearnedDrive(Section):
    """One drive that a profile was learned from."""

    file: str = Field(max_length=200, description="name of the recording")
    sha256: str = Field(pattern="^[0-9a-f]{64}$", description="digest of the recording")
    date: str = Field(max_length=32, description="UTC of its first message, ISO 8601")
    duration_s: float = Field(ge=0.0, description="from its first to its last message")
    windows: int = Field(ge=0, description="number of evaluations of the 5 s metrics")


class Origin(Section):
    """Device, configuration and drives that a profile holds for."""

    imu: str = Field(max_length=64, description="source of the inertial samples")
    gnss: str = Field(max_length=64, description="source of the fixes")
    imu_rate_hz: float = Field(gt=0.0, description="rate of the inertial samples")
    gnss_rate_hz: float = Field(gt=0.0, description="rate of the fixes")
    configuration: str = Field(max_length=64, description="digest of the settings that the metrics depend on")
    code: str = Field(max_length=64, description="version of the unit that learned it")
    drives: tuple[LearnedDrive, ...] = Field(description="recordings, in order")

    def differences(self, present: "Origin") -> dict[ProfileCondition, str]:
        """In what a unit differs from the one that the profile was learned for, and how; rates may by a fifth."""
        pairs = (
            (ProfileCondition.IMU, self.imu, present.imu, self.imu != present.imu),
            (ProfileCondition.GNSS, self.gnss, present.gnss, self.gnss != present.gnss),
            (ProfileCondition.IMU_RATE, f"{self.imu_rate_hz:.3g} Hz", f"{present.imu_rate_hz:.3g} Hz",
             not 0.8 < present.imu_rate_hz / self.imu_rate_hz < 1.25),
            (ProfileCondition.GNSS_RATE, f"{self.gnss_rate_hz:.3g} Hz", f"{present.gnss_rate_hz:.3g} Hz",
             not 0.8 < present.gnss_rate_hz / self.gnss_rate_hz < 1.25),
            (ProfileCondition.CONFIGURATION, self.configuration, present.configuration,
             self.configuration != present.configuration),
        )  # fmt: skip
        return {trait: f"{TRAITS[trait]} {learned}, now {now}" for trait, learned, now, differs in pairs if differs}


class Profile(Section):
    """Standard deviations of the 5 s metrics for each dynamics class, and where they come from."""

    sigma: Mapping[Metric, tuple[float, ...]] = Field(
        description="standard deviation of each metric for each dynamics class, noise of the GNSS velocity apart"
    )
    threshold: float = Field(gt=0.0, description="number of standard deviations above which a metric accuses")
    false_alarm_rate: float = Field(ge=0.0, le=1.0, description="share of fault-free evaluations above the threshold")
    long_factor: float = Field(
        default=1.0, ge=1.0, description="factor on the standard deviation of the free propagations over 30 and 60 s"
    )
    provenance: str = Field(max_length=400, description="drives, duration and date of the data that it was learned of")
    origin: Origin | None = Field(default=None, description="what `obu calibrate spoofing` learned it from")

    @model_validator(mode="after")
    def _complete(self) -> "Profile":
        for metric, values in self.sigma.items():
            if len(values) != CLASSES or min(values) <= 0.0:
                raise ValueError(f"{metric} needs {CLASSES} positive standard deviations")
        return self

    def times(self, factor: float, provenance: str) -> "Profile":
        """Profile of sensors whose errors are larger by a factor."""
        sigma = {metric: tuple(factor * value for value in values) for metric, values in self.sigma.items()}
        return self.model_copy(update={"sigma": sigma, "provenance": provenance})

    def sigma_of(self, metric: Metric, window: Window) -> float | None:
        """Standard deviation of a metric in the worst dynamics class that a window visits; None without one."""
        values = self.sigma.get(metric)
        if values is None:
            return None
        first, last = classes_of(metric, window)
        return hypot(max(values[first : last + 1]), window.noise.get(metric, 0.0))


def classes_of(metric: Metric, window: Window) -> tuple[int, int]:
    """Lowest and highest dynamics class that a window visits."""
    if metric in SPEED_METRICS:
        edges, extremes = SPEED_EDGES_M_S, window.speed_m_s
    else:
        edges, extremes = FORCE_EDGES_M_S2, (window.force_m_s2, window.force_m_s2)
    lowest, highest = extremes
    return bisect_left(edges, lowest), bisect_left(edges, highest)


def learn(
    windows: Iterable[Window], *, threshold: float | None = None, provenance: str,
    long_statistics: Iterable[float] = (), stated: Profile | None = None,
) -> Profile:  # fmt: skip
    """Learn a profile of the windows of fault-free drives.

    Parameters
    ----------
    windows : iterable of Window
        Of recorded drives, in order; overlapping windows may be among them.
    threshold : float, optional
        [-] Number of standard deviations above which a metric is to accuse; without it the least of 5 and more with no
        alarm on these drives, times a tolerance.
    provenance : str
        Which drives, of which device and configuration.
    long_statistics : iterable of float
        [-] Chi-squares of the free propagations over their thresholds, evaluated once a second.
    stated : Profile, optional
        Profile of the stated grade: at most `MAX_GRADES` times its limits are learned, so that a slow drag during the
        drives cannot teach the monitor to pass it.

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
    The scale of a class is that of `UNIT_IMU` or larger, and robust: by the median of the magnitude, less the known
    noise of the GNSS velocity and of the attitude. A class with few windows takes the largest of the others::

        sigma² = (1.4826 median |C|)² - mean(noise²),    f² = max( t² max(T) / threshold, 1 )

    The tolerance t = 1 + 3 / √(2n) is three standard deviations of a scale that n independent windows have shown: ten
    minutes are 120 of 5 s and 10 of 60 s, and no tail of 1e-5.
    """
    known, long = list(windows), np.array(list(long_statistics))
    if len(known) < MIN_WINDOWS:
        raise ValueError(f"{len(known)} windows of 5 s are too few to learn from; drive for ten minutes or more")
    sigma = {}
    for metric in Metric:
        found: list[list[tuple[float, float]]] = [[] for _ in range(CLASSES)]
        for window in known:
            if metric in window.difference:
                pair = (window.difference[metric], window.noise.get(metric, 0.0))
                found[classes_of(metric, window)[1 if metric not in SPEED_METRICS else 0]].append(pair)
        enough = [_sigma(pairs) for pairs in found if len(pairs) >= MIN_WINDOWS]
        if not enough:
            enough = [_sigma(every) for every in [list(chain(*found))] if len(every) >= MIN_WINDOWS]
        if enough:
            scales = (_sigma(pairs) if len(pairs) >= MIN_WINDOWS else max(enough) for pairs in found)
            sigma[metric] = tuple(map(max, scales, UNIT_IMU.sigma[metric]))
    draft = Profile(sigma=sigma, threshold=1.0, false_alarm_rate=0.0, provenance=provenance)
    k = threshold
    if k is None:
        k = max(MIN_THRESHOLD, _tolerance(len(known), SHORT_S) * _quiet(known, draft))
    k, factor = min(k, MAX_THRESHOLD), 1.0
    if len(long):
        factor = max(1.0, _tolerance(len(known), LONG_S) * float(np.sqrt(long.max())))
    profile = draft.model_copy(update={"threshold": k, "long_factor": factor})
    if stated is not None:
        profile = _bounded(profile, stated)
    alarms, _ = alarms_of(known, profile)
    return profile.model_copy(update={"false_alarm_rate": (alarms + 1) / (len(known) + 1)})


def _tolerance(evaluations: int, independent_s: float) -> float:
    return 1.0 + 3.0 / sqrt(2.0 * max(1.0, evaluations / independent_s))


def _quiet(windows: Sequence[Window], draft: Profile) -> float:
    """Largest number of standard deviations that a metric exceeds in two successive windows."""
    ratios = []
    for window in windows:
        sigmas = {metric: draft.sigma_of(metric, window) for metric in window.difference}
        ratios.append({metric: abs(window.difference[metric]) / sd for metric, sd in sigmas.items() if sd})
    pairs = pairwise(ratios)
    return max((min(a[metric], b[metric]) for a, b in pairs for metric in a.keys() & b.keys()), default=0.0)


def _bounded(profile: Profile, stated: Profile) -> Profile:
    """Limit what was learned to `MAX_GRADES` times the limits of a stated grade."""
    sigma = {
        metric: tuple(
            min(value, MAX_GRADES * stated.threshold * most / profile.threshold)
            for value, most in zip(values, stated.sigma.get(metric, values), strict=True)
        )
        for metric, values in profile.sigma.items()
    }
    factor = min(profile.long_factor, MAX_GRADES * stated.long_factor)
    return profile.model_copy(update={"sigma": sigma, "long_factor": factor})


def alarms_of(windows: Iterable[Window], profile: Profile) -> tuple[int, int]:
    """Number of evaluations that accuse, and of episodes without interruption."""
    run = alarms = episodes = 0
    for window in windows:
        run = run + 1 if exceeding(window, profile) else 0
        alarms += run >= CONSECUTIVE
        episodes += run == CONSECUTIVE
    return alarms, episodes


def exceeding(window: Window, profile: Profile) -> list[Metric]:
    """Metrics of a window above the profile's threshold."""
    found = []
    for metric, difference in window.difference.items():
        sigma = profile.sigma_of(metric, window)
        if sigma is not None and abs(difference) > profile.threshold * sigma:
            found.append(metric)
    return found


def _sigma(pairs: list[tuple[float, float]]) -> float:
    difference, noise = np.array(pairs).T
    scale = MAD * float(np.median(np.abs(difference)))
    return float(np.sqrt(max(scale**2 - np.mean(noise**2), 0.0)))


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

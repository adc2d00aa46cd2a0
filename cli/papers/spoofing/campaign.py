"""Thresholds learned on training drives, false detections on validation drives, and attacks on these."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
import numpy.typing as npt

from services.core.spoofing.profile import CLASSES, FORCE_EDGES_M_S2, SPEED_EDGES_M_S, SPEED_METRICS
from services.core.spoofing.windows.metrics import CONSECUTIVE, Metric, consecutive
from shared.maths.earth import STANDARD_GRAVITY
from shared.maths.rotation import ned_from_body

from .method import (
    CUT_OFF_HZ,
    WINDOW,
    Rates,
    attitude_rates,
    gnss_rates,
    metrics,
    paper_rates,
    paper_sigma,
    sensor_rates,
    turned_by_course,
)
from .phone import MOUNT, RATE_HZ, VELOCITY_SD, PhoneDrive, drive_phone

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
Sigma = Mapping[Metric, FloatArray]  # per dynamics class

ALL = tuple(Metric)
SETTLING_WINDOWS = 20  # windows after the start, in which filters settle
MIN_WINDOWS = 30  # windows of a class; with fewer it takes the largest standard deviation of all classes
PAPER_K = 3.0
CUT_OFFS_HZ = (0.03, 0.06, 0.12, 0.24, 0.45)
EPISODES_PER_HOUR = 1.0
STARTS_PER_DRIVE = 6
SOON_S, LATER_S = 30, 60  # after the start of an attack


class Mode(StrEnum):
    """How GNSS and sensors are compared."""

    PAPER_RAW = "P, sigma of 1 Hz errors"  # the paper
    PAPER = "P, sigma of windows"
    MATCHED = "M, same high-pass on both"  # and low-passed gravity for the compass
    GYROSCOPE = "G, gyroscope and attitude"


@dataclass(frozen=True)
class DriveRates:
    """A drive as the methods see it: rates of the sensors by mode and cut-off, and what the classes depend on."""

    velocity: FloatArray  # shape (n, 3) [m/s, ENU]
    true_velocity: FloatArray | None  # None of a recording
    sensors: Mapping[tuple[Mode, float], Rates]  # n - 1 seconds each; see `sensors_of`
    force_class: IntArray  # shape (n - 1,) of the largest | |f| - g | of each second
    carrier_velocity: FloatArray | None = None  # shape (n, 3) [m/s, ENU] the paper's input; None of a recording

    @property
    def by_carrier(self) -> "DriveRates":
        """The drive with the velocity by carrier phases in place of that of the receiver."""
        if self.carrier_velocity is None:
            raise ValueError("a recording has no velocity by carrier phases")
        return replace(self, velocity=self.carrier_velocity)


def measured(drive: PhoneDrive) -> DriveRates:
    """Compute the rates of the sensors of a simulated phone, for all modes and cut-offs."""
    sensors = {}
    read, mounting = (drive.force, drive.field, drive.height, RATE_HZ), ned_from_body(*MOUNT)
    for cut_off in CUT_OFFS_HZ:
        sensors[Mode.PAPER, cut_off] = paper_rates(*read, mounting, cut_off_hz=cut_off)
        sensors[Mode.MATCHED, cut_off] = sensor_rates(*read, cut_off_hz=cut_off)
    sensors[Mode.PAPER_RAW, CUT_OFF_HZ] = sensors[Mode.PAPER, CUT_OFF_HZ]
    sensors[Mode.GYROSCOPE, CUT_OFF_HZ] = attitude_rates(
        drive.force, drive.rate, drive.height, drive.d_from_enu, RATE_HZ
    )
    excess = np.abs(np.linalg.norm(drive.force, axis=1) - STANDARD_GRAVITY).reshape(-1, RATE_HZ).max(axis=1)
    force_class = np.searchsorted(FORCE_EDGES_M_S2, excess)[:-1]
    return DriveRates(drive.velocity, drive.true_velocity, sensors, force_class, drive.carrier_velocity)


def measure(seed: int) -> DriveRates:
    """Simulate a drive and compute its rates."""
    return measured(drive_phone(seed))


def sensors_of(drive: DriveRates, mode: Mode, velocity: FloatArray, cut_off_hz: float = CUT_OFF_HZ) -> Rates:
    """Rates of the sensors in east, north, up: the paper turns them by the course of GNSS, true or not."""
    rates = drive.sensors[mode, cut_off_hz]
    return turned_by_course(rates, velocity) if mode in (Mode.PAPER, Mode.PAPER_RAW) else rates


def differences(
    drive: DriveRates, mode: Mode, *, velocity: FloatArray | None = None, cut_off_hz: float = CUT_OFF_HZ
) -> dict[Metric, FloatArray]:
    """Metrics of every window, with the GNSS velocity of the drive or another one."""
    given = drive.velocity if velocity is None else velocity
    gnss = gnss_rates(given, filtered=mode is Mode.MATCHED, cut_off_hz=cut_off_hz)
    return metrics(gnss, sensors_of(drive, mode, given, cut_off_hz), np.hypot(given[:, 0], given[:, 1]))


def class_range(drive: DriveRates, metric: Metric, velocity: FloatArray | None = None) -> tuple[IntArray, IntArray]:
    """Lowest and highest dynamics class that each window visits: of the speed, or of the specific force."""
    if metric in SPEED_METRICS:
        given = drive.velocity if velocity is None else velocity
        classes = np.searchsorted(SPEED_EDGES_M_S, np.hypot(given[1:, 0], given[1:, 1]))
    else:
        classes = drive.force_class
    seen = np.lib.stride_tricks.sliding_window_view(classes, WINDOW)
    if metric in SPEED_METRICS:
        return seen.min(axis=1), seen.max(axis=1)
    return seen.max(axis=1), seen.max(axis=1)


def learn(drives: Sequence[DriveRates], mode: Mode, cut_off_hz: float = CUT_OFF_HZ) -> dict[Metric, FloatArray]:
    """Standard deviation of each metric in each dynamics class; by the paper's rule, of errors at 1 Hz."""
    found = {}
    for metric in Metric:
        rows = [_samples(drive, mode, metric, cut_off_hz) for drive in drives]
        classes = np.concatenate([row[0] for row in rows])
        values = [np.concatenate([row[1][column] for row in rows]) for column in range(len(rows[0][1]))]
        sigma = np.full(CLASSES, np.nan)
        for number in range(CLASSES):
            chosen = [value[(classes == number) & np.isfinite(value)] for value in values]
            if len(chosen[0]) >= MIN_WINDOWS:
                sigma[number] = paper_sigma(*chosen) if len(chosen) == 2 else np.sqrt(np.mean(chosen[0] ** 2))
        found[metric] = np.where(np.isnan(sigma), np.nanmax(sigma), sigma)
    return found


def _samples(
    drive: DriveRates, mode: Mode, metric: Metric, cut_off_hz: float
) -> tuple[IntArray, tuple[FloatArray, ...]]:
    """Classes, and either the metric of each window or the errors of GNSS and sensors in each second."""
    if mode is not Mode.PAPER_RAW:
        values = differences(drive, mode, cut_off_hz=cut_off_hz)[metric]
        return class_range(drive, metric)[0][SETTLING_WINDOWS:], (values[SETTLING_WINDOWS:],)
    if drive.true_velocity is None:
        raise ValueError("the paper's sigma needs the true velocity; a recording has none")
    true = gnss_rates(drive.true_velocity)
    given = (gnss_rates(drive.velocity), sensors_of(drive, mode, drive.velocity, cut_off_hz))
    pair = [_rate(rates, metric) - _rate(true, metric) for rates in given]
    speed = np.hypot(drive.velocity[1:, 0], drive.velocity[1:, 1])
    if metric is Metric.HEADING_RATE:
        slow = np.minimum(speed, np.hypot(drive.velocity[:-1, 0], drive.velocity[:-1, 1])) <= 1.0
        pair = [np.where(slow, np.nan, np.pi - np.mod(np.pi - error, 2.0 * np.pi)) for error in pair]
    classes = np.searchsorted(SPEED_EDGES_M_S, speed) if metric in SPEED_METRICS else drive.force_class
    return classes[SETTLING_WINDOWS:], tuple(error[SETTLING_WINDOWS:] for error in pair)


def _rate(rates: Rates, metric: Metric) -> FloatArray:
    east, north, up = rates.acceleration.T
    values: dict[Metric, FloatArray] = {
        Metric.HEADING_RATE: rates.heading_rate,
        Metric.ACCELERATION_EAST: east,
        Metric.ACCELERATION_NORTH: north,
        Metric.ACCELERATION_UP: up,
        Metric.ACCELERATION: np.linalg.norm(rates.acceleration, axis=1),
        Metric.ALTITUDE_RATE: rates.altitude_rate,
    }
    return values[metric]


def normalised(
    drive: DriveRates, mode: Mode, sigma: Sigma, *, velocity: FloatArray | None = None, cut_off_hz: float = CUT_OFF_HZ
) -> dict[Metric, FloatArray]:
    """|metric| over the standard deviation of the worst class that the window visits; 0 where it is not defined."""
    found = {}
    for metric, values in differences(drive, mode, velocity=velocity, cut_off_hz=cut_off_hz).items():
        lowest, highest = class_range(drive, metric, velocity)
        table = np.array([[sigma[metric][a : b + 1].max(initial=0.0) for b in range(CLASSES)] for a in range(CLASSES)])
        scale = table[np.minimum(lowest, highest), highest]
        found[metric] = np.where(np.isnan(values), 0.0, np.abs(values) / scale)[SETTLING_WINDOWS:]
    return found


def false_detections(
    drives: Sequence[DriveRates],
    mode: Mode,
    sigma: Sigma,
    cut_off_hz: float = CUT_OFF_HZ,
    *,
    used: Sequence[Metric] = ALL,
) -> dict[str, float]:
    """Share [%] of windows above three sigma, by metric, and of any metric."""
    rows = [normalised(drive, mode, sigma, cut_off_hz=cut_off_hz) for drive in drives]
    above = {metric: np.concatenate([row[metric] for row in rows]) > PAPER_K for metric in used}
    any_metric = np.any(list(above.values()), axis=0)
    return {metric.value: 100.0 * float(values.mean()) for metric, values in above.items()} | {
        "any": 100.0 * float(any_metric.mean())
    }


def alarms(values: Mapping[Metric, FloatArray], k: float, used: Sequence[Metric] = ALL) -> npt.NDArray[np.bool_]:
    """Windows at which a metric has exceeded k sigma in two successive epochs."""
    found: npt.NDArray[np.bool_] = np.any([consecutive(values[m] > k, CONSECUTIVE) for m in used], axis=0)
    return found


def threshold(drives: Sequence[DriveRates], mode: Mode, sigma: Sigma, cut_off_hz: float = CUT_OFF_HZ) -> float:
    """Smallest k, a multiple of 1/4, with at most one alarm episode an hour on the drives."""
    rows = [normalised(drive, mode, sigma, cut_off_hz=cut_off_hz) for drive in drives]
    hours = sum(len(row[Metric.ACCELERATION]) for row in rows) / 3600.0
    k = PAPER_K
    while sum(episodes(alarms(row, k)) for row in rows) > EPISODES_PER_HOUR * hours:
        k += 0.25
    return k


def episodes(alarm: npt.NDArray[np.bool_]) -> int:
    """Number of uninterrupted alarms."""
    return int((np.diff(alarm.astype(int), prepend=0) == 1).sum())


Attack = Callable[[FloatArray, int, FloatArray, np.random.Generator], FloatArray]


def _replay_static(velocity: FloatArray, start: int, _: FloatArray, rng: np.random.Generator) -> FloatArray:
    return rng.standard_normal(velocity[start:].shape) * VELOCITY_SD


def _replay_straight(velocity: FloatArray, start: int, _: FloatArray, rng: np.random.Generator) -> FloatArray:
    straight: FloatArray = velocity[start] + rng.standard_normal(velocity[start:].shape) * VELOCITY_SD
    return straight


def _replay_other(velocity: FloatArray, start: int, other: FloatArray, _: np.random.Generator) -> FloatArray:
    return other[start : len(velocity)]


def _climb(velocity: FloatArray, start: int, _: FloatArray, __: np.random.Generator) -> FloatArray:
    after = np.arange(len(velocity) - start)
    return velocity[start:] + np.outer(np.minimum(0.2 * after, 1.0), [0.0, 0.0, 1.0])


def _drag_off(acceleration: float, largest: float) -> Attack:
    """Add a velocity along the course at the start that grows up to `largest` [m/s]."""

    def attack(velocity: FloatArray, start: int, _: FloatArray, __: np.random.Generator) -> FloatArray:
        along = velocity[start] * [1.0, 1.0, 0.0]
        after = np.arange(len(velocity) - start)
        added = np.outer(np.minimum(acceleration * after, largest), along / np.linalg.norm(along))
        return velocity[start:] + added

    return attack


# The climb grows by 0.2 m/s², the drag-offs by 0.3 and 0.1 m/s².
ATTACKS: dict[str, Attack] = {
    "static replay": _replay_static,
    "straight-line replay": _replay_straight,
    "other drive replayed": _replay_other,
    "climb to 1 m/s": _climb,
    "drag-off to 3 m/s": _drag_off(0.3, 3.0),
    "drag-off to 1 m/s": _drag_off(0.1, 1.0),
}


@dataclass(frozen=True)
class Detection:
    """Delays [s] of the attacks that were detected within 60 s, and how many attacks there were."""

    delays_s: list[int]
    attacks: int

    def share(self, within_s: int) -> float:
        """Share [%] detected within a time."""
        return 100.0 * sum(delay <= within_s for delay in self.delays_s) / self.attacks

    @property
    def median_s(self) -> float | None:
        """Median delay of the attacks detected within `LATER_S`."""
        return float(np.median(self.delays_s)) if self.delays_s else None


def detect(
    drives: Sequence[DriveRates],
    mode: Mode,
    sigma: Sigma,
    k: float,
    attack: Attack,
    *,
    used: Sequence[Metric] = ALL,
    cut_off_hz: float = CUT_OFF_HZ,
) -> Detection:
    """Attack each drive at random times at which it moves faster than 5 m/s."""
    delays, count = [], 0
    for number, drive in enumerate(drives):
        rng = np.random.default_rng((number, 5))
        speed = np.hypot(drive.velocity[:, 0], drive.velocity[:, 1])
        moving = np.flatnonzero(speed > 5.0)
        moving = moving[(moving > 100) & (moving < len(speed) - LATER_S - 10)]
        other = drives[(number + 1) % len(drives)].velocity
        for start in rng.choice(moving, STARTS_PER_DRIVE, replace=False).tolist():
            velocity = np.concatenate([drive.velocity[:start], attack(drive.velocity, start, other, rng)])
            values = normalised(drive, mode, sigma, velocity=velocity, cut_off_hz=cut_off_hz)
            alarm = alarms(values, k, used)
            first = start + 1 - WINDOW - SETTLING_WINDOWS  # row of the window that ends with the epoch after the start
            after = np.flatnonzero(alarm[first : first + LATER_S])
            count += 1
            if len(after):
                delays.append(int(after[0]) + 1)
    return Detection(delays, count)

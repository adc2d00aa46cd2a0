"""Metrics over time of a true and of a replayed drive, altitude and its rate, and the cut-off against the truth."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from services.core.spoofing.windows.metrics import Metric
from shared.maths.rotation import ned_from_body

from ..report import Figure, figure
from .campaign import PAPER_K, SETTLING_WINDOWS, DriveRates, Mode, Sigma, normalised, sensors_of
from .method import WINDOW, gnss_rates, paper_rates, turned_by_course
from .phone import MOUNT, RATE_HZ, drive_phone

FloatArray = npt.NDArray[np.float64]

REPLAY_S = 300  # [s] begin of the replay of another drive
TRUTH_CUT_OFFS_HZ = (0.005, 0.01, 0.03, 0.06, 0.12, 0.24, 0.45)
TRUTH_SEEDS = (1, 2, 3)


def replayed(drive: DriveRates, other: DriveRates) -> FloatArray:
    """Velocity [m/s, ENU] of GNSS: the drive's own, and from `REPLAY_S` on that of another drive."""
    length = min(len(drive.velocity), len(other.velocity))
    velocity: FloatArray = np.concatenate([drive.velocity[:REPLAY_S], other.velocity[REPLAY_S:length]])
    return np.concatenate([velocity, drive.velocity[length:]])


def above_before_and_after(
    drives: Sequence[DriveRates], sigma: Sigma, mode: Mode = Mode.PAPER_RAW
) -> dict[str, tuple[float, float]]:
    """Share [%] of windows with a metric above 3 sigma: of a true drive, and of one that is replayed from a time on."""
    velocity = replayed(drives[0], drives[1 % len(drives)])
    first = REPLAY_S - WINDOW - SETTLING_WINDOWS
    true, false = normalised(drives[0], mode, sigma), normalised(drives[0], mode, sigma, velocity=velocity)

    def share(values: dict[Metric, FloatArray], metric: Metric) -> float:
        return 100.0 * float((values[metric][first:] > PAPER_K).mean())

    return {metric.value: (share(true, metric), share(false, metric)) for metric in Metric}


def errors_by_cut_off(
    seeds: Sequence[int] = TRUTH_SEEDS, cut_offs_hz: Sequence[float] = TRUTH_CUT_OFFS_HZ
) -> dict[float, float]:
    """Deviation [m/s²] of the paper's high-passed east acceleration from the true one, by cut-off [Hz].

    The paper's figure has the difference of both sensors. Against the truth a low cut-off is the best: what the
    high-pass takes away is the vehicle's own acceleration, and what it leaves is gravity on slopes.
    """
    mounting, found = ned_from_body(*MOUNT), {}
    drives = [drive_phone(seed) for seed in seeds]
    for cut_off_hz in cut_offs_hz:
        errors = []
        for drive in drives:
            read = paper_rates(drive.force, drive.field, drive.height, RATE_HZ, mounting, cut_off_hz=cut_off_hz)
            east = turned_by_course(read, drive.true_velocity).acceleration[:, 0]
            errors.append(east - gnss_rates(drive.true_velocity).acceleration[:, 0])
        found[cut_off_hz] = float(np.sqrt(np.mean(np.concatenate(errors)[SETTLING_WINDOWS:] ** 2)))
    return found


def thresholds(sigma: Sigma) -> dict[str, list[float]]:
    """Three sigma of each metric, by class of speed or of specific force: the paper's thresholds."""
    return {metric.value: (PAPER_K * values).tolist() for metric, values in sigma.items()}


def figures_over_time(drives: Sequence[DriveRates], sigma: Sigma, by_cut_off: dict[float, float]) -> list[Figure]:
    """Draw the metrics of a true and of a replayed drive, altitude and its rate, and the cut-offs."""
    drawn: list[Figure] = []
    drive, other = drives[0], drives[1 % len(drives)]
    velocity = replayed(drive, other)
    for title, given in (("Metrics of a true drive", drive.velocity), ("Metrics of a replayed drive", velocity)):
        values = normalised(drive, Mode.PAPER_RAW, sigma, velocity=given)
        with figure(title, drawn.append, columns=len(Metric), height=2.6) as panels:
            for axes, metric in zip(panels, Metric, strict=True):
                time_s = SETTLING_WINDOWS + WINDOW + np.arange(len(values[metric]))
                axes.plot(time_s, values[metric], linewidth=0.7)
                axes.axhline(PAPER_K, color="red", linewidth=0.8)
                axes.set_title(metric.value.replace("_", " "), fontsize=7)
                axes.set(xlabel="time [s]", ylim=(0.0, 12.0))
            panels[0].set_ylabel("metric over sigma")
    with figure("Altitude and its rate", drawn.append, columns=2) as panels:
        pressure = sensors_of(drive, Mode.PAPER_RAW, drive.velocity).altitude_rate
        satellites = gnss_rates(drive.velocity).altitude_rate
        for rate, label in ((satellites, "GNSS"), (pressure, "barometer")):
            panels[0].plot(np.cumsum(rate), label=label)
            panels[1].plot(rate, linewidth=0.7, label=label)
        panels[0].set(xlabel="time [s]", ylabel="change of altitude [m]")
        panels[1].set(xlabel="time [s]", ylabel="altitude rate [m/s]")
        panels[0].legend()
    with figure("Cut-off against the truth", drawn.append) as (axes,):
        axes.semilogx(list(by_cut_off), list(by_cut_off.values()), marker=".")
        axes.set_xticks(list(by_cut_off), [f"{cut_off:g}" for cut_off in by_cut_off])
        axes.minorticks_off()
        axes.set(xlabel="cut-off [Hz]", ylabel="error of the east acceleration [m/s²]")
    return drawn

"""Statistics over time in tunnels, correlation of both speeds, and histograms of the statistics in normal driving.

In a tunnel the receiver repeats its last speed for 10 s and then reports zero, as the paper observed of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from services.core.motion_conflict.tachograph import KM_H, SAMPLES, SpeedWindow, WindowMode, median, trimmed_mean

from ..report import Figure, figure
from .profiles import Drive
from .sweeps import LIMIT_KM_H, Speeds

FloatArray = npt.NDArray[np.float64]

HOLD_S = 10.0  # for which the receiver repeats its last speed
TUNNELS = {  # begin and length [s] on the motorway's profile
    "one tunnel of 60 s": ((900.0, 60.0),),
    "two tunnels of 40 s": ((900.0, 40.0), (1000.0, 40.0)),
    "one tunnel of 120 s": ((900.0, 120.0),),
}
LAGS_S = np.arange(-15.0, 15.5, 0.5)
DELAYS_S = (0.0, 2.0, 5.0)  # of GNSS, which the correlation finds again


@dataclass(frozen=True)
class TunnelRun:
    """GNSS speed, trimmed mean and median [km/h] over time [s]; the statistics from the first full window on."""

    times_s: FloatArray
    gnss: FloatArray
    odometer: FloatArray
    window_s: FloatArray
    mean: FloatArray
    median: FloatArray


def in_tunnels(drive: Speeds, tunnels: Sequence[tuple[float, float]]) -> TunnelRun:
    """Run the window over a drive through tunnels."""

    def gnss(time_s: float) -> float:
        for begin_s, length_s in tunnels:
            if begin_s <= time_s < begin_s + length_s:
                return drive.gnss(begin_s) if time_s < begin_s + HOLD_S else 0.0
        return drive.gnss(time_s)

    window, rows = SpeedWindow(WindowMode.WALL), []
    speeds = np.array([(t, gnss(t), drive.odometer(t)) for t in drive.times_s], dtype=float)
    for time_s, satellite, odometer in speeds.tolist():
        window.add(int(time_s * 1e9), satellite * KM_H, odometer * KM_H)
        if window.complete:
            rows.append((time_s, window.trimmed_mean() / KM_H, window.median() / KM_H))
    return TunnelRun(*speeds.T, *np.array(rows).T)


def correlation(drive: Speeds, delay_s: float) -> FloatArray:
    """Pearson's correlation of the odometer with a GNSS that is late, at each of `LAGS_S` by which it is advanced."""
    margin_s = float(LAGS_S.max())
    times_s = np.arange(margin_s, drive.times_s[-1] - margin_s, 1.0)
    odometer = np.array([drive.odometer(t) for t in times_s.tolist()])
    found: list[float] = []
    for lag_s in LAGS_S.tolist():
        late = np.array([drive.gnss(t - delay_s + lag_s) for t in times_s.tolist()])
        found.append(float(np.corrcoef(odometer, late)[0, 1]))
    return np.array(found)


def window_statistics(differences: Sequence[float]) -> FloatArray:
    """Trimmed mean and median [km/h] of each full window of signed differences 10 s apart, shape (n, 2)."""
    absolute = np.abs(differences).tolist()
    windows = [absolute[start : start + SAMPLES] for start in range(len(absolute) - SAMPLES + 1)]
    rows = [(trimmed_mean(window), median(window)) for window in windows]
    return np.array(rows, dtype=float).reshape(-1, 2)


def tunnels_document() -> dict[str, object]:
    """Largest statistics in tunnels, and the delay that the correlation finds."""
    runs = {name: in_tunnels(Drive("highway"), tunnels) for name, tunnels in TUNNELS.items()}
    return {
        "tunnels": {
            name: {"largest_trimmed_mean_km_h": float(run.mean.max()), "largest_median_km_h": float(run.median.max())}
            for name, run in runs.items()
        },
        "correlation_delay_s": {
            f"{delay_s:g}": float(LAGS_S[int(np.argmax(correlation(Drive("urban"), delay_s)))]) for delay_s in DELAYS_S
        },
    }


def tunnel_figures(statistics: dict[str, FloatArray]) -> list[Figure]:
    """Draw tunnels over time, the correlation, and the histograms of both statistics by kind of drive."""
    drawn: list[Figure] = []
    with figure("Tunnels", drawn.append, columns=len(TUNNELS)) as panels:
        for axes, (name, tunnels) in zip(panels, TUNNELS.items(), strict=True):
            run = in_tunnels(Drive("highway"), tunnels)
            shown = (run.times_s >= 800.0) & (run.times_s <= 1500.0)
            axes.plot(run.times_s[shown], run.gnss[shown], color="grey", label="GNSS")
            shown = (run.window_s >= 800.0) & (run.window_s <= 1500.0)
            axes.plot(run.window_s[shown], run.mean[shown], label="MT")
            axes.plot(run.window_s[shown], run.median[shown], "--", label="median")
            axes.axhline(LIMIT_KM_H, color="grey", linewidth=0.8)
            axes.set(xlabel="time [s]", title=name)
        panels[0].set_ylabel("[km/h]")
        panels[0].legend(fontsize="small")
    with figure("Correlation of both speeds", drawn.append) as (axes,):
        for delay_s in DELAYS_S:
            axes.plot(LAGS_S, correlation(Drive("urban"), delay_s), label=f"GNSS late by {delay_s:g} s")
        axes.set(xlabel="GNSS advanced by [s]", ylabel="correlation")
        axes.legend()
    with figure("Histograms of the statistics", drawn.append, columns=max(1, len(statistics))) as panels:
        for axes, (kind, values) in zip(panels, statistics.items(), strict=False):
            axes.hist(values, bins=40, label=["MT", "median"])
            axes.set(xlabel="[km/h]", title=kind)
            axes.legend()
    return drawn

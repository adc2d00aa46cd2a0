"""Speeds of GPS alone beside Galileo alone: least-squares positions of raw pseudoranges, and their differences.

The paper compares velocities of both systems from Doppler on its drives. The recordings here with both systems have no
Doppler of a drive: speeds are distances of successive positions over time, and noisier.
"""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt

from services.core.cooperative.broadcast.rinex import read_rinex_navigation
from services.core.cooperative.broadcast.rinex_observation import read_rinex_observations
from services.core.cooperative.broadcast.store import EphemerisStore
from services.core.cooperative.detection import weighted_fit
from services.core.cooperative.satellites.monitor import SatelliteMonitor
from services.core.motion_conflict.tachograph import KM_H, SAMPLES, trimmed_mean
from shared.maths.gnss_signals import EARTH_RATE, SPEED_OF_LIGHT

FloatArray = npt.NDArray[np.float64]
Positions = dict[float, FloatArray]  # [s]: [m, ECEF]

SYSTEMS = {"GPS": ("1", "GPS_L1"), "Galileo": ("6", "GAL_E1")}
MIN_SD = 3.0  # [m] of a phone's pseudorange
MAX_DURATION_S = 5.5  # between two epochs of the phone, which come every 5 s
ROUNDS = 15
PHONE, STATION = "gsdc_samples", "geonet_rinex_raim"


@dataclass(frozen=True)
class Comparison:
    """Speeds of a phone in a car by two systems, at the epochs that both solve."""

    epochs: dict[str, int]  # with a position, by system
    total: int
    difference_km_h: FloatArray  # |GPS - Galileo| of horizontal speeds

    @property
    def largest_mean_km_h(self) -> float:
        """Largest trimmed mean of 30 successive differences."""
        values = self.difference_km_h
        return max(trimmed_mean(values[k : k + SAMPLES].tolist()) for k in range(len(values) - SAMPLES + 1))


def compare_phone(folder: Path) -> Comparison:
    """Solve a phone's pseudoranges by each system alone."""
    epochs: dict[float, list[Mapping[str, str]]] = {}
    with (folder / "2021_Pixel4XL_derived.csv").open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            epochs.setdefault(float(row["millisSinceGpsEpoch"]) / 1000.0, []).append(row)
    solved: dict[str, Positions] = {}
    for name, system in SYSTEMS.items():
        found = {t: _position([r for r in rows if _system(r) == system]) for t, rows in epochs.items()}
        solved[name] = {t: position for t, position in found.items() if position is not None}
    speeds = [speeds_of(positions, MAX_DURATION_S) for positions in solved.values()]
    both = sorted(set(speeds[0]) & set(speeds[1]))
    differences = np.array([abs(speeds[0][t] - speeds[1][t]) for t in both]) / KM_H
    return Comparison({name: len(record) for name, record in solved.items()}, len(epochs), differences)


def station_speeds(folder: Path) -> FloatArray:
    """Horizontal speeds [km/h] by GPS alone of a surveyed station, which does not move, over 30 s each."""
    ephemerides, ionosphere = read_rinex_navigation((folder / "07590920.05n").read_text())
    epochs, _ = read_rinex_observations((folder / "07590920.05o").read_text())
    store, monitor, positions = EphemerisStore(kept=100), SatelliteMonitor(), {}
    store.ionosphere = ionosphere
    for ephemeride in ephemerides:
        store.add(ephemeride)
    for epoch in epochs:
        solution = monitor.evaluate(epoch, store).solution
        if solution is not None:
            positions[epoch.gps_time_ns * 1e-9] = np.array(solution.position_e)
    return np.array(list(speeds_of(positions, 31.0).values())) / KM_H


def speeds_of(positions: Positions, longest_s: float) -> dict[float, float]:
    """Horizontal speeds [m/s] between successive positions, by the time of the second one."""
    times = sorted(positions)
    found = {}
    for before, after in pairwise(times):
        if after - before <= longest_s:
            up = positions[before] / np.linalg.norm(positions[before])
            velocity = (positions[after] - positions[before]) / (after - before)
            found[after] = float(np.linalg.norm(velocity - up * (velocity @ up)))
    return found


def _system(row: Mapping[str, str]) -> tuple[str, str]:
    return row["constellationType"], row["signalType"]


def _position(rows: Sequence[Mapping[str, str]]) -> FloatArray | None:
    """Least-squares position [m, ECEF]; None with fewer than four satellites or where the steps do not converge."""
    if len(rows) < 4:
        return None

    def column(name: str) -> FloatArray:
        return np.array([float(row[name]) for row in rows])

    satellite = np.column_stack([column(f"{axis}SatPosM") for axis in "xyz"])
    delays = column("isrbM") + column("ionoDelayM") + column("tropoDelayM")
    pseudorange = column("rawPrM") + column("satClkBiasM") - delays
    sd = np.maximum(column("rawPrUncM"), MIN_SD)
    state = np.append(6.37e6 * satellite.mean(axis=0) / np.linalg.norm(satellite.mean(axis=0)), 0.0)
    for _ in range(ROUNDS):
        turn = EARTH_RATE * np.linalg.norm(satellite - state[:3], axis=1) / SPEED_OF_LIGHT
        x, y, z = satellite.T
        c, s = np.cos(turn), np.sin(turn)
        away = np.column_stack([c * x + s * y, c * y - s * x, z]) - state[:3]
        distance = np.linalg.norm(away, axis=1)
        H = np.column_stack([-away / distance[:, np.newaxis], np.ones(len(rows))])
        fit = weighted_fit(H, pseudorange - distance - state[3], sd)
        if fit is None:
            return None
        state = state + fit.parameters
        if np.linalg.norm(fit.parameters[:3]) < 1e-3:
            return state[:3]
    return None

"""What all peers are given and how all are judged: `rtk_drive_57min`, from the true state at its start on."""

import os
import shlex
import subprocess
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import degrees
from pathlib import Path
from typing import TypedDict

import numpy as np

from benchmarks.navigation.cases import DRIVES, PHASES
from benchmarks.navigation.runs import REPOSITORY, data_folder
from cli.solve.metrics.counters import Counters
from cli.solve.metrics.drift import drifts
from cli.solve.metrics.errors import Stamps, errors_against
from cli.solve.metrics.metrics import Run, metrics_of
from cli.solve.outages import Gap, Outages
from cli.solve.reference_track import Reference
from cli.solve.track import NAMES, Track
from shared.maths.earth import FloatArray
from shared.messages.navigation import NavigationPhase

BEGIN_S, START_S, SETTLED_S = 456250.0, 456300.0, 456600.0  # of the files, of the protocol, of the judgement
BUILT = REPOSITORY / ".obu" / "peers"
LEVER_M = (0.136, -0.301, -0.184)
NO_ARM = (0.0, 0.0, 0.0)  # truth and solutions are of the IMU
OUTAGES_EACH = 15
OUTPUT_HZ = 20.0
# The ADIS16465 as published with the path: deg/sqrt(h), m/s/sqrt(h), deg/h, mGal, ppm, h.
ARW, VRW, GYRO_BIAS, ACCEL_BIAS, SCALE, CORRELATION_H = 0.1, 0.1, 25.0, 200.0, 1000.0, 1.0


class SetResult(TypedDict):
    """What a peer made of one set."""

    us_per_sample: float
    peak_mb: float
    accuracy: dict[str, float]


class PeerResult(TypedDict):
    """Of one peer: why it was not run, or what it made of each set."""

    absent: str | None
    sets: dict[str, SetResult]


@dataclass(frozen=True)
class PeerInput:
    """One set as every peer gets it."""

    imu: FloatArray  # time, three increments of angle [rad], three of velocity [m/s]; forward, right, down
    gnss: FloatArray  # time, latitude, longitude [deg], height, three sd NED, velocity NED, three sd NED
    odometer: FloatArray  # time, speed
    truth: Reference
    initial: FloatArray  # latitude, longitude [deg], height, velocity NED, roll, pitch, yaw [deg] at the start

    @property
    def rate_hz(self) -> int:
        """Of the inertial samples."""
        return round(1.0 / float(np.median(np.diff(self.imu[:, 0]))))

    def without(self, gaps: Sequence[Gap]) -> "PeerInput":
        """Take GNSS away."""
        stamps = nanoseconds(self.gnss[:, 0])
        hidden = np.any([(stamps >= first) & (stamps < last) for first, last in gaps], axis=0)
        return replace(self, gnss=self.gnss[~hidden])


def nanoseconds(seconds: FloatArray) -> Stamps:
    """Stamps [ns] of seconds of the week."""
    stamps: Stamps = np.round(seconds * 1e6).astype(np.int64) * 1000
    return stamps


def given(name: str) -> PeerInput:
    """Read a set."""
    folder = data_folder() / DRIVES[name].folder
    imu, truth = np.load(folder / "imu.npz"), np.load(folder / "truth_20hz.npz")
    row = int(np.searchsorted(truth["t_s"], START_S))
    lla, attitude = truth["lla"], truth["rpy_rad"]
    initial = np.r_[np.degrees(lla[row, :2]), lla[row, 2], truth["velocity_ned_m_s"][row], np.degrees(attitude[row])]
    reference = Reference(
        "truth", nanoseconds(truth["t_s"]), at_antenna=False, geodetic=lla,
        velocity_n=truth["velocity_ned_m_s"].astype(float), attitude=attitude,
    )  # fmt: skip
    increments = np.column_stack([imu["t_s"], imu["dtheta_rad"], imu["dvel_m_s"]])
    return PeerInput(increments, np.loadtxt(folder / "gnssv.txt"), np.loadtxt(folder / "odo.txt"), reference, initial)


@dataclass(frozen=True)
class Cost:
    """CPU seconds and memory of a program."""

    cpu_s: float
    peak_mb: float


class Peer(ABC):
    """A filter that somebody else has written."""

    name: str
    variable: str  # of the environment, that names the program
    how: str  # to come by it
    built: str = ""  # program that `build` has made, below `BUILT`
    sets: tuple[str, ...] = ("rtk", "spp")
    outages: bool = True

    @abstractmethod
    def prepare(self, data: PeerInput, folder: Path, program: str) -> list[str]:
        """Write the peer's own files; the command that runs it."""

    @abstractmethod
    def result(self, folder: Path) -> FloatArray:
        """Read time, latitude, longitude [deg], height, velocity NED, roll, pitch, yaw [deg]; 20 rows a second."""

    def measure(self, folder: Path) -> PeerResult:
        """Run the peer, if it is there."""
        built = BUILT / self.built
        program = os.environ.get(self.variable) or (str(built) if self.built and built.is_file() else None)
        if not program:
            return PeerResult(absent=f"{self.variable} names no program. {self.how}", sets={})
        present = [name for name in self.sets if (data_folder() / DRIVES[name].folder).is_dir()]
        try:
            return PeerResult(absent=None, sets={name: self._set(name, folder, program) for name in present})
        except (OSError, RuntimeError, ValueError) as error:
            return PeerResult(absent=f"It was started, but failed: {error}", sets={})

    def _set(self, name: str, folder: Path, program: str) -> SetResult:
        data, place = given(name), folder / f"{self.variable.lower()}-{name}"
        cost, solved = self._run(data, place, program)
        accuracy = judged(solved, data.truth)
        if self.outages:
            accuracy["outage_largest_error_rms_m"] = self._drift(data, place, program)
        samples = int((data.imu[:, 0] >= START_S).sum())
        return SetResult(us_per_sample=1e6 * cost.cpu_s / samples, peak_mb=cost.peak_mb, accuracy=accuracy)

    def _drift(self, data: PeerInput, folder: Path, program: str) -> float:
        largest: list[float] = []
        for phase in PHASES:
            gaps = protocol_gaps(phase)
            _, solved = self._run(data.without(gaps), folder.with_name(f"{folder.name}-{phase}"), program)
            errors = errors_against(data.truth, track_of(solved), lever_arm_b=NO_ARM)
            largest += [drift.largest_m for drift in drifts(errors, gaps)]
        return round(float(np.sqrt(np.mean(np.square(largest)))), 4)

    def _run(self, data: PeerInput, folder: Path, program: str) -> tuple[Cost, FloatArray]:
        folder.mkdir(parents=True, exist_ok=True)
        cost = run(self.prepare(data, folder, program), folder)
        return cost, self.result(folder)


def run(command: Sequence[str], folder: Path) -> Cost:
    """Run a program to its end, on one thread as far as it heeds that, and see what it took."""
    environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    with (folder / "output.log").open("wb") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log, cwd=folder, env=environment)
        _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"{shlex.join(command)} ended with {process.returncode}; see {folder / 'output.log'}")
    return Cost(usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024)


def protocol_gaps(phase_s: int) -> list[Gap]:
    """The outages of one run, as `obu solve --outage 60/180@PHASE` makes them."""
    outages = Outages.parse(f"60/180@{phase_s}")
    outages.recording_ns = round(BEGIN_S * 1e9)
    return outages.gaps(round(459662.0 * 1e9))[:OUTAGES_EACH]


def track_of(rows: FloatArray) -> Track:
    """Rows of a result as a track, with nothing in the columns that peers do not tell alike."""
    values = np.zeros((len(rows), len(NAMES)))
    places: dict[str, Callable[[FloatArray], FloatArray]] = {
        "latitude_deg": lambda r: r[:, 1:4],
        "velocity_north_m_s": lambda r: r[:, 4:7],
        "roll_rad": lambda r: np.radians(r[:, 7:10]),
    }
    for name, columns in places.items():
        first = NAMES.index(name)
        values[:, first : first + 3] = columns(rows)
    return Track(nanoseconds(rows[:, 0]), [NavigationPhase.NAVIGATING] * len(rows), values)


def judged(rows: FloatArray, truth: Reference) -> dict[str, float]:
    """Judge a result as `obu solve --score-from` judges ours."""
    track = track_of(rows)
    errors = errors_against(truth, track, lever_arm_b=NO_ARM)
    stamps = track.stamps_ns
    made = Run(track, Counters(), errors, [], int(stamps[0]), int(stamps[-1]), 0, 0, round(SETTLED_S * 1e9))
    metrics = metrics_of(made)
    names = ("horizontal_rmse_m", "vertical_rmse_m", "velocity_horizontal_rmse_m_s", "yaw_rmse_rad")
    found = {name: metrics[name] for name in names}
    accuracy = {name: value for name, value in found.items() if value is not None}
    accuracy["yaw_rmse_deg"] = round(degrees(accuracy.pop("yaw_rmse_rad")), 4)
    return accuracy


def thinned(rows: FloatArray) -> FloatArray:
    """About 20 rows a second, stamps rising."""
    step = max(1, round(1.0 / (OUTPUT_HZ * float(np.median(np.diff(rows[:, 0]))))))
    kept = rows[::step]
    rising: FloatArray = kept[np.r_[True, np.diff(kept[:, 0]) > 0.0]]
    return rising

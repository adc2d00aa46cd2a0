"""What an inertial sample costs in each way of navigating: `python -m benchmarks.navigation.ways`.

Sample by sample, a whole log at once, and that with Numba. Every row is a process of its own, so that its memory and
its start are its own; times are of the processor, the fastest of three. The drive is simulated; each sample cut in two
makes 200 Hz of its 100 Hz. With "gnss" a position a second is all that aids, for that is what KF-GINS does; "all" adds
velocity, wheels and standstill. Nothing is late.

KF_GINS names the executable of KF-GINS, KF_GINS_CONFIG a configuration and KF_GINS_SAMPLES the number of samples of
its log, and then it runs beside ours.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from services.core.fusion.aiding import Measurement
    from services.core.fusion.navigator import Navigator

ROOT = Path(__file__).resolve().parents[2]
DRIVE_S = 600.0
REPETITIONS = 3  # of which the fastest counts: whatever else runs here only adds
SECOND_NS = 1_000_000_000
CHUNK = 2000
WAYS = ("sample by sample", "whole log", "whole log, Numba")
BEGAN = "OBU_BENCHMARK_BEGAN"


@dataclass(frozen=True)
class Cost:
    """One way through one log."""

    way: str
    rate_hz: int
    aiding: str
    us_per_sample: float
    resident_mb: float
    first_solution_s: float  # from the start of the process


def main() -> int:
    """Measure every way, and print a table."""
    print("| way | Hz | aiding | us per sample | MB resident | s to the first solution |")
    print("|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "drive.npz"
        _save(path)
        for rate_hz in (100, 200):
            for aiding in ("gnss", "all"):
                for way in WAYS:
                    if cost := _apart(path, way, rate_hz, aiding):
                        print(
                            f"| {way} | {rate_hz} | {aiding} | {cost.us_per_sample:.2f} | {cost.resident_mb:.0f} ",
                            end="",
                        )
                        print(f"| {cost.first_solution_s:.2f} |", flush=True)
    print(_kf_gins())
    return 0


def _apart(path: Path, way: str, rate_hz: int, aiding: str) -> Cost | None:
    """Run in a process of its own."""
    command = [sys.executable, "-m", "benchmarks.navigation.ways", str(path), way, str(rate_hz), aiding]
    costs = []
    for _ in range(REPETITIONS):
        environment = os.environ | {BEGAN: repr(time.time())}
        run = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
        if run.returncode != 0:
            print(f"{way}: {run.stderr.strip().splitlines()[-1]}", file=sys.stderr)
            return None
        costs.append(Cost(**json.loads(run.stdout)))
    return min(costs, key=lambda cost: cost.us_per_sample)


def _kf_gins() -> str:
    """Time the peer on the reader's own log, with its reading and writing of files."""
    program, config = os.environ.get("KF_GINS"), os.environ.get("KF_GINS_CONFIG")
    samples = int(os.environ.get("KF_GINS_SAMPLES", "0"))
    if not (program and config and samples):
        return "KF-GINS was not timed: KF_GINS, KF_GINS_CONFIG and KF_GINS_SAMPLES do not say what to run."
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([program, config], check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return f"KF-GINS: {seconds / samples * 1e6:.1f} us per sample, with its reading and writing of files."


def _save(path: Path) -> None:
    """Simulate the drive once, so that the processes that are measured know nothing of the simulator."""
    import numpy as np

    from services.sensors.simulator.drive import simulate

    d = simulate("urban", seed=1, duration_s=DRIVE_S)
    good = d.fix_valid
    np.savez(
        path, t=d.t_ns, f=d.force_b, w=d.rate_b, arm=np.array(d.lever_arm_b), start=d.position[0], yaw=d.attitude[0, 2],
        fix=d.fix_ns[good], position=d.fix_position[good], velocity=d.fix_velocity_n[good],
        position_sd=d.fix_position_sd_n[good], velocity_sd=d.fix_velocity_sd_n[good],
        odometer_ns=d.odometer_ns, odometer=d.odometer,
    )  # fmt: skip


@dataclass(frozen=True)
class Log:
    """What a navigator is given."""

    fresh: "Callable[[], Navigator]"
    stamps: Any
    samples: Any
    measurements: "list[Measurement]"


def _load(path: Path, rate_hz: int, aiding: str) -> Log:
    """Make a log of the drive."""
    from math import radians

    import numpy as np

    from services.core.fusion.gnss import Reading, Stamp, gnss_measurements
    from services.core.fusion.heading import Prior
    from services.core.fusion.navigator import Navigator
    from services.core.fusion.settings import Settings
    from services.core.fusion.wheels import WheelSpeed
    from shared.maths.earth import Geodetic

    log, every = np.load(path), aiding == "all"
    settings = Settings(
        lever_arm_body_m=tuple(log["arm"].tolist()), levelling_s=2.0, merge_delay_s=0.0,
        zero_velocity=every, non_holonomic=every,
    )  # fmt: skip
    measurements: list[Measurement] = []
    for k, stamp_ns in enumerate((log["fix"] - 2_100_000).tolist()):
        reading = Reading((0.0, 0.0, 0.0), np.diag(log["position_sd"][k] ** 2))
        moving = Reading(tuple(log["velocity"][k].tolist()), np.diag(log["velocity_sd"][k] ** 2)) if every else None
        place, stamp = Geodetic(*log["position"][k].tolist()), Stamp(stamp_ns, stamp_ns, "gnss")
        measurements += gnss_measurements(settings, stamp, place, reading, moving)
    for stamp_ns, speed in zip(log["odometer_ns"].tolist(), log["odometer"].tolist(), strict=True):
        if every:
            measurements.append(WheelSpeed(stamp_ns, stamp_ns, "wheels", speed, 0.0, True, True, settings))
    prior = Prior(Geodetic(*log["start"].tolist()), (1.0, 1.0, 2.0), float(log["yaw"]), radians(1.0))

    def fresh() -> Navigator:
        navigator = Navigator(settings)
        navigator.remember(prior)
        return navigator

    stamps, samples = log["t"], np.column_stack([log["f"], log["w"]])
    if rate_hz == 200:
        stamps = np.column_stack([stamps - 5_000_000, stamps]).ravel()
        samples = np.repeat(samples, 2, axis=0)
    return Log(fresh, stamps, samples, sorted(measurements, key=lambda m: m.time_ns))


def _sample_by_sample(log: Log, began: float) -> tuple[float, float]:
    """CPU seconds, and seconds to the first solution."""
    given, first_s, seconds, navigator, pending = 0, 0.0, 0.0, log.fresh(), log.measurements
    for begin in range(0, len(log.stamps), CHUNK):  # the whole log as Python's numbers would be most of the memory
        stamps, rows = log.stamps[begin : begin + CHUNK].tolist(), log.samples[begin : begin + CHUNK].tolist()
        chunk = [(stamp, tuple(row[:3]), tuple(row[3:])) for stamp, row in zip(stamps, rows, strict=True)]
        started = time.process_time()
        for stamp, force, rate in chunk:
            while given < len(pending) and pending[given].time_ns <= stamp:
                navigator.measure(pending[given])
                given += 1
            navigator.imu(stamp, force, rate)
            if stamp % SECOND_NS == 0 and navigator.solution() is not None:
                first_s = first_s or time.time() - began
        seconds += time.process_time() - started
    return seconds, first_s


def _whole_log(log: Log, began: float, *, numba: bool) -> tuple[float, float]:
    """CPU seconds, and seconds to the first solution; fetching machine code counts as start and not as work."""
    from services.core.fusion.batch import solve
    from services.core.fusion.fast import compiled_run

    compiled, first_s, short = compiled_run() if numba else None, 0.0, 20 * 200
    if numba and compiled is None:
        raise SystemExit("Numba is not installed: pip install .[fast]")
    for _ in solve(
        log.fresh(), log.stamps[:short], log.samples[:short], log.measurements, every_ns=SECOND_NS, compiled=compiled
    ):
        first_s = first_s or time.time() - began
    started = time.process_time()
    for _ in solve(log.fresh(), log.stamps, log.samples, log.measurements, every_ns=SECOND_NS, compiled=compiled):
        pass
    return time.process_time() - started, first_s


def measure(path: Path, way: str, rate_hz: int, aiding: str) -> Cost:
    """Navigate through the drive in one way."""
    began, log = float(os.environ[BEGAN]), _load(path, rate_hz, aiding)
    if way == WAYS[0]:
        seconds, first_s = _sample_by_sample(log, began)
    else:
        seconds, first_s = _whole_log(log, began, numba=way == WAYS[2])
    resident_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return Cost(way, rate_hz, aiding, seconds / len(log.stamps) * 1e6, resident_mb, first_s)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        print(json.dumps(asdict(measure(Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]), sys.argv[4]))))
    else:
        sys.exit(main())

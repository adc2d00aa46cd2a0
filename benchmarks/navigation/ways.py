"""What an inertial sample costs in each way of navigating: `python -m benchmarks.navigation.ways`.

Sample by sample and a whole log at once, and both with Numba. Every row is a process of its own, so that its memory and
its start are its own; the ways take turns, and of the processor's times the least of each counts, for whatever else
runs on the machine only adds. A loop of plain Python beside them tells how fast the machine was: the ratio to it can be
compared between machines. The drive is simulated; each sample cut in two makes 200 Hz of its 100 Hz. With "gnss" a
position a second is all that aids, for that is what KF-GINS does; "all" adds velocity, wheels and standstill. Nothing
is late. A solution is asked for once a second.

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
from dataclasses import asdict, astuple, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from services.core.fusion.aids.base import Measurement
    from services.core.fusion.navigator import Navigator

ROOT = Path(__file__).resolve().parents[2]
DRIVE_S = 300.0
REPETITIONS = 3
SECOND_NS = 1_000_000_000
CHUNK = 2000
SHORT = 20 * 200  # samples
HALVES_SD = 1e-3  # [m/s², rad/s] by which the halves of a sample differ from it
WAYS = ("sample by sample", "whole log", "sample by sample, Numba", "whole log, Numba")
GOALS_US = {WAYS[0]: 8.0, WAYS[1]: 8.0, WAYS[2]: 2.0, WAYS[3]: 1.0}  # at 200 Hz with positions alone
GOAL_START_S, GOAL_MB = 0.6, 60.0  # the memory without Numba
YARD = 100_000  # turns of the loop that the machine is measured with
BEGAN = "OBU_BENCHMARK_BEGAN"
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # matrices of 34 by 34 are not worth a second one


@dataclass(frozen=True)
class Cost:
    """One way through one log."""

    us_per_sample: float
    yard_ns: float  # a turn of the loop
    start_mb: float  # resident when the first solution is there, the log included
    start_cpu_s: float  # of the processor, from the start of the process to the first solution
    start_s: float  # the same on the clock, which counts what others do meanwhile


def main() -> int:
    """Measure every way, and print a table beside the goals."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "drive.npz"
        _save(path)
        if _apart(path, WAYS[3], 200, "gnss"):  # which compiles, if that was not done before
            print(f"resident MB of Python {_resident_mb(''):.0f}, with NumPy {_resident_mb('import numpy'):.0f}\n")
        print("| way | Hz | aiding | us a sample | goal | over the loop's ns | MB at the start ", end="")
        print("| goal | CPU s to the first solution | goal | s on the clock |\n" + "|---" * 11 + "|")
        for rate_hz in (200, 100):
            for aiding in ("gnss", "all"):
                for way, cost in _turns(path, rate_hz, aiding).items():
                    print(_row(way, rate_hz, aiding, cost), flush=True)
    print(_kf_gins())
    return 0


def _row(way: str, rate_hz: int, aiding: str, cost: Cost) -> str:
    goal_us = f"<= {GOALS_US[way]:g}" if (rate_hz, aiding) == (200, "gnss") else ""
    goal_mb = "" if "Numba" in way else f"<= {GOAL_MB:g}"
    return (
        f"| {way} | {rate_hz} | {aiding} | {cost.us_per_sample:.2f} | {goal_us} "
        f"| {cost.us_per_sample / cost.yard_ns:.3f} | {cost.start_mb:.0f} | {goal_mb} "
        f"| {cost.start_cpu_s:.2f} | <= {GOAL_START_S:g} | {cost.start_s:.2f} |"
    )


def _turns(path: Path, rate_hz: int, aiding: str) -> dict[str, Cost]:
    """Run the ways in turns; the least of every figure of each."""
    found: dict[str, list[Cost]] = {}
    for _ in range(REPETITIONS):
        for way in WAYS:
            if cost := _apart(path, way, rate_hz, aiding):
                found.setdefault(way, []).append(cost)
    return {way: Cost(*map(min, zip(*map(astuple, costs), strict=True))) for way, costs in found.items()}


def _resident_mb(code: str) -> float:
    """Memory of a process that does nothing but this."""
    tell = f"{code}\nprint(open('/proc/self/statm').read().split()[1])"
    command, environment = [sys.executable, "-c", tell], os.environ | ONE_THREAD
    run = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return int(run.stdout) * resource.getpagesize() / 2**20


def _apart(path: Path, way: str, rate_hz: int, aiding: str) -> Cost | None:
    """Run in a process of its own."""
    command = [sys.executable, "-m", "benchmarks.navigation.ways", str(path), way, str(rate_hz), aiding]
    switch = {"NUMBA_DISABLE_JIT": "0" if "Numba" in way else "1"}
    environment = os.environ | ONE_THREAD | switch | {BEGAN: repr(time.time())}
    run = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    if run.returncode != 0:
        print(f"{way}: {run.stderr.strip().splitlines()[-1]}", file=sys.stderr)
        return None
    return Cost(**json.loads(run.stdout))


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
    good, samples = d.fix_valid, np.column_stack([d.force_b, d.rate_b])
    halves = np.random.default_rng(1).normal(0.0, HALVES_SD, samples.shape)  # no sensor says the same twice
    np.savez(
        path, t100=d.t_ns, s100=samples, arm=np.array(d.lever_arm_b), start=d.position[0], yaw=d.attitude[0, 2],
        t200=np.column_stack([d.t_ns - 5_000_000, d.t_ns]).ravel(),
        s200=np.stack([samples + halves, samples - halves], axis=1).reshape(-1, 6),
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

    from services.core.fusion.aids.gnss.fix import Reading, Stamp, gnss_measurements
    from services.core.fusion.aids.odometer.aid import WheelSpeed
    from services.core.fusion.navigator import Navigator
    from services.core.fusion.settings import Settings
    from services.core.fusion.start.heading import Prior
    from shared.maths.earth import Geodetic

    log, every = np.load(path), aiding == "all"
    settings = Settings().with_values(
        {
            "merge_delay_s": 0.0,
            "vehicle.gnss.lever_arm_body_m": tuple(log["arm"].tolist()),
            "alignment.levelling_s": 2.0,
            "standstill.enabled": every,
            "non_holonomic.enabled": every,
        }
    )
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
        navigator.use_prior(prior)
        return navigator

    stamps, samples = log[f"t{rate_hz}"], log[f"s{rate_hz}"]
    return Log(fresh, stamps, samples, sorted(measurements, key=lambda m: m.time_ns))


def _sample_by_sample(log: Log, first: "Callable[[], None]") -> float:
    """CPU seconds."""
    given, seconds, navigator, pending, aligned = 0, 0.0, log.fresh(), log.measurements, False
    for begin in range(0, len(log.stamps), CHUNK):  # the whole log as Python's numbers would be most of the memory
        stamps, rows = log.stamps[begin : begin + CHUNK].tolist(), log.samples[begin : begin + CHUNK].tolist()
        chunk = [(stamp, tuple(row[:3]), tuple(row[3:])) for stamp, row in zip(stamps, rows, strict=True)]
        started = time.process_time()
        for stamp, force, rate in chunk:
            while given < len(pending) and pending[given].time_ns <= stamp:
                navigator.measure(pending[given])
                given += 1
            navigator.imu(stamp, force, rate)
            if stamp % SECOND_NS == 0 and navigator.solution() is not None and not aligned:
                aligned = True
                first()
        seconds += time.process_time() - started
    return seconds


def _whole_log(log: Log, first: "Callable[[], None]") -> float:
    """CPU seconds, without those until the first solution of a short log, which are the start."""
    from services.core.fusion.batch import solve

    short, whole = (log.stamps[:SHORT], log.samples[:SHORT]), (log.stamps, log.samples)
    next(iter(solve(log.fresh(), *short, log.measurements, every_ns=SECOND_NS)))
    first()
    started = time.process_time()
    for _ in solve(log.fresh(), *whole, log.measurements, every_ns=SECOND_NS):
        pass
    return time.process_time() - started


def _yard_ns() -> float:
    """What a turn of a loop of plain Python costs now."""
    started, total = time.process_time(), 0.0
    for turn in range(YARD):
        total += turn * 0.5
    return (time.process_time() - started) / YARD * 1e9


def measure(path: Path, way: str, rate_hz: int, aiding: str) -> Cost:
    """Navigate through the drive in one way."""
    from shared.maths.compiled import COMPILED

    start = (0.0, 0.0, 0.0)
    if "Numba" in way and not COMPILED:
        raise SystemExit("Numba is not installed, or left out by NUMBA_DISABLE_JIT")
    log = _load(path, rate_hz, aiding)

    def first() -> None:
        nonlocal start
        resident = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * resource.getpagesize()
        start = resident / 2**20, time.process_time(), time.time() - float(os.environ[BEGAN])

    run = _sample_by_sample if way.startswith(WAYS[0]) else _whole_log
    seconds = run(log, first)
    return Cost(seconds / len(log.stamps) * 1e6, min(_yard_ns() for _ in range(5)), *start)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        print(json.dumps(asdict(measure(Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]), sys.argv[4]))))
    else:
        sys.exit(main())

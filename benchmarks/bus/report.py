"""Latency over the bus and cost of the whole unit: measures, prints the table and stores it."""

import argparse
import json
import os
import platform
import shutil
import subprocess
import tempfile
import timeit
from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path

from benchmarks import tables
from broker import local_config

from . import unit
from .hops import HERE

RESULTS = HERE.parent / "results"
UNIT_S, SHORT_S, SMOKE_S = 30.0, 10.0, 2.0
P50_GOAL_MS, P99_GOAL_MS, CPU_GOAL_PERCENT, PSS_GOAL_MB = 2.5, 6.0, 40.0, 450.0


def main(arguments: Sequence[str]) -> int:
    """Measure, or say what is missing."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument(
        "--short", action="store_true", help=f"{SHORT_S:.0f} s in place of {UNIT_S:.0f}; stores no result"
    )
    parser.add_argument("--smoke", action="store_true", help=f"{SMOKE_S:.0f} s, to see that it runs; stores no result")
    options = parser.parse_args(arguments)
    seconds = SMOKE_S if options.smoke else SHORT_S if options.short else UNIT_S
    if reason := missing():
        print(f"the bus is not measured: {reason}")
        return 0
    subprocess.run(["make", "--silent", "-C", str(HERE)], check=True)
    load_before = os.getloadavg()[0]
    realtime = take_realtime_priority()
    print(f"the whole unit, twice {seconds:.0f} s")
    with tempfile.TemporaryDirectory(prefix="obu-bench-") as folder:
        result = unit.measure(Path(folder), seconds, settled=not options.smoke)
    show(result, load_before, realtime=realtime, stored=not (options.smoke or options.short))
    return 0


def take_realtime_priority() -> bool:
    """Run everything that is measured, C and ours, as the vehicle's services run: before whatever else there is."""
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))  # children inherit it
    except PermissionError:
        return False
    return True


def missing() -> str | None:
    """Name what this machine lacks for the benchmark."""
    if local_config.executable() is None:
        return "there is no mosquitto; `apt install mosquitto` brings it"
    if shutil.which("gcc") is None or shutil.which("make") is None:
        return "there is no C compiler to make the yardstick with; `apt install gcc make libmosquitto-dev` brings it"
    probe = subprocess.run(
        ["gcc", "-x", "c", "-fsyntax-only", "-"], input=b"#include <mosquitto.h>\n", capture_output=True, check=False
    )
    return "there is no mosquitto.h; `apt install libmosquitto-dev` brings it" if probe.returncode else None


def show(result: unit.UnitResult, load_before: float, *, realtime: bool, stored: bool) -> None:
    """Print the table, and keep it with all the numbers behind it where it is to be stored."""
    document = {
        "measured_at": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": (here := machine()),
        "load_before": round(load_before, 2),
        "realtime_priority": realtime,
        "unit": asdict(result),
    }
    priority = "hot path under SCHED_RR, as in the vehicle" if realtime else "no real-time priority to be had"
    circumstances = f"{document['measured_at']} on {here}; {priority}; load {load_before:.1f} before"
    text = table(result, circumstances)
    print(text)
    if not stored:
        return
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "bus.json").write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
    tables.publish(RESULTS / "bus.md", text)


def machine() -> str:
    """Describe the machine and its Python as far as it matters for the numbers."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith(("model name", "Model"))]
    processor = f"{platform.machine()}, {os.cpu_count()} cores, {models[-1] if models else 'unknown'}"
    return f"{processor}, Python {platform.python_version()} with {_turn_ns():.0f} ns a turn of a loop"


def _turn_ns() -> float:
    """Time a turn of a loop that adds: a Python that was built without its own profile takes half as long again."""
    return 1e3 * min(timeit.repeat("for i in turns: total += i", "turns, total = range(1000), 0", number=1000))


def table(result: unit.UnitResult, circumstances: str) -> str:
    """Lay the numbers out beside their goals."""
    cpu = sum(cost.cpu_percent for cost in result.costs.values())
    pss = sum(cost.pss_mb for cost in result.costs.values())
    beside, c = result.imu_to_solution_beside, result.three_hops_c_beside
    rows = [
        ("IMU sample to solution: p50, ms", f"{result.imu_to_solution.p50_ms:.2f}", f"{P50_GOAL_MS:g}"),
        ("IMU sample to solution: p99, ms", f"{result.imu_to_solution.p99_ms:.2f}", f"{P99_GOAL_MS:g}"),
        ("the same beside three hops in C, times theirs: p50", f"{beside.p50_ms / c.p50_ms:.1f}", ""),
        ("the same beside three hops in C, times theirs: p99", f"{beside.p99_ms / c.p99_ms:.1f}", ""),
        ("CPU of the whole unit, % of one core", f"{cpu:.1f}", f"{CPU_GOAL_PERCENT:g}"),
        ("memory of the whole unit (PSS), MB", f"{pss:.0f}", f"{PSS_GOAL_MB:g}"),
    ]
    head = ("measure", "found", "at most")
    costs = [(name, f"{cost.cpu_percent:.1f}", f"{cost.pss_mb:.0f}") for name, cost in result.costs.items()]
    return (
        f"# The bus\n\nMeasured {circumstances}; IMU at {unit.IMU_RATE_HZ} Hz.\n\n{_markdown(head, rows)}\n"
        "## Cost of each process\n\n" + _markdown(("process", "CPU, % of one core", "PSS, MB"), costs)
    )


def _markdown(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)

"""The bus beside C, and the cost of the whole unit: runs everything, prints the table and stores it."""

import json
import os
import platform
import shutil
import socket
import subprocess
import tempfile
import time
import timeit
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

from broker import local_config
from cli.demo.local import broker_command, free_port

from . import unit
from .hops import HERE, PAYLOAD_BYTES, RATE_HZ, Ages, one_hop_c, one_hop_ours, three_hops_c

RESULTS = HERE.parent / "results"
ROUNDS, ROUND_S = 5, 3.0
UNIT_S = 30.0
RATIO_GOAL, CPU_GOAL_PERCENT, PSS_GOAL_MB = 4.0, 60.0, 700.0


@dataclass(frozen=True)
class Hops:
    """The rounds on an idle broker, summarised."""

    one_hop: Ages
    one_hop_c: Ages
    three_hops_c: Ages


def main() -> int:
    """Measure, or say what is missing."""
    if reason := missing():
        print(f"the bus is not measured: {reason}")
        return 0
    subprocess.run(["make", "--silent", "-C", str(HERE)], check=True)
    load_before = os.getloadavg()[0]
    realtime = take_realtime_priority()
    print(f"one hop and three hops, {ROUNDS} rounds of {ROUND_S:.0f} s each")
    hops = measure_hops()
    print(f"the whole unit, twice {UNIT_S:.0f} s")
    with tempfile.TemporaryDirectory(prefix="obu-bench-") as folder:
        result = unit.measure(Path(folder), UNIT_S)
    store(hops, result, load_before, realtime=realtime)
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


def measure_hops() -> Hops:
    """Take turns, so that whatever else the machine does disturbs all alike."""
    ours, c, three = [], [], []
    with tempfile.TemporaryDirectory(prefix="obu-bench-") as name, broker(Path(name)) as port:
        for _ in range(ROUNDS):
            c.append(one_hop_c(port, ROUND_S))
            ours.append(one_hop_ours(port, Path(name), ROUND_S))
            three.append(three_hops_c(port, RATE_HZ, ROUND_S))
    return Hops(Ages.typical(ours), Ages.typical(c), Ages.typical(three))


@contextmanager
def broker(folder: Path) -> Iterator[int]:
    """Run Mosquitto, configured as in the unit, on a free loopback port."""
    port = free_port()
    with (folder / "broker.log").open("wb") as log:
        process = subprocess.Popen(broker_command(folder, port, "mosquitto"), stderr=log)
    try:
        deadline = time.monotonic() + 5.0
        while time.monotonic() < deadline:
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", port)) == 0:
                    break
            time.sleep(0.05)
        yield port
    finally:
        process.terminate()
        process.wait()


def store(hops: Hops, result: unit.UnitResult, load_before: float, *, realtime: bool) -> None:
    """Print the table, and keep it with all the numbers behind it."""
    document = {
        "measured_at": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": (here := machine()),
        "load_before": round(load_before, 2),
        "realtime_priority": realtime,
        "hops": asdict(hops),
        "unit": asdict(result),
    }
    priority = "hot path under SCHED_RR, as in the vehicle" if realtime else "no real-time priority to be had"
    circumstances = f"{document['measured_at']} on {here}; {priority}; load {load_before:.1f} before"
    text = table(hops, result, circumstances)
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "bus.json").write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
    (RESULTS / "bus.md").write_text(text, encoding="utf-8")
    print(text)


def machine() -> str:
    """Describe the machine and its Python as far as it matters for the numbers."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith(("model name", "Model"))]
    processor = f"{platform.machine()}, {os.cpu_count()} cores, {models[-1] if models else 'unknown'}"
    return f"{processor}, Python {platform.python_version()} with {_turn_ns():.0f} ns a turn of a loop"


def _turn_ns() -> float:
    """Time a turn of a loop that adds: a Python that was built without its own profile takes half as long again."""
    return 1e3 * min(timeit.repeat("for i in turns: total += i", "turns, total = range(1000), 0", number=1000))


def table(hops: Hops, result: unit.UnitResult, circumstances: str) -> str:
    """Lay the numbers out beside their goals."""
    cpu = sum(cost.cpu_percent for cost in result.costs.values())
    pss = sum(cost.pss_mb for cost in result.costs.values())
    rows = [
        *_ratios(f"one hop, {RATE_HZ} Hz, {PAYLOAD_BYTES} bytes", hops.one_hop, hops.one_hop_c),
        *_ratios("IMU to solution, C beside it at the same rate", result.imu_to_solution_beside,
                 result.three_hops_c_beside),
        *_ratios(f"IMU to solution, C alone at {RATE_HZ} Hz", result.imu_to_solution, hops.three_hops_c),
        ("CPU of the whole unit, % of one core", f"{cpu:.1f}", "", "", f"<= {CPU_GOAL_PERCENT:.0f}"),
        ("memory of the whole unit (PSS), MB", f"{pss:.0f}", "", "", f"<= {PSS_GOAL_MB:.0f}"),
    ]  # fmt: skip
    head = ("measure", "ours", "C", "ratio", "goal")
    costs = [(name, f"{cost.cpu_percent:.1f}", f"{cost.pss_mb:.0f}") for name, cost in result.costs.items()]
    return (
        f"# The bus beside C\n\nMeasured {circumstances}.\n\n{_markdown(head, rows)}\n"
        f"## Cost of each process, IMU at {unit.IMU_RATE_HZ} Hz\n\n"
        + _markdown(("process", "CPU, % of one core", "PSS, MB"), costs)
    )


def _ratios(name: str, ours: Ages, c: Ages) -> list[tuple[str, ...]]:
    goal = f"<= {RATIO_GOAL:.0f}"
    return [
        (f"{name}: p50, ms", f"{ours.p50_ms:.3f}", f"{c.p50_ms:.3f}", f"{ours.p50_ms / c.p50_ms:.2f}", goal),
        (f"{name}: p99, ms", f"{ours.p99_ms:.3f}", f"{c.p99_ms:.3f}", f"{ours.p99_ms / c.p99_ms:.2f}", goal),
    ]


def _markdown(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)

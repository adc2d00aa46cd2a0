"""What the start of a unit costs, and how soon a killed process publishes again: `python -m benchmarks.bus.births`.

Twice: with processes that are forked from one parent, and with processes that start by themselves.
"""

import argparse
import json
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import psutil

from cli.demo.local import free_port, local_broker, unit
from cli.demo.supervisor import Supervisor
from shared.bus.bus import Bus
from shared.runtime.config import parse_vehicle
from shared.topics import BY_NAME

from .unit import VEHICLE

WATCH_S = 0.05
LIMIT_S = 120.0
KILLS = 5  # of each victim
PAUSE_S = 12.0  # after which the supervisor restarts a killed process without a longer pause
VICTIMS = {"parsers.imu": "imu/sample", "core.trust": "trust/state", "core.fusion": "navigation/solution"}


@dataclass(frozen=True)
class Births:
    """One way to start a unit: its processes, the parent included, and neither broker nor supervisor."""

    connected_s: float  # until every process is connected to the broker
    cpu_s: float  # user and system, until then
    pss_mb: float  # after the drive
    again_s: dict[str, float]  # median from the kill of a process to its first message


class Running:
    """A unit under its supervisor in this process, which is watched while anything is awaited."""

    def __init__(self, folder: Path, *, forked: bool) -> None:
        path = folder / "vehicle.toml"
        path.write_text(VEHICLE)
        (folder / "logs").mkdir()
        broker = local_broker(folder, free_port(), "mosquitto", parse_vehicle(VEHICLE))
        environment = {"OBU_VEHICLE": str(path), "OBU_BROKER": broker.address.url, "OBU_STATE": str(folder)}
        self.supervisor: Supervisor = unit(
            parse_vehicle(VEHICLE), environment, folder / "logs", broker.command, forked=forked
        )
        self._bus = Bus(
            "observer", "bench", broker.address, [BY_NAME[name] for name in VICTIMS.values()], folder, observer=True
        )
        self._lives: dict[str, set[int]] = {}

    def until(self, condition: Callable[[], bool]) -> float:
        """Watch until a condition holds; returns the time that it took."""
        started = time.monotonic()
        while not condition():
            if time.monotonic() - started > LIMIT_S:
                raise RuntimeError("it did not happen in time")
            self.supervisor.watch()
            for envelope in self._bus.receive(WATCH_S):
                self._lives.setdefault(envelope.topic, set()).add(envelope.incarnation)
        return time.monotonic() - started

    def processes(self) -> list[psutil.Process]:
        """Every process of the unit, and the parent of forked ones."""
        children = psutil.Process().children()
        return [child for child in children if "mosquitto" not in child.name()]

    def all_connected(self) -> bool:
        """Whether every process of the unit has said that it is connected."""
        return all(c.signs.is_connected for name, c in self.supervisor.children.items() if name != "broker")

    def again(self, name: str) -> float:
        """Kill a process; returns the time until the first message of its next life."""
        topic, process = VICTIMS[name], self.supervisor.children[name].process
        assert process is not None
        known = len(self._lives[topic])
        process.kill()
        return self.until(lambda: len(self._lives[topic]) > known)

    def close(self) -> None:
        """End everything."""
        self._bus.close()
        self.supervisor.stop()


def measure(seconds: float, *, forked: bool) -> Births:
    """Start a unit, let it drive, and kill some of its processes."""
    with tempfile.TemporaryDirectory() as folder:
        running = Running(Path(folder), forked=forked)
        try:
            connected_s = running.until(running.all_connected)
            cpu_s = sum(sum(process.cpu_times()[:2]) for process in running.processes())
            running.until(waited(seconds))
            pss_mb = sum(process.memory_full_info().pss for process in running.processes()) * 1e-6
            again = {name: list[float]() for name in VICTIMS}
            for _ in range(KILLS):
                for name, times in again.items():
                    running.until(waited(PAUSE_S / len(VICTIMS)))
                    times.append(running.again(name))
        finally:
            running.close()
    return Births(
        round(connected_s, 2), round(cpu_s, 2), round(pss_mb, 1),
        {name: round(statistics.median(times), 2) for name, times in again.items()},
    )  # fmt: skip


def waited(seconds: float) -> Callable[[], bool]:
    """Give a condition that holds after a time."""
    end = time.monotonic() + seconds
    return lambda: time.monotonic() > end


def main() -> None:
    """Print one line of JSON for each way."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="drive before the memory is measured")
    options = parser.parse_args()
    for forked in (False, True):
        print(json.dumps({"forked": forked} | asdict(measure(options.seconds, forked=forked))), flush=True)


if __name__ == "__main__":
    main()

"""What the whole unit costs, and how long an inertial sample takes from the driver to the solution."""

import os
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import psutil

from broker import local_config
from cli.demo.local import free_port, local_broker, reaches_broker, unit
from cli.demo.supervisor import Supervisor
from shared.bus.bus import Bus
from shared.messages.imu import ImuSamples
from shared.messages.navigation import NavigationPhase, NavigationSolution
from shared.processes import Role, running
from shared.runtime.config import BrokerAddress, parse_vehicle
from shared.topics import BY_NAME, hot_path

from .hops import Ages, three_hops_c

IMU_RATE_HZ = 100
VEHICLE = """
[vehicle]
name = "bench"

[vehicle.gnss]
lever_arm_body_m = [0.3, 0.0, -1.2]

[sensors.simulator]
scenario = "urban"
seed = 1

[monitoring.status]
port = 0
"""
COLD = tuple(row.name for row in running(Role.OBU) if row.name not in hot_path())
START_S = 10.0  # of a broker
READY_S = 60.0
ROUNDS = 5  # beside the yardstick
SETTLING_S = 10.0  # start-up costs more than running


@dataclass(frozen=True)
class Cost:
    """What a process uses: share of one core, and its share of memory (pages that it shares count in part)."""

    cpu_percent: float
    pss_mb: float


@dataclass(frozen=True)
class UnitResult:
    """The unit alone, and with the yardstick in C running beside it under the same load."""

    costs: dict[str, Cost]
    imu_to_solution: Ages
    imu_to_solution_beside: Ages
    three_hops_c_beside: Ages


class Listener:
    """Follows inertial samples from the arrival of their bytes to the arrival of their solution.

    As the yardstick's subscriber it wakes for solutions only, and takes the time when it has a packet in its hands;
    when the bytes arrived it reads from a second connection, once there is a solution.
    """

    def __init__(self, port: int, folder: Path) -> None:
        address = BrokerAddress("127.0.0.1", port)
        self._solutions, self._samples = (
            Bus("observer", "bench", address, [BY_NAME[name]], folder, observer=True)
            for name in ("navigation/solution", "imu/sample")
        )
        self._received_ns: dict[int, int] = {}
        self._order: deque[int] = deque()
        self.navigating = False

    def ages(self, seconds: float) -> list[int]:
        """Listen for a while; the age of each solution on arrival."""
        found: list[int] = []
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            arrived = self._solutions.receive(0.05)
            self._note()
            for envelope in arrived:
                solution = envelope.decode()
                assert isinstance(solution, NavigationSolution)
                self.navigating = solution.phase is NavigationPhase.NAVIGATING
                if solution.sampled_ns in self._received_ns:
                    found.append(envelope.received_ns - self._received_ns[solution.sampled_ns])
        return found

    def close(self) -> None:
        """Leave the bus."""
        self._solutions.close()
        self._samples.close()

    def _note(self) -> None:
        """Take down what came of samples; all of those of a solution did before it."""
        for envelope in self._samples.receive(0.0):
            samples = envelope.decode()
            assert isinstance(samples, ImuSamples)
            for stamp_ns in samples.sampled_ns:
                self._received_ns[stamp_ns] = samples.received_ns
                self._order.append(stamp_ns)
        while len(self._order) > 10 * IMU_RATE_HZ:
            del self._received_ns[self._order.popleft()]


@contextmanager
def running_unit(folder: Path) -> Iterator[tuple[Supervisor, int]]:
    """Run every process and Mosquitto; the supervisor, and the broker's port."""
    port, path = free_port(), folder / "vehicle.toml"
    path.write_text(VEHICLE)
    (folder / "logs").mkdir()
    broker = local_broker(folder, port, "mosquitto", parse_vehicle(VEHICLE))
    environment = {"OBU_VEHICLE": str(path), "OBU_BROKER": broker.address.url, "OBU_STATE": str(folder)}
    supervisor = unit(parse_vehicle(VEHICLE), environment, folder / "logs")
    supervisor.add("sensors.simulator", [sys.executable, "-m", "benchmarks.bus.party"])
    supervisor.add("broker", broker.command)
    try:
        _await_start(supervisor, folder)
        for name in COLD:
            os.sched_setscheduler(_host(supervisor, name).pid, os.SCHED_OTHER, os.sched_param(0))
        yield supervisor, port
    finally:
        supervisor.stop()


def _await_start(supervisor: Supervisor, folder: Path) -> None:
    """Start all processes: the recorder and the broker first, the others when these listen."""
    deadline = time.monotonic() + READY_S
    while supervisor.alive() < len(supervisor.children):
        supervisor.watch()
        if time.monotonic() > deadline:
            raise RuntimeError(f"not every process starts within {READY_S:.0f} s; see {folder / 'logs'}")
        time.sleep(0.05)


def measure(folder: Path, seconds: float, *, settled: bool = True) -> UnitResult:
    """Drive the simulated vehicle, and measure once it navigates and, where wanted, its start has settled."""
    with running_unit(folder) as (supervisor, port):
        listener = Listener(port, folder)
        _await_navigation(listener, folder, SETTLING_S if settled else 0.0)
        before, started = _cpu_s(supervisor), time.monotonic()
        alone = Ages.of(listener.ages(seconds))
        costs = _costs(supervisor, before, time.monotonic() - started)
        rounds = [_beside(listener, seconds / ROUNDS) for _ in range(ROUNDS)]
        listener.close()
        ours, yardstick = (Ages.typical(ages) for ages in zip(*rounds, strict=True))
        return UnitResult(costs, alone, ours, yardstick)


@contextmanager
def _open_broker(folder: Path) -> Iterator[int]:
    """Run a Mosquitto for the yardstick: the unit's own lets nobody else take the names of its processes."""
    port, program = free_port(), local_config.executable()
    path = folder / "mosquitto.conf"
    path.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\nset_tcp_nodelay true\nlog_type error\n")
    with subprocess.Popen([str(program), "-c", str(path)]) as process:
        try:
            _await_broker(port)
            yield port
        finally:
            process.terminate()


def _await_broker(port: int) -> None:
    deadline = time.monotonic() + START_S
    while True:
        try:
            reaches_broker(BrokerAddress("127.0.0.1", port))
        except OSError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.05)
        else:
            return


def _beside(listener: Listener, seconds: float) -> tuple[Ages, Ages]:
    """Ours, and a yardstick that is started anew: where the kernel places its processes changes it by half."""
    listener.ages(0.2)  # what came while nobody listened
    yardstick: list[Ages] = []
    with tempfile.TemporaryDirectory() as folder, _open_broker(Path(folder)) as port:
        thread = threading.Thread(target=lambda: yardstick.append(three_hops_c(port, IMU_RATE_HZ, seconds)))
        thread.start()
        ours = Ages.of(listener.ages(seconds))
        thread.join()
    return ours, yardstick[0]


def _await_navigation(listener: Listener, folder: Path, settling_s: float) -> None:
    deadline = time.monotonic() + READY_S
    while not listener.navigating:
        if time.monotonic() > deadline:
            raise RuntimeError(f"the unit does not navigate within {READY_S:.0f} s; see {folder / 'logs'}")
        listener.ages(0.5)
    listener.ages(settling_s)


def _host(supervisor: Supervisor, name: str) -> psutil.Process:
    process = supervisor.children[name].process
    assert process is not None
    return psutil.Process(process.pid)


def _hosts(supervisor: Supervisor) -> dict[str, psutil.Process]:
    hosts = {name: _host(supervisor, name) for name in supervisor.children}
    return hosts | ({} if supervisor.parent is None else {"parent of all": psutil.Process(supervisor.parent)})


def _cpu_s(supervisor: Supervisor) -> dict[str, float]:
    return {name: sum(host.cpu_times()[:2]) for name, host in _hosts(supervisor).items()}


def _costs(supervisor: Supervisor, before: dict[str, float], seconds: float) -> dict[str, Cost]:
    after = _cpu_s(supervisor)
    return {
        name: Cost(round(100 * (after[name] - before[name]) / seconds, 2), round(host.memory_full_info().pss * 1e-6, 1))
        for name, host in _hosts(supervisor).items()
    }

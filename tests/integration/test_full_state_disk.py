"""Every process starts while the disk of the state folder is full, and says that nothing is kept."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from shared.bus.bus import Bus
from shared.messages.operation import ProcessHealth, ProcessState
from shared.processes import PROCESSES, Kind, Role
from shared.runtime.config import BrokerAddress
from shared.topics import BY_NAME
from tests.support.bus import simulated
from tests.support.patience import HANGS_S

ROOT = Path(__file__).resolve().parents[2]
IN_A_NAMESPACE = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-ec"]
FULL = (
    "mount -t tmpfs none /dev/shm; mount -t tmpfs -o size=64k none {0}; cat /dev/zero >{0}/filler 2>/dev/null || true; "
)
VEHICLE = """
[vehicle]
name = "car"
[sensors.gnss]
device = "tcp://127.0.0.1:9"
[sensors.imu]
device = "tcp://127.0.0.1:9"
[sensors.can]
device = "socketcan://nothing"
[sensors.corrections]
sources = ["tcp://127.0.0.1:9"]
[monitoring.status]
port = 0
[monitoring.outputs]
gpsd_port = 0
nmea_port = 0
"""
PLAZA = """
[vehicle]
name = "car"
role = "rsu"
"""
NAMES = [row.name for row in PROCESSES if row.kind is not Kind.REPLAY]
WITHIN_S = 120.0


@pytest.mark.slow
def test_with_a_full_state_disk_every_process_starts_and_says_so(tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    if subprocess.run([*IN_A_NAMESPACE, FULL.format(disk)], capture_output=True, check=False).returncode:
        pytest.skip("this system lets no ordinary user mount a small disk")
    for role, text in ((Role.OBU, VEHICLE), (Role.RSU, PLAZA)):
        (tmp_path / f"{role}.toml").write_text(text)
    broker = simulated.start(tmp_path)
    bus = Bus("observer", "car", BrokerAddress(port=broker.port), [BY_NAME["health/+"]], tmp_path, observer=True)
    started: dict[str, subprocess.Popen[bytes]] = {}
    heard: dict[str, ProcessHealth] = {}
    try:
        for row in PROCESSES:
            if row.name in NAMES:
                started[row.name] = _start(row.name, Role.OBU if Role.OBU in row.roles else Role.RSU, tmp_path, broker)
        deadline = time.monotonic() + WITHIN_S
        while len(heard) < len(NAMES) and time.monotonic() < deadline:
            for envelope in bus.receive(0.2):
                message = envelope.decode()
                if isinstance(message, ProcessHealth) and message.state is ProcessState.READY:
                    heard[message.process] = message
        missing = {name: (tmp_path / f"{name}.log").read_text()[-500:] for name in NAMES if name not in heard}
        assert not missing
        assert {name: health.rejects.get("state disk") for name, health in heard.items()} == dict.fromkeys(NAMES, 1)
        assert [name for name, process in started.items() if process.poll() is not None] == []
    finally:
        for process in started.values():
            process.terminate()
        for process in started.values():
            process.wait(HANGS_S)
        bus.close()
        broker.stop()


def _start(name: str, role: Role, folder: Path, broker: simulated.SimulatedMosquitto) -> subprocess.Popen[bytes]:
    """Start a process with a full disk of its own below its state folder, which there was no room to make."""
    disk = folder / "disk"
    environment = {
        **os.environ,
        "OBU_VEHICLE": str(folder / f"{role}.toml"),
        "OBU_STATE": str(disk / "state"),
        "OBU_BROKER": f"mqtt://127.0.0.1:{broker.port}",
    }
    command = [*IN_A_NAMESPACE, FULL.format(disk) + 'exec "$@"', "sh", sys.executable, "-m", "cli", "run", name]
    with (folder / f"{name}.log").open("wb") as log:
        return subprocess.Popen(command, cwd=ROOT, env=environment, stdout=log, stderr=log)

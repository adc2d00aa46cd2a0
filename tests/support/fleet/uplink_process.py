"""monitoring.uplink as `obu run` starts it, beside publishers of what it reads on a real bus."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from shared.bus.bus import Bus
from shared.evidence import KeyFile
from shared.messages.base import Message
from shared.messages.imu import ImuSamples
from shared.messages.uplink import UplinkState
from shared.runtime.config import BrokerAddress
from shared.topics import BY_NAME
from tests.support.bus import brokers
from tests.support.data import REPOSITORY
from tests.support.fleet.certificates import Authority
from tests.support.outputs import fix, solution, verdict
from tests.support.patience import HANGS_S

WITHIN_S = 30.0


class UplinkProcess:
    """The process beside publishers of what it reads: ten solutions a second, and inertial samples as fast."""

    def __init__(self, folder: Path, port: int, authority: Authority) -> None:
        self.state = folder / "state"
        self.state.mkdir()
        self.key = KeyFile(self.state / "keys").signer()
        authority.enrol(self.state / "uplink", "car", port, self.key.key_id)
        vehicle = folder / "vehicle.toml"
        vehicle.write_text('[vehicle]\nname = "car"\n[monitoring.uplink]\n')
        self.broker = brokers.start(brokers.MOSQUITTO, folder)
        self._environment = {
            **os.environ, "OBU_STATE": str(self.state), "OBU_VEHICLE": str(vehicle),
            "OBU_BROKER": f"mqtt://127.0.0.1:{self.broker.port}", "OBU_KEYS": "",
        }  # fmt: skip
        self._log = (folder / "log").open("wb")
        self.process = self._started()
        address = BrokerAddress("127.0.0.1", self.broker.port)
        topics = (BY_NAME["uplink/state"],)
        self._buses = {
            name: Bus(name, "car", address, (), self.state)
            for name in ("core.fusion", "core.trust", "parsers.gnss", "parsers.imu")
        }
        self._observer = Bus("observer", "car", address, topics, self.state, observer=True)
        self.states: list[UplinkState] = []

    def kill(self) -> None:
        """End the process at once, and start it again."""
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()
        self.process = self._started()

    def drive_until(self, condition: Callable[[], bool]) -> None:
        """Publish in real time until a condition holds."""
        deadline = time.monotonic() + WITHIN_S
        while not condition():
            assert time.monotonic() < deadline, self.states[-1:]
            assert self.process.poll() is None, "the process has ended"
            now_ns = self._buses["core.fusion"].now_ns()
            messages: dict[str, Message] = {
                "parsers.gnss": fix(now_ns, time.time_ns()),
                "core.trust": verdict(now_ns),
                "core.fusion": solution(now_ns),
                "parsers.imu": samples(now_ns),
            }
            for name, message in messages.items():
                self._buses[name].publish(message)
            for bus in self._buses.values():
                bus.receive(0.0)
            self.states += [state for e in self._observer.receive(0.1) if isinstance(state := e.decode(), UplinkState)]

    def close(self) -> None:
        self.process.terminate()
        self.ended_with = self.process.wait(HANGS_S)
        for bus in (*self._buses.values(), self._observer):
            bus.close()
        self.broker.stop()
        self._log.close()

    def _started(self) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "cli", "run", "monitoring.uplink"]
        return subprocess.Popen(command, cwd=REPOSITORY, env=self._environment, stdout=self._log, stderr=self._log)


def samples(now_ns: int) -> ImuSamples:
    return ImuSamples(
        received_ns=now_ns, source="imu0", sampled_ns=(now_ns,), specific_force_body_m_s2=((0.0, 0.0, -9.8),),
        angular_rate_body_rad_s=((0.0, 0.0, 0.0),),
    )  # fmt: skip

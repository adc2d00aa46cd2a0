"""A real Mosquitto on a free loopback port, with the unit's configuration."""

import socket
import subprocess
import time
from pathlib import Path

import pytest

from broker import local_config
from cli.demo.local import free_port
from tests.support.bus import brokers

READY_WITHIN_S = 5.0


class Mosquitto:
    """A child process; its retained messages outlive a restart, as on the vehicle."""

    kind = brokers.MOSQUITTO

    def __init__(self, executable: str, folder: Path, acl: Path, *, closed: bool = False) -> None:
        self._executable, self._folder = executable, folder
        self.port = free_port()
        self._config = local_config.write(folder, self.port, acl.parent)
        if not closed:
            self._config.write_text(opened(self._config.read_text(), acl))
        self._process = self._run()

    def stop(self) -> None:
        """End it by SIGTERM; it saves its retained messages."""
        if self._process.poll() is None:
            self._process.terminate()
        self._process.wait(READY_WITHIN_S)

    def kill(self) -> None:
        """End it by SIGKILL: it saves nothing."""
        self._process.kill()
        self._process.wait(READY_WITHIN_S)

    def restart(self) -> None:
        """Start it again on the same port."""
        self.stop()
        self._process = self._run()

    def try_start(self) -> bool:
        """Start it; return whether it stays."""
        self._process = self._started()
        return self._process.poll() is None

    def _run(self) -> subprocess.Popen[bytes]:
        process = self._started()
        if process.poll() is not None:
            pytest.fail("Mosquitto does not start: " + (self._folder / "mosquitto.log").read_text())
        return process

    def _started(self) -> subprocess.Popen[bytes]:
        """Start it, and wait until it listens or has ended."""
        with (self._folder / "mosquitto.log").open("ab") as log:
            process = subprocess.Popen(local_config.command(self._executable, self._config), stderr=log)
        deadline = time.monotonic() + READY_WITHIN_S
        while time.monotonic() < deadline and process.poll() is None:
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", self.port)) == 0:
                    return process
            time.sleep(0.02)
        process.kill()
        process.wait()
        return process


def opened(text: str, acl: Path) -> str:
    """Change a configuration so that every client is who it says, as most tests need it."""
    closed = ("allow_anonymous", "use_username_as_clientid", "password_file", "acl_file")
    kept = [line for line in text.splitlines() if line.split(" ")[0] not in closed]
    return "\n".join((*kept, "allow_anonymous true", f"acl_file {acl}", ""))  # of every listener


def start(folder: Path, acl: str | None = None) -> Mosquitto:
    """Start Mosquitto, or skip the test where it is not installed."""
    return Mosquitto(_program(), folder, brokers.access_list(folder, acl))


def start_closed(folder: Path, acl: Path) -> Mosquitto:
    """Start Mosquitto with the access list and the password file beside it, or skip the test."""
    return Mosquitto(_program(), folder, acl, closed=True)


def _program() -> str:
    executable = local_config.executable()
    if executable is None:
        pytest.skip("no mosquitto on this machine: `apt install mosquitto` brings it")
    return executable

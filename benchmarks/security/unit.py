"""A simulated unit of its own, as `obu demo` starts it, and what its page says."""

import json
import os
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from http.client import HTTPException
from pathlib import Path
from typing import Any

import psutil

from cli.demo.local import free_port

ANSWER_S = 5.0
START_S = 180.0
POLL_S = 0.2


@dataclass(frozen=True)
class Unit:
    """The unit: its process, the port of its page, the folder of its state, and the environment of its processes."""

    process: subprocess.Popen[bytes]
    port: int
    state: Path

    def get(self, path: str) -> dict[str, Any]:
        """What a path of the page answers; nothing where it does not."""
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{self.port}{path}", timeout=ANSWER_S) as answer:
                found: dict[str, Any] = json.load(answer)
                return found
        except (OSError, ValueError, HTTPException):
            return {}

    @property
    def broker_port(self) -> int:
        """Port of the broker."""
        return int((self.state / "credentials" / "address").read_text().split()[0].rpartition(":")[2])

    def secret(self, name: str) -> str:
        """Secret of a user of the bus: an attacker that has taken a process over knows it."""
        return (self.state / "credentials" / name).read_text().strip()

    def child(self, mark: str) -> psutil.Process:
        """The process of the unit whose command holds a text."""
        for child in psutil.Process(self.process.pid).children(recursive=True):
            try:
                line = " ".join(child.cmdline())
            except psutil.Error:
                continue  # it has just ended
            if mark in line and "start.sh" not in line and "probe.py" not in line:
                return child
        raise LookupError(f"no process with {mark!r} in its command")

    def broker(self) -> psutil.Process:
        """The broker."""
        return self.child(str(self.state / "mosquitto.conf"))

    def verdict(self) -> str:
        """State of trust as the banner shows it."""
        return str(self.get("/api/trust").get("state", "no answer"))

    def is_well(self) -> bool:
        """Whether every process is ready and no outage is open."""
        health = self.get("/api/health")
        processes = health.get("processes", {})
        ready = bool(processes) and all(entry["status"] == "ready" for entry in processes.values())
        return ready and health.get("state") == "ok" and not self.get("/api/outages").get("open", [0])

    def until(self, condition: Callable[[], bool], limit_s: float) -> float | None:
        """Wait for a condition; the time it took [s], or None if it did not come."""
        started = time.monotonic()
        while time.monotonic() - started < limit_s:
            if condition():
                return time.monotonic() - started
            time.sleep(POLL_S)
        return None

    def outages(self) -> set[tuple[str, int]]:
        """Root causes of outages, each with its beginning [ns since 1970]."""
        found = self.get("/api/outages")
        return {(str(o["what"]), int(o["since_ns"])) for o in (*found.get("open", []), *found.get("closed", []))}


@contextmanager
def running(folder: Path) -> Iterator[Unit]:
    """Drive a simulated vehicle until the position can be used; raises RuntimeError if that does not come."""
    port = free_port()
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "cli", "demo", "--port", str(port), "--broker", "mosquitto"],
            env=os.environ | {"OBU_STATE": str(folder)}, stdout=log, stderr=log,
        )  # fmt: skip
    unit = Unit(process, port, folder / "demo")
    try:
        if unit.until(lambda: unit.verdict() == "safe" and unit.is_well(), START_S) is None:
            raise RuntimeError(f"the unit is not SAFE within {START_S:.0f} s; see {unit.state / 'logs'}")
        yield unit
    finally:
        process.terminate()
        process.wait(20.0)

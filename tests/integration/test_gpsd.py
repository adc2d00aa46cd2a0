"""The bytes of the simulated receiver, decoded by gpsd."""

import json
import math
import os
import pty
import shutil
import socket
import subprocess
import sys
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from cli.demo.local import free_port
from services.sensors.simulator.gnss.simulated_receiver import SOURCE
from services.sensors.simulator.scenarios import BY_NAME
from services.sensors.simulator.world import Equipment, World
from shared.bus.bus import Bus
from shared.messages.gnss import GnssRaw
from shared.messages.navigation import TruthState
from shared.runtime.config import BrokerAddress
from tests.support.bus import simulated
from tests.support.patience import HANGS_S

NS = 1_000_000_000
START_NS = time.time_ns()  # gpsd rejects times far from its own clock
SPEED_UP = 16.0  # this test reads no stamps of gpsd's own clock
LIMIT_S = 12.0
Report = dict[str, Any]  # JSON of gpsd

pytestmark = pytest.mark.skipif(shutil.which("gpsd") is None, reason="gpsd is not installed: apt install gpsd")


@contextmanager
def gpsd(device: str) -> Iterator[socket.socket]:
    """Run gpsd on a device and a port of its own, and connect to it."""
    port = free_port()
    command = [shutil.which("gpsd") or "gpsd", "-N", "-n", "-b", "-S", str(port), device]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        client = connect(port)
        client.sendall(b'?WATCH={"enable":true,"json":true}\n')
        client.settimeout(0.02)
        with client:
            yield client
    finally:
        process.terminate()
        process.wait(HANGS_S)


def connect(port: int) -> socket.socket:
    deadline = time.monotonic() + HANGS_S
    while True:
        with suppress(ConnectionRefusedError):
            return socket.create_connection(("127.0.0.1", port), 1.0)
        assert time.monotonic() < deadline, "gpsd does not listen"
        time.sleep(0.05)


def reports(protocol: str, wanted: int) -> tuple[list[Report], list[Report], list[TruthState]]:
    """Play the receiver to gpsd until it has reported enough positions with a fix: TPV, SKY and the truth."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    positions: list[Report] = []
    skies: list[Report] = []
    truth: list[TruthState] = []
    rest = b""
    try:
        with gpsd(os.ttyname(slave)) as client:
            began = time.monotonic()
            for due_ns, message in World(BY_NAME["highway"], 1, START_NS, Equipment(protocols=(protocol,))):
                if isinstance(message, TruthState):
                    truth.append(message)
                if not isinstance(message, GnssRaw):
                    continue
                assert message.source == SOURCE
                while time.monotonic() - began < (due_ns - START_NS) / NS / SPEED_UP:
                    with suppress(TimeoutError):
                        rest += client.recv(65536)
                os.write(master, message.data)
                *lines, rest = rest.split(b"\n")
                for report in map(json.loads, lines):
                    if report["class"] == "TPV" and report.get("mode", 0) >= 2:
                        positions.append(report)
                    elif report["class"] == "SKY" and "satellites" in report:
                        skies.append(report)
                if len(positions) >= wanted or time.monotonic() - began > HANGS_S:
                    break
    finally:
        os.close(master)
        os.close(slave)
    return positions, skies, truth


@pytest.mark.parametrize("protocol", ["ubx", "nmea"])
def test_gpsd_decodes_the_true_position(protocol: str) -> None:
    positions, _, truth = reports(protocol, 40)
    assert len(positions) >= 20
    assert {report["mode"] for report in positions[5:]} == {3}
    last = positions[-1]
    lat, lon = math.radians(last["lat"]), math.radians(last["lon"])

    def distance_rad(t: TruthState) -> float:
        east = (lon - math.radians(t.longitude_deg)) * math.cos(lat)
        return math.hypot(lat - math.radians(t.latitude_deg), east)

    near = min(truth, key=distance_rad)  # gpsd may be an epoch behind what was written
    assert distance_rad(near) * 6.37e6 < 2.5, "metres: the truth comes every 100 ms"
    assert last["altHAE"] == pytest.approx(near.height_ellipsoid_m + 1.2, abs=0.1)
    assert last["speed"] > 10.0
    assert near.yaw_rad is not None and last["track"] == pytest.approx(math.degrees(near.yaw_rad), abs=0.5)


def test_gpsd_decodes_satellites_and_stated_accuracy() -> None:
    positions, skies, _ = reports("ubx", 10)
    assert positions[-1]["eph"] == pytest.approx(math.hypot(0.01, 0.01), abs=0.001)
    assert positions[-1]["epv"] == pytest.approx(0.015, abs=0.001)
    assert skies[-1]["uSat"] > 20
    assert skies[-1]["pdop"] == pytest.approx(math.hypot(skies[-1]["hdop"], skies[-1]["vdop"]), abs=0.02)


@pytest.mark.skipif(shutil.which("gpsdecode") is None, reason="gpsdecode is not installed: apt install gpsd-clients")
def test_gpsdecode_reads_the_output_of_obu_tail_raw(tmp_path: Path) -> None:
    """The device bytes are written to the pipe while the unit runs."""
    broker = simulated.start(tmp_path)
    environment = os.environ | {"OBU_BROKER": f"mqtt://127.0.0.1:{broker.port}", "OBU_STATE": str(tmp_path)}
    command = [sys.executable, "-m", "cli", "tail", "--raw", "gnss/raw", "--count", "60"]
    tail = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE)
    world = World(BY_NAME["highway"], 1, START_NS, Equipment(protocols=("nmea",)))
    chunks = (message for _, message in world if isinstance(message, GnssRaw))
    bus = Bus("sensors.gnss", "vehicle", BrokerAddress("127.0.0.1", broker.port), (), tmp_path)
    sent = b""
    try:
        while tail.poll() is None:
            bus.receive(0.02)
            if any(name.startswith("observer") for name in broker.handle.broker.sessions):
                chunk = next(chunks)
                bus.publish(chunk)
                sent += chunk.data
    finally:
        bus.close()
        broker.stop()
    written, _ = tail.communicate()
    assert written and written in sent
    decoded = subprocess.run(["gpsdecode"], input=written, capture_output=True, check=True, timeout=HANGS_S).stdout
    fixes = [report for line in decoded.splitlines() if (report := json.loads(line))["class"] == "TPV"]
    assert any("lat" in fix for fix in fixes)

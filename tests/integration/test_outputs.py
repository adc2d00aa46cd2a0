"""gpsd, gpspipe, cgps and gpxlogger read what monitoring.outputs gives."""

import fcntl
import json
import os
import pty
import select
import shutil
import socket
import struct
import subprocess
import termios
import threading
import time
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from cli.demo.local import free_port
from services.monitoring.outputs.process import Config, Process
from shared.messages.operation import OriginKind
from tests.support.bus.live_bus import LiveBus, eventually, running
from tests.support.outputs import LATITUDE_DEG, LONGITUDE_DEG, fix, origin, satellites, solution, verdict
from tests.support.patience import HANGS_S

Report = dict[str, Any]  # JSON of gpsd

pytestmark = pytest.mark.skipif(shutil.which("gpspipe") is None, reason="no gpspipe: apt install gpsd-clients")


@contextmanager
def unit(kind: OriginKind = OriginKind.LIVE) -> Iterator[tuple[LiveBus, int, int]]:
    """Run the process with ten solutions a second: bus, port of gpsd, port of NMEA."""
    gpsd_port, nmea_port = free_port(), free_port()
    process = Process(Config(gpsd_port=gpsd_port, nmea_port=nmea_port, rate_hz=5))
    with running(process.run) as bus:
        ended = threading.Event()

        def drive() -> None:
            while not ended.wait(0.1):
                now_ns = bus.now_ns()
                for message in (origin(now_ns, kind), verdict(now_ns), fix(now_ns, time.time_ns()),
                                satellites(now_ns), solution(now_ns)):  # fmt: skip
                    bus.deliver(message)

        thread = threading.Thread(target=drive)
        thread.start()
        try:
            eventually(lambda: process.nmea.socket is not None)
            yield bus, gpsd_port, nmea_port
        finally:
            ended.set()
            thread.join()


def piped(port: int, *options: str) -> list[bytes]:
    command = ["gpspipe", *options, f"127.0.0.1:{port}"]
    return subprocess.run(command, capture_output=True, check=True, timeout=HANGS_S).stdout.splitlines()


def test_gpspipe_reads_json() -> None:
    with unit() as (_, port, _):
        reports = [json.loads(line) for line in piped(port, "-w", "-n", "16")]
    assert [report["class"] for report in reports[:3]] == ["VERSION", "DEVICES", "WATCH"]
    position = [report for report in reports if report["class"] == "TPV"][-1]
    assert (position["mode"], position["status"]) == (3, 6)
    assert position["lat"] == pytest.approx(LATITUDE_DEG, abs=1e-8)
    assert any(report["class"] == "SKY" and report["uSat"] == 8 for report in reports)


def test_gpspipe_reads_nmea_from_the_same_port() -> None:
    with unit() as (_, port, _):
        lines = piped(port, "-r", "-n", "16")
    assert {line[:6] for line in lines if line.startswith(b"$")} >= {b"$GNRMC", b"$GNGGA", b"$GNGSA", b"$GNHDT"}


@pytest.mark.skipif(shutil.which("gpxlogger") is None, reason="no gpxlogger: apt install gpsd-clients")
def test_gpxlogger_writes_a_track(tmp_path: Path) -> None:
    track = tmp_path / "track.gpx"
    with unit() as (_, port, _):
        logger = subprocess.Popen(["gpxlogger", "-f", str(track), "-i", "1", f"127.0.0.1:{port}"])
        time.sleep(3.0)
        logger.terminate()
        logger.wait(HANGS_S)
    points = [node for node in ET.parse(track).iter() if node.tag.endswith("trkpt")]  # its own output
    assert points
    assert float(points[0].get("lat", "nan")) == pytest.approx(LATITUDE_DEG, abs=1e-7)


@pytest.mark.skipif(shutil.which("cgps") is None, reason="no cgps: apt install gpsd-clients")
def test_cgps_shows_the_position() -> None:
    master, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 120, 0, 0))  # of the screen that it draws on
    shown = b""
    with unit() as (_, port, _):
        cgps = subprocess.Popen(["cgps", f"127.0.0.1:{port}"], env={"TERM": "xterm"}, stdin=slave, stdout=slave)
        try:
            deadline = time.monotonic() + HANGS_S
            while str(LATITUDE_DEG)[:8].encode() not in shown and time.monotonic() < deadline:
                if select.select([master], [], [], 0.2)[0]:
                    shown += os.read(master, 65536)
        finally:
            cgps.terminate()
            cgps.wait(HANGS_S)
            os.close(master)
            os.close(slave)
    assert str(LATITUDE_DEG)[:8].encode() in shown
    assert b"3D" in shown


@pytest.mark.skipif(shutil.which("gpsd") is None, reason="no gpsd: apt install gpsd")
@pytest.mark.parametrize(("kind", "status"), [(OriginKind.LIVE, None), (OriginKind.SIMULATED, 8)])
def test_gpsd_itself_reads_nmea_over_tcp(kind: OriginKind, status: int | None) -> None:
    port = free_port()
    with unit(kind) as (_, _, nmea_port):
        command = [shutil.which("gpsd") or "gpsd", "-N", "-n", "-S", str(port), f"tcp://127.0.0.1:{nmea_port}"]
        gpsd = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            position = first_position(port)
        finally:
            gpsd.terminate()
            gpsd.wait(HANGS_S)
    assert position["mode"] == 3
    assert position.get("status") == status
    assert position["lat"] == pytest.approx(LATITUDE_DEG, abs=1e-7)
    assert position["lon"] == pytest.approx(LONGITUDE_DEG, abs=1e-7)
    assert position["speed"] == pytest.approx(5.0, abs=0.01)


def first_position(port: int) -> Report:
    deadline = time.monotonic() + HANGS_S
    while time.monotonic() < deadline:
        with suppress(OSError), socket.create_connection(("127.0.0.1", port), 1.0) as client:
            client.settimeout(5.0)
            client.sendall(b'?WATCH={"enable":true,"json":true}\n')
            for line in client.makefile():
                report: Report = json.loads(line)
                if report["class"] == "TPV" and report.get("mode") == 3 and "speed" in report:
                    return report
        time.sleep(0.1)
    raise AssertionError("gpsd gives no position")

"""Corrections from casters that others have written, as processes of their own on this machine."""

import shutil
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from cli.demo.local import free_port
from services.sensors.corrections.process import Config
from tests.support.bus import mosquitto
from tests.support.gnss.correction_chain import chain
from tests.support.gnss.frames import rtcm, spartn
from tests.support.patience import HANGS_S

FRAMES = [rtcm(1005, 19), rtcm(1077, 400), rtcm(1087, 300), rtcm(1230, 10)]
SIMPLE = {"RTCM 1005 station position", "RTCM 1230 GLONASS biases"}
TYPES = {"RTCM 1077 GPS MSM7", "RTCM 1087 GLONASS MSM7", *SIMPLE}


@contextmanager
def base() -> Iterator[int]:
    """A base: a TCP server that sends every client the same frames, ten times a second; gives its port."""
    stop = threading.Event()

    def serve(connection: socket.socket) -> None:
        with connection, suppress(OSError):
            while not stop.is_set():
                connection.sendall(b"".join(FRAMES))
                time.sleep(0.1)

    def accept() -> None:
        while not stop.is_set():
            with suppress(TimeoutError):
                connection, _ = server.accept()
                threads.append(threading.Thread(target=serve, args=(connection,)))
                threads[-1].start()

    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.05)
        threads = [threading.Thread(target=accept)]
        threads[0].start()
        try:
            yield int(server.getsockname()[1])
        finally:
            stop.set()
            for thread in threads:
                thread.join(HANGS_S)


def program(name: str, remedy: str) -> str:
    found = shutil.which(name) or shutil.which(name, path=str(Path(sys.executable).parent))
    if found is None:
        pytest.skip(f"{name} is not installed: {remedy}")
    return found


@contextmanager
def running(command: list[str], port: int) -> Iterator[None]:
    """Run a caster until its port is open, and end it."""
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        deadline = time.monotonic() + HANGS_S
        while True:
            with suppress(OSError), socket.create_connection(("127.0.0.1", port), 1.0):
                break
            assert time.monotonic() < deadline and process.poll() is None, f"{command[0]} does not listen"
            time.sleep(0.05)
        yield
    finally:
        process.terminate()
        try:
            process.wait(HANGS_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait(HANGS_S)


@contextmanager
def str2str() -> Iterator[int]:
    """RTKLIB's program as a caster of NTRIP version 1."""
    caster, port = program("str2str", "apt install rtklib"), free_port()
    with base() as source:
        command = [caster, "-in", f"tcpcli://127.0.0.1:{source}", "-out", f"ntripc://me:secret@:{port}/MOUNT"]
        with running(command, port):
            yield port


def password(folder: Path, text: str) -> str:
    path = folder / "password"
    path.write_text(text)
    path.chmod(0o600)
    return str(path)


def test_the_stream_of_str2str_arrives_whole(tmp_path: Path) -> None:
    with str2str() as port:
        config = Config(sources=(f"ntrip://me@127.0.0.1:{port}/MOUNT",), password_file=password(tmp_path, "secret"))
        with chain(config) as run:
            run.until(lambda: run.state is not None and run.state.types.keys() >= TYPES)
            assert b"".join(FRAMES) in run.data()
            assert run.state is not None and run.state.rejects.keys() <= {"garbage_bytes", "rtcm_checksum"}


def test_what_str2str_refuses_is_said_with_the_remedy(tmp_path: Path) -> None:
    with str2str() as port:
        locked, lost = f"ntrip://me@127.0.0.1:{port}/MOUNT", f"ntrip://me@127.0.0.1:{port}/M0UNT"
        with chain(Config(sources=(locked,), password_file=password(tmp_path, "wrong"))) as run:
            run.until(run.says("user or password"))
            assert run.data() == b"" and "wrong" not in str(run.bus.published)
        with chain(Config(sources=(lost,), password_file=password(tmp_path, "secret"))) as run:
            run.until(run.says("does not know the mount point 'M0UNT'; near to it are MOUNT"))


@pytest.mark.parametrize("version", ["2.0", "1.0"])
def test_the_stream_of_gnssserver_arrives_whole(tmp_path: Path, version: str) -> None:
    """That of pygnssutils: NTRIP version 2 with chunks, and version 1. It passes on what it can decode itself."""
    caster, port = program("gnssserver", "pip install pygnssutils"), free_port()
    with base() as source:
        command = [
            caster, "-S", f"127.0.0.1:{source}", "-O", str(port), "-H", "127.0.0.1", "-N", "1",
            "--ntripversion", version, "--ntripuser", "me", "--ntrippassword", "secret",
        ]  # fmt: skip
        config = Config(
            sources=(f"ntrip://me@127.0.0.1:{port}/pygnssutils",), password_file=password(tmp_path, "secret")
        )
        with running(command, port), chain(config) as run:
            run.until(lambda: run.state is not None and run.state.types.keys() >= SIMPLE)
            assert run.state is not None and not run.state.rejects


@pytest.mark.broker
def test_spartn_arrives_from_the_topics_of_a_broker(tmp_path: Path) -> None:
    from paho.mqtt import client as mqtt
    from paho.mqtt.enums import CallbackAPIVersion

    frames = [spartn(0, 0), spartn(1, 2, 900), spartn(2, 0, 30)]
    broker = mosquitto.start(tmp_path, "topic readwrite #\n")
    try:
        sender = mqtt.Client(CallbackAPIVersion.VERSION2)
        sender.connect("127.0.0.1", broker.port)
        sender.loop_start()
        source = f"mqtt://127.0.0.1:{broker.port}?topic=/pp/ip/eu"
        with chain(Config(sources=(source,))) as run:
            run.until(run.says("connected"))
            for _ in range(20):
                for frame in frames:
                    sender.publish("/pp/ip/eu", frame)
                time.sleep(0.02)
                run.pump()
            run.until(lambda: len(run.data()) > 0)
            assert b"".join(frames) in run.data() and run.state is not None
            run.until(lambda: run.state is not None and "SPARTN HPAC Galileo" in run.state.types)
        sender.loop_stop()
        sender.disconnect()
    finally:
        broker.stop()

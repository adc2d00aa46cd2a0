"""Floods on a running unit: the memory of its broker, its verdict, the answers of its page, and its logs."""

import socket
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from shared.topics import MANY_BYTES
from tests.support.bus import raw_mqtt
from tests.support.bus.mqtt import Client

from .unit import Unit

MB = 1_000_000
FLOOD_S = 12.0
TAKEN = "parsers.v2x"  # a name with a secret that does not run in the demo: a process that was taken over
TOPICS = ("v2x/cam", "v2x/send", f"health/{TAKEN}", f"consumed/{TAKEN}")
SESSIONS, OCCUPYING, VISITORS = 470, 1000, 1100
BEGUN = b"\x10\xff\xff\x0f"  # a CONNECT of the largest packet, whose rest does not come
RESTARTED, BACK_S = "monitoring.recorder", 10.0  # killed meanwhile: no verdict depends on it


@dataclass(frozen=True)
class Flood:
    """What came of one flood."""

    name: str
    refused: str
    broker_peak_mb: float
    verdicts: tuple[str, ...]  # during and after it
    page_slowest_s: float
    log_bytes: int
    recovered: bool = True  # what was to come back did

    @property
    def passed(self) -> bool:
        """Broker below 100 MB, the verdict SAFE throughout, the page answering others, logs below 10 kB."""
        return self.recovered and (
            self.broker_peak_mb < 100.0 and set(self.verdicts) == {"safe"} and self.page_slowest_s < 5.0
            and self.log_bytes < 10_000
        )  # fmt: skip


class Gauge:
    """Watches the unit during a flood."""

    def __init__(self, unit: Unit) -> None:
        self._unit = unit
        self._due_s = 0.0
        self._logs = _log_bytes(unit)
        self.peak_mb = self.slowest_s = 0.0
        self.verdicts: list[str] = []

    def read(self) -> None:
        """Measure, twice a second at most."""
        if time.monotonic() < self._due_s:
            return
        started = time.monotonic()
        self.verdicts.append(self._unit.verdict())
        self.slowest_s = max(self.slowest_s, time.monotonic() - started)
        self.peak_mb = max(self.peak_mb, self._unit.broker().memory_info().rss / MB)
        self._due_s = time.monotonic() + 0.5

    def result(self, name: str, refused: str, recovered: bool = True) -> Flood:
        """What came of it."""
        self._due_s = 0.0
        self.read()
        logs = _log_bytes(self._unit) - self._logs
        peak_mb, slowest_s = round(self.peak_mb, 1), round(self.slowest_s, 2)
        return Flood(name, refused, peak_mb, tuple(self.verdicts), slowest_s, logs, recovered)


def _log_bytes(unit: Unit) -> int:
    """Bytes in the logs of the unit's processes; that of the broker has a limit of its own."""
    return sum(path.stat().st_size for path in (unit.state / "logs").glob("*.log") if path.name != "broker.log")


def every_flood(unit: Unit) -> Iterator[Flood]:
    """Try each flood, one after the other."""
    floods: tuple[Callable[[Unit], Flood], ...] = (
        _without_secret, _retained, _sessions, _acknowledged, _silent, _unfinished, _visitors
    )  # fmt: skip
    for flood in floods:
        yield flood(unit)
        unit.until(lambda: unit.verdict() == "safe", 60.0)


def _without_secret(unit: Unit) -> Flood:
    gauge, refused, end = Gauge(unit), 0, time.monotonic() + 5.0
    while time.monotonic() < end:
        with Client(unit.broker_port, user="core.fusion", password="guess") as client:
            refused += client.connect().is_failure
        gauge.read()
    return gauge.result("connections with a wrong secret, one after the other", f"all {refused} refused")


def _retained(unit: Unit) -> Flood:
    """600 MB of retained messages by a process that was taken over, while an observer reads nothing."""
    gauge, sent = Gauge(unit), 0
    with ExitStack() as stack:
        idle = stack.enter_context(_idle_observer(unit))
        client = stack.enter_context(Client(unit.broker_port, user=TAKEN, password=unit.secret(TAKEN)))
        client.connect()
        end = time.monotonic() + FLOOD_S
        while time.monotonic() < end and sent * MANY_BYTES < 600 * MB and not client.ended:
            try:
                for topic in TOPICS:
                    client.publish(f"obu/demo/{topic}", bytes(MANY_BYTES), qos=0, retain=True)
                    sent += 1
            except AssertionError:  # the broker reads no more
                break
            gauge.read()
        ended = client.ended
        idle.close()
    name = f"600 MB retained by {TAKEN}, beside an observer that reads nothing"
    return gauge.result(name, f"{'cut off' if ended else 'slowed down'} after {sent * MANY_BYTES // MB} MB")


@contextmanager
def _idle_observer(unit: Unit) -> Iterator[socket.socket]:
    name = "observer.8"
    with socket.create_connection(("127.0.0.1", unit.broker_port)) as connection:
        connection.sendall(raw_mqtt.connect_packet(name, name, unit.secret(name)))
        if connection.recv(4)[3:] != b"\x00":
            raise RuntimeError("the broker refuses the observer")
        connection.sendall(raw_mqtt.subscribe("obu/demo/#"))
        yield connection


def _sessions(unit: Unit) -> Flood:
    """470 sessions of one name: each ends the one before."""
    gauge, held = Gauge(unit), 0
    with ExitStack() as stack:
        clients = []
        for _ in range(SESSIONS):
            client = stack.enter_context(Client(unit.broker_port, user=TAKEN, password=unit.secret(TAKEN)))
            held += not client.connect().is_failure
            clients.append(client)
            gauge.read()
        for client in clients:
            client.exchange(0.0)
        left = sum(not client.ended for client in clients)
    return gauge.result(f"{SESSIONS} sessions of one name", f"{held} accepted, {left} left: each ends the one before")


def _acknowledged(unit: Unit) -> Flood:
    gauge, sent = Gauge(unit), 0
    with Client(unit.broker_port, user=TAKEN, password=unit.secret(TAKEN)) as client:
        client.connect()
        end = time.monotonic() + FLOOD_S
        while time.monotonic() < end and not client.ended:
            for _ in range(50):
                client.paho.publish("obu/demo/v2x/cam", b"x" * 200, 1)
            sent += 50
            client.exchange(0.0)
            gauge.read()
    return gauge.result("QoS 1 messages without end", f"{sent} sent, invalid, dropped by each consumer")


def _silent(unit: Unit) -> Flood:
    return _occupied(unit, f"{OCCUPYING} connections to the broker that say nothing", b"")


def _unfinished(unit: Unit) -> Flood:
    return _occupied(unit, f"{OCCUPYING} connections to the broker with an unfinished CONNECT", BEGUN)


def _occupied(unit: Unit, name: str, first: bytes) -> Flood:
    """Occupy the broker's port; a process that is killed meanwhile has to be connected again."""
    gauge = Gauge(unit)
    with ExitStack() as stack:
        for _ in range(OCCUPYING):
            try:
                connection = stack.enter_context(socket.create_connection(("127.0.0.1", unit.broker_port), timeout=2.0))
                connection.sendall(first)
            except OSError:
                continue  # refused
            gauge.read()
        before = unit.child(f"cli run {RESTARTED}").pid
        unit.child(f"cli run {RESTARTED}").kill()

        def is_back() -> bool:
            gauge.read()
            try:
                again = unit.child(f"cli run {RESTARTED}").pid != before
            except LookupError:
                return False
            processes = unit.get("/api/health").get("processes", {})
            return again and processes.get(RESTARTED, {}).get("status") == "ready"

        back_s = unit.until(is_back, BACK_S)
    back = "not back" if back_s is None else f"back after {back_s:.1f} s"
    return gauge.result(name, f"those beyond 64 refused, {RESTARTED}, killed meanwhile, {back}", back_s is not None)


def _visitors(unit: Unit) -> Flood:
    """1,100 connections to the page: those beyond the limit of one peer are ended."""
    gauge = Gauge(unit)
    with ExitStack() as stack:
        held = []
        for number in range(VISITORS):
            source = (f"127.0.1.{1 + number % 250}", 0)
            try:
                held.append(
                    stack.enter_context(
                        socket.create_connection(("127.0.0.1", unit.port), timeout=1.0, source_address=source)
                    )
                )
            except OSError:
                continue  # refused
            gauge.read()
        end = time.monotonic() + 5.0
        while time.monotonic() < end:
            gauge.read()
    return gauge.result(f"{VISITORS} connections to the page from 250 addresses", f"{len(held)} accepted")

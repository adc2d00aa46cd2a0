"""The connections of simulated vehicles, in one thread: connect again, send, repeat, reorder, take receipts."""

import heapq
import itertools
import random
import selectors
import ssl
import time
from array import array
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass

from shared.fleet.cbor import BadCbor
from shared.fleet.receipts import Receipt
from shared.fleet.topics import BATCH, RECEIPT, WATCH, topic

from .mqtt import Connection, ConnectionLost
from .outboxes import BatchSender

MAX_CONCURRENT = 32  # connections that are being made
SET_UP_S = 20.0  # for TCP, TLS and MQTT together
AGAIN_S, LONGEST_AGAIN_S = 1.0, 60.0
DELAYED_SHARE = 0.2  # share of batches that are held back for a time, when they are reordered
HELD_S, REPEATED_S = 3.0, 5.0  # at most
MAX_WAIT_S = 0.5


@dataclass(frozen=True)
class Disturbance:
    """What the network does to batches."""

    repeat: float = 0.0  # share that arrives twice
    reorder: bool = False


@dataclass(eq=False)
class Vehicle:
    """A vehicle that sends from an outbox."""

    name: str
    outbox: BatchSender
    tls: Callable[[], ssl.SSLContext]
    connection: Connection | None = None
    attempts: int = 0
    sent_s: float = 0.0


class Traffic:
    """All vehicles of one process; `turn` works for a moment."""

    def __init__(self, address: tuple[str, int], disturbance: Disturbance, seed: int) -> None:
        self.counts: Counter[str] = Counter()
        self.faults: Counter[str] = Counter()
        self.latencies = array("f")  # [s], one a batch with a receipt
        self.ready = 0  # connections
        self._address, self._disturbance = address, disturbance
        self._random = random.Random(seed)
        self._selector = selectors.DefaultSelector()
        self._timers: list[tuple[float, int, Callable[[], None]]] = []
        self._numbers = itertools.count()
        self._queue = deque[Vehicle]()  # that want a connection
        self._setting_up: dict[Vehicle, float] = {}

    def at(self, when_s: float, work: Callable[[], None]) -> None:
        """Do something at a time of the monotonic clock."""
        heapq.heappush(self._timers, (when_s, next(self._numbers), work))

    def join(self, vehicle: Vehicle) -> None:
        """Connect a vehicle when its turn comes."""
        self._queue.append(vehicle)

    def turn(self) -> None:
        """Do what is due, then wait for the sockets for a moment."""
        now_s = time.monotonic()
        while self._timers and self._timers[0][0] <= now_s:
            heapq.heappop(self._timers)[2]()
        while self._queue and len(self._setting_up) < MAX_CONCURRENT:
            self._connect(self._queue.popleft(), now_s)
        wait_s = self._timers[0][0] - time.monotonic() if self._timers else MAX_WAIT_S
        for key, _ in self._selector.select(max(0.0, min(wait_s, MAX_WAIT_S))):
            self._work(key.data)
        for vehicle in [item for item, until_s in self._setting_up.items() if time.monotonic() > until_s]:
            self._drop(vehicle, "it does not answer")

    def pump(self, vehicle: Vehicle) -> None:
        """Send what the window of a vehicle has room for."""
        while (connection := vehicle.connection) is not None and connection.is_ready:
            now_s = time.monotonic()
            data = vehicle.outbox.next(now_s)
            if data is None:
                return
            self.counts["sent"] += 1
            draw = self._random.random
            if draw() < self._disturbance.repeat:
                self.counts["repeated"] += 1
                self._later(vehicle, data, REPEATED_S)
            if self._disturbance.reorder and draw() < DELAYED_SHARE:
                self.counts["held back"] += 1
                self._later(vehicle, data, HELD_S)
            else:
                self._publish(vehicle, data)

    def alive(self, vehicle: Vehicle) -> None:
        """Ping where nothing was sent for a time."""
        if vehicle.connection is not None and vehicle.connection.is_ready and time.monotonic() - vehicle.sent_s > 30:
            self._guarded(vehicle, vehicle.connection.ping)

    def close(self) -> None:
        """End all connections."""
        for key in list(self._selector.get_map().values()):
            key.data.connection.close()
        self._selector.close()

    def _later(self, vehicle: Vehicle, data: bytes, most_s: float) -> None:
        self.at(time.monotonic() + self._random.uniform(0.0, most_s), lambda: self._publish(vehicle, data))

    def _publish(self, vehicle: Vehicle, data: bytes) -> None:
        connection = vehicle.connection
        if connection is None or not connection.is_ready:
            self.counts["lost with the connection"] += 1
            return
        self._guarded(vehicle, lambda: connection.publish(topic(vehicle.name, BATCH), data))

    def _guarded(self, vehicle: Vehicle, work: Callable[[], None]) -> None:
        try:
            self._counted(vehicle, work)
        except ConnectionLost as error:
            self._drop(vehicle, str(error))
        else:
            self._watch(vehicle)

    def _counted(self, vehicle: Vehicle, work: Callable[[], None]) -> None:
        connection = vehicle.connection
        assert connection is not None
        before = connection.bytes_out, connection.bytes_in
        try:
            work()
        finally:
            self.counts["bytes out"] += connection.bytes_out - before[0]
            self.counts["bytes in"] += connection.bytes_in - before[1]
            vehicle.sent_s = time.monotonic() if connection.bytes_out > before[0] else vehicle.sent_s

    def _connect(self, vehicle: Vehicle, now_s: float) -> None:
        topics = topic(vehicle.name, RECEIPT), topic(vehicle.name, WATCH)
        try:
            vehicle.connection = Connection(self._address, vehicle.tls(), vehicle.name, topics)
        except ConnectionLost as error:
            self._drop(vehicle, str(error))
            return
        self._setting_up[vehicle] = now_s + SET_UP_S
        self._selector.register(vehicle.connection, selectors.EVENT_WRITE, vehicle)

    def _work(self, vehicle: Vehicle) -> None:
        connection = vehicle.connection
        if connection is None:
            return
        came = list[bytes]()
        was_ready = connection.is_ready
        self._guarded(vehicle, lambda: came.extend(connection.work()))
        if vehicle.connection is connection and connection.is_ready and not was_ready:
            self._setting_up.pop(vehicle, None)
            self.ready += 1
            self.counts["connections"] += 1
            vehicle.attempts = 0
            vehicle.outbox.restart()
        for payload in came:
            self._take(vehicle, payload)
        self.pump(vehicle)

    def _take(self, vehicle: Vehicle, payload: bytes) -> None:
        try:
            receipt = Receipt.decode(payload)
        except BadCbor:
            self.counts["no receipt"] += 1
            return
        self.counts["receipts"] += 1
        self.counts["refused"] += len(receipt.refused)
        taken = vehicle.outbox.take(receipt, time.monotonic())
        self.counts["receipted"] += len(taken)
        self.latencies.extend(taken)

    def _watch(self, vehicle: Vehicle) -> None:
        connection = vehicle.connection
        assert connection is not None
        if self._selector.get_key(connection).events != connection.wants:
            self._selector.modify(connection, connection.wants, vehicle)

    def _drop(self, vehicle: Vehicle, reason: str) -> None:
        connection, vehicle.connection = vehicle.connection, None
        self._setting_up.pop(vehicle, None)
        self.faults[reason[:100]] += 1
        if connection is not None:
            self.ready -= connection.is_ready
            if connection.fileno() in self._selector.get_map():
                self._selector.unregister(connection)
            connection.close()
        longest = min(AGAIN_S * 2.0 ** min(vehicle.attempts, 10), LONGEST_AGAIN_S)
        vehicle.attempts += 1
        self.at(time.monotonic() + longest * self._random.uniform(0.5, 1.0), lambda: self.join(vehicle))

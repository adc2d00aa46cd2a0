"""A paho client for tests: every step waits for the broker's answer, and nothing runs in a thread."""

import select
import socket
import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

import paho.mqtt.client as paho
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from tests.support.patience import HANGS_S

KEEP_ALIVE_S = 60
PATIENCE_S = HANGS_S  # a test of what never comes counts in `QUIET_S`
QUIET_S = 0.1  # [s] on a loopback, longer than any delivery takes


class Client:
    """One connection; use it in a `with` block."""

    def __init__(
        self,
        port: int,
        client_id: str = "",
        *,
        user: str | None = "tester",
        password: str | None = None,
        protocol: MQTTProtocolVersion = MQTTProtocolVersion.MQTTv311,
        manual_ack: bool = False,
    ) -> None:
        self.port = port
        self.messages: list[paho.MQTTMessage] = []
        self.connack: ReasonCode | None = None
        self.ended = False
        self._subacks: dict[int, list[ReasonCode]] = {}
        self._pubacks: set[int] = set()
        self.paho = paho.Client(CallbackAPIVersion.VERSION2, client_id, protocol=protocol, manual_ack=manual_ack)
        self.paho.username_pw_set(user, password)
        self.paho.on_connect = self._on_connect
        self.paho.on_disconnect = self._on_disconnect
        self.paho.on_subscribe = self._on_suback
        self.paho.on_unsubscribe = self._on_suback
        self.paho.on_publish = self._on_publish
        self.paho.on_message = self._on_message
        self.paho.on_socket_open = _no_delay

    def connect(self, *, keep_alive_s: int = KEEP_ALIVE_S) -> ReasonCode:
        """Connect and return the broker's answer."""
        self.connack, self.ended = None, False
        self.paho.connect("127.0.0.1", self.port, keep_alive_s)
        self.until(lambda: self.connack is not None)
        assert self.connack is not None
        return self.connack

    def will(self, topic: str, payload: str, *, qos: int = 1, retain: bool = False) -> None:
        """Set the will; before `connect`."""
        self.paho.will_set(topic, payload, qos, retain)

    def subscribe(self, *patterns: str, qos: int = 1) -> list[int]:
        """Subscribe and return the QoS granted to each filter, 0x80 for a rejected one."""
        return self._suback(self.paho.subscribe([(pattern, qos) for pattern in patterns])[1])

    def unsubscribe(self, pattern: str) -> None:
        """Unsubscribe and wait for the answer."""
        self._suback(self.paho.unsubscribe(pattern)[1])

    def publish(self, topic: str, payload: str | bytes, *, qos: int = 1, retain: bool = False) -> None:
        """Publish and, at QoS 1, wait for the acknowledgement."""
        packet_id = self.paho.publish(topic, payload, qos, retain).mid
        self.until(lambda: packet_id in self._pubacks if qos else not self.paho.want_write())

    def take(self, count: int = 1, within_s: float = PATIENCE_S) -> list[paho.MQTTMessage]:
        """Wait for messages and return them."""
        self.until(lambda: len(self.messages) >= count, within_s)
        taken, self.messages = self.messages, []
        return taken

    def payloads(self, count: int = 1, within_s: float = PATIENCE_S) -> list[str]:
        """Wait for messages and return their payloads."""
        return [message.payload.decode() for message in self.take(count, within_s)]

    def receives_nothing(self) -> bool:
        """Whether no message is queued or received within `QUIET_S`."""
        self.spin(QUIET_S)
        return not self.messages

    def ends(self, within_s: float = PATIENCE_S) -> None:
        """Wait until the broker ends the connection."""
        self.until(lambda: self.ended, within_s)

    def kill(self) -> None:
        """Close the socket without DISCONNECT."""
        sock = self.paho.socket()
        assert isinstance(sock, socket.socket)
        sock.shutdown(socket.SHUT_RDWR)
        self.ends()

    def leave(self) -> None:
        """Disconnect in an orderly way."""
        self.paho.disconnect()
        self.spin(0.01)

    def until(self, happened: Callable[[], bool], within_s: float = PATIENCE_S) -> None:
        """Run the network until something has happened, or fail."""
        deadline = time.monotonic() + within_s
        while not happened():
            assert time.monotonic() < deadline, f"not within {within_s} s; {len(self.messages)} messages came"
            self.exchange(0.02)

    def spin(self, duration_s: float) -> None:
        """Run the network for a while, or until the connection has ended."""
        deadline = time.monotonic() + duration_s
        while time.monotonic() < deadline and self.paho.socket() is not None:
            self.exchange(0.01)

    def exchange(self, timeout_s: float) -> None:
        """Read and write once; paho's own `loop` would keep a pair of sockets that it closes too late."""
        sock = self.paho.socket()
        if sock is None:
            time.sleep(timeout_s)
            return
        readable, writable, _ = select.select([sock], [sock] if self.paho.want_write() else [], [], timeout_s)
        if readable:
            self.paho.loop_read()
        if writable and self.paho.socket() is not None:
            self.paho.loop_write()
        if self.paho.socket() is not None:
            self.paho.loop_misc()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        if self.paho.socket() is not None:
            self.leave()
        if (sock := self.paho.socket()) is not None:
            sock.close()

    def _suback(self, packet_id: int | None) -> list[int]:
        assert packet_id is not None
        self.until(lambda: packet_id in self._subacks)
        return [int(code.value) for code in self._subacks.pop(packet_id)]

    def _on_connect(
        self, _c: paho.Client, _u: object, _f: paho.ConnectFlags, reason: ReasonCode, _p: Properties | None
    ) -> None:
        self.connack = reason

    def _on_disconnect(
        self, _c: paho.Client, _u: object, _f: paho.DisconnectFlags, _r: ReasonCode, _p: Properties | None
    ) -> None:
        self.ended = True

    def _on_suback(
        self, _c: paho.Client, _u: object, packet_id: int, reasons: list[ReasonCode], _p: Properties | None
    ) -> None:
        self._subacks[packet_id] = reasons

    def _on_publish(self, _c: paho.Client, _u: object, packet_id: int, _r: ReasonCode, _p: Properties | None) -> None:
        self._pubacks.add(packet_id)

    def _on_message(self, _c: paho.Client, _u: object, message: paho.MQTTMessage) -> None:
        self.messages.append(message)


def _no_delay(_client: paho.Client, _userdata: object, sock: object) -> None:
    if isinstance(sock, socket.socket):
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

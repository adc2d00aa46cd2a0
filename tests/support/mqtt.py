"""A paho client for tests: every step waits for the broker's answer, and nothing runs in a thread."""

import select
import socket
import time
from collections.abc import Callable, Mapping, Sequence
from types import TracebackType
from typing import Self

import paho.mqtt.client as paho
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode
from paho.mqtt.subscribeoptions import SubscribeOptions

PATIENCE_S = 5.0
QUIET_S = 0.1  # on a loopback, what has not come by then was not sent
Pairs = Sequence[tuple[str, str]]


class Client:
    """One connection; use it in a `with` block."""

    def __init__(
        self,
        port: int,
        client_id: str = "",
        *,
        user: str | None = "tester",
        protocol: MQTTProtocolVersion = MQTTProtocolVersion.MQTTv5,
        manual_ack: bool = False,
    ) -> None:
        self.port = port
        self.messages: list[paho.MQTTMessage] = []
        self.connack: ReasonCode | None = None
        self.connack_properties: Properties | None = None
        self.session_present = False
        self.farewell: ReasonCode | None = None
        self._subacks: dict[int, list[ReasonCode]] = {}
        self._pubacks: dict[int, ReasonCode] = {}
        self.paho = paho.Client(CallbackAPIVersion.VERSION2, client_id, protocol=protocol, manual_ack=manual_ack)
        self.paho.username_pw_set(user)
        self.paho.on_connect = self._on_connect
        self.paho.on_disconnect = self._on_disconnect
        self.paho.on_subscribe = self._on_suback
        self.paho.on_unsubscribe = self._on_suback
        self.paho.on_publish = self._on_publish
        self.paho.on_message = self._on_message
        self.paho.on_socket_open = _no_delay

    def connect(self, *, keep_alive_s: int = 60, clean_start: bool = True, **numbers: int) -> ReasonCode:
        """Connect and return the broker's answer; `numbers` are properties by paho's names."""
        self.connack = self.farewell = None
        v5 = self.paho.protocol == MQTTProtocolVersion.MQTTv5
        self.paho.connect(
            "127.0.0.1",
            self.port,
            keep_alive_s,
            clean_start=clean_start if v5 else paho.MQTT_CLEAN_START_FIRST_ONLY,
            properties=_properties(PacketTypes.CONNECT, (), numbers) if v5 else None,
        )
        self.until(lambda: self.connack is not None)
        assert self.connack is not None
        return self.connack

    def will(self, topic: str, payload: str, *, qos: int = 1, retain: bool = False, user: Pairs = ()) -> None:
        """Leave a will; before `connect`."""
        self.paho.will_set(topic, payload, qos, retain, _properties(PacketTypes.WILLMESSAGE, user, {}))

    def subscribe(self, *patterns: str, qos: int = 1, **options: bool | int) -> list[int]:
        """Subscribe and return the reason codes."""
        wanted = [(pattern, _options(qos, options)) for pattern in patterns]
        _, packet_id = self.paho.subscribe(wanted)
        return self._suback(packet_id)

    def unsubscribe(self, pattern: str) -> list[int]:
        """Unsubscribe and return the reason codes."""
        return self._suback(self.paho.unsubscribe(pattern)[1])

    def publish(
        self, topic: str, payload: str | bytes, *, qos: int = 1, retain: bool = False, user: Pairs = (), **more: int
    ) -> int | None:
        """Publish and, at QoS 1, return the reason code of the acknowledgement."""
        properties = _properties(PacketTypes.PUBLISH, user, more)
        packet_id = self.paho.publish(topic, payload, qos, retain, properties).mid
        if qos == 0:
            self.until(lambda: not self.paho.want_write())
            return None
        self.until(lambda: packet_id in self._pubacks)
        return int(self._pubacks.pop(packet_id).value)

    def take(self, count: int = 1, within_s: float = PATIENCE_S) -> list[paho.MQTTMessage]:
        """Wait for messages and hand them over."""
        self.until(lambda: len(self.messages) >= count, within_s)
        taken, self.messages = self.messages, []
        return taken

    def payloads(self, count: int = 1, within_s: float = PATIENCE_S) -> list[str]:
        """Wait for messages and hand over their payloads."""
        return [message.payload.decode() for message in self.take(count, within_s)]

    def hears_nothing(self) -> bool:
        """Whether no message waits or comes while one listens for a moment."""
        self.spin(QUIET_S)
        return not self.messages

    def ends_with(self, within_s: float = PATIENCE_S) -> int:
        """Wait until the broker ends the connection and return why."""
        self.until(lambda: self.farewell is not None, within_s)
        assert self.farewell is not None
        return int(self.farewell.value)

    def kill(self) -> None:
        """Lose the connection without a farewell."""
        sock = self.paho.socket()
        assert isinstance(sock, socket.socket)
        sock.shutdown(socket.SHUT_RDWR)
        self.until(lambda: self.farewell is not None)

    def leave(self, reason: int = 0) -> None:
        """Disconnect with a farewell."""
        code = ReasonCode(PacketTypes.DISCONNECT, identifier=reason)
        self.paho.disconnect(code if self.paho.protocol == MQTTProtocolVersion.MQTTv5 else None)
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
        self, _c: paho.Client, _u: object, flags: paho.ConnectFlags, reason: ReasonCode, properties: Properties | None
    ) -> None:
        self.connack, self.connack_properties, self.session_present = reason, properties, flags.session_present

    def _on_disconnect(
        self, _c: paho.Client, _u: object, _f: paho.DisconnectFlags, reason: ReasonCode, _p: Properties | None
    ) -> None:
        self.farewell = self.farewell or reason

    def _on_suback(
        self, _c: paho.Client, _u: object, packet_id: int, reasons: list[ReasonCode], _p: Properties | None
    ) -> None:
        self._subacks[packet_id] = reasons

    def _on_publish(
        self, _c: paho.Client, _u: object, packet_id: int, reason: ReasonCode, _p: Properties | None
    ) -> None:
        self._pubacks[packet_id] = reason

    def _on_message(self, _c: paho.Client, _u: object, message: paho.MQTTMessage) -> None:
        self.messages.append(message)


def user_properties(message: paho.MQTTMessage) -> list[tuple[str, str]]:
    """User properties of a message, in their order."""
    return list(getattr(message.properties, "UserProperty", []))


def expiry_s(message: paho.MQTTMessage) -> int | None:
    """Seconds that a message has left, as the broker says."""
    return getattr(message.properties, "MessageExpiryInterval", None)


def _properties(packet: int, user: Pairs, numbers: Mapping[str, int]) -> Properties:
    properties = Properties(packet)  # type: ignore[no-untyped-call]  # paho leaves it untyped
    if user:
        properties.UserProperty = list(user)
    for name, value in numbers.items():
        setattr(properties, name, value)
    return properties


def _options(qos: int, options: Mapping[str, bool | int]) -> SubscribeOptions:
    return SubscribeOptions(
        qos,
        bool(options.get("no_local", False)),
        bool(options.get("retain_as_published", False)),
        int(options.get("retain_handling", 0)),
    )


def _no_delay(_client: paho.Client, _userdata: object, sock: object) -> None:
    if isinstance(sock, socket.socket):
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

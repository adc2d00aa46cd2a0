"""The door of a process to the bus: paho-mqtt 2 over MQTT 5, its loop in our own hands.

Nothing runs in a thread and no work is done in a callback: callbacks queue, the process's own loop
decodes, and the heartbeat is sent from that loop, so that a process that hangs goes silent.
"""

import contextlib
import logging
import os
import select
import socket
import time
from collections import Counter, deque
from collections.abc import Sequence
from pathlib import Path

import paho.mqtt.client as paho
import psutil
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from . import codec
from .clock import Clock
from .config import BrokerAddress
from .envelope import Envelope, make_envelope
from .messages import Message, ProcessHealth, ProcessState
from .publish_properties import PublishProperties, use_for_received_messages
from .topics import BY_MESSAGE, Topic

__all__ = ["Bus", "Envelope"]

log = logging.getLogger(__name__)

HEARTBEAT_S = 0.5
KEEP_ALIVE_S = 5
CONNECT_S = 1.0  # a host that does not answer shall not use up the time that SIGTERM leaves
RECONNECT_S = (0.05, 0.1, 0.2, 0.5, 1.0)
QUEUE_LENGTH = 2000

use_for_received_messages()


class Bus:
    """One process's own connection to the broker.

    `receive` must be called at least every 0.2 s: it runs the network loop, the heartbeat and the
    reconnection. QoS 0 messages published while the broker is away are lost and counted, QoS 1
    messages wait for it in a bounded queue. An observer only listens: it has no last will and no
    heartbeat, and there may be several of one name.
    """

    def __init__(
        self,
        process: str,
        vehicle: str,
        address: BrokerAddress,
        subscriptions: Sequence[Topic],
        state_dir: Path,
        *,
        observer: bool = False,
    ) -> None:
        self.process, self.vehicle, self.address, self.state_dir = process, vehicle, address, state_dir
        self.vehicle_toml = ""
        self.stopping = False
        self.connected = False
        self.rejects: Counter[str] = Counter()
        self.last_error: str | None = None
        self.dropped = self.reconnections = self.messages_in = self.messages_out = 0
        self._clock = Clock(state_dir)
        self.incarnation = self.now_ns()
        self._prefix = f"obu/{vehicle}/"
        self._filters = [(self._prefix + topic.name, SubscribeOptions(qos=topic.qos)) for topic in subscriptions]
        self._queue: deque[Envelope] = deque(maxlen=QUEUE_LENGTH)
        self._waiting: deque[tuple[str, bytes, dict[str, str], Topic]] = deque(maxlen=QUEUE_LENGTH)
        self._sequence = 0
        self._next_heartbeat = self._next_attempt = 0.0
        self._attempts = 0
        self._alive_file = os.environ.get("OBU_ALIVE")  # touched with each heartbeat, for a container's health check
        self._host = psutil.Process()
        self._observer = observer
        self._client = self._make_client()

    def now_ns(self) -> int:
        """Read the OBU time line."""
        return self._clock.now_ns()

    def publish(self, message: Message) -> None:
        """Send a message on the topic of its type."""
        topic = BY_MESSAGE[type(message)]
        payload, properties = codec.encode(message)
        self.send(codec.topic_name(message), payload, properties, topic)

    def send(self, name: str, payload: bytes, properties: dict[str, str], topic: Topic) -> None:
        """Send bytes on a topic by its short name, stamped with who we are and a running number."""
        self._sequence += 1
        self.messages_out += 1
        properties = {
            **properties,
            "from": self.process,
            "life": str(self.incarnation),
            "seq": str(self._sequence),
        }
        if self.connected and not self._waiting and not self._client.want_write():
            self._transmit(name, payload, properties, topic)
        elif self.connected or topic.qos:
            self.dropped += len(self._waiting) == self._waiting.maxlen
            self._waiting.append((name, payload, properties, topic))
        else:
            self.dropped += 1

    @property
    def sequence(self) -> int:
        """Running number of the last message sent."""
        return self._sequence

    def receive(self, timeout_s: float) -> list[Envelope]:
        """Run the network for up to `timeout_s` and return what came, oldest first.

        Returns at once when something is there. After SIGTERM `stopping` is set and the call returns.
        """
        if self._client.socket() is None:
            self._connect(timeout_s)
        else:
            self._exchange(timeout_s)
        self._heartbeat()
        messages = list(self._queue)
        self._queue.clear()
        return messages

    def close(self) -> None:
        """Say farewell and disconnect; the last will is not sent."""
        self.stopping = True
        if self.connected:
            if not self._observer:
                self.publish(self.health(ProcessState.DISCONNECTED))
            deadline = time.monotonic() + 0.5
            while (self._client.want_write() or self._waiting) and self.connected and time.monotonic() < deadline:
                self._exchange(0.05)
            self._client.disconnect()

    def health(self, state: ProcessState) -> ProcessHealth:
        """Describe this process as it is now."""
        with self._host.oneshot():
            cpu, rss = self._host.cpu_times(), self._host.memory_info().rss
        return ProcessHealth(
            process=self.process,
            state=state,
            incarnation=self.incarnation,
            sent_ns=self.now_ns(),
            messages_in=self.messages_in,
            messages_out=self.messages_out,
            dropped=self.dropped,
            rejects=dict(self.rejects),
            reconnections=self.reconnections,
            cpu_s=cpu.user + cpu.system,
            rss_bytes=rss,
            last_error=self.last_error,
        )

    def _make_client(self) -> paho.Client:
        identity = f"{self.process}-{self._host.pid}" if self._observer else self.process
        client = paho.Client(CallbackAPIVersion.VERSION2, client_id=identity, protocol=paho.MQTTv5)
        client.username_pw_set(self.address.username or self.process, self.address.password)
        client.max_queued_messages_set(QUEUE_LENGTH)
        client.connect_timeout = CONNECT_S
        client.on_connect = self._on_connect
        client.on_disconnect = self._on_disconnect
        client.on_message = self._on_message
        client.on_socket_open = _no_delay
        if not self._observer:
            self._leave_will(client)
        return client

    def _leave_will(self, client: paho.Client) -> None:
        will = ProcessHealth(
            process=self.process, state=ProcessState.LOST, incarnation=self.incarnation, sent_ns=self.incarnation
        )
        payload, _ = codec.encode(will)
        client.will_set(
            self._prefix + codec.topic_name(will),
            payload,
            qos=1,
            retain=True,
            properties=_properties(
                {"from": self.process, "life": str(self.incarnation), "seq": "0"}, PacketTypes.WILLMESSAGE
            ),
        )

    def _connect(self, timeout_s: float) -> None:
        wait = self._next_attempt - time.monotonic()
        if wait > 0:
            time.sleep(min(wait, timeout_s))
            return
        self._next_attempt = time.monotonic() + RECONNECT_S[min(self._attempts, len(RECONNECT_S) - 1)]
        self._attempts += 1
        try:
            self._client.connect(self.address.host, self.address.port, keepalive=KEEP_ALIVE_S)
        except OSError as error:
            self.last_error = f"no broker at {self.address.host}:{self.address.port}: {error.strerror or error}"
            if self._attempts == 1:
                log.warning("%s, trying again until it is there", self.last_error)

    def _exchange(self, timeout_s: float) -> None:
        """Read and write until the socket has nothing more to say, waiting once for the first word."""
        for _ in range(QUEUE_LENGTH):
            sock = self._client.socket()
            if sock is None:
                break
            writers = [sock] if self._client.want_write() else []
            readable, writable, _ = select.select([sock], writers, [], 0.0 if self._queue else timeout_s)
            if writable:
                self._client.loop_write()
            if not readable:
                break
            timeout_s = 0.0
            self._client.loop_read()
        self._client.loop_misc()
        while self._waiting and self.connected and not self._client.want_write():
            self._transmit(*self._waiting.popleft())

    def _transmit(self, name: str, payload: bytes, properties: dict[str, str], topic: Topic) -> None:
        packed = PublishProperties(properties, topic.expiry_s if topic.retain else None)
        sent = self._client.publish(self._prefix + name, payload, topic.qos, topic.retain, packed)
        self.dropped += sent.rc == paho.MQTT_ERR_QUEUE_SIZE

    def _heartbeat(self) -> None:
        now = time.monotonic()
        if self.connected and not self._observer and now >= self._next_heartbeat:
            self._next_heartbeat = now + HEARTBEAT_S
            self.publish(self.health(ProcessState.READY))
            if self._alive_file:
                Path(self._alive_file).touch()

    def _on_connect(
        self,
        client: paho.Client,
        _userdata: object,
        _flags: paho.ConnectFlags,
        reason: ReasonCode,
        _properties: Properties | None,
    ) -> None:
        if reason.is_failure:
            self.last_error = f"the broker refuses {self.process}: {reason}"
            log.error("%s; check the credentials in OBU_BROKER", self.last_error)
            return
        if self._filters:
            client.subscribe(self._filters)
        self.connected, self.last_error = True, None
        self._attempts, self._next_heartbeat = 0, 0.0
        log.info("connected to %s:%d", self.address.host, self.address.port)

    def _on_disconnect(
        self,
        _client: paho.Client,
        _userdata: object,
        _flags: paho.DisconnectFlags,
        reason: ReasonCode,
        _properties: Properties | None,
    ) -> None:
        if self.connected and not self.stopping:
            self.reconnections += 1
            self.last_error = f"connection to the broker lost: {reason}"
            log.warning("%s", self.last_error)
        self.connected = False
        self._next_attempt = time.monotonic() + RECONNECT_S[0]

    def _on_message(self, _client: paho.Client, _userdata: object, message: paho.MQTTMessage) -> None:
        self.messages_in += 1
        self.dropped += len(self._queue) == self._queue.maxlen
        properties = dict(getattr(message.properties, "UserProperty", ()))
        envelope = make_envelope(
            message.topic.removeprefix(self._prefix),
            bytes(message.payload),
            properties,
            received_ns=self.now_ns(),
            retained=message.retain,
        )
        if envelope is None:
            self.rejects["envelope"] += 1
        else:
            self._queue.append(envelope)


def _properties(user: dict[str, str], packet: int) -> Properties:
    properties = Properties(packet)  # type: ignore[no-untyped-call]  # paho leaves it untyped
    properties.UserProperty = list(user.items())
    return properties


def _no_delay(_client: paho.Client, _userdata: object, sock: object) -> None:
    # Without it bursts of small messages wait for the peer's delayed acknowledgement: 20 to 40 ms.
    if isinstance(sock, socket.socket):
        with contextlib.suppress(OSError):  # a Unix socket has no such option
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

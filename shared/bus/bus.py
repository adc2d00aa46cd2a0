"""The connection of a process to the bus: a paho-mqtt client (MQTT 3.1.1) in the loop of the process.

There is no thread, and callbacks only queue: messages are decoded and heartbeats are sent in the loop of the process,
so that a process that hangs sends no heartbeats.
"""

import logging
import re
import select
import socket
import ssl
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from ..errors import BadPayload, UserError
from ..messages.base import Message, Sender
from ..messages.operation import MessageKind, ProcessHealth, ProcessState, TopicTraffic
from ..messages.settings import SettingsState
from ..runtime.alive import LivenessSignal
from ..runtime.clock import Clock
from ..runtime.config import BrokerAddress
from ..runtime.credentials import OBSERVER, Identity, identity_of, observer_of, replay_of
from ..runtime.last_end import LastEnd
from ..runtime.usage import ProportionalSize, resident_bytes
from ..settings.held import HeldSettings
from ..tls import reason_of
from ..topics import BROKER_LOG, BY_MESSAGE, BY_NAME, SETTINGS, TOPICS, Topic, may_send, topic_of
from . import codec
from .envelope import Envelope

__all__ = ["Bus", "Envelope", "decoded"]

log = logging.getLogger(__name__)

HEARTBEAT_S = 0.5
KINDS_EVERY = 4  # heartbeats
HUNG_S = 12.0  # without a heartbeat, after which the process ends itself and tells where; a slow disk takes less
KEEP_ALIVE_S = 5
CONNECT_S = 1.0  # timeout; shorter than the time between SIGTERM and SIGKILL
RECONNECT_S = (0.05, 0.1, 0.2, 0.5, 1.0)
STABLE_AFTER_S = 3.0  # a shorter connection counts as failed: two clients of one name disconnect each other
QUEUE_LENGTH = 2000
IN_FLIGHT = 100  # messages of QoS 1 that the broker has not acknowledged yet
REFUSAL = re.compile(rb"\bClient (.{1,64}?) disconnected, not authori[sz]ed")
TOO_MANY_CONNECTIONS = re.compile(rb"\bClient connection from .{1,100}? denied: max_connections exceeded")
REFUSED_KEPT = 8
MAX_READS = 64  # per call, so that a flood of messages does not stop the loop


class Bus:
    """The connection of one process to the broker.

    `receive` must be called at least every 0.2 s: it runs the network, the heartbeat and the
    reconnection. QoS 0 messages published while the broker is away are lost and counted, QoS 1
    messages wait in a bounded queue, as do messages that a slow broker does not read yet. A full queue
    drops the oldest, counted in `dropped`. An observer publishes nothing: it has no last will and no
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
        self.settings = HeldSettings()
        self.stopping = False
        self.connected = False
        self.rejects: Counter[str] = Counter()
        self.last_error: str | None = None
        self.refused: list[str] = []  # clients without the right secret, newest last; after `hear_broker`
        self.refusals = self.crowded = 0  # connections without the right secret, and beyond the most of a listener
        self.tell_kinds: Callable[[], tuple[MessageKind, ...]] = tuple  # messages of its devices by kind
        self.reconnections = self.messages_in = self.messages_out = self.dropped = 0
        self._clock = Clock(state_dir)
        if self._clock.not_stored is not None:
            self.rejects["state disk"] += 1
        self._memory, self._end = ProportionalSize(), LastEnd(state_dir, process)
        self.incarnation = self.now_ns()
        self.sequence = 0  # of the last message sent
        self._prefix = f"obu/{vehicle}/"
        self._inbox: deque[tuple[mqtt.MQTTMessage, int]] = deque(maxlen=QUEUE_LENGTH)
        self._waiting: deque[tuple[str, bytes, Topic]] = deque()
        self._last: mqtt.MQTTMessageInfo | None = None  # of QoS 1
        self._next_heartbeat = self._next_attempt = 0.0
        self._attempts = self._brief = self._tables = 0
        self._connected_s = 0.0
        self._alive: LivenessSignal | None = None  # of a process that is watched
        self._observer, self._guarded, self._hears_broker = observer, False, False
        self._identity = self._identify()
        self._filters = {self._prefix + topic.name: topic.qos for topic in subscriptions}
        if not observer:
            self._filters.setdefault(self._prefix + SETTINGS, BY_NAME[SETTINGS].qos)
        self._awaits = frozenset(topic.name for topic in subscriptions)
        self._own = self._filters
        self._followed: frozenset[str] | None = None  # None: as constructed
        self._published: dict[str, tuple[int, int, bytes]] = {}  # of a fast topic: count, time and bytes of the newest
        self._received: dict[str, tuple[int, Envelope | None]] = {t.name: (0, None) for t in subscriptions if t.fast}
        if len(subscriptions) == len(TOPICS):
            # Mosquitto serves subscribers of single topics before those of all: processes before observers.
            self._filters = {self._prefix + "#": 1}
            self._received = {}
        self._client = self._make_client()

    def _make_client(self) -> mqtt.Client:
        who = self._identity
        # A broker that checks secrets takes the user for the client identifier; for others observers differ by it.
        unproved = self._observer and who.secret is None
        client_id = f"{self.process}-{self.incarnation:x}" if unproved else who.user
        client = _Client(
            CallbackAPIVersion.VERSION2, client_id, protocol=mqtt.MQTTv311, reconnect_on_failure=False,
            transport="tcp" if self.address.socket is None else "unix",
        )  # fmt: skip
        client.username_pw_set(who.user, who.secret)
        if self.address.tls:
            try:
                client.tls_set(self.address.authority)
            except OSError as error:
                raise UserError(
                    f"cannot read the authority of the broker {self.address.authority}: {error.strerror}; set "
                    "OBU_BROKER_CA to the unit's ca.pem"
                ) from error
        client.connect_timeout = CONNECT_S
        client.max_inflight_messages_set(IN_FLIGHT)
        client.max_queued_messages_set(QUEUE_LENGTH)
        client.on_socket_open = _send_at_once
        client.on_connect, client.on_disconnect = self._on_connect, self._on_disconnect
        client.on_subscribe, client.on_message = self._on_subscribe, self._on_message
        if not self._observer:
            will = ProcessHealth(
                process=self.process, state=ProcessState.LOST, incarnation=self.incarnation, sent_ns=self.incarnation
            )
            client.will_set(self._prefix + codec.topic_name(will), self._sign(will), qos=1, retain=True)
        return client

    def _identify(self) -> Identity:
        """User and secret: those of the broker's address if given, otherwise from the unit's folder of secrets."""
        if self.address.username:
            return Identity(self.address.username, self.address.password)
        if not self._observer:
            return identity_of(self.process, self.state_dir)
        find = observer_of if self.process == OBSERVER else replay_of
        return find(self.state_dir, self.address.place)

    def now_ns(self) -> int:
        """Read the OBU time line."""
        return self._clock.now_ns()

    def publish(self, message: Message) -> None:
        """Publish a message on the topic of its type, with its sender and sequence number."""
        topic = BY_MESSAGE[type(message)]
        self.sequence += 1
        self.messages_out += 1
        name, payload = self._prefix + codec.topic_name(message, topic), self._sign(message)
        if self._is_too_large(topic, payload):
            return
        if not (self.connected or topic.qos):
            self.dropped += 1
            return
        if topic.fast:
            count, _, _ = self._published.get(topic.name, (0, 0, b""))
            self._published[topic.name] = count + 1, self.now_ns(), payload
        self._send_in_order(name, payload, topic)

    def hear_broker(self) -> None:
        """Receive what the broker writes into its log: counts what it has refused in `refusals` and `crowded`."""
        self._hears_broker, self._filters[BROKER_LOG] = True, 0

    def follow(self, fast: frozenset[str]) -> None:
        """Observe every topic that is not fast, and these of the fast ones; to be called whenever they may change."""
        if fast == self._followed:
            return
        # A filter that ends in # finds the topic itself as well, and Mosquitto serves it after those of processes.
        followed = {
            f"{self._prefix}{t.name}/#": t.qos for t in TOPICS if not t.is_covered and (not t.fast or t.name in fast)
        }
        if self._hears_broker:
            followed[BROKER_LOG] = 0
        self._followed = fast
        self._change_filters(followed)

    def also(self, topics: Sequence[Topic]) -> None:
        """Subscribe to these topics besides those of the process, in the place of those of the last call."""
        self._change_filters(self._own | {self._prefix + topic.name: topic.qos for topic in topics})

    def _change_filters(self, followed: dict[str, int]) -> None:
        before, self._filters = self._filters, followed
        if not self.connected or before == followed:
            return
        if new := [(name, qos) for name, qos in followed.items() if name not in before]:
            self._client.subscribe(new)
        if old := [name for name in before if name not in followed]:
            self._client.unsubscribe(old)

    def forward(self, envelope: Envelope) -> None:
        """Publish a recorded message unchanged, with the time of its arrival at the recorder.

        At QoS 0 and not retained, so that messages of all topics keep their order, and none is left after a jump.
        """
        row = topic_of(envelope.topic)
        if row is None or not self.connected:
            self.dropped += 1
            return
        topic = replace(row, qos=0, retain=False)
        name, payload = self._prefix + envelope.topic, codec.replayed(envelope.payload, envelope.received_ns)
        self.messages_out += 1
        if self._is_too_large(row, payload):
            return
        self._send_in_order(name, payload, topic)

    def receive(self, timeout_s: float) -> list[Envelope]:
        """Run the network for up to `timeout_s` and return the received messages, oldest first.

        Returns as soon as there are messages. After SIGTERM `stopping` is set and the call returns.
        """
        self._heartbeat()  # before the wait, so that received messages are not delayed by it
        if self._client.socket() is not None or self._connect(timeout_s):
            self._exchange(timeout_s)
        return self._take()

    def close(self) -> None:
        """Publish the state `disconnected` and disconnect; the last will is not sent."""
        self.stopping = True
        if self._guarded:
            self._end.close()
        if self._alive is not None:
            self._alive.stopping()
        if self.connected and not self._observer:
            self.publish(self.health(ProcessState.DISCONNECTED))
        deadline = time.monotonic() + 0.5
        while self.connected and self._has_unsent() and time.monotonic() < deadline:
            self._exchange(0.05)
        self._client.disconnect()
        self.connected = False
        self._identity.release()

    def health(self, state: ProcessState) -> ProcessHealth:
        """The present state and counters of this process."""
        return ProcessHealth(
            process=self.process,
            state=state,
            incarnation=self.incarnation,
            sent_ns=self.now_ns(),
            messages_in=self.messages_in,
            messages_out=self.messages_out,
            dropped=self.dropped,
            rejects=dict(self.rejects),
            kinds=self._kinds(),
            reconnections=self.reconnections,
            cpu_s=time.process_time(),
            rss_bytes=resident_bytes(),
            pss_bytes=self._memory.read(),
            last_error=self.last_error or self._end.reason,
            published=tuple(
                TopicTraffic(
                    topic=name, count=count, newest_ns=sent_ns, stamp_ns=codec.stamp_ns(BY_NAME[name], payload)
                )
                for name, (count, sent_ns, payload) in self._published.items()
            ),
            received=tuple(_received(name, count, newest) for name, (count, newest) in self._received.items()),
        )

    def _kinds(self) -> tuple[MessageKind, ...]:
        """Every fourth time, since a table may have 64 rows."""
        self._tables += 1
        return self.tell_kinds() if self._tables % KINDS_EVERY == 1 else ()

    def guard(self) -> None:
        """End the program if `receive` is not called for `HUNG_S`; its next run tells where it hung."""
        self._guarded, self._alive = True, LivenessSignal()
        self._end.begin()

    def failed(self, error: BaseException) -> None:
        """Note the exception that ends this process, for its next run to tell."""
        self._end.failed(error)

    def _sign(self, message: Message) -> bytes:
        sender = Sender(process=self.process, incarnation=self.incarnation, sequence=self.sequence)
        return codec.signed(codec.encode(message), sender)

    def _is_too_large(self, topic: Topic, payload: bytes) -> bool:
        """Whether the broker would end the connection for this message; it is counted, and said in the heartbeat."""
        if len(payload) <= topic.most_bytes:
            return False
        self.dropped += 1
        self.rejects["too large"] += 1
        self.last_error = f"not sent: {len(payload)} bytes on {topic.name}, which holds {topic.most_bytes} at most"
        return True

    def _ready(self) -> bool:
        """Whether the broker has read everything written to it."""
        return self.connected and not self._client.want_write()

    def _has_unsent(self) -> bool:
        """Whether a message is unsent or not acknowledged."""
        last = self._last
        return bool(self._waiting) or (last is not None and not last.rc and not last.is_published())

    def _send(self, name: str, payload: bytes, topic: Topic) -> None:
        info = self._client.publish(name, payload, topic.qos, topic.retain)
        if info.rc == mqtt.MQTT_ERR_QUEUE_SIZE:  # too many messages of QoS 1 are not acknowledged
            self.dropped += 1
        elif topic.qos:
            self._last = info

    def _send_in_order(self, name: str, payload: bytes, topic: Topic) -> None:
        if not self._waiting and self._ready():
            self._send(name, payload, topic)
            return
        self._waiting.append((name, payload, topic))
        if len(self._waiting) > QUEUE_LENGTH:
            self._waiting.popleft()
            self.dropped += 1

    def _connect(self, timeout_s: float) -> bool:
        wait = self._next_attempt - time.monotonic()
        if wait > 0:
            time.sleep(min(wait, timeout_s))
            return False
        self._next_attempt = time.monotonic() + RECONNECT_S[min(self._attempts, len(RECONNECT_S) - 1)]
        self._attempts += 1
        try:
            self._client.connect(self.address.socket or self.address.host, self.address.port, KEEP_ALIVE_S)
        except OSError as error:
            self.last_error = f"no broker at {self.address.place}: {reason_of(error)}"
            if self._attempts == 1:
                log.warning("%s; connecting again until it responds", self.last_error)
        return self._client.socket() is not None

    def _exchange(self, timeout_s: float) -> None:
        """Wait until the broker sends or reads; receive, and send what waited."""
        client, sock = self._client, [cast(socket.socket, self._client.socket())]
        waiting = sock if _undelivered(sock[0]) else []  # decrypted already: the kernel knows nothing of it
        readable, writable, _ = select.select(
            sock, sock if client.want_write() else [], [], 0.0 if waiting else timeout_s
        )
        readable = readable or waiting
        if writable:
            client.loop_write()
        for _ in range(MAX_READS):
            if not readable:
                break
            client.loop_read()
            if client.socket() is None:
                break
            readable = sock if _undelivered(sock[0]) else select.select(sock, [], [], 0.0)[0]
        if client.want_write():
            client.loop_write()
        while self._waiting and self._ready():
            self._send(*self._waiting.popleft())

    def _on_connect(
        self, client: mqtt.Client, _u: object, _f: mqtt.ConnectFlags, reason: ReasonCode, _p: Properties | None
    ) -> None:
        if reason.is_failure:
            complaint = f"the broker refuses {self._identity.user}: {reason}; {self._why_refused()}"
            if complaint != self.last_error:
                log.error("%s", complaint)
            self.last_error = complaint
            return
        self.connected, self.last_error = True, None
        self._connected_s, self._next_heartbeat = time.monotonic(), 0.0
        log.info("connected to %s", self.address.place)
        if self._filters:
            client.subscribe(list(self._filters.items()))  # after each connection: sessions are clean

    def _why_refused(self) -> str:
        if self._identity.secret is None:
            return "it knows its users by a secret: set OBU_STATE to the state folder of the unit that runs this broker"
        return "the secret is of another unit or an earlier one: restart process and broker after `obu keys make`"

    def _on_subscribe(
        self, _c: mqtt.Client, _u: object, _mid: int, granted: list[ReasonCode], _p: Properties | None
    ) -> None:
        refused = [code for code in granted if code.is_failure]
        if refused:
            self.rejects["refused"] += len(refused)
            self.last_error = (
                f"the broker refuses a subscription of {self._identity.user} to {self._prefix}: {refused[0]}; it may "
                "serve a vehicle of another name"
            )
            log.error("%s", self.last_error)

    def _on_message(self, _c: mqtt.Client, _u: object, message: mqtt.MQTTMessage) -> None:
        if self._hears_broker and _is_broker_log(message):
            self._note_refusal(bytes(message.payload))
            return
        self.messages_in += 1
        self.dropped += len(self._inbox) == QUEUE_LENGTH
        self._inbox.append((message, self.now_ns()))

    def _note_refusal(self, line: bytes) -> None:
        if found := REFUSAL.search(line):
            self.refusals += 1
            self.refused = [*self.refused[1 - REFUSED_KEPT :], found[1].decode("utf-8", "replace")]
        elif TOO_MANY_CONNECTIONS.search(line):
            self.crowded += 1

    def _on_disconnect(
        self, _c: mqtt.Client, _u: object, _f: mqtt.DisconnectFlags, reason: ReasonCode, _p: Properties | None
    ) -> None:
        if not self.connected:
            return
        self.connected = False
        lost = [entry for entry in self._waiting if not entry[2].qos]
        self.dropped += len(lost)
        self._waiting = deque(entry for entry in self._waiting if entry[2].qos)
        if self.stopping:
            return
        self.reconnections += 1
        if time.monotonic() - self._connected_s < STABLE_AFTER_S:
            self._brief += 1
        else:
            self._attempts = self._brief = self._tables = 0
        self.last_error = f"connection to the broker lost: {reason}"
        self._next_attempt = time.monotonic() + RECONNECT_S[min(self._attempts, len(RECONNECT_S) - 1)]
        hint = f"; does another {self.process} run on this broker?" if self._brief > 1 and not self._observer else ""
        log.warning("%s%s", self.last_error, hint)

    def _heartbeat(self) -> None:
        now = time.monotonic()
        if now < self._next_heartbeat:
            return
        self._next_heartbeat = now + HEARTBEAT_S
        self._client.loop_misc()  # keep-alive
        if self._guarded:
            self._end.watch(HUNG_S)
        if self._alive is not None:
            self._alive.beat(connected=self.connected)
            self.last_error, self._alive.fault = self._alive.fault or self.last_error, None
        if self.connected and not self._observer:
            self.publish(self.health(ProcessState.READY))

    def _take(self) -> list[Envelope]:
        envelopes = []
        while self._inbox:
            message, received_ns = self._inbox.popleft()
            try:
                name = message.topic.removeprefix(self._prefix)
                envelope = Envelope.of(name, bytes(message.payload), received_ns, retained=message.retain)
            except (BadPayload, UnicodeDecodeError) as error:
                self.rejects["envelope"] += 1
                self.last_error = str(error)[:400]
                continue
            if not may_send(envelope.producer, name):
                self.rejects["sender"] += 1
                self.last_error = f"{name} of {envelope.producer}, which may not publish it: dropped"
                continue
            if name == SETTINGS and self._ends_for(envelope):
                self.stopping = True
            if name == SETTINGS and name not in self._awaits:
                continue
            envelopes.append(envelope)
            if name in self._received:
                self._received[name] = self._received[name][0] + 1, envelope
        return envelopes

    def _ends_for(self, envelope: Envelope) -> bool:
        """Whether the unit holds other settings than this process."""
        state = decoded(self, envelope)
        return isinstance(state, SettingsState) and self.settings.note(self.process, state)


class _Client(mqtt.Client):
    """With a time limit for a Unix socket: a broker that hangs accepts no connection, and paho waits for it forever."""

    def _create_unix_socket_connection(self) -> socket.socket:
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            connection.settimeout(CONNECT_S)
            connection.connect(self._host)
        except OSError:
            connection.close()
            raise
        return connection


def decoded(bus: Bus, envelope: Envelope) -> Message | None:
    """Decode the payload; an invalid one is counted as rejected and gives None."""
    try:
        return envelope.decode()
    except BadPayload as error:
        bus.rejects["payload"] += 1
        bus.last_error = str(error)[:400]
        return None


def _received(name: str, count: int, newest: Envelope | None) -> TopicTraffic:
    if newest is None:
        return TopicTraffic(topic=name, count=count)
    stamp_ns = codec.stamp_ns(BY_NAME[name], newest.payload)
    return TopicTraffic(
        topic=name, count=count, newest_ns=newest.received_ns, stamp_ns=stamp_ns, producer=newest.producer
    )  # fmt: skip


def _undelivered(sock: socket.socket) -> bool:
    """Whether a TLS connection holds bytes that were received and not read."""
    return isinstance(sock, ssl.SSLSocket) and sock.pending() > 0


def _is_broker_log(message: mqtt.MQTTMessage) -> bool:
    try:
        return message.topic == BROKER_LOG
    except UnicodeDecodeError:  # counted when it is taken
        return False


def _send_at_once(_client: mqtt.Client, _userdata: object, sock: object) -> None:
    """Without TCP_NODELAY bursts of small messages wait for the peer's delayed acknowledgement: 20 to 40 ms."""
    if isinstance(sock, socket.socket) and sock.family != socket.AF_UNIX:
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

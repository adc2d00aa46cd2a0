"""The door of a process to the bus: MQTT 5 by a client of our own, its loop in our own hands.

Nothing runs in a thread or a callback: the process's own loop decodes, and the heartbeat is sent from that loop, so
that a process that hangs goes silent.
"""

import faulthandler
import logging
import os
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from ..messages.base import Message
from ..messages.operation import ProcessHealth, ProcessState
from ..runtime.clock import Clock
from ..runtime.config import BrokerAddress
from ..runtime.usage import resident_bytes
from ..topics import BY_MESSAGE, TOPICS, Topic
from . import codec
from .envelope import Envelope, Opener
from .mqtt.client import Client, Lost, Outgoing, Refused
from .mqtt.client_packets import MESSAGE_EXPIRY, user_property
from .mqtt.packets import Connect, Publish, Subscription
from .mqtt.properties import NONE
from .mqtt.wire import text, varint

__all__ = ["Bus", "Envelope"]

log = logging.getLogger(__name__)

HEARTBEAT_S = 0.5
HUNG_S = 20.0  # without a heartbeat: longer than a slow disk takes, and whoever restarts it should get to know
KEEP_ALIVE_S = 5
RECONNECT_S = (0.05, 0.1, 0.2, 0.5, 1.0)
STEADY_S = 3.0  # a connection that lasts less is no success: two of one name would take it from each other for ever
QUEUE_LENGTH = 2000
GATHERED_BYTES = 65_536  # that one write may hold
PACKET_BYTES = codec.MAXIMUM_PAYLOAD + 65_536  # the largest payload, and the rest of its packet


class Bus:
    """One process's own connection to the broker.

    `receive` must be called at least every 0.2 s: it runs the network, the heartbeat and the
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
        self.reconnections = self.messages_in = self.messages_out = 0
        self._clock = Clock(state_dir)
        self.incarnation = self.now_ns()
        self._prefix = f"obu/{vehicle}/"
        self._heads: dict[str, bytes] = {}  # topics, encoded
        # The properties of every message, up to its running number. They go first, for `Opener`.
        origin = user_property("from", process) + user_property("life", str(self.incarnation))
        self._signature = origin + user_property("seq", "")[:-2]
        self._sequence = 0
        self._next_heartbeat = self._next_attempt = 0.0
        self._attempts = self._refusals = self._brief = 0
        self._connected_s = 0.0
        self._alive_file = os.environ.get("OBU_ALIVE")  # touched with each heartbeat, for a container's health check
        self._observer, self._guarded = observer, False
        filters = [Subscription(self._prefix + topic.name, topic.qos) for topic in subscriptions]
        if len(subscriptions) == len(TOPICS):
            # Mosquitto serves those who name a topic before those who take everything: the hot path before observers.
            filters = [Subscription(self._prefix + "#", 1)]
        self._client = Client(
            self._request(), address.password, filters, Opener(self._prefix, self._clock.now_ns),
            queue=QUEUE_LENGTH, packet_bytes=PACKET_BYTES,
        )  # fmt: skip

    def now_ns(self) -> int:
        """Read the OBU time line."""
        return self._clock.now_ns()

    def publish(self, message: Message, *, at_once: bool = True) -> None:
        """Send a message on the topic of its type, at once or with the next `flush` or `receive`."""
        topic = BY_MESSAGE[type(message)]
        payload, properties = codec.encode(message)
        self._gather(codec.topic_name(message, topic), payload, properties, topic)
        if at_once or self._client.gathered_bytes > GATHERED_BYTES:
            self.flush()

    def send(self, name: str, payload: bytes, properties: dict[str, str], topic: Topic) -> None:
        """Send bytes on a topic by its short name, stamped with who we are and a running number."""
        self._gather(name, payload, properties, topic)
        self.flush()

    @property
    def sequence(self) -> int:
        """Running number of the last message sent."""
        return self._sequence

    @property
    def dropped(self) -> int:
        """Messages that full queues forgot, and those of QoS 0 that found no broker."""
        return self._client.dropped

    def receive(self, timeout_s: float) -> list[Envelope]:
        """Run the network for up to `timeout_s` and return what came, oldest first.

        Returns at once when something is there. After SIGTERM `stopping` is set and the call returns.
        """
        self._heartbeat()  # before the wait: what comes shall not wait for it
        if self._client.is_open or self._connect(timeout_s):
            self._exchange(timeout_s)
        return self._take()

    def close(self) -> None:
        """Say farewell and disconnect; the last will is not sent."""
        self.stopping = True
        if self._guarded:
            faulthandler.cancel_dump_traceback_later()
        if self.connected and not self._observer:
            self.publish(self.health(ProcessState.DISCONNECTED))
        deadline = time.monotonic() + 0.5
        while self.connected and not self._client.is_idle and time.monotonic() < deadline:
            self._exchange(0.05)
        self._client.leave()
        self.connected = False

    def health(self, state: ProcessState) -> ProcessHealth:
        """Describe this process as it is now."""
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
            cpu_s=time.process_time(),
            rss_bytes=resident_bytes(),
            last_error=self.last_error,
        )

    def _request(self) -> Connect:
        identity = f"{self.process}-{self.incarnation:x}" if self._observer else self.process
        user = self.address.username or self.process
        return Connect(identity, True, KEEP_ALIVE_S, user, None if self._observer else self._will(), NONE)

    def _will(self) -> Publish:
        will = ProcessHealth(
            process=self.process, state=ProcessState.LOST, incarnation=self.incarnation, sent_ns=self.incarnation
        )
        topic, properties = self._prefix + codec.topic_name(will), self._signature + text("0")
        return Publish(topic, codec.encode(will)[0], qos=1, retain=True, properties=properties)

    def _gather(self, name: str, payload: bytes, properties: dict[str, str], topic: Topic) -> None:
        self._sequence += 1
        self.messages_out += 1
        head = self._heads.get(name)
        if head is None:
            head = self._heads[name] = text(self._prefix + name)
        number = b"%d" % self._sequence
        packed = self._signature + len(number).to_bytes(2) + number
        for key, value in properties.items():
            packed += user_property(key, value)
        if topic.retain and topic.expiry_s:
            packed += bytes((MESSAGE_EXPIRY,)) + topic.expiry_s.to_bytes(4)
        self._client.publish(Outgoing(head, varint(len(packed)) + packed, payload, topic.qos, topic.retain))

    def flush(self) -> None:
        """Write what was published to be sent later."""
        try:
            self._client.flush()
        except Lost as error:
            self._lose(error)

    def _connect(self, timeout_s: float) -> bool:
        wait = self._next_attempt - time.monotonic()
        if wait > 0:
            time.sleep(min(wait, timeout_s))
            return False
        self._next_attempt = time.monotonic() + RECONNECT_S[min(self._attempts, len(RECONNECT_S) - 1)]
        self._attempts += 1
        try:
            self._client.open(self.address.host, self.address.port)
        except OSError as error:
            self.last_error = f"no broker at {self.address.host}:{self.address.port}: {error.strerror or error}"
            if self._attempts == 1:
                log.warning("%s, trying again until it is there", self.last_error)
            return False
        return True

    def _exchange(self, timeout_s: float) -> None:
        try:
            self._client.exchange(timeout_s)
        except Lost as error:
            self._lose(error)
        if self._client.up and not self.connected:
            self.connected, self.last_error = True, None
            self._connected_s, self._next_heartbeat = time.monotonic(), 0.0
            log.info("connected to %s:%d", self.address.host, self.address.port)
        if self._client.refusals > self._refusals:
            self._refusals = self._client.refusals
            self.rejects["refused"], self.last_error = self._refusals, self._client.complaint

    def _lose(self, error: Lost) -> None:
        if isinstance(error, Refused):
            complaint = f"the broker refuses {self.process}: {error}"
            if complaint != self.last_error:
                log.error("%s; check the credentials in OBU_BROKER", complaint)
            self.last_error = complaint
        else:
            if self.connected and not self.stopping:
                self._note_loss(error)
            self.last_error = f"connection to the broker lost: {error}"
            self._next_attempt = time.monotonic() + RECONNECT_S[min(self._attempts, len(RECONNECT_S) - 1)]
        self.connected = False

    def _note_loss(self, error: Lost) -> None:
        self.reconnections += 1
        if time.monotonic() - self._connected_s < STEADY_S:
            self._brief += 1
        else:
            self._attempts = self._brief = 0
        hint = f"; does another {self.process} run on this broker?" if self._brief > 1 and not self._observer else ""
        log.warning("connection to the broker lost: %s%s", error, hint)

    def guard(self) -> None:
        """From now on end the program, with a traceback on standard error, when `receive` is not called any more."""
        self._guarded = True

    def _heartbeat(self) -> None:
        now = time.monotonic()
        if self._observer or now < self._next_heartbeat:
            return
        self._next_heartbeat = now + HEARTBEAT_S
        if self._guarded:
            faulthandler.dump_traceback_later(HUNG_S, exit=True)
        if self.connected:
            self.publish(self.health(ProcessState.READY))
            if self._alive_file:
                Path(self._alive_file).touch()

    def _take(self) -> list[Envelope]:
        inbox = self._client.inbox
        if not inbox:
            return []
        self.messages_in += len(inbox)
        envelopes = [envelope for envelope in inbox if envelope is not None]
        if len(envelopes) != len(inbox):
            self.rejects["envelope"] += len(inbox) - len(envelopes)
        inbox.clear()
        return envelopes

"""The connection to the centre: MQTT 3.1.1 over TLS with the unit's certificate, in the loop of the process.

Only connecting has a thread of its own: the name of the host, TCP and TLS may take seconds, and the heartbeat on the
bus must go on. There is no connection without TLS. QoS 0 and clean sessions: what counts is a receipt of the centre.
"""

import contextlib
import logging
import random
import select
import socket
import ssl
import threading
import time
from collections import Counter, deque
from typing import cast

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion, MQTTErrorCode
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from shared.fleet.identity import UplinkIdentity
from shared.fleet.topics import RECEIPT, WATCH, topic
from shared.tls import reason_of

log = logging.getLogger(__name__)

KEEP_ALIVE_S = 60
CONNECT_S = 10.0  # of TCP, of TLS, and of the centre's answer, each
RECONNECT_S, LONGEST_RECONNECT_S = 1.0, 60.0
STABLE_AFTER_S = 30.0  # a shorter connection counts as failed
UNACKNOWLEDGED_MS = 30_000  # after which a connection over which nothing comes back is given up
MAX_WAITING = 64  # messages that are not taken yet
MAX_BYTES = 65_536  # of a message from the centre
MAX_PACKET_BYTES = 2 * MAX_BYTES  # that are read at all: a packet of MQTT may state 256 MB
MAX_READS = 16  # in one turn
# What a centre sends: CONNACK, PUBLISH of QoS 0 (retained too), SUBACK, PINGRESP. Of others the client keeps messages,
# and answers that it owes, without bound.
PACKETS = frozenset((0x20, 0x30, 0x31, 0x90, 0xD0))
FIXED_BYTES = 4  # header and lengths of a PUBLISH


class TlsClient(mqtt.Client):
    """A client without another way to connect than TLS; a connection that fails is closed at once."""

    def __init__(self, context: ssl.SSLContext, name: str) -> None:
        super().__init__(CallbackAPIVersion.VERSION2, name, protocol=mqtt.MQTTv311, reconnect_on_failure=False)
        self._tls = context

    def _create_socket(self) -> ssl.SSLSocket:
        plain = socket.create_connection((self.host, self.port), CONNECT_S)
        with contextlib.suppress(OSError):  # each only improves the connection
            plain.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            plain.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, UNACKNOWLEDGED_MS)
        sock = plain
        try:
            sock = self._tls.wrap_socket(plain, server_hostname=self.host, do_handshake_on_connect=False)
            sock.do_handshake()
        except BaseException:
            sock.close()
            raise
        return sock

    def _sock_recv(self, bufsize: int) -> bytes:
        if bufsize > MAX_PACKET_BYTES:  # the rest of a packet
            raise OSError(f"a message of {bufsize} bytes")
        return super()._sock_recv(bufsize)

    def _packet_handle(self) -> MQTTErrorCode:
        if self._in_packet["command"] not in PACKETS:
            return MQTTErrorCode.MQTT_ERR_PROTOCOL
        return super()._packet_handle()


class Link:
    """One connection at a time. `turn` and `wait` are called in the loop of the process, and do not block longer."""

    def __init__(self, rejects: Counter[str]) -> None:
        self.connected = False
        self.sessions = 0  # connections that the centre has accepted
        self.sent_bytes = 0  # of MQTT, without TLS
        self.fault: str | None = None  # why there is no connection
        self._rejects = rejects
        self._identity: UplinkIdentity | None = None
        self._client: mqtt.Client | None = None
        self._connecting: threading.Thread | None = None
        self._failure: str | None = None  # of the thread
        self._inbox: deque[tuple[str, bytes]] = deque(maxlen=MAX_WAITING)
        self._attempts = 0
        self._next_s = self._begun_s = 0.0
        self._accepted = False  # this connection, by the centre

    def use(self, identity: UplinkIdentity | None) -> None:
        """Connect as this unit from now on; a connection of another certificate is ended."""
        if identity == self._identity:
            return
        self._identity = identity
        self._drop()
        self._attempts, self._next_s = 0, 0.0
        if identity is not None:
            self.fault = f"connecting to {identity.centre.host}:{identity.centre.mqtt_port}"

    def turn(self, now_s: float) -> list[tuple[str, bytes]]:
        """Connect if it is time, read and write; give noun and payload of what the centre has sent."""
        if self._connecting is not None:
            if self._connecting.is_alive():
                return []
            self._connecting = None
            if self._failure is not None:
                self._retry(now_s, self._failure)
        if self._client is None:
            self._connect(now_s)
            return []
        client = self._client
        if client.socket() is None:
            self._retry(now_s, self._failure or "the connection was lost")
            return []
        self._exchange(client)
        if self._client is client and not self.connected and now_s - self._begun_s > 3 * CONNECT_S:
            self._retry(now_s, "it accepts connections and does not answer")
        taken, self._inbox = list(self._inbox), deque(maxlen=MAX_WAITING)
        return taken

    def wait(self, timeout_s: float) -> None:
        """Sleep until something comes, at most for a time."""
        sock = None if self._client is None or self._connecting is not None else self._client.socket()
        if sock is None:
            time.sleep(timeout_s)
        elif not _undelivered(sock):
            with contextlib.suppress(OSError, ValueError):  # the next turn finds that it is closed
                select.select([sock], [], [], timeout_s)

    @property
    def is_ready(self) -> bool:
        """Whether the network has taken everything that was sent."""
        return self.connected and self._client is not None and not self._client.want_write()

    def publish(self, noun: str, payload: bytes) -> bool:
        """Send a message below the unit's name; False if there is no connection."""
        if not self.connected or self._client is None or self._identity is None:
            return False
        name = topic(self._identity.centre.vehicle, noun)
        info = self._client.publish(name, payload, 0)
        if info.rc:
            return False
        self.sent_bytes += FIXED_BYTES + len(name) + len(payload)
        return True

    def close(self) -> None:
        """Disconnect."""
        self._drop()

    def _connect(self, now_s: float) -> None:
        if self._identity is None or now_s < self._next_s:
            return
        self._begun_s, self._failure = now_s, None
        try:
            client = self._make_client(self._identity)
        except (OSError, ValueError) as error:  # ssl.SSLError is an OSError
            self._retry(now_s, f"{self._identity.tls} cannot be used: {reason_of(error)[:200]}; run `obu enrol` again")
            return
        self._client = client
        host, port = self._identity.centre.host, self._identity.centre.mqtt_port
        self._connecting = threading.Thread(target=self._open, args=(client, host, port), name="centre", daemon=True)
        self._connecting.start()

    def _make_client(self, identity: UplinkIdentity) -> mqtt.Client:
        context = ssl.create_default_context(cafile=str(identity.authority))
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        context.load_cert_chain(identity.tls)
        name = identity.centre.vehicle
        client = TlsClient(context, name)
        client.on_connect, client.on_disconnect = self._on_connect, self._on_disconnect
        client.on_message = self._on_message
        return client

    def _open(self, client: mqtt.Client, host: str, port: int) -> None:
        """Connect, in a thread; the client is not touched elsewhere meanwhile."""
        try:
            client.connect(host, port, KEEP_ALIVE_S)
        except ssl.SSLCertVerificationError as error:
            self._failure = (
                f"it does not prove to be the centre: {error.verify_message}; check its address, and this unit's clock"
            )
        except (OSError, ValueError) as error:
            self._failure = reason_of(error)[:200]

    def _exchange(self, client: mqtt.Client) -> None:
        sock = cast(socket.socket, client.socket())
        with contextlib.suppress(OSError, ValueError):
            for _ in range(MAX_READS):
                if not _undelivered(sock) and not select.select([sock], [], [], 0.0)[0]:
                    break
                client.loop_read()
                if client.socket() is None:
                    return
        if client.want_write():
            client.loop_write()
        client.loop_misc()  # keep-alive

    def _retry(self, now_s: float, reason: str) -> None:
        """Give this connection up, and plan the next one."""
        steady = self._accepted and now_s - self._begun_s > STABLE_AFTER_S
        self._drop()
        self._attempts = 0 if steady else self._attempts + 1
        longest = min(RECONNECT_S * 2.0 ** min(self._attempts, 10), LONGEST_RECONNECT_S)
        self._next_s = now_s + longest * random.uniform(0.5, 1.0)
        centre = self._identity.centre if self._identity is not None else None
        fault = f"no connection to {centre.host}:{centre.mqtt_port}: {reason}" if centre else reason
        if fault != self.fault:
            log.warning("%s; it is tried again", fault)
        self.fault = fault

    def _drop(self) -> None:
        client, self._client = self._client, None
        self.connected = self._accepted = False
        self._inbox.clear()
        if client is None or self._connecting is not None:
            return  # a thread that still connects finds itself forgotten
        client.on_disconnect = None
        with contextlib.suppress(OSError, ValueError):
            client.disconnect()
            if (sock := client.socket()) is not None:
                sock.close()

    def _on_connect(
        self, client: mqtt.Client, _u: object, _f: mqtt.ConnectFlags, reason: ReasonCode, _p: Properties | None
    ) -> None:
        if reason.is_failure:
            self._failure = f"the centre refuses this unit: {reason}; ask it whether its certificate was revoked"
            return
        if client is not self._client or self._identity is None:
            return
        vehicle = self._identity.centre.vehicle
        self.connected = self._accepted = True
        self.fault = None
        self.sessions += 1
        log.info("connected to the centre at %s:%d", self._identity.centre.host, self._identity.centre.mqtt_port)
        client.subscribe([(topic(vehicle, RECEIPT), 0), (topic(vehicle, WATCH), 0)])

    def _on_disconnect(
        self, client: mqtt.Client, _u: object, _f: mqtt.DisconnectFlags, reason: ReasonCode, _p: Properties | None
    ) -> None:
        if client is self._client:
            self.connected = False
            self._failure = self._failure or f"the connection was lost: {reason}"

    def _on_message(self, client: mqtt.Client, _u: object, message: mqtt.MQTTMessage) -> None:
        try:
            name = message.topic
        except UnicodeDecodeError:
            name = ""
        vehicle = self._identity.centre.vehicle if self._identity is not None else ""
        nouns = {topic(vehicle, noun): noun for noun in (RECEIPT, WATCH)}
        if client is not self._client or name not in nouns or len(message.payload) > MAX_BYTES:
            self._rejects["message of the centre"] += 1
            return
        self._rejects["flood of the centre"] += len(self._inbox) == MAX_WAITING
        self._inbox.append((nouns[name], bytes(message.payload)))


def _undelivered(sock: object) -> bool:
    """Whether TLS has bytes that were decrypted and not read."""
    return isinstance(sock, ssl.SSLSocket) and sock.pending() > 0

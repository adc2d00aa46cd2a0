"""V2X radios: datagrams over UDP, bare or in JSON, or bare CAM over MQTT; each frame with its arrival time.

udp://127.0.0.1:47347            GeoNetworking packets, from the basic header on, one a datagram
udp+json://127.0.0.1:47347       the same with what the radio measured: {"frame": base64, "freqofs": Hz}, as a flow
                                 graph of gr-ieee802-11 can send its PDU and the carrier frequency offset beside it
mqtt://host:1883/prefix          CAM in UPER without headers: received from prefix/received, sent to prefix/send
"""

import contextlib
import json
import select
import socket
import struct
import time
from base64 import b64decode
from collections import Counter, deque
from typing import Protocol, cast
from urllib.parse import urlsplit

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from ..errors import RejectedFrame, UserError
from ..messages.v2x import MAX_FRAME_BYTES, Encapsulation
from ..v2x.geonetworking import decode_payload
from .device import DeviceBusy, DeviceLost

EXAMPLES = "udp://127.0.0.1:47347, udp+json://127.0.0.1:47347 or mqtt://127.0.0.1:1883/v2x"
RECEIVE_BUFFER_BYTES = 1 << 20  # of the kernel: half a second of 2,000 frames/s of 500 bytes with its own overhead
SO_TIMESTAMPNS = 35  # Linux: arrival time of a datagram as control message, struct timespec of CLOCK_REALTIME
TIMESPEC = struct.Struct("@ll")
MAX_AGE_NS = 1_000_000_000  # a greater age of a datagram comes from a host's clock that was set meanwhile
QUEUE_LENGTH = 4096
MAX_CFO_HZ = 1e6  # 20 ppm of both oscillators are 236 kHz
KEEP_ALIVE_S = 10
CONNECT_S = 1.0
Frames = list[tuple[int, bytes]]


class Radio(Protocol):
    """An open V2X radio; every method raises `DeviceLost` when it is gone."""

    encapsulation: Encapsulation
    cfo_hz: list[float | None]  # of each frame of the last `read`; empty: this radio measures none

    def read(self, most: int) -> Frames:
        """Return up to `most` frames that have arrived as (age in ns, bytes), without waiting."""
        ...

    def write(self, frame: bytes) -> None:
        """Send a GeoNetworking packet; raises `DeviceBusy` if it is not accepted."""
        ...

    def close(self) -> None:
        """Close the radio; may be called twice."""
        ...


def host_and_port(url: str) -> tuple[str, int]:
    """Read host and port of a URL; raises `UserError` without them."""
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise UserError(f"V2X radio {url!r}: {error}; try {EXAMPLES}") from error
    if not host or not port:
        raise UserError(f"V2X radio {url!r} has no host or no port: try {EXAMPLES}")
    return host, port


def check_radio_url(url: str) -> None:
    """Raise `UserError` for an invalid URL."""
    host_and_port(url)
    scheme, path = urlsplit(url).scheme, urlsplit(url).path.strip("/")
    if scheme not in ("udp", "udp+json", "mqtt"):
        raise UserError(f"unknown V2X radio {url!r}: try {EXAMPLES}")
    if scheme != "mqtt" and path:
        raise UserError(f"V2X radio {url!r}: a UDP address has no path; try {EXAMPLES}")
    if scheme == "mqtt" and (not path or set(path) & set("+#")):
        raise UserError(f"V2X radio {url!r} needs a topic prefix without wildcards: try {EXAMPLES}")


def open_radio(url: str, send_to: str | None, rejects: Counter[str]) -> Radio:
    """Open the radio of a URL; raises `DeviceLost` if it is not available. Frames that are too long are counted."""
    check_radio_url(url)
    try:
        if urlsplit(url).scheme == "udp":
            return UdpRadio(host_and_port(url), host_and_port(send_to) if send_to else None, rejects)
        if urlsplit(url).scheme == "udp+json":
            return JsonRadio(host_and_port(url), host_and_port(send_to) if send_to else None, rejects)
        return MqttRadio(url, rejects)
    except OSError as error:
        raise DeviceLost(
            f"cannot open {url}: {error.strerror or error}; check the address and who else uses it"
        ) from error


class UdpRadio:
    """A radio that exchanges GeoNetworking packets as UDP datagrams."""

    encapsulation = Encapsulation.GEONETWORKING
    longest_bytes = MAX_FRAME_BYTES  # of a datagram

    def __init__(self, address: tuple[str, int], peer: tuple[str, int] | None, rejects: Counter[str]) -> None:
        self._peer, self._rejects = peer, rejects
        self.cfo_hz: list[float | None] = []
        family = socket.getaddrinfo(*address, type=socket.SOCK_DGRAM)[0][0]
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
            with contextlib.suppress(OSError):  # without it, a frame counts as arrived when it is read
                self._socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
            self._socket.setblocking(False)
            self._socket.bind(address)
        except OSError:
            self._socket.close()
            raise

    def read(self, most: int) -> Frames:
        """Return what has arrived: (age in ns, packet)."""
        frames: Frames = []
        now_ns = time.time_ns()
        for _ in range(most):  # rejected datagrams count too: no sender can block the process
            try:
                data, control, _, _ = self._socket.recvmsg(self.longest_bytes + 1, socket.CMSG_SPACE(TIMESPEC.size))
            except BlockingIOError:
                break
            except OSError as error:
                raise DeviceLost(f"lost the UDP socket: {error}; check the network interface") from error
            if 0 < len(data) <= self.longest_bytes:
                age_ns = now_ns - _arrival_ns(control, now_ns)
                frames.append((age_ns if 0 <= age_ns <= MAX_AGE_NS else 0, data))
            else:
                self._rejects["frame_length"] += 1
        return frames

    def write(self, frame: bytes) -> None:
        """Send a packet to the configured address."""
        if self._peer is None:
            raise DeviceBusy("no address to send to")
        try:
            self._socket.sendto(frame, self._peer)
        except OSError as error:  # nobody listens there, or the queue is full: the next CAM follows within a second
            raise DeviceBusy(str(error)) from error

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def _arrival_ns(control: list[tuple[int, int, bytes]], now_ns: int) -> int:
    for level, kind, data in control:
        if level == socket.SOL_SOCKET and kind == SO_TIMESTAMPNS and len(data) == TIMESPEC.size:
            seconds, nanoseconds = TIMESPEC.unpack(data)
            return cast(int, seconds) * 1_000_000_000 + cast(int, nanoseconds)
    return now_ns


class JsonRadio(UdpRadio):
    """A radio whose program sends each packet as JSON over UDP, with the carrier frequency offset that it measured."""

    longest_bytes = 4 * MAX_FRAME_BYTES // 3 + 512

    def read(self, most: int) -> Frames:
        """Return what has arrived; one that is not such an object is counted."""
        frames: Frames = []
        self.cfo_hz = []
        for age_ns, data in super().read(most):
            try:
                frame, cfo_hz = _of_json(data)
            except ValueError:
                self._rejects["frame_json"] += 1
                continue
            frames.append((age_ns, frame))
            self.cfo_hz.append(cfo_hz)
        return frames


def _of_json(data: bytes) -> tuple[bytes, float | None]:
    """Frame and offset [Hz] of a datagram; raises ValueError. An offset that is no finite number is None."""
    try:
        given = json.loads(data)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error
    if not isinstance(given, dict) or not isinstance(given.get("frame"), str):
        raise ValueError("no frame")
    frame = b64decode(given["frame"], validate=True)
    if not 0 < len(frame) <= MAX_FRAME_BYTES:
        raise ValueError("length")
    offset = given.get("freqofs")
    if isinstance(offset, int | float) and not isinstance(offset, bool) and abs(offset) <= MAX_CFO_HZ:
        return frame, float(offset)
    return frame, None


class MqttRadio:
    """A radio behind an MQTT broker, which exchanges bare CAM in UPER."""

    encapsulation = Encapsulation.NONE

    def __init__(self, url: str, rejects: Counter[str]) -> None:
        parts = urlsplit(url)
        self._url, self._rejects = url, rejects
        self.cfo_hz: list[float | None] = []
        self._prefix = parts.path.strip("/")
        self._inbox: deque[tuple[int, bytes]] = deque(maxlen=QUEUE_LENGTH)
        self._fault: str | None = None
        self._client = mqtt.Client(CallbackAPIVersion.VERSION2, protocol=mqtt.MQTTv311, reconnect_on_failure=False)
        if parts.username:
            self._client.username_pw_set(parts.username, parts.password)
        self._client.connect_timeout = CONNECT_S
        self._client.on_connect, self._client.on_message = self._on_connect, self._on_message
        self._client.connect(*host_and_port(url), KEEP_ALIVE_S)

    def read(self, most: int) -> Frames:
        """Return what has arrived: (age in ns, CAM)."""
        for _ in range(most):  # rejected messages count too: no sender can block the process
            if len(self._inbox) >= most:
                break
            code = self._client.loop(0.0)
            if code != mqtt.MQTT_ERR_SUCCESS or self._fault:
                raise DeviceLost(f"lost {self._url}: {self._fault or mqtt.error_string(code)}; check the broker")
            opened = self._client.socket()
            if opened is None or not select.select([opened], [], [], 0.0)[0]:
                break
        now_ns = time.monotonic_ns()
        taken = [self._inbox.popleft() for _ in range(min(most, len(self._inbox)))]
        return [(now_ns - arrived_ns, data) for arrived_ns, data in taken]

    def write(self, frame: bytes) -> None:
        """Send the CAM of a GeoNetworking packet."""
        try:
            payload = decode_payload(frame)
        except RejectedFrame as error:
            raise DeviceBusy(str(error)) from error
        if self._client.publish(f"{self._prefix}/send", payload, qos=0).rc != mqtt.MQTT_ERR_SUCCESS:
            raise DeviceBusy("the broker does not accept it")

    def close(self) -> None:
        """Disconnect."""
        self._client.disconnect()

    def _on_connect(
        self, client: mqtt.Client, _u: object, _f: mqtt.ConnectFlags, reason: ReasonCode, _p: Properties | None
    ) -> None:
        if reason.is_failure:
            self._fault = str(reason)
        else:
            client.subscribe(f"{self._prefix}/received", qos=0)

    def _on_message(self, _c: mqtt.Client, _u: object, message: mqtt.MQTTMessage) -> None:
        if not 0 < len(message.payload) <= MAX_FRAME_BYTES:
            self._rejects["frame_length"] += 1
            return
        if len(self._inbox) == QUEUE_LENGTH:  # the oldest is dropped
            self._rejects["queue_full"] += 1
        self._inbox.append((time.monotonic_ns(), bytes(message.payload)))

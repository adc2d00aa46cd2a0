"""One TCP connection: bytes to packets, packets to the broker, keep-alive."""

import asyncio
import logging
import socket
from collections import deque
from typing import cast

from .broker import Broker
from .packets import (
    PINGRESP,
    Acknowledge,
    Answer,
    Connect,
    Disconnect,
    Framer,
    Kind,
    Packet,
    Ping,
    ProtocolError,
    Publish,
    Subscribe,
    Unsubscribe,
    decode,
    encode_acknowledgement,
    encode_connack,
)
from .session import Session

log = logging.getLogger(__name__)
UNSENT_BYTES = 262_144  # beyond it, messages wait in the session's bounded queue


class Connection(asyncio.Protocol):
    """The connection of one client."""

    def __init__(self, broker: Broker, connections: set["Connection"]) -> None:
        self.writable = True
        self._broker = broker
        self._connections = connections
        self._framer = Framer(broker.limits.packet_bytes, broker.limits.connect_bytes)
        self._session: Session | None = None
        self._inbox: deque[tuple[int, bytes]] = deque()  # packets that wait for their turn
        self._refused: ProtocolError | None = None  # by what follows them
        self._ended = False
        self._unsent: list[bytes] = []
        self._unsent_bytes = 0
        self._unread_bytes = 0
        self._silent_after_s = broker.limits.connect_within_s
        self._heard_s = 0.0
        self._timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Set up a connection that has just been accepted."""
        self._transport = cast(asyncio.Transport, transport)
        self._loop = asyncio.get_running_loop()
        self._connections.add(self)
        if len(self._connections) > self._broker.limits.connections:
            self._broker.turn_away(transport.get_extra_info("peername"))
            self.end()
            return
        opened = transport.get_extra_info("socket")
        if opened.family != socket.AF_UNIX:
            opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._transport.set_write_buffer_limits(UNSENT_BYTES)
        self._heard_s = self._loop.time()
        self._watch()

    def data_received(self, data: bytes) -> None:
        """Handle the packets that are complete; a packet that is refused ends the connection."""
        self._heard_s = self._loop.time()
        try:
            self._inbox.extend(self._framer.feed(data))
        except ProtocolError as refused:
            self._refused = refused
        self._work()

    def _work(self) -> None:
        """Handle some packets, and leave the rest to the next turn: a client that floods does not delay the others."""
        try:
            left = self._broker.limits.bytes_in_turn
            for _ in range(min(len(self._inbox), self._broker.limits.packets_in_turn)):
                if self._ended:
                    return
                if left <= 0:
                    break
                first, body = self._inbox.popleft()
                left -= len(body)
                packet = decode(first, body)
                if self._session is None:
                    self._greet(packet)
                else:
                    self._handle(packet, self._session)
            if self._refused is not None and not self._inbox:
                raise self._refused
        except ProtocolError as refused:
            self._refuse(refused)
        if self._inbox and not self._ended:
            self._transport.pause_reading()
            self._loop.call_soon(self._work)
        elif not self._transport.is_closing():
            self._transport.resume_reading()

    def _refuse(self, refused: ProtocolError) -> None:
        who = self._session.client_id if self._session else "a client without session"
        self._broker.counters.note("protocol error", f"{who}: {refused}")
        if refused.answer is not None and self._session is None:
            self.write(encode_connack(refused.answer))
        self.end()

    def pause_writing(self) -> None:
        """The transport's buffer is full."""
        self.writable = False

    def resume_writing(self) -> None:
        """The transport's buffer has room: send what waited."""
        self.writable = True
        self._unread_bytes = 0
        if self._session is not None:
            self._session.pump()

    def connection_lost(self, exc: Exception | None) -> None:
        """The connection was lost: publish the will."""
        self.end()
        self._connections.discard(self)

    def write(self, frame: bytes) -> None:
        """Send the bytes of one packet, together with those of the same iteration of the loop."""
        if not self._unsent:
            self._loop.call_soon(self._flush)
        self._unsent.append(frame)
        self._unsent_bytes += len(frame)
        if self._unsent_bytes > UNSENT_BYTES:
            self._flush()

    def _answer(self, frame: bytes) -> None:
        """Send a reply, which is not queued; a client that sends requests without reading is disconnected."""
        if not self.writable:
            self._unread_bytes += len(frame)
        if self._unread_bytes <= self._broker.limits.unread_bytes:
            self.write(frame)
        elif not self._ended:
            self._broker.counters.note(
                "unread", f"{self._session.client_id if self._session else 'a client without session'} does not read"
            )
            self.end()
            self.abort()

    def _flush(self) -> None:
        frames, self._unsent, self._unsent_bytes = self._unsent, [], 0
        if frames and not self._transport.is_closing():
            self._transport.write(b"".join(frames))

    def end(self, *, will: bool = True) -> None:
        """Close the connection after the unsent bytes, or after a second."""
        if self._ended:
            return
        self._ended = True
        if self._timer is not None:
            self._timer.cancel()
        self._flush()
        self._loop.call_later(1.0, self.abort)
        self._transport.close()
        if self._session is not None:
            self._broker.leave(self._session, will=will)

    def abort(self) -> None:
        """Close at once."""
        self._transport.abort()

    def _watch(self) -> None:
        """Close a connection after its keep-alive; checked once per period."""
        silent_s = self._loop.time() - self._heard_s
        if silent_s >= self._silent_after_s:
            client_id = self._session.client_id if self._session else "a client without session"
            self._broker.counters.note("keep-alive", client_id)
            self.end()
        else:
            self._timer = self._loop.call_later(self._silent_after_s - silent_s, self._watch)

    def _handle(self, packet: Packet, session: Session) -> None:
        match packet:
            case Publish():
                self._broker.receive(packet, session)
                if packet.qos:
                    self._answer(encode_acknowledgement(Kind.PUBACK, packet.packet_id))
            case Acknowledge():
                session.acknowledge(packet.packet_id)
            case Ping():
                self._answer(PINGRESP)
            case Subscribe():
                granted, kept = self._broker.subscribe(packet, session)
                self._answer(encode_acknowledgement(Kind.SUBACK, packet.packet_id, granted))
                for message in kept:
                    session.send(message)
            case Unsubscribe():
                self._broker.unsubscribe(packet, session)
                self._answer(encode_acknowledgement(Kind.UNSUBACK, packet.packet_id))
            case Disconnect():
                log.info("client %s disconnected", session.client_id)
                self.end(will=False)
            case Connect():
                raise ProtocolError("a second CONNECT")

    def _greet(self, request: Packet) -> None:
        if not isinstance(request, Connect):
            raise ProtocolError("the first packet is not CONNECT")
        self._session = self._broker.connect(request, self)
        self.write(encode_connack(Answer.ACCEPTED))
        if self._timer is not None:
            self._timer.cancel()
        if request.keep_alive_s:
            self._silent_after_s = 1.5 * request.keep_alive_s
            self._watch()
        log.info("client %s connected as %s", self._session.client_id, self._session.user)

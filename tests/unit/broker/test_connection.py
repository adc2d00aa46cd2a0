"""A connection whose client does not read, on a transport that the test fills."""

import asyncio
import socket

from broker.simulated.broker import Broker
from broker.simulated.connection import Connection
from broker.simulated.session import Limits
from tests.support.bus import raw_mqtt

PING = raw_mqtt.packet(0xC0, b"")
MESSAGE = raw_mqtt.packet(0x32, raw_mqtt.string("t") + b"\0\1\0x")  # of QoS 1, answered with five bytes or four


class Transport(asyncio.Transport):
    """Stores what is written."""

    def __init__(self, raw: socket.socket) -> None:
        super().__init__({"socket": raw})
        self.written = b""
        self.closing = self.aborted = False
        self.reading = True

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        pass

    def write(self, data: bytes | bytearray | memoryview) -> None:
        self.written += data

    def is_closing(self) -> bool:
        return self.closing

    def pause_reading(self) -> None:
        self.reading = False

    def resume_reading(self) -> None:
        self.reading = True

    def close(self) -> None:
        self.closing = True

    def abort(self) -> None:
        self.closing = self.aborted = True


async def _ask(broker: Broker, packet: bytes, *, reads: bool) -> Transport:
    """Ask 200 times, ten packets at once."""
    with socket.socket() as raw:
        transport = Transport(raw)
        connection = Connection(broker, set())
        connection.connection_made(transport)
        connection.data_received(raw_mqtt.connect_packet("asker", "tester"))
        await asyncio.sleep(0)
        transport.written = b""
        for _ in range(20):
            connection.pause_writing()
            connection.data_received(packet * 10)
            await asyncio.sleep(0)
            if reads:
                connection.resume_writing()
        return transport


def test_a_client_that_sends_packets_and_does_not_read_is_disconnected() -> None:
    for packet in (PING, MESSAGE, raw_mqtt.subscribe("a")):
        broker = Broker(limits=Limits(unread_bytes=100))
        transport = asyncio.run(_ask(broker, packet, reads=False))
        assert transport.aborted
        assert 80 < len(transport.written) <= 100
        assert broker.counters.counts["unread"] == 1
        assert not broker.sessions


def test_a_client_that_reads_at_times_stays_connected() -> None:
    broker = Broker(limits=Limits(unread_bytes=100))
    transport = asyncio.run(_ask(broker, PING, reads=True))
    assert transport.written == raw_mqtt.packet(0xD0, b"") * 200
    assert not transport.aborted and broker.counters.counts["unread"] == 0


async def _flood(broker: Broker, payload: bytes, count: int) -> list[int]:
    """Send many messages at once, and count the kept ones after each turn of the loop."""
    with socket.socket() as raw:
        transport = Transport(raw)
        connection = Connection(broker, set())
        connection.connection_made(transport)
        connection.data_received(raw_mqtt.connect_packet("flooder", "tester"))
        connection.data_received(b"".join(_numbered(payload, number) for number in range(count)))
        turns = []
        while not transport.reading:
            turns.append(len(broker.retained))
            await asyncio.sleep(0)
        return [*turns, len(broker.retained)]


def _numbered(payload: bytes, number: int) -> bytes:
    topic = f"t/{number:05d}".encode()
    return raw_mqtt.packet(0x31, len(topic).to_bytes(2, "big") + topic + payload)


def test_a_client_that_floods_gives_others_a_turn_after_some_packets_and_after_some_bytes() -> None:
    limits = Limits(packets_in_turn=10, bytes_in_turn=1000)
    assert asyncio.run(_flood(Broker(limits=limits), b"x", 35)) == [10, 20, 30, 35]
    assert asyncio.run(_flood(Broker(limits=limits), bytes(600), 5)) == [2, 4, 5]

"""What the connection to the centre reads."""

import socket
import ssl
from collections import Counter

import pytest

from services.monitoring.uplink.link import Link, TlsClient

DISCONNECT = b"\xe0\x00"


# The most that four bytes can state, and 128 KiB.
@pytest.mark.parametrize(("length", "ends"), [(b"\xff\xff\xff\x7f", True), (b"\x80\x80\x08", False)])
def test_a_packet_that_states_more_than_is_ever_sent_ends_the_connection(length: bytes, ends: bool) -> None:
    client = TlsClient(ssl.create_default_context(), "car")
    ours, theirs = socket.socketpair()
    ours.setblocking(False)
    client._sock = ours
    theirs.sendall(b"\x30" + length)
    for _ in range(3):
        client.loop_read()
    assert (client.socket() is None) == ends
    theirs.close()
    ours.close()


# What the centre has no reason to send: the client keeps messages of QoS 2 and answers that it owes without bound.
@pytest.mark.parametrize(
    ("packet", "ends"),
    [
        (b"\x34\x07\x00\x03a/b\x00\x01", True),
        (b"\x32\x07\x00\x03a/b\x00\x01", True),
        (b"\xc0\x00", True),
        (b"\x62\x02\x00\x01", True),
        (b"\x30\x05\x00\x03a/b", False),
        (b"\x31\x05\x00\x03a/b", False),
        (b"\xd0\x00", False),
    ],
    ids=["QoS 2", "QoS 1", "PINGREQ", "PUBREL", "QoS 0", "retained", "PINGRESP"],
)
def test_a_packet_that_this_protocol_does_not_have_ends_the_connection(packet: bytes, ends: bool) -> None:
    client = TlsClient(ssl.create_default_context(), "car")
    ours, theirs = socket.socketpair()
    ours.setblocking(False)
    client._sock = ours
    theirs.sendall(packet)
    for _ in range(3):
        client.loop_read()
    assert (client.socket() is None) == ends
    assert not client._in_messages
    theirs.close()
    ours.close()


def test_a_link_that_is_closed_says_goodbye_and_gives_its_socket_back() -> None:
    client, link = TlsClient(ssl.create_default_context(), "car"), Link(Counter())
    ours, theirs = socket.socketpair()
    ours.setblocking(False)
    client._sock = ours
    link._client, link.connected = client, True
    link.close()
    assert not link.connected and ours.fileno() == -1
    assert theirs.recv(16) == DISCONNECT and theirs.recv(16) == b""
    theirs.close()

"""What the connection to the centre reads."""

import socket
import ssl

import pytest

from services.monitoring.uplink.link import TlsClient


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

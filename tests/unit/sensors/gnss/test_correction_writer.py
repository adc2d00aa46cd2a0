"""Corrections on their way to the receiver's port."""

import os
import pty
import tty
from collections import Counter
from typing import cast

from services.sensors.gnss.correction_writer import MAX_BYTES, PORTION_BYTES, CorrectionWriter
from services.sensors.gnss.process import Config, Process
from shared.bus.bus import Bus
from shared.devices.driver import Link
from shared.messages.corrections import CorrectionProtocol, GnssCorrection
from tests.support.bus.live_bus import LiveBus, eventually, running


def correction(data: bytes) -> GnssCorrection:
    return GnssCorrection(received_ns=1, source="base", data=data, protocol=CorrectionProtocol.RTCM3, frames=1)


class FakeLink:
    """A port that accepts bytes, or does not."""

    def __init__(self) -> None:
        self.accepts, self.written, self.attempts = True, b"", 0

    def write(self, _bus: Bus, data: bytes) -> bool:
        self.attempts += 1
        self.written += data if self.accepts else b""
        return self.accepts


def test_corrections_are_written_in_portions_and_in_their_order() -> None:
    bus, link, writer = LiveBus(), FakeLink(), CorrectionWriter()
    data = [bytes((k,)) * size for k, size in enumerate((100, 3000, 1024, 1))]
    for payload in data:
        writer.take(bus.as_bus(), correction(payload))
    for _ in range(8):
        before = len(link.written)
        writer.write(bus.as_bus(), cast(Link, link))
        assert len(link.written) - before <= PORTION_BYTES
    assert link.written == b"".join(data) and not bus.rejects


def test_what_waits_is_bounded_and_the_oldest_makes_room() -> None:
    bus, link, writer = LiveBus(), FakeLink(), CorrectionWriter()
    for k in range(40):
        writer.take(bus.as_bus(), correction(bytes((k,)) * 1000))
    while link.attempts < 50:
        writer.write(bus.as_bus(), cast(Link, link))
        link.attempts += 1
    kept = MAX_BYTES // 1000
    assert bus.rejects == Counter(correction_lost=40 - kept)
    assert set(link.written) == set(range(40 - kept, 40))


def test_a_port_that_takes_nothing_costs_one_attempt_a_second_and_what_waits() -> None:
    bus, link, writer = LiveBus(), FakeLink(), CorrectionWriter()
    link.accepts = False
    for _ in range(100):
        writer.take(bus.as_bus(), correction(b"x" * 100))
        writer.write(bus.as_bus(), cast(Link, link))
    assert link.attempts == 1 and bus.rejects["correction_lost"] >= 1


def test_corrections_reach_the_port_of_the_receiver() -> None:
    far, near = pty.openpty()
    tty.setraw(near)
    with running(Process(Config(device=f"serial://{os.ttyname(near)}")).run) as bus:
        eventually(lambda: bool(os.write(far, b"x") and bus.published))
        bus.deliver(correction(b"\xd3\x00\x01" * 50))
        eventually(bus.all_received)
        assert os.read(far, 512) == b"\xd3\x00\x01" * 50
    os.close(far)
    os.close(near)

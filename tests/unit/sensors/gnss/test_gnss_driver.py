import os
import pty
import time
import tty
from pathlib import Path

import pytest

from services.sensors.gnss.process import Config, Process
from shared.bus.bus import HUNG_S
from shared.errors import UserError
from shared.messages.gnss import GnssRaw, GnssWrite
from shared.messages.operation import HostClock
from tests.support.bus.live_bus import eventually, running


def test_received_and_written_bytes_are_unchanged() -> None:
    far, near = pty.openpty()
    tty.setraw(near)
    everything = bytes(range(256))
    with running(Process(Config(device=f"serial://{os.ttyname(near)}", source="roof")).run) as bus:
        eventually(lambda: bool(os.write(far, b"x") and bus.of(GnssRaw)))
        bus.published.clear()
        os.write(far, everything)
        eventually(lambda: everything in b"".join(raw.data for raw in bus.of(GnssRaw)))
        assert {(raw.source, raw.recorded) for raw in bus.of(GnssRaw)} == {("roof", None)}
        bus.deliver(GnssWrite(received_ns=1, source="roof", data=everything))
        bus.deliver(GnssWrite(received_ns=1, source="another receiver", data=b"not for us"))
        eventually(bus.all_received)
        assert os.read(far, 512) == everything
        assert bus.longest_gap_s < HUNG_S, "the process would end itself"
    os.close(far)
    os.close(near)


def test_the_clock_of_the_host_is_stated_beside_a_receiver_and_not_beside_a_recorded_file(tmp_path: Path) -> None:
    far, near = pty.openpty()
    tty.setraw(near)
    with running(Process(Config(device=f"serial://{os.ttyname(near)}")).run) as bus:
        eventually(lambda: bool(bus.of(HostClock)))
        (clock,) = bus.of(HostClock)
        assert abs(clock.utc_ns - time.time_ns()) < 60 * 10**9 and bus.as_bus().now_ns() - clock.sampled_ns >= 0
        assert clock.synchronised is (clock.maximum_error_s is not None)
    os.close(far)
    os.close(near)
    (tmp_path / "receiver.ubx").write_bytes(bytes(64))
    with running(Process(Config(device=f"file://{tmp_path / 'receiver.ubx'}")).run) as bus:
        eventually(lambda: bool(bus.of(GnssRaw)))
        assert not bus.of(HostClock)
        assert all(raw.recorded for raw in bus.of(GnssRaw)), "so that its dates are taken as recorded"


def test_an_invalid_device_url_is_rejected_at_the_start() -> None:
    with pytest.raises(UserError, match="try serial"):
        Process(Config(device="COM3"))

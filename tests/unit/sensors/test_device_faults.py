"""Faults of devices, each with the recovery that docs/reference/device-faults.md states."""

import contextlib
import os
import pty
import random
import time
import tty
from collections.abc import Callable
from pathlib import Path

from pyubx2.ubxmessage import UBXMessage

from services.parsers.gnss.process import Config, Process
from shared.bus.bus import Bus
from shared.devices.driver import Link, run_driver
from shared.devices.recognising import Port
from shared.messages.base import Tick
from shared.messages.gnss import GnssFix, GnssRaw, GnssReceiver
from shared.messages.operation import DeviceFound, DeviceState
from shared.protocols.ubx import ubx_frame
from tests.support.bus.live_bus import LiveBus, eventually, running

SENTENCE = b"$GNRMC,,V,,,,,,,,,,N*4D\r\n"
START_NS = 1_795_000_000 * 10**9


def plug(dev: Path, number: int, by_id: Path) -> int:
    """Plug a device in under a kernel's name, with the link that udev makes; return its far end."""
    far, near = pty.openpty()
    tty.setraw(near)
    node = dev / f"ttyUSB{number}"
    node.symlink_to(os.ttyname(near))
    link = by_id / "usb-u-blox_GNSS_receiver-if00"
    link.unlink(missing_ok=True)
    link.symlink_to(node)
    os.close(near)
    return far


def driving(port: Port) -> Callable[[Bus], None]:
    return lambda bus: run_driver(bus, Link(port.open), port.url, raw, source="gnss0")


def raw(data: bytes, received_ns: int) -> GnssRaw:
    return GnssRaw(received_ns=received_ns, source="gnss0", data=data)


def says(far: int, bus: LiveBus) -> bool:
    """Let the device speak; whether a message of it has arrived since."""
    before = len(bus.of(GnssRaw))
    with contextlib.suppress(OSError):
        os.write(far, SENTENCE)
    time.sleep(0.05)
    return len(bus.of(GnssRaw)) > before


def epoch(itow_ms: int) -> bytes:
    """A fix at rest, and the end of its epoch."""
    pvt = UBXMessage(
        "NAV", "NAV-PVT", 0, iTOW=itow_ms, fixType=3, gnssFixOk=1, lat=42.5, lon=13.25, hAcc=1000, vAcc=1000
    )
    return bytes(pvt.serialize()) + ubx_frame(0x01, 0x61, itow_ms.to_bytes(4, "little"))


def test_a_device_that_comes_back_under_another_name_is_read_within_seconds(tmp_path: Path) -> None:
    dev, by_id = tmp_path / "dev", tmp_path / "by-id"
    dev.mkdir()
    by_id.mkdir()
    far = plug(dev, 0, by_id)
    port = Port(f"serial://{dev / 'ttyUSB0'}?baud=9600", "gnss", by_id)
    with running(driving(port)) as bus:
        eventually(lambda: says(far, bus))
        os.close(far)
        (dev / "ttyUSB0").unlink()
        eventually(lambda: bus.rejects["device_lost"] == 1)
        far = plug(dev, 1, by_id)
        eventually(lambda: says(far, bus))
        assert "usb-u-blox" in (port.opened_as or "")
        eventually(lambda: any(device_state.found is DeviceFound.WORKING for device_state in bus.of(DeviceState)))
    os.close(far)


def test_a_flood_of_rubbish_is_bounded_and_the_next_message_is_read() -> None:
    process, generator = Process(Config()), random.Random(1)
    for k in range(50):
        list(process.handle(raw(generator.randbytes(16384), START_NS + k * 10_000_000)))
    now_ns = START_NS + 10**9
    list(process.handle(raw(SENTENCE * 3, now_ns)))
    said = [
        gnss_receiver
        for gnss_receiver in process.handle(Tick(now_ns=now_ns))
        if isinstance(gnss_receiver, GnssReceiver)
    ]
    assert "NMEA RMC" in said[-1].messages
    assert process.rejects["garbage_bytes"] > 700_000
    assert len(process.rejects) < 20


def test_a_receiver_whose_time_stands_still_gives_no_further_fixes_and_is_counted() -> None:
    process = Process(Config())
    fixes = []
    for second in range(10):
        frozen = epoch(1000)
        fixes += [
            gnss_fix
            for gnss_fix in process.handle(raw(frozen, START_NS + second * 10**9))
            if isinstance(gnss_fix, GnssFix)
        ]
    assert len(fixes) == 1
    assert process.rejects["repeated_epoch"] == 9


def test_half_a_frame_costs_itself_alone() -> None:
    process = Process(Config())
    whole = [epoch(1000 * k) for k in range(6)]
    whole[3] = whole[3][:50]
    fixes = []
    for second, data in enumerate(whole):
        fixes += [
            gnss_fix
            for gnss_fix in process.handle(raw(data, START_NS + second * 10**9))
            if isinstance(gnss_fix, GnssFix)
        ]
    assert len(fixes) == 5

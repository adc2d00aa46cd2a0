import time

import can
import pytest

from services.sensors.can.process import Config, Process
from shared.errors import UserError
from shared.messages import CanRaw
from tests.support.live_bus import eventually, running


def test_frames_travel_in_batches_of_a_tenth_of_a_second() -> None:
    with running(Process(Config(device="virtual://batches")).run) as bus, can.Bus("batches", "virtual") as far:
        time.sleep(0.1)
        for number in range(100):
            far.send(can.Message(arbitration_id=0x100, is_extended_id=False, data=bytes([number])))
            time.sleep(0.004)
        eventually(lambda: _lines(bus.of(CanRaw)) == [f"batches 100#{number:02X}" for number in range(100)])
        assert 3 <= len(bus.of(CanRaw)) <= 8
        assert bus.longest_gap_s < 0.2
    for raw in bus.of(CanRaw):
        stamps_s = [float(line.split(b")")[0][1:]) for line in raw.data.splitlines()]
        assert stamps_s == sorted(stamps_s)
        assert 0 <= raw.received_ns * 1e-9 - stamps_s[0] < 0.2


def test_a_driver_that_only_listens_sends_nothing() -> None:
    with can.Bus("listen", "virtual") as far, running(Process(Config(device="virtual://listen")).run):
        heard = far.recv(0.5)
    assert heard is None


def test_a_driver_asks_for_speed_as_often_as_it_was_told() -> None:
    with can.Bus("ask", "virtual") as far:
        with running(Process(Config(device="virtual://ask", obd_period_s=0.1)).run):
            time.sleep(0.65)
        requests = []
        while (frame := far.recv(0)) is not None:
            requests.append((frame.arbitration_id, bytes(frame.data)))
    assert 3 <= len(requests) <= 7
    assert set(requests) == {(0x7DF, bytes.fromhex("02010D0000000000"))}


def test_a_wrong_device_is_refused_at_the_start() -> None:
    with pytest.raises(UserError, match="try socketcan"):
        Process(Config(device="can0"))


def _lines(raws: list[CanRaw]) -> list[str]:
    return [line.split(") ")[1] for raw in raws for line in raw.data.decode().splitlines()]

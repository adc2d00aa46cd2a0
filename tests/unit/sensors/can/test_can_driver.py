import time

import can
import pytest

from services.sensors.can.process import NS, Config, Process, next_request_ns
from shared.errors import UserError
from shared.messages.vehicle import CanRaw
from tests.support.bus.live_bus import eventually, running
from tests.support.patience import HANGS_S


def test_frames_are_published_in_batches_of_at_most_0_07_s_and_none_is_lost() -> None:
    started_s, sent = time.monotonic(), 0
    with running(Process(Config(device="virtual://batches")).run) as bus, can.Bus("batches", "virtual") as far:
        while len(bus.of(CanRaw)) < 4:
            assert time.monotonic() - started_s < HANGS_S, "a batch ends while frames are received"
            far.send(can.Message(arbitration_id=0x100, is_extended_id=False, data=sent.to_bytes(2)))
            sent += 1
            time.sleep(0.004)
        eventually(lambda: _lines(bus.of(CanRaw))[-1] == f"batches 100#{sent - 1:04X}")
    raws, elapsed_s = bus.of(CanRaw), time.monotonic() - started_s
    # The first frames were sent before the driver had opened the bus; after the first received one none is missing.
    first = sent - len(_lines(raws))
    assert _lines(raws) == [f"batches 100#{number:04X}" for number in range(first, sent)]
    assert len(raws) <= elapsed_s / 0.03 + 1, "a batch ends after 0.03 s without a frame, or after 0.07 s"
    for raw in raws:
        stamps_s = [float(line.split(b")")[0][1:]) for line in raw.data.splitlines()]
        assert stamps_s == sorted(stamps_s)
        assert 0 <= raw.received_ns * 1e-9 - stamps_s[0] < elapsed_s


def test_the_driver_transmits_nothing_by_default() -> None:
    with can.Bus("listen", "virtual") as far, running(Process(Config(device="virtual://listen")).run):
        received = far.recv(0.5)
    assert received is None


def test_the_driver_requests_the_speed_with_the_configured_period() -> None:
    requests: list[tuple[int, bytes]] = []
    started_s = time.monotonic()
    with can.Bus("ask", "virtual") as far, running(Process(Config(device="virtual://ask", obd_period_s=0.1)).run):
        while len(requests) < 4:
            frame = far.recv(HANGS_S)
            assert frame is not None, "no request was transmitted"
            requests.append((frame.arbitration_id, bytes(frame.data)))
        assert time.monotonic() - started_s >= 0.3
    assert set(requests) == {(0x7DF, bytes.fromhex("02010D0000000000"))}


def test_requests_are_at_the_stamps_of_gnss_and_whole_periods_away() -> None:
    period_ns, fix_ns = NS // 2, 100 * NS + 137_000_000
    at_ns = next_request_ns(fix_ns + 40_000_000, period_ns, fix_ns)
    assert (at_ns - fix_ns) % period_ns == 0 and at_ns - fix_ns == NS // 2
    for late_ns in (0, 60_000_000, 99_000_000):  # a loop that looks ten times a second
        at_ns = next_request_ns(at_ns + late_ns, period_ns, fix_ns)
        assert (at_ns - fix_ns) % period_ns == 0
    assert (at_ns - fix_ns) == 2 * NS, "one request in each period"
    early_ns = fix_ns + 400_000_000
    assert next_request_ns(early_ns, period_ns, fix_ns) == fix_ns + NS, "no two requests within half a period"
    assert next_request_ns(early_ns, period_ns, None) == early_ns + period_ns
    assert next_request_ns(fix_ns + 9 * NS, period_ns, fix_ns) == fix_ns + 9 * NS + period_ns, "no fixes any more"


def test_an_invalid_device_url_is_rejected_at_the_start() -> None:
    with pytest.raises(UserError, match="try socketcan"):
        Process(Config(device="can0"))


def _lines(raws: list[CanRaw]) -> list[str]:
    return [line.split(") ")[1] for raw in raws for line in raw.data.decode().splitlines()]

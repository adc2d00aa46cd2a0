import os
import pty
import time
import tty

from services.sensors.imu.process import Config, Process
from shared.messages.imu import ImuRaw
from shared.protocols import xbus
from tests.support.bus.live_bus import eventually, running


def test_frames_at_100_hz_are_published_unchanged_with_a_delay_below_5_ms() -> None:
    far, near = pty.openpty()
    tty.setraw(near)
    frame = xbus.encode_message(xbus.MTDATA2, bytes(60))
    with running(Process(Config(device=f"serial://{os.ttyname(near)}")).run) as bus:
        eventually(lambda: bool(os.write(far, b"x") and bus.of(ImuRaw)))
        time.sleep(0.05)
        bus.published.clear()
        sent_ns = []
        for _ in range(20):
            sent_ns.append(bus.now_ns())
            os.write(far, frame)
            time.sleep(0.01)
        eventually(lambda: b"".join(raw.data for raw in bus.of(ImuRaw)) == frame * 20)
        arrivals = bus.of(ImuRaw)
    os.close(far)
    os.close(near)
    # A loaded host may join or delay some frames; the smallest delay of twenty is that of the driver.
    assert len(arrivals) >= 5
    assert min(raw.received_ns - max(sent for sent in sent_ns if sent <= raw.received_ns) for raw in arrivals) < 5e6

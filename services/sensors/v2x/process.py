"""Receives frames from the V2X radio and sends those of this unit."""

import time

from pydantic import Field

from shared.bus.bus import Bus, decoded
from shared.devices.device import DeviceLost
from shared.devices.driver import Connection
from shared.devices.v2x_device import Radio, check_radio_url, host_and_port, open_radio
from shared.messages.base import DeviceName
from shared.messages.v2x import CamFrames, V2xSend
from shared.runtime.config import Section
from shared.v2x import frames

BATCH_S = 0.02
MAX_BATCH_FRAMES = 72  # of the longest frames: 167 kB, and 223 kB in base 64
MAX_READ = 4096  # frames in one go
MAX_BURST_S = 0.5  # of frames at the greatest rate, after a pause


class Config(Section):
    """Settings of the V2X driver; `shared/devices/v2x_device.py` lists the kinds of radio."""

    device: str = Field(default="udp://127.0.0.1:47347", description="URL of the radio: where its frames arrive")
    send_to: str | None = Field(
        default=None, description="UDP only: URL to which frames of this unit are sent; without it none are sent"
    )
    source: DeviceName = Field(default="v2x0", description="name of this radio in the published messages")
    max_frames_s: int = Field(
        default=4000,
        ge=50,
        le=20_000,
        description="frames accepted in a second; those beyond it are counted and dropped",
    )


class Process:
    """Publishes the received frames in batches of at most 20 ms."""

    def __init__(self, config: Config) -> None:
        check_radio_url(config.device)  # an invalid URL is a configuration error, raised at the start
        if config.send_to is not None:
            host_and_port(config.send_to)
        self._config = config
        self._next_batch = 0.0
        self._allowance = MAX_BURST_S * config.max_frames_s  # frames that may be published now
        self._refilled = time.monotonic()

    def run(self, bus: Bus) -> None:
        """Receive and send until the bus stops."""
        config = self._config
        link = Connection[Radio](lambda: open_radio(config.device, config.send_to, bus.rejects))
        while not bus.stopping and not bus.connected:  # data published before would be lost
            bus.receive(0.1)
        while not bus.stopping:
            for envelope in bus.receive(max(0.0, self._next_batch - time.monotonic())):
                message = decoded(bus, envelope)
                if isinstance(message, V2xSend):
                    link.write(bus, message.data)
            if time.monotonic() >= self._next_batch:
                self._next_batch = time.monotonic() + BATCH_S
                self._publish_batch(bus, link)
        link.close()

    def _publish_batch(self, bus: Bus, link: Connection[Radio]) -> None:
        try:
            radio = link.opened()
            if radio is None:
                return
            arrived = radio.read(MAX_READ)
        except DeviceLost as error:
            link.lose(bus, error)
            return
        link.note_working(bus)
        accepted, offsets = arrived[: self._accept(len(arrived))], radio.cfo_hz
        if len(accepted) < len(arrived):
            bus.rejects["frame_rate"] += len(arrived) - len(accepted)
        now_ns = bus.now_ns()
        for first in range(0, len(accepted), MAX_BATCH_FRAMES):
            batch = [(now_ns - age_ns, data) for age_ns, data in accepted[first : first + MAX_BATCH_FRAMES]]
            bus.publish(
                CamFrames(
                    received_ns=batch[-1][0],
                    source=self._config.source,
                    encapsulation=radio.encapsulation,
                    data=frames.pack(batch),
                    cfo_hz=tuple(offsets[first : first + len(batch)]),
                )
            )

    def _accept(self, arrived: int) -> int:
        """How many of so many frames the limit of the rate admits: a token bucket."""
        now, greatest = time.monotonic(), MAX_BURST_S * self._config.max_frames_s
        self._allowance = min(greatest, self._allowance + (now - self._refilled) * self._config.max_frames_s)
        self._refilled = now
        accepted = min(arrived, int(self._allowance))
        self._allowance -= accepted
        return accepted

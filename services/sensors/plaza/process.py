"""Publishes the pulses of the lanes' detectors, and passes the orders for pictures on to their camera."""

import time
from collections import deque
from pathlib import Path
from typing import Annotated

from pydantic import Field

from shared.bus.bus import Bus, decoded
from shared.devices.device import DeviceLost
from shared.devices.driver import Connection
from shared.errors import UserError
from shared.messages.toll import PictureOrder, PictureState, PlazaDetector
from shared.runtime.config import Section
from shared.toll.plaza import load_plaza

from .camera import Camera, check_camera, open_camera
from .pulses import BadLine, Detector, LanePulse, check_detector, open_detector

READ_S = 0.01
REPEAT_NS = 5_000_000_000
STATE_NS = 1_000_000_000
ANSWERS = 100  # in one state
EARLIER = 20
MAX_PULSES_S = 20  # of a lane, in a second: more is a fault of the detector


class Config(Section):
    """Settings of the detectors; `services/sensors/plaza/pulses.py` lists their kinds."""

    plaza_file: Path = Field(
        default=Path("deploy/plazas/example.geojson"),
        description="GeoJSON file of the plaza, relative to the working folder or repository",
    )
    detectors: Annotated[tuple[str, ...], Field(max_length=100)] = Field(
        default=("udp://127.0.0.1:47360",), description="URLs of the detectors: UDP, serial ports, inputs (GPIO)"
    )
    camera: str | None = Field(
        default=None,
        description="URL of the camera, udp://host:port, or `simulated:`; without it no pictures are taken",
    )


class LaneCount:
    """Pulses of one lane, with their running numbers."""

    def __init__(self, plaza: str, lane: str, since_ns: int) -> None:
        self._plaza, self._lane, self._since_ns = plaza, lane, since_ns
        self._count = 0
        self._times: deque[int] = deque(maxlen=EARLIER + 1)  # newest first
        self._backward: deque[int] = deque(maxlen=EARLIER + 1)
        self.said_ns = since_ns

    def add(self, time_ns: int, *, backward: bool) -> bool:
        """Count a pulse; False: there were too many within a second."""
        if len(self._times) > MAX_PULSES_S - 1 and abs(time_ns - self._times[MAX_PULSES_S - 1]) < STATE_NS:
            return False
        if time_ns in self._times:
            time_ns = max(self._times) + 1
        self._times.appendleft(time_ns)
        if backward:
            self._backward.appendleft(time_ns)
        self._count += 1
        return True

    def message(self, now_ns: int) -> PlazaDetector | None:
        """State the newest pulse and those before it; None before the first."""
        if not self._times:
            return None
        self.said_ns = now_ns
        newest, *earlier = self._times
        return PlazaDetector(
            sampled_ns=newest, plaza=self._plaza, lane=self._lane, since_ns=self._since_ns, pulse=self._count - 1,
            earlier_ns=tuple(earlier), backward_ns=tuple(time for time in self._backward if time in self._times),
        )  # fmt: skip


class Process:
    """Reads the detectors every 10 ms, and repeats the newest pulse of each lane every 5 s."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._plaza = load_plaza(config.plaza_file)
        self._lanes = {lane.name for lane in self._plaza.lanes}
        for url in config.detectors:
            lane = check_detector(url)
            if lane is not None and lane not in self._lanes:
                raise UserError(
                    f"detector {url!r}: the plaza has no lane {lane!r}; it has {', '.join(sorted(self._lanes))}"
                )
        if config.camera is not None:
            check_camera(config.camera)
        self._camera: Camera | None = open_camera(config.camera) if config.camera is not None else None
        self._counts: dict[str, LaneCount] = {}
        self._state_ns = 0

    def run(self, bus: Bus) -> None:
        """Count until the bus stops."""
        links = [Connection[Detector](lambda url=url: open_detector(url)) for url in self._config.detectors]  # type: ignore[misc]  # bound now
        while not bus.stopping and not bus.connected:  # pulses published before would be lost
            bus.receive(0.1)
        since_ns = bus.now_ns()
        next_s = time.monotonic()
        while not bus.stopping:
            for envelope in bus.receive(max(0.0, next_s - time.monotonic())):
                message = decoded(bus, envelope)
                if isinstance(message, PictureOrder) and message.plaza == self._plaza.name and self._camera:
                    self._camera.obey(message, bus.now_ns())
            if time.monotonic() >= next_s:
                next_s = time.monotonic() + READ_S
                for link in links:
                    self._read(bus, link, since_ns)
                self._repeat(bus)
        for link in links:
            link.close()
        if self._camera is not None:
            self._camera.close()

    def _read(self, bus: Bus, link: Connection[Detector], since_ns: int) -> None:
        try:
            detector = link.opened()
            if detector is None:
                return
            pulses = detector.read()
        except DeviceLost as error:
            link.lose(bus, error)
            return
        link.note_working(bus)
        for pulse in pulses:
            if isinstance(pulse, BadLine):
                bus.rejects["detector_line"] += 1
            else:
                self._count(bus, pulse, since_ns)

    def _count(self, bus: Bus, pulse: LanePulse, since_ns: int) -> None:
        if pulse.lane not in self._lanes:
            bus.rejects["detector_lane"] += 1
            return
        count = self._counts.setdefault(pulse.lane, LaneCount(self._plaza.name, pulse.lane, since_ns))
        if not count.add(bus.now_ns() - pulse.age_ns, backward=pulse.backward):
            bus.rejects["detector_rate"] += 1
        elif (message := count.message(bus.now_ns())) is not None:
            bus.publish(message)

    def _repeat(self, bus: Bus) -> None:
        now_ns = bus.now_ns()
        for count in self._counts.values():
            if now_ns - count.said_ns >= REPEAT_NS and (message := count.message(now_ns)) is not None:
                bus.publish(message)
        if self._camera is not None and now_ns - self._state_ns >= STATE_NS:
            self._state_ns = now_ns
            self._camera.expire(now_ns)
            pictures, answered = self._camera.pictures.values(), self._camera.answered
            bus.publish(
                PictureState(
                    sampled_ns=now_ns, plaza=self._plaza.name, pictures=len(pictures),
                    oldest_ns=min((order.pulse_ns for order in pictures), default=None),
                    failed=self._camera.failed,
                    answered=tuple(answered.popleft() for _ in range(min(ANSWERS, len(answered)))),
                )
            )  # fmt: skip

"""Simulates the traffic of a toll plaza: frames by UDP to the V2X driver, everything else on the bus."""

import heapq
import logging
import socket
from itertools import count
from pathlib import Path

import numpy as np
from pydantic import Field

from shared.bus.bus import Bus, decoded
from shared.devices.v2x_device import host_and_port
from shared.messages.base import Message
from shared.messages.toll import TollReceipt, TollTransaction
from shared.toll.plaza import load_plaza

from .operator import Operator
from .world import Frame, Traffic, World

log = logging.getLogger(__name__)

NS = 1_000_000_000
MAX_DELAY_NS = NS  # a frame overdue by more than this is dropped (the host was suspended)


class Config(Traffic):
    """Settings of the simulated traffic."""

    plaza_file: Path = Field(
        default=Path("deploy/plazas/example.geojson"),
        description="GeoJSON file of the plaza, relative to the working folder or repository",
    )
    send_to: str = Field(default="udp://127.0.0.1:47347", description="URL at which the V2X driver receives")
    seed: int = Field(default=1, ge=0, description="seed of all random numbers; the same seed gives the same traffic")
    answer_after_s: float = Field(default=0.2, ge=0.0, le=60.0, description="delay of the simulated operator's answers")
    answers_lost: float = Field(
        default=0.05, ge=0.0, le=1.0, description="share of the operator's answers that do not arrive"
    )
    pause_s: float = Field(
        default=1.5, ge=0.0, le=60.0, description="delay of the traffic, so that others can subscribe before it"
    )


class Process:
    """Sends each frame and publishes each message when it is due."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._plaza = load_plaza(config.plaza_file)
        self._address = host_and_port(config.send_to)
        self._operator = Operator()
        self._rng = np.random.default_rng((config.seed, 1))
        self._answers: list[tuple[int, int, TollReceipt]] = []
        self._order = count()
        self._next_service_ns = 0

    def run(self, bus: Bus) -> None:
        """Simulate until the bus stops."""
        while not bus.stopping and not bus.connected:
            bus.receive(0.1)
        begin_ns = bus.now_ns() + round(self._config.pause_s * 1e9)
        self._wait(bus, begin_ns)
        if bus.stopping:
            return
        start_ns = (bus.now_ns() // NS + 1) * NS  # receivers have their epochs at full seconds
        world = World(self._plaza, self._config, self._config.seed, start_ns)
        log.info("simulating %d vehicles at %s", self._config.vehicles, self._plaza.name)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as radio:
            for due_ns, item in world:
                self._wait(bus, due_ns)
                if bus.stopping:
                    return
                self._emit(bus, radio, due_ns, item)

    def _emit(self, bus: Bus, radio: socket.socket, due_ns: int, item: Frame | Message) -> None:
        if isinstance(item, Frame):
            if bus.now_ns() - due_ns > MAX_DELAY_NS:
                bus.rejects["late"] += 1
                return
            try:
                radio.sendto(item.data, self._address)
            except OSError as error:
                bus.rejects["send"] += 1
                bus.last_error = f"cannot send to {self._config.send_to}: {error.strerror}"
        else:
            bus.publish(item)

    def _wait(self, bus: Bus, due_ns: int) -> None:
        """Serve the bus until an instant, at least every 5 ms; answer as the operator does."""
        while not bus.stopping:
            remaining_s = (due_ns - bus.now_ns()) * 1e-9
            if remaining_s <= 0.0 and bus.now_ns() < self._next_service_ns:
                return
            self._next_service_ns = bus.now_ns() + 5_000_000
            for envelope in bus.receive(min(max(remaining_s, 0.0), 0.1)):
                message = decoded(bus, envelope)
                if isinstance(message, TollTransaction):
                    self._answer(message, bus.now_ns())
            while self._answers and self._answers[0][0] <= bus.now_ns():
                bus.publish(heapq.heappop(self._answers)[2])
            if due_ns <= bus.now_ns():
                return

    def _answer(self, transaction: TollTransaction, now_ns: int) -> None:
        receipt = self._operator.receive(transaction, now_ns)
        if self._rng.random() >= self._config.answers_lost:
            due_ns = now_ns + round(self._config.answer_after_s * 1e9)
            heapq.heappush(self._answers, (due_ns, next(self._order), receipt))

"""Simulates a vehicle and publishes the raw bytes of its devices in real time."""

import logging
from typing import Literal

from pydantic import Field, field_validator

from shared.attacks import ScheduledAttack, schedule
from shared.bus.bus import Bus, decoded
from shared.messages.base import Vector3
from shared.messages.gnss import GnssWrite
from shared.messages.simulation import SimulationAttack
from shared.runtime.config import Section

from .gnss.simulated_receiver import SOURCE
from .motion.centre_line import road_network
from .scenarios import scenario_of
from .v2x.traffic import MAX_COUNT
from .world import Equipment, World

log = logging.getLogger(__name__)

MAX_DELAY_NS = 1_000_000_000  # messages overdue by more than this are dropped (the host was suspended)


class Config(Section):
    """Settings of the simulator."""

    scenario: str = Field(default="parking_lot", description="name of the simulated drive")
    seed: int = Field(default=1, description="seed of all random numbers; the same seed gives the same bytes")
    protocols: tuple[Literal["ubx", "nmea"], ...] = Field(
        default=("ubx", "nmea"), description="initial output protocols of the GNSS receiver"
    )
    mounting_rpy_deg: Vector3 = Field(
        default=(0.0, 0.0, 0.0), description="roll, pitch, yaw of the IMU relative to the vehicle"
    )
    second_antenna_m: float = Field(
        default=0.0, ge=0.0, le=10.0, description="distance of a second GNSS antenna ahead of the first; 0: none"
    )
    neighbours: int = Field(
        default=4, ge=0, le=MAX_COUNT, description="vehicles around it that a V2X radio receives; 0: none"
    )
    pause_s: float = Field(
        default=1.5, ge=0.0, le=60.0, description="delay of the drive, so that other processes can subscribe before it"
    )

    attacks: tuple[str, ...] = Field(
        default=(), max_length=32, description='attacks, each as name(parameters)@start:duration, such as "drag_off@60"'
    )

    @property
    def scheduled(self) -> tuple[ScheduledAttack, ...]:
        """The attacks as they are scheduled."""
        return tuple(schedule(text) for text in self.attacks)

    @field_validator("attacks")
    @classmethod
    def _are_attacks(cls, attacks: tuple[str, ...]) -> tuple[str, ...]:
        for text in attacks:
            schedule(text)
        return attacks

    @field_validator("scenario")
    @classmethod
    def _exists(cls, name: str) -> str:
        scenario_of(name)
        return name

    @field_validator("seed")
    @classmethod
    def _is_seed(cls, seed: int) -> int:
        if seed < 0:
            raise ValueError("seed must be 0 or more")
        return seed


class Process:
    """Publishes each message at its absolute arrival time, so that delays do not accumulate."""

    def __init__(self, config: Config) -> None:
        self._config = config

    def run(self, bus: Bus) -> None:
        """Simulate until the bus stops."""
        while not bus.stopping and not bus.connected:
            bus.receive(0.1)
        begin_ns = bus.now_ns() + round(self._config.pause_s * 1e9)
        while not bus.stopping and bus.now_ns() < begin_ns:
            bus.receive(0.1)
        scenario = scenario_of(self._config.scenario, self._config.seed)
        config = self._config
        equipment = Equipment(
            config.protocols, config.mounting_rpy_deg, config.second_antenna_m, neighbours=config.neighbours
        )
        world = World(scenario, config.seed, bus.now_ns(), equipment, config.scheduled)
        log.info("simulating %s with seed %d: %s", scenario.name, self._config.seed, scenario.purpose)
        bus.publish(world.attack_state(bus.now_ns()))
        bus.publish(road_network(scenario.course, scenario.start, bus.now_ns()))
        for due_ns, message in world:
            self._wait(bus, due_ns, world)
            if bus.stopping:
                return
            if bus.now_ns() - due_ns > MAX_DELAY_NS:
                bus.rejects["late"] += 1
            else:
                bus.publish(message)

    def _wait(self, bus: Bus, due_ns: int, world: World) -> None:
        """Serve the bus until the message is due, and at least once."""
        while not bus.stopping:
            remaining_s = (due_ns - bus.now_ns()) * 1e-9
            for envelope in bus.receive(min(max(remaining_s, 0.0), 0.1)):
                written = decoded(bus, envelope)
                if isinstance(written, GnssWrite) and written.source == SOURCE:
                    world.write(written.data, bus.now_ns())
                elif isinstance(written, SimulationAttack):
                    world.command(written)
            if due_ns <= bus.now_ns():
                return

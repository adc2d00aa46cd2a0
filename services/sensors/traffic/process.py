"""Simulates the traffic of a toll plaza."""

from pathlib import Path

from shared.bus.bus import Bus
from shared.messages.operation import Origin, OriginKind
from shared.runtime.config import Section
from shared.toll.plaza import load_plaza

PERIOD_NS = 2_000_000_000


class Config(Section):
    """Settings of the simulated traffic."""

    plaza_file: Path = Path("deploy/plazas/example.geojson")  # GeoJSON, relative to the working folder or repository
    seed: int = 1  # seed of all random numbers


class Process:
    """Publishes the origin of the data."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._plaza = load_plaza(config.plaza_file)

    def run(self, bus: Bus) -> None:
        """Work until the bus stops."""
        next_ns = 0
        while not bus.stopping:
            bus.receive(0.1)
            if bus.now_ns() >= next_ns:
                next_ns = bus.now_ns() + PERIOD_NS
                bus.publish(Origin(now_ns=bus.now_ns(), kind=OriginKind.SIMULATED, name=self._plaza.name,
                                   seed=self._config.seed))  # fmt: skip

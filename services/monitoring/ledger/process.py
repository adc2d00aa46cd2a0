"""Charges each passage once: the state of the ledger once a second."""

from pathlib import Path

from shared.bus.bus import Bus
from shared.messages.toll import LedgerState
from shared.runtime.config import Section
from shared.toll.plaza import load_plaza

PERIOD_NS = 1_000_000_000


class Config(Section):
    """Settings of monitoring.ledger."""

    plaza_file: Path = Path("deploy/plazas/example.geojson")  # GeoJSON, relative to the working folder or repository


class Process:
    """Publishes the state of the ledger."""

    def __init__(self, config: Config) -> None:
        self._plaza = load_plaza(config.plaza_file)

    def run(self, bus: Bus) -> None:
        """Work until the bus stops."""
        next_ns = 0
        while not bus.stopping:
            bus.receive(0.1)
            if bus.now_ns() >= next_ns:
                next_ns = bus.now_ns() + PERIOD_NS
                bus.publish(LedgerState(now_ns=bus.now_ns(), plaza=self._plaza.name))

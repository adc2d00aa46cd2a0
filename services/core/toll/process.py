"""Describes the toll plaza on the bus."""

from collections.abc import Iterator
from pathlib import Path

from shared.messages.base import Message, Tick
from shared.messages.toll import PlazaDescription
from shared.runtime.config import Section
from shared.toll.plaza import load_plaza


class Config(Section):
    """Settings of core.toll."""

    plaza_file: Path = Path("deploy/plazas/example.geojson")  # GeoJSON, relative to the working folder or repository


class Process:
    """Publishes the description of the plaza with the first tick."""

    def __init__(self, config: Config) -> None:
        self._plaza = load_plaza(config.plaza_file)
        self._described = False

    def handle(self, message: Message) -> Iterator[PlazaDescription]:
        """Describe the plaza once."""
        if isinstance(message, Tick) and not self._described:
            self._described = True
            yield self._plaza.description(message.now_ns)

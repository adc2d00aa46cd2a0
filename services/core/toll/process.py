"""Tracks vehicles at a toll plaza by their CAM, decides their lanes and follows their passages."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from pydantic import Field

from shared.messages.base import Tick
from shared.messages.gnss import GnssFix
from shared.messages.toll import (
    GateCommand,
    OpenPassages,
    PlazaDescription,
    TollDelta,
    TollPassage,
    TollRegistration,
    TollTracks,
)
from shared.messages.v2x import CamList
from shared.toll.plaza import load_plaza

from .core import Core
from .settings import Settings

In = CamList | GnssFix | TollRegistration | OpenPassages | TollDelta | Tick
Out = PlazaDescription | TollDelta | TollTracks | TollPassage | GateCommand
TRACKS_NS = 500_000_000  # period of `toll/tracks` while CAM arrive
DELTA_NS = 900_000_000  # least distance of two deltas; receivers send one fix a second, or more
NO_FIX_NS = 2_000_000_000  # without a fix for so long, a tick publishes why there is no delta


class Config(Settings):
    """Settings of core.toll."""

    plaza_file: Path = Field(
        default=Path("deploy/plazas/example.geojson"),
        description="GeoJSON file of the plaza, relative to the working folder or repository",
    )


class Process:
    """Publishes passages and gate commands as they happen, tracks twice and the delta once a second."""

    def __init__(self, config: Config) -> None:
        self._plaza = load_plaza(config.plaza_file)
        settings = Settings.model_validate(config.model_dump(exclude={"plaza_file"}))
        self._core = Core(self._plaza, settings)
        self._described = False
        self._tracks_ns = self._delta_ns = 0

    @property
    def rejects(self) -> Counter[str]:
        """Rejected messages by reason."""
        return self._core.rejected

    def handle(self, message: In) -> Iterator[Out]:
        """Use a message."""
        match message:
            case CamList():
                yield from self._core.use(message.cams)
                yield from self._tracks(message.received_ns)
            case GnssFix():
                self._core.fix(message)
                yield from self._delta(message.sampled_ns, DELTA_NS)
            case TollRegistration():
                self._core.register(message)
            case OpenPassages():
                yield from self._core.continue_passages(message)
            case TollDelta():  # retained: after a restart, the last one of the process before
                self._core.use_delta(message)
            case Tick():
                yield from self._tick(message.now_ns)

    def _tick(self, now_ns: int) -> Iterator[Out]:
        if not self._described:
            self._described = True
            yield self._plaza.description(now_ns)
        yield from self._delta(now_ns, NO_FIX_NS)
        yield from self._core.tick(now_ns)
        yield from self._tracks(now_ns)

    def _delta(self, now_ns: int, period_ns: int) -> Iterator[TollDelta]:
        """Estimate the delta with a fix, not with a tick: it has to be there before the CAM that it belongs to."""
        if now_ns - self._delta_ns >= period_ns:
            self._delta_ns = now_ns
            delta = self._core.estimate_delta(now_ns)
            self._core.use_delta(delta)
            yield delta

    def _tracks(self, now_ns: int) -> Iterator[TollTracks]:
        if now_ns - self._tracks_ns >= TRACKS_NS:
            self._tracks_ns = now_ns
            yield self._core.tracks(now_ns)

"""Decodes the bytes of inertial measurement units to samples in body axes."""

from collections import Counter
from collections.abc import Iterator

from pydantic import Field

from shared.errors import ConfigError
from shared.kinds import Kinds
from shared.messages.base import Message
from shared.messages.imu import ImuRaw, ImuSamples
from shared.protocols.recognition import recognise
from shared.runtime.config import VehicleSettings, vehicle_in
from shared.runtime.old_keys import MOUNTING, in_section

from .decoder import Decoder, Stream
from .lines import LineForm, LineImu, UndescribedLines
from .protocols import DEFAULT_PROTOCOL, PROTOCOLS

MAX_SOURCES = 8
TEXT = "text lines"
MAX_UNKNOWN_BYTES = 4096  # without a protocol that is known


class Config(VehicleSettings):
    """Settings of the IMU parser; the mounting is `[vehicle.imu] body_from_sensor`."""

    minimum_delay_s: float = Field(
        default=0.003, ge=0.0, description="minimum delay from an inertial sample to its arrival"
    )
    line: LineForm | None = Field(
        default=None, description="form of the lines of an IMU that sends text; absent: its bytes are recognised"
    )

    def model_post_init(self, context: object) -> None:
        """Raise `ConfigError` for a mounting that no mount makes."""
        (a, b, c), (d, e, f), (g, h, i) = self.vehicle.imu.body_from_sensor
        if a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) < 0.0:  # determinant
            file = vehicle_in(context)
            raise ConfigError(
                f"{file.path if file else 'settings'}: {in_section(MOUNTING)} mirrors the axes, which no mount does: "
                "the third row must be the cross product of the first and the second"
            )


class Process:
    """One decoder per source; time is taken from the stamps of the messages only."""

    def __init__(self, config: Config) -> None:
        self.rejects: Counter[str] = Counter()
        self.kinds = Kinds()
        self._config = config
        self._decoders: dict[str, Decoder] = {}
        self._unknown: dict[str, bytes] = {}  # first bytes of sources that are not recognised yet

    def handle(self, message: Message) -> Iterator[ImuSamples]:
        """Process raw IMU bytes; other messages are ignored."""
        if not isinstance(message, ImuRaw):
            return
        source = message.source
        if source not in self._decoders:
            if source not in self._unknown and len(self._unknown) + len(self._decoders) >= MAX_SOURCES:
                self.rejects["too_many_sources"] += 1
                return
            data = self._unknown.pop(source, b"") + message.data
            if (decoder := self._recognised(source, data)) is None:
                self._unknown[source] = data
                return
            self._decoders[source] = decoder
            message = message.model_copy(update={"data": data})
        if (samples := self._decoders[source].take(message)) is not None:
            yield samples

    def _recognised(self, source: str, data: bytes) -> Decoder | None:
        """The decoder of a source by its first bytes; None while they may be the beginning of any."""
        stream = Stream(
            source, self._config.vehicle.imu.body_from_sensor, self._config.minimum_delay_s, self.rejects, self.kinds
        )
        found = recognise(data).names
        names = [name for name in found if name in PROTOCOLS]
        if names:
            return PROTOCOLS[names[0]](stream)
        if self._config.line is not None:
            return LineImu(stream, self._config.line)
        if TEXT in found:
            return UndescribedLines(stream)
        return PROTOCOLS[DEFAULT_PROTOCOL](stream) if len(data) >= MAX_UNKNOWN_BYTES else None

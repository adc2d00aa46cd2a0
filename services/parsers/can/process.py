"""Decodes vehicle and wheel speeds from CAN frames."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from pydantic import Field

from shared.errors import UserError
from shared.faults import Faults
from shared.messages.base import Message
from shared.messages.vehicle import CanRaw, VehicleSpeed, WheelSpeeds
from shared.runtime.config import Section

from .candump import CanFrame, LineReader
from .database import WheelSpeedDecoder
from .standards import StandardSpeeds

NS = 1_000_000_000
OLDEST_LINE_NS = 10 * NS
MAX_SOURCES = 8
REPOSITORY = Path(__file__).resolve().parents[3]


class WheelSignals(Section):
    """Name of the signal of each wheel in the DBC file."""

    front_left: str | None = Field(default=None, description="name of the signal of the front left wheel")
    front_right: str | None = Field(default=None, description="name of the signal of the front right wheel")
    rear_left: str | None = Field(default=None, description="name of the signal of the rear left wheel")
    rear_right: str | None = Field(default=None, description="name of the signal of the rear right wheel")


class Config(Section):
    """Settings of the CAN parser; without a DBC file there are no wheel speeds."""

    vehicle_speed_delay_s: float = Field(
        default=0.1, ge=0.0, description="delay of OBD-II and J1939 speeds from the wheels to the CAN bus"
    )
    wheel_speed_delay_s: float = Field(
        default=0.02, ge=0.0, description="delay of wheel speeds from the wheels to the CAN bus"
    )
    wheel_speed_period_s: float = Field(default=0.1, ge=0.0, description="minimum period of the published wheel speeds")
    dbc_file: Path | None = Field(
        default=None, description="path of the DBC file, relative to the working folder or to the repository"
    )
    wheel_speed_unit: str | None = Field(
        default=None, description="unit of the wheel-speed signals, if that of the DBC file is missing or wrong"
    )
    wheel_speed_signals: WheelSignals = Field(
        default=WheelSignals(), description="name of the wheel-speed signal of each wheel in the DBC file"
    )


class Process:
    """Decodes OBD-II and J1939 speeds by their standards, wheel speeds by the DBC file."""

    def __init__(self, config: Config) -> None:
        self.rejects: Counter[str] = Counter()
        self._faults = Faults(self.rejects)
        self._config = config
        self._readers: dict[str, LineReader] = {}
        self._standards = StandardSpeeds()
        self._decoder = self._load(config)

    def handle(self, message: Message) -> Iterator[VehicleSpeed | WheelSpeeds]:
        """Process a batch of candump lines; other messages are ignored."""
        if not isinstance(message, CanRaw):
            return
        if message.source not in self._readers and len(self._readers) >= MAX_SOURCES:
            self.rejects["too_many_sources"] += 1
            return
        for frame in self._readers.setdefault(message.source, LineReader(self.rejects)).feed(message.data):
            with self._faults.decoding(message.received_ns):
                yield from self._decoded(frame, message)

    def _decoded(self, frame: CanFrame, message: CanRaw) -> Iterator[VehicleSpeed | WheelSpeeds]:
        received_ns = self._received_ns(frame, message)
        # A file may hold the frames of several interfaces; those of the bus itself have its name.
        bus = message.source if frame.interface == message.source else f"{message.source}/{frame.interface}"
        if speed := self._standards.decode(frame):
            yield VehicleSpeed(
                sampled_ns=received_ns - round(self._config.vehicle_speed_delay_s * NS),
                received_ns=received_ns,
                source=f"{bus}/{speed.name}",
                speed_m_s=speed.speed_m_s,
                resolution_m_s=speed.resolution_m_s,
            )
        if self._decoder and (speeds := self._decoder.decode(frame, received_ns, bus)):
            yield WheelSpeeds(
                sampled_ns=received_ns - round(self._config.wheel_speed_delay_s * NS),
                received_ns=received_ns,
                source=bus,
                **{f"{wheel}_m_s": speed for wheel, speed in speeds.items()},
            )

    def _received_ns(self, frame: CanFrame, message: CanRaw) -> int:
        """Time stamp of a line if it is consistent with that of its batch, otherwise that of the batch."""
        if 0 <= message.received_ns - frame.time_ns < OLDEST_LINE_NS:
            return frame.time_ns
        self.rejects["line_stamp"] += 1
        return message.received_ns

    def _load(self, config: Config) -> WheelSpeedDecoder | None:
        if config.dbc_file is None:
            return None
        signals = {wheel: name for wheel, name in config.wheel_speed_signals if name}
        if not signals:
            raise UserError("[parsers.can] has a dbc_file and no wheel_speed_signals: name the signal of each wheel")
        try:
            path = config.dbc_file if config.dbc_file.exists() else REPOSITORY / config.dbc_file
            period_ns = round(config.wheel_speed_period_s * NS)
            text, unit = path.read_text(encoding="latin-1"), config.wheel_speed_unit
            return WheelSpeedDecoder(text, signals, period_ns, self.rejects, unit)
        except (OSError, ValueError) as error:
            raise UserError(
                f"[parsers.can] dbc_file = {str(config.dbc_file)!r}: {error}; correct the path or the file"
            ) from error

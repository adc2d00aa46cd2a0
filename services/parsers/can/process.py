"""Decodes vehicle and wheel speeds, and further signals, from CAN frames."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

from pydantic import Field

from shared import shipped
from shared.bounded import read_text
from shared.errors import UserError
from shared.faults import Faults
from shared.kinds import Kinds
from shared.messages.base import Message
from shared.messages.operation import MessageUse
from shared.messages.vehicle import CanRaw, VehicleSignal, VehicleSpeed, WheelSpeeds
from shared.runtime.config import Section

from .candump import ERROR_FRAME, REMOTE_FRAME, UNUSABLE, CanFrame, LineReader
from .database import DBC_BYTES, WHEELS, QuantitySignal, SignalDecoder, Value
from .standards import StandardSpeeds, standard_use

NS = 1_000_000_000
OLDEST_LINE_NS = 10 * NS
MAX_SOURCES = 8
MAX_SIGNALS = 32
MAX_IDENTIFIERS = 4096  # whose names are kept: more than a vehicle has
SPEED = "vehicle_speed"
Output = VehicleSpeed | WheelSpeeds | VehicleSignal


class WheelSignals(Section):
    """Name of the signal of each wheel in the DBC file."""

    front_left: str | None = Field(default=None, description="name of the signal of the front left wheel")
    front_right: str | None = Field(default=None, description="name of the signal of the front right wheel")
    rear_left: str | None = Field(default=None, description="name of the signal of the rear left wheel")
    rear_right: str | None = Field(default=None, description="name of the signal of the rear right wheel")


class NamedSignal(Section):
    """One quantity that is read from the DBC file."""

    signal: str = Field(description="name of the signal in the DBC file, or message.signal")
    unit: str | None = Field(default=None, description="unit of the signal, if that of the file is missing or wrong")
    scale: float | None = Field(
        default=None,
        ge=-1e9,
        le=1e9,
        description="factor from the file's value to the published unit, where the unit of the signal is unknown",
    )


SignalName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,31}$")]


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
    signal_period_s: float = Field(
        default=0.1, ge=0.0, description="minimum period of the published speed and signals of the DBC file"
    )
    signals: dict[SignalName, NamedSignal] = Field(
        default_factory=dict,
        max_length=MAX_SIGNALS,
        description="further quantities of the DBC file by name: vehicle_speed is published as vehicle/speed, others "
        "as vehicle/signal, in SI units for yaw_rate, steering_angle, steering_wheel_angle, acceleration_longitudinal, "
        "acceleration_lateral and odometer",
    )


class Process:
    """Decodes OBD-II and J1939 speeds by their standards, wheel speeds by the DBC file."""

    def __init__(self, config: Config) -> None:
        self.rejects: Counter[str] = Counter()
        self.kinds = Kinds()
        for kind in (ERROR_FRAME, REMOTE_FRAME):
            self.kinds.expect(kind, MessageUse.UNUSED)
        self.kinds.expect(UNUSABLE, MessageUse.UNKNOWN)
        self._rejects_before: Counter[str] = Counter()
        self._names: dict[tuple[int, bool], tuple[str, MessageUse]] = {}
        self._faults = Faults(self.rejects)
        self._config = config
        self._readers: dict[str, LineReader] = {}
        self._standards = StandardSpeeds(self.rejects)
        self._wheels = self._load(config, _wheels(config), config.wheel_speed_period_s)
        self._signals = self._load(config, _signals(config), config.signal_period_s)

    def handle(self, message: Message) -> Iterator[Output]:
        """Process a batch of candump lines; other messages are ignored."""
        if not isinstance(message, CanRaw):
            return
        if message.source not in self._readers and len(self._readers) >= MAX_SOURCES:
            self.rejects["too_many_sources"] += 1
            return
        for frame in self._readers.setdefault(message.source, LineReader(self.rejects, self.kinds)).feed(message.data):
            with self._faults.decoding(message.received_ns):
                yield from self._decoded(frame, message)

    def _decoded(self, frame: CanFrame, message: CanRaw) -> Iterator[Output]:
        kind, use = self._kind(frame)
        self.kinds.count(kind, use)
        if use is not MessageUse.USED:
            return
        before = self.rejects.total()
        yield from self._outputs(frame, message)
        if self.rejects.total() != before:
            new = self.rejects - self._rejects_before
            self._rejects_before = self.rejects.copy()
            self.kinds.reject(kind, next(reversed(new)))

    def _kind(self, frame: CanFrame) -> tuple[str, MessageUse]:
        """Name of a frame's identifier for the table of kinds, and what is done with it."""
        key = frame.identifier, frame.extended
        if (known := self._names.get(key)) is not None:
            return known
        decoders = [decoder for decoder in (self._wheels, self._signals) if decoder]
        name = next((name for decoder in decoders if (name := decoder.name_of(frame))), None)
        use = MessageUse.USED if any(decoder.uses(frame) for decoder in decoders) else standard_use(frame)
        digits = f"{frame.identifier:08X}" if frame.extended else f"{frame.identifier:03X}"
        kind = f"CAN {digits}{f' {name}' if name else ''}"[:64]
        known = kind, use or (MessageUse.UNUSED if name else MessageUse.UNKNOWN)
        if len(self._names) < MAX_IDENTIFIERS:
            self._names[key] = known
        return known

    def _outputs(self, frame: CanFrame, message: CanRaw) -> Iterator[Output]:
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
        if self._standards.vin:
            yield VehicleSignal(
                sampled_ns=received_ns, received_ns=received_ns, source=bus, name="vin", text=self._standards.vin
            )
        if self._wheels and (speeds := self._wheels.decode(frame, received_ns, bus)):
            yield WheelSpeeds(
                sampled_ns=received_ns - round(self._config.wheel_speed_delay_s * NS),
                received_ns=received_ns,
                source=_named(bus, self._wheels, frame),
                **{f"{speed.name}_m_s": speed.value for speed in speeds},
            )
        if self._signals:
            for value in self._signals.decode(frame, received_ns, bus):
                yield self._signal(value, received_ns, _named(bus, self._signals, frame))

    def _signal(self, value: Value, received_ns: int, source: str) -> Output:
        sampled_ns = received_ns - round(self._config.wheel_speed_delay_s * NS)
        if value.name == SPEED:
            return VehicleSpeed(
                sampled_ns=sampled_ns, received_ns=received_ns, source=f"{source}/dbc", speed_m_s=value.value,
                resolution_m_s=value.resolution,
            )  # fmt: skip
        return VehicleSignal(
            sampled_ns=sampled_ns, received_ns=received_ns, source=source, name=value.name, value=value.value,
            unit=value.unit,
        )  # fmt: skip

    def _received_ns(self, frame: CanFrame, message: CanRaw) -> int:
        """Time stamp of a line if it is consistent with that of its batch, otherwise that of the batch."""
        if 0 <= message.received_ns - frame.time_ns < OLDEST_LINE_NS:
            return frame.time_ns
        self.rejects["line_stamp"] += 1
        return message.received_ns

    def _load(self, config: Config, wanted: list[QuantitySignal], period_s: float) -> SignalDecoder | None:
        if config.dbc_file is None or not wanted:
            return None
        try:
            path = shipped(config.dbc_file)
            return SignalDecoder(read_text(path, DBC_BYTES, "latin-1"), wanted, round(period_s * NS), self.rejects)
        except (OSError, ValueError) as error:
            raise UserError(
                f"[parsers.can] dbc_file = {str(config.dbc_file)!r}: {error}; correct the path, the name or the file"
            ) from error


def _named(bus: str, decoder: SignalDecoder, frame: CanFrame) -> str:
    """Name of the source: senders of one parameter group are told apart by their address."""
    address = decoder.other_sender(frame)
    return bus if address is None else f"{bus}/{address:02X}"


def _wheels(config: Config) -> list[QuantitySignal]:
    """The wheels of the DBC file; raises `UserError` for a file that nothing is read from, and the reverse."""
    wheels = [
        QuantitySignal(wheel, name, config.wheel_speed_unit) for wheel, name in config.wheel_speed_signals if name
    ]
    if config.dbc_file is not None and not wheels and not config.signals:
        raise UserError(
            "[parsers.can] has a dbc_file and neither wheel_speed_signals nor signals: name the signal of each wheel"
        )
    if config.dbc_file is None and (wheels or config.signals):
        raise UserError("[parsers.can] names signals and no dbc_file: state the path of the file as dbc_file")
    return wheels


def _signals(config: Config) -> list[QuantitySignal]:
    """The named quantities of the DBC file; raises `UserError` for the name of a wheel."""
    if wheel := next((name for name in config.signals if name in WHEELS), None):
        raise UserError(f"[parsers.can.signals] {wheel}: write the signals of wheels into wheel_speed_signals")
    return [QuantitySignal(name, signal.signal, signal.unit, signal.scale) for name, signal in config.signals.items()]

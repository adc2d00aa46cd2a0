"""What every message on the bus has in common."""

from binascii import a2b_base64, b2a_base64
from typing import Annotated, ClassVar, cast

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PlainSerializer, ValidationInfo, WithJsonSchema
from pydantic.fields import FieldInfo

from ..maths.dates import END_DATE_NS


def unit(name: str) -> FieldInfo:
    """Name the unit of a number whose field does not end in it; "1" is that of counts and ratios."""
    return cast(FieldInfo, Field(json_schema_extra={"unit": name}))


# What no sensor on Earth can say, and a sum or a square of which is still a number: the bounds of every number on the
# bus, by its unit. A process may compute with whatever the contract lets through.
MAX_VALUE = 1e9  # of a quantity, in its unit
MAX_DURATION_S = 1e10  # of a duration: since 1970, and more
MAX_SQUARE = 1e18
MAX_STATISTIC = 1e30  # of a test, which divides by the square of a small standard deviation
MAX_COUNT = 2**53  # the last that a float holds exactly


def _within(largest: float) -> FieldInfo:
    return cast(FieldInfo, Field(ge=-largest, le=largest))


Count = Annotated[int, Field(ge=0, le=MAX_COUNT), unit("1")]
Bytes = Annotated[int, Field(ge=0, le=MAX_COUNT)]
Ratio = Annotated[float, _within(MAX_VALUE), unit("1")]
Statistic = Annotated[float, _within(MAX_STATISTIC)]  # with a unit of its own
Quantity = Annotated[float, _within(MAX_VALUE)]  # its unit ends the name of its field
Seconds = Annotated[float, _within(MAX_DURATION_S)]
Square = Annotated[float, _within(MAX_SQUARE)]
Vector3 = tuple[Quantity, Quantity, Quantity]
# Upper triangle of a symmetric 3x3 matrix, row by row: NN NE ND EE ED DD.
Symmetric3 = tuple[Square, Square, Square, Square, Square, Square]
Latitude = Annotated[float, Field(ge=-90.0, le=90.0)]
Longitude = Annotated[float, Field(ge=-180.0, le=180.0)]
# Wide enough for every field of UBX.
Height = Annotated[float, _within(1e7)]
Speed = Annotated[float, _within(1e7)]
Deviation = Annotated[float, Field(ge=0.0, le=MAX_VALUE)]
Velocity3 = tuple[Speed, Speed, Speed]
Deviation3 = tuple[Deviation, Deviation, Deviation]
# A stamp in ns since 1970 on the OBU time line, or since 1980 by GPS: up to 2100, and differences of two fit 64 bits.
# Live, one before 1980 is rejected as well; the clock of a recorded file may begin at zero, less a delay.
Nanoseconds = Annotated[int, Field(gt=-END_DATE_NS, lt=END_DATE_NS)]
Integer = Annotated[int, Field(ge=-(2**63), lt=2**63)]
Name = Annotated[str, Field(max_length=64)]
# Parsers append what they read it from, such as "/nmea", and the result is a `Name`.
DEVICE_NAME_LENGTH = 48
DeviceName = Annotated[str, Field(max_length=DEVICE_NAME_LENGTH)]
Reason = Annotated[str, Field(max_length=400)]


def _from_base64(value: object, info: ValidationInfo) -> object:
    return a2b_base64(value, strict_mode=True) if info.mode == "json" and isinstance(value, str) else value


def _to_base64(value: bytes) -> str:
    return b2a_base64(value, newline=False).decode()


Base64 = Annotated[
    bytes,
    Field(max_length=1 << 19),
    BeforeValidator(_from_base64),
    PlainSerializer(_to_base64, return_type=str, when_used="json"),
    WithJsonSchema({"type": "string", "contentEncoding": "base64"}),
]


class Message(BaseModel):
    """A frozen, strictly typed record; unknown fields of a newer producer are ignored.

    The validator of a type is built when it is first used: a process uses a few of them.
    """

    model_config = ConfigDict(frozen=True, strict=True, allow_inf_nan=False, extra="ignore", defer_build=True)


class Persistent(Message):
    """A message whose newest one outlives a power-off; the runtime notes the boot in which it was saved."""

    boot: Annotated[Name | None, Field(exclude_if=lambda value: value is None)] = None  # of the host, in the saved file
    earlier_life: Annotated[bool, Field(exclude_if=lambda value: not value)] = False  # restored from an earlier boot


class Sender(Message):
    """Process, incarnation and sequence number of a message: the field `sender` of every payload on the bus."""

    process: Name
    incarnation: Annotated[Nanoseconds, unit("ns")]  # start of the process on the OBU time line
    sequence: Count
    recorded_ns: Nanoseconds | None = None  # arrival at the recorder, of a message that is replayed


class StampedMessage(Message):
    """A measurement with its two stamps on the OBU time line."""

    sampled_ns: Nanoseconds  # when the value was true
    received_ns: Nanoseconds  # when its bytes arrived at the driver
    source: Name  # which device


class RawBytes(Message):
    """Bytes of a device as they are; base64 in JSON."""

    is_stream: ClassVar[bool] = False  # whether it may be cut anywhere, as what a serial port gives
    received_ns: Nanoseconds
    source: DeviceName
    data: Base64


class Tick(Message):
    """The passage of time, given by the runtime; not on the bus."""

    now_ns: Nanoseconds

"""What every message on the bus has in common."""

from binascii import a2b_base64, b2a_base64
from typing import Annotated, ClassVar, cast

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PlainSerializer, ValidationInfo, WithJsonSchema
from pydantic.fields import FieldInfo


def unit(name: str) -> FieldInfo:
    """Name the unit of a number whose field does not end in it; "1" is that of counts and ratios."""
    return cast(FieldInfo, Field(json_schema_extra={"unit": name}))


Count = Annotated[int, unit("1")]
Ratio = Annotated[float, unit("1")]
Vector3 = tuple[float, float, float]
# Upper triangle of a symmetric 3x3 matrix, row by row: NN NE ND EE ED DD.
Symmetric3 = tuple[float, float, float, float, float, float]
Latitude = Annotated[float, Field(ge=-90.0, le=90.0)]
Longitude = Annotated[float, Field(ge=-180.0, le=180.0)]
# What no sensor on Earth can say, but hostile bytes can; wide enough for every field of UBX.
Height = Annotated[float, Field(ge=-1e7, le=1e7)]
Speed = Annotated[float, Field(ge=-1e7, le=1e7)]
Deviation = Annotated[float, Field(ge=0.0, le=1e9)]
Velocity3 = tuple[Speed, Speed, Speed]
Deviation3 = tuple[Deviation, Deviation, Deviation]
LARGEST_NS = 2**63
Nanoseconds = Annotated[int, Field(ge=-LARGEST_NS, lt=LARGEST_NS)]
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


class Sender(Message):
    """Process, incarnation and sequence number of a message: the field `sender` of every payload on the bus."""

    process: Name
    incarnation: Annotated[Nanoseconds, unit("ns")]  # start of the process on the OBU time line
    sequence: Annotated[Count, Field(ge=0, lt=LARGEST_NS)]
    recorded_ns: Nanoseconds | None = None  # arrival at the recorder, of a message that is replayed


class Stamped(Message):
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

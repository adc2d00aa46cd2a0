"""Encodes and decodes Xbus, the wire format of Xsens motion trackers: messages, and the fields of MTData2.

A message is FA, bus id FF, message id, length (FF: two more bytes of length follow), payload, and a
checksum that makes the sum of all bytes after FA a multiple of 256. All numbers are big-endian.
Source: Xsens, "MT Low Level Communication Protocol Documentation", chapters 2 and 5.3.
"""

import re
import struct
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from itertools import accumulate
from operator import itemgetter
from typing import NamedTuple

from .framing.finder import FrameFinder, Sums
from .framing.framing import Framing
from .protocol import Protocol, Question, Reason

HEADER = b"\xfa\xff"
LONG = 0xFF  # in place of the length, which follows in two bytes
MTDATA2 = 0x36
KNOWN_MESSAGES = {
    0x00: "0x00", 0x01: "DeviceID", 0x0D: "ProductCode", 0x13: "FirmwareRev", 0x31: "GotoConfigAck",
    0x11: "GotoMeasurementAck", 0x32: "MTData", 0x3E: "WakeUp", 0x42: "Error", 0xC1: "OutputConfiguration",
}  # fmt: skip
MAX_PAYLOAD_BYTES = 2048
MAX_FIELDS = 64  # of a measurement

# Data identifiers without their format bits: the low two bits are the number format
# (0 float32, 1 fixed 12.20, 2 fixed 16.32, 3 float64), the next two the reference frame.
TEMPERATURE = 0x0810  # [°C]
PACKET_COUNTER = 0x1020
SAMPLE_TIME_FINE = 0x1060  # [100 µs]
SAMPLE_TIME_COARSE = 0x1070  # [s]
QUATERNION = 0x2010
EULER_ANGLES = 0x2030  # [deg]
BARO_PRESSURE = 0x3010  # [Pa]
DELTA_V = 0x4010  # [m/s]
ACCELERATION = 0x4020  # [m/s²] specific force
RATE_OF_TURN = 0x8020  # [rad/s]
DELTA_Q = 0x8030
MAGNETIC_FIELD = 0xC020  # [-] normalised to the field at the place of calibration
STATUS_BYTE = 0xE010
STATUS_WORD = 0xE020

CLIPPED = 0x3F << 8  # bits 8 to 13 of the status word: accelerometer and gyroscope x, y, z

_INTEGERS = {
    PACKET_COUNTER: ">H",
    SAMPLE_TIME_FINE: ">I",
    SAMPLE_TIME_COARSE: ">I",
    BARO_PRESSURE: ">I",
    STATUS_BYTE: ">B",
    STATUS_WORD: ">I",
}
_REALS = {
    TEMPERATURE: 1,
    QUATERNION: 4,
    EULER_ANGLES: 3,
    DELTA_V: 3,
    ACCELERATION: 3,
    RATE_OF_TURN: 3,
    DELTA_Q: 4,
    MAGNETIC_FIELD: 3,
}
_SIZES = (4, 4, 6, 8)  # bytes of a number in each format


class XbusMessage(NamedTuple):
    """One message with a valid checksum."""

    mid: int
    payload: bytes


def encode_message(mid: int, payload: bytes) -> bytes:
    """Frame a payload; raises ValueError above `MAX_PAYLOAD_BYTES`."""
    if len(payload) > MAX_PAYLOAD_BYTES:
        raise ValueError(f"a payload of {len(payload)} bytes exceeds {MAX_PAYLOAD_BYTES}")
    size = bytes([len(payload)]) if len(payload) < 255 else struct.pack(">BH", 255, len(payload))
    body = bytes([0xFF, mid]) + size + payload
    return b"\xfa" + body + bytes([-sum(body) & 0xFF])


def encode_mtdata2(fields: Mapping[int, bytes]) -> bytes:
    """Frame a measurement: data identifier (with format bits) -> data."""
    return encode_message(MTDATA2, b"".join(struct.pack(">HB", i, len(data)) + data for i, data in fields.items()))


def encode_field(data_id: int, *values: float) -> bytes:
    """Encode the data of one field in the number format given by its identifier.

    Parameters
    ----------
    data_id : int
        Data identifier with its format bits, such as ``ACCELERATION`` (float32) or ``ACCELERATION | 1``.
    *values : float
        The numbers of the field, in its unit.

    Returns
    -------
    bytes
        The data, as an input of `encode_mtdata2`.

    Raises
    ------
    ValueError
        The identifier is unknown, the count is wrong, or a value is out of range of the format.
    """
    kind = data_id & 0xFFF0
    try:
        if kind in _INTEGERS:
            return struct.pack(_INTEGERS[kind], *(int(value) for value in values))
        if _REALS.get(kind) != len(values):
            raise ValueError(f"field {data_id:#06x} cannot hold {len(values)} numbers")
        return b"".join(_encode_real(value, data_id & 3) for value in values)
    except (struct.error, OverflowError) as error:
        raise ValueError(f"field {data_id:#06x}: {error}") from error


def _encode_real(value: float, number_format: int) -> bytes:
    if number_format == 1:
        return struct.pack(">i", round(value * 2**20))
    if number_format == 2:  # the 32 bits of the fraction go first
        scaled = round(value * 2**32)
        return struct.pack(">Ih", scaled & 0xFFFFFFFF, scaled >> 32)
    return struct.pack(">f" if number_format == 0 else ">d", value)


def split_mtdata2(payload: bytes) -> Iterator[tuple[int, bytes]]:
    """Split a measurement into (data identifier, data); raises ValueError at a truncated field."""
    position = 0
    while position < len(payload):
        if position + 3 > len(payload) or position + 3 + payload[position + 2] > len(payload):
            raise ValueError(f"truncated field at byte {position}")
        data_id, size = struct.unpack_from(">HB", payload, position)
        yield data_id, payload[position + 3 : position + 3 + size]
        position += 3 + size


def decode_mtdata2(payload: bytes, rejects: Counter[str]) -> dict[int, tuple[float, ...]]:
    """Decode all known fields of a measurement.

    Parameters
    ----------
    payload : bytes
        Payload of an MTData2 message.
    rejects : Counter
        Counts ``bad_field`` for a field of the wrong size and ``cut_field`` for a truncated one. Unknown fields
        are skipped.

    Returns
    -------
    dict
        Data identifier without format bits -> its numbers, NaN and infinity of the device included.
    """
    form = _layouts.get(len(payload))
    if form is not None:
        numbers = form.layout.unpack(payload)
        if form.heads(numbers) == form.expected:
            return {kind: numbers[start:stop] for kind, start, stop in form.fields}
    values: dict[int, tuple[float, ...]] = {}
    faults = rejects.total()
    try:
        for data_id, data in split_mtdata2(payload):
            kind = data_id & 0xFFF0
            if kind not in _INTEGERS and kind not in _REALS:
                continue
            try:
                values[kind] = decode_field(data_id, data)
            except ValueError:
                rejects["bad_field"] += 1
    except ValueError:
        rejects["cut_field"] += 1
    if rejects.total() == faults:
        _cache_layout(payload)
    return values


class _FieldLayout(NamedTuple):
    """Cached field layout of a measurement of one length, since a tracker always sends the same fields."""

    layout: struct.Struct
    heads: Callable[[tuple[float, ...]], tuple[float, ...]]
    expected: tuple[float, ...]
    fields: tuple[tuple[int, int, int], ...]  # data identifier, first number, number after the last


_layouts: dict[int, _FieldLayout] = {}  # by payload length, hence bounded
MAX_NUMBERS = 64


def _cache_layout(payload: bytes) -> None:
    """Cache the layout of a valid measurement if it has two or more fields and none needs scaling."""
    code, count = ">", 0
    heads: list[int] = []
    fields: list[tuple[int, int, int]] = []
    for data_id, data in split_mtdata2(payload):
        heads += count, count + 1
        count += 2
        kind = data_id & 0xFFF0
        if kind not in _INTEGERS and kind not in _REALS:
            code += f"HB{len(data)}x"
            continue
        layout, scale = _layout(data_id)
        if scale != 1:
            return
        code += "HB" + layout.format.removeprefix(">")
        fields.append((kind, count, count + len(layout.unpack(data))))
        count = fields[-1][2]
    if len(heads) > 2 and count <= MAX_NUMBERS:
        form = struct.Struct(code)
        pick = itemgetter(*heads)
        _layouts[len(payload)] = _FieldLayout(form, pick, pick(form.unpack(payload)), tuple(fields))


def decode_field(data_id: int, data: bytes) -> tuple[float, ...]:
    """Decode the numbers of one field; raises ValueError for an unknown identifier or a wrong size."""
    layout, scale = _layout(data_id)
    if len(data) != layout.size:
        raise ValueError(f"field {data_id:#06x} has {len(data)} bytes, not {layout.size}")
    numbers: tuple[float, ...] = layout.unpack(data)
    if scale == 1:
        return numbers
    if scale == 2**20:
        return tuple(number / scale for number in numbers)
    return tuple(whole + fraction / scale for fraction, whole in zip(numbers[::2], numbers[1::2], strict=True))


@cache
def _layout(data_id: int) -> tuple[struct.Struct, int]:
    kind, number_format = data_id & 0xFFF0, data_id & 3
    if kind in _INTEGERS:
        return struct.Struct(_INTEGERS[kind]), 1
    if kind not in _REALS:
        raise ValueError(f"field {data_id:#06x} is unknown")
    codes: Sequence[tuple[str, int]] = (("f", 1), ("i", 2**20), ("Ih", 2**32), ("d", 1))
    code, scale = codes[number_format]
    return struct.Struct(">" + code * _REALS[kind]), scale


class XbusFraming(Framing):
    """Preamble, bus, kind, length in one byte or three, payload, checksum."""

    protocol, begins = "Xbus", ((HEADER[:1], HEADER[1:]),)
    starts = rb"\xfa\xff(?s:.)(?:[\x00-\xfe]|\xff[\x00-\x08](?s:.))"
    begun = rb"\xfa(?:\xff(?:(?s:.)(?:\xff[\x00-\x08]?)?)?)?"
    malformed = too_long = bad_header = "oversize"
    most_bytes = MAX_PAYLOAD_BYTES + 7

    def size(self, buffer: bytes | bytearray, start: int, header: int) -> int | None:
        """By the length in the header; 0 where the longer form states too much."""
        if header < 4 or (buffer[start + 3] == LONG and header < 6):
            return None
        if buffer[start + 3] < LONG:
            return buffer[start + 3] + 5
        size = buffer[start + 4] << 8 | buffer[start + 5]
        return size + 7 if size <= MAX_PAYLOAD_BYTES else 0

    def fault(self, buffer: bytes | bytearray, start: int, stop: int, at: Callable[[int], Sums]) -> str | None:
        """Compare the sum of all bytes behind the preamble, which is 0."""
        return "bad_checksum" if at(stop)[0] - at(start)[0] - HEADER[0] & 0xFF else None


FRAMING = XbusFraming()


class XbusReader(FrameFinder[XbusMessage]):
    """Extracts the messages from a byte stream that may hold invalid bytes; see `FrameFinder`.

    `rejects` counts `garbage_bytes`, `bad_checksum`, `oversize` and `cut_message`. Inside an incomplete message only a
    measurement with complete fields takes precedence: an 8-bit checksum alone is too weak.
    """

    starts = re.compile(FRAMING.starts + rb"|(?:" + FRAMING.begun + rb")\Z")
    malformed, kinds = FRAMING.sync, FRAMING.malformed_beginnings
    most_bytes = MAX_PAYLOAD_BYTES
    cut = "cut_message"

    def __init__(self, rejects: Counter[str] | None = None) -> None:
        super().__init__(rejects)
        self._s = [0]  # running sum of the bytes

    def feed(self, data: bytes) -> list[XbusMessage]:
        """Process the next bytes; return the completed messages."""
        if not self._buffer and (message := _only(data)) is not None:
            return [message]
        return super().feed(data)

    def _sum(self, data: bytes) -> None:
        self._s = list(accumulate(data, initial=self._s[0]))

    def _sums(self, index: int) -> Sums:
        return (self._s[index],)

    def _carry(self, index: int) -> None:
        self._s = [self._s[index] & 0xFF]

    def _size(self, start: int, match: re.Match[bytes]) -> int | None:
        size = FRAMING.size(self._buffer, start, match.end() - start)
        if size == 0:
            self._reject(start, FRAMING.bad_header)
        return size

    def _frame(self, start: int, stop: int, sums: Sums | None) -> XbusMessage | None:
        shift = self._base - self._summed_from
        at = lambda index: sums if index == start and sums else self._sums(index + shift)  # noqa: E731
        if fault := FRAMING.fault(self._buffer, start, stop, at):
            self._reject(start, fault)
            return None
        return XbusMessage(self._buffer[start + 2], bytes(self._buffer[self._payload_start(start) : stop - 1]))

    def _payload_start(self, start: int) -> int:
        return start + (6 if self._buffer[start + 3] == LONG else 4)

    def _sure(self, start: int, stop: int) -> bool:
        """Whether it is a measurement with complete fields, of which a tracker sends no more than `MAX_FIELDS`."""
        if self._buffer[start + 2] != MTDATA2:
            return False
        position, stop = self._payload_start(start), stop - 1
        for _ in range(MAX_FIELDS):
            if position + 3 > stop:
                break
            position += 3 + self._buffer[position + 2]
        return position == stop


def _only(data: bytes) -> XbusMessage | None:
    """The message if these bytes are exactly one valid message (the usual case), otherwise None."""
    whole = len(data) > 4 and data.startswith(HEADER) and data[3] == len(data) - 5 < LONG and not sum(data[1:]) & 0xFF
    return XbusMessage(data[2], data[4:-1]) if whole else None


_CONFIGURE = "switch it on with MT Manager, or by SetOutputConfiguration"
PROTOCOL = Protocol(
    FRAMING, "Xsens Xbus", frozenset(("imu",)),
    # GotoConfig, since a tracker that measures does not answer to anything else, and GotoMeasurement.
    questions={"imu": Question(encode_message(0x30, b""), encode_message(0x10, b""))},
    reasons={
        "bad_checksum": Reason("an Xbus message with a wrong checksum",
                               "check ground and cable, and that the rate of the port carries what is sent"),
        "oversize": Reason("an Xbus header with a length beyond 2048 bytes, mostly damage", "as bad_checksum"),
        "cut_message": Reason("an Xbus message without its end", "as bad_checksum"),
        "cut_field": Reason("a measurement that ends within a field", "bring the tracker's firmware up to date"),
        "bad_field": Reason("a field of another length than its kind has", "bring the tracker's firmware up to date"),
        "packet_gap": Reason("measurements that were lost", "check the rate of the port against the output rate"),
        "counter_restart": Reason("a tracker that started again", "check its supply"),
        "no_sample_time": Reason("measurements without SampleTimeFine", _CONFIGURE),
        "no_acceleration": Reason("measurements without acceleration or delta-v", _CONFIGURE),
        "no_rate_of_turn": Reason("measurements without rate of turn or delta-q", _CONFIGURE),
        "no_acceleration_and_rate_of_turn": Reason("a unit that is set to send orientation alone", _CONFIGURE),
    },
)  # fmt: skip

"""The inertial sensors inside u-blox receivers: UBX-ESF-RAW to samples.

The receiver's parser passes these frames on, as bytes of the source `<receiver>/imu`.

Source: u-blox F9 HPS 1.30 interface description (UBX-22010984), UBX-ESF-RAW and the table of its data types. The
unit of its time tag is not stated: it is found out by the arrivals.
"""

import math
import struct

from shared.messages.imu import ImuRaw, ImuSamples
from shared.messages.operation import MessageUse
from shared.protocols.framing.framer import Framer
from shared.protocols.registry import BY_NAME

from .decoder import Batch, Decoder, SampleError, Stream

ESF_RAW = b"\x10\x03"  # class and number
KIND = "UBX ESF-RAW"
GYROSCOPE = {14: 0, 13: 1, 5: 2}  # axis of each data type
ACCELEROMETER = {16: 0, 17: 1, 18: 2}
DEG_S, M_S2 = 2.0**-12, 2.0**-10  # [deg/s, m/s²] of a digit
TAG_WRAP = 1 << 32
LEARNING_NS = 3_000_000_000  # over which the unit of the time tag is found out
TICKS_S = (1e-3, 25.6e-6, 1 / 65536, 1e-6, 1e-4)  # units in use, of which one within 3 % is taken
RATE_TOLERANCE = 0.03
_DATA = struct.Struct("<II")


class ReceiverImu(Decoder):
    """Groups accelerations and rates by their time tag.

    `rejects` counts those of the framing, `ubx_short`, `incomplete_sample`, `not_finite`, `out_of_range`.
    """

    def __init__(self, stream: Stream) -> None:
        super().__init__(stream)
        self._framer = Framer((BY_NAME["UBX"].framing,), stream.rejects)
        self._tag: int | None = None  # unwrapped
        self._first: tuple[int, int] | None = None  # tag and arrival [ns] since which the unit is being found out
        self._tick_s: float | None = None

    def take(self, raw: ImuRaw) -> ImuSamples | None:
        """Process the next bytes; None while the unit of the time tag is not known."""
        batch = Batch()
        for frame in self._framer.feed(raw.data):
            if frame.data[2:4] == ESF_RAW:
                with self.faults.decoding(raw.received_ns):
                    self._take(batch, frame.data[6:-2], raw.received_ns)
        return self.samples(batch, raw.received_ns) if batch.device_ns else None

    def _take(self, batch: Batch, payload: bytes, received_ns: int) -> None:
        try:
            if len(payload) < 4 or len(payload) % 8 != 4:
                raise SampleError("ubx_short")
            groups: dict[int, dict[int, int]] = {}
            for data, tag in _DATA.iter_unpack(payload[4:]):
                groups.setdefault(tag, {})[data >> 24] = _signed(data & 0xFFFFFF)
            for tag, values in groups.items():
                self._add(batch, tag, values, received_ns)
        except SampleError as fault:
            self.count(KIND, MessageUse.USED, fault)
        else:
            self.count(KIND, MessageUse.USED)

    def _add(self, batch: Batch, tag: int, values: dict[int, int], received_ns: int) -> None:
        rate, force = [math.nan] * 3, [math.nan] * 3
        for kind, axis in GYROSCOPE.items():
            if kind in values:
                rate[axis] = math.radians(values[kind] * DEG_S)
        for kind, axis in ACCELEROMETER.items():
            if kind in values:
                force[axis] = values[kind] * M_S2
        if not all(map(math.isfinite, (*rate, *force))):
            raise SampleError("incomplete_sample")
        step = 0 if self._tag is None else (tag - self._tag) % TAG_WRAP
        if self._tag is not None and step == 0:
            raise SampleError("repeated_sample")
        if self._tag is None or step >= TAG_WRAP // 2:
            self._tag, self._first, self._tick_s = tag, None, None
        else:
            self._tag += step
        tick_s = self._unit(received_ns)
        if tick_s is not None:
            self.add(batch, round(self._tag * tick_s * 1e9), force, rate)

    def _unit(self, received_ns: int) -> float | None:
        """Unit of the time tag [s]: what the arrivals say, or the one in use that is next to it."""
        if self._tick_s is None and self._tag is not None:
            first_tag, first_ns = self._first = self._first or (self._tag, received_ns)
            if received_ns - first_ns >= LEARNING_NS and self._tag > first_tag:
                found = (received_ns - first_ns) * 1e-9 / (self._tag - first_tag)
                near = min(TICKS_S, key=lambda tick_s: abs(tick_s / found - 1.0))
                self._tick_s = near if abs(near / found - 1.0) < RATE_TOLERANCE else found
        return self._tick_s


def _signed(value: int) -> int:
    return value - (1 << 24) if value >> 23 else value

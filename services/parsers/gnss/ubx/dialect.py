"""Decodes the UBX frames of one receiver."""

from collections.abc import Iterator
from functools import cache

from pyubx2.ubxtypes_core import UBX_MSGIDS

from shared.maths.clock_mapping import ClockMapping
from shared.maths.dates import WEEK_NS
from shared.messages.gnss import (
    GnssNavigationBits,
    GnssRawEpoch,
    GnssSatellites,
    GnssSignalQuality,
    GnssSignals,
)
from shared.messages.imu import ImuRaw
from shared.messages.operation import MessageUse
from shared.messages.vehicle import VehicleSpeed

from ..dialect import Dialect, Output, Stream
from ..gnss_time import MS, Unwrapper
from ..lateness import MAX_DELAY_S, with_lateness
from . import messages, raw, signal
from .configuration import ANSWERS, UbxDialogue
from .epoch import DECODERS, Epoch, EpochAssembler, fix_from_epoch
from .wheel_ticks import WheelTicks

PART_AGE_NS = 1_500_000_000  # between a part of the signal quality and the next fix; at 1 Hz it is up to one second
SAME_EPOCH_MS = 12  # times of week of one epoch are closer: RXM-RAWX has the receiver's own clock
USED_MESSAGES = frozenset(
    (
        *(f"NAV-{kind}" for kind in (*DECODERS, "EOE", "SAT", "SIG")), *(f"RXM-{kind}" for kind in raw.KINDS),
        *signal.FIELDS, *ANSWERS,
    )
)  # fmt: skip

OfEpoch = GnssSatellites | GnssSignals | GnssRawEpoch


class UbxDialect(Dialect):
    """Fixes, satellites, signals, raw measurements, and the answers to a configuration."""

    name = "UBX"
    positions = (
        frozenset(("NAV-PVT",)), frozenset(("NAV-PVAT",)), frozenset(("NAV-SOL",)),
        frozenset(("NAV-POSLLH", "NAV-STATUS")),
    )  # fmt: skip

    def __init__(self, stream: Stream) -> None:
        super().__init__(stream)
        self.dialogue = UbxDialogue(stream.source)
        self._epochs = EpochAssembler(stream.rejects)
        self._wheels = WheelTicks(stream.metres_per_wheel_tick)
        self._week, self._clock = Unwrapper(WEEK_NS), ClockMapping(stream.minimum_delay_s, longest_delay_s=MAX_DELAY_S)
        # Time of week [ms] and message, pending until the fix of their epoch is stamped; at most one of each kind.
        self._waiting: dict[type[OfEpoch], tuple[int, OfEpoch]] = {}
        self._signal: dict[str, tuple[int, signal.Part]] = {}  # of this epoch, each with its arrival [ns]
        self._resets = 0  # of the clock mapping, published already
        self._last_stamp: tuple[int, int] | None = None  # time of week [ms] and time stamp [ns] of the newest fix

    def payload(self, frame: bytes) -> bytes:
        """What lies between header and checksum."""
        return frame[6:-2]

    def kind(self, frame: bytes) -> str:
        """Name by class and number, in hexadecimal where they are unknown."""
        return _name(frame[2], frame[3])

    def use(self, kind: str) -> MessageUse:
        """Unknown is what the interface description does not list."""
        of_vehicle = (kind == "ESF-RAW" and self.stream.uses_imu) or kind == "ESF-MEAS"
        if kind in USED_MESSAGES or of_vehicle:
            return MessageUse.USED
        return MessageUse.UNUSED if kind in _known() else MessageUse.UNKNOWN

    def take(self, frame: bytes, received_ns: int) -> Iterator[Output]:
        """Decode a frame; of NAV-STATUS both the kind of fix and the interference are used."""
        kind, payload = self.kind(frame), self.payload(frame)
        if kind in signal.FIELDS:
            yield from self._take_signal(kind, payload, received_ns)
        group, _, name = kind.partition("-")
        if group == "RXM":
            yield from self._take_raw(name, payload, received_ns)
        elif group == "NAV" and name in ("SAT", "SIG"):
            itow = messages.itow_ms(payload)
            decoded = self._satellites(payload, received_ns) if name == "SAT" else self._signals(payload, received_ns)
            yield from self._stamped(itow, decoded)
        elif group == "ESF":
            yield from self._take_vehicle(name, frame, received_ns)
        elif group == "NAV" and name in messages.SIZES:
            for epoch in tuple(self._epochs.take(name, payload, received_ns)):
                with self.stream.faults.decoding(received_ns):  # a fault in one costs not the present message
                    yield from self._fix(epoch)

    def _fix(self, epoch: Epoch) -> Iterator[Output]:
        if (told := epoch.fix()) is None:
            return
        stream = self.stream
        stream.fix_ns = epoch.last_received_ns
        sampled_ns = self._clock.stamp(self._week.unwrap(epoch.itow_ms * MS), epoch.first_received_ns)
        self._last_stamp = epoch.itow_ms, sampled_ns
        fix = fix_from_epoch(epoch, told, sampled_ns=sampled_ns, source=stream.source, dates=stream.dates)
        yield with_lateness(fix, self._clock)
        yield from self._signal_quality(sampled_ns, epoch.last_received_ns, of_fix=True)
        for kind, (itow, message) in list(self._waiting.items()):
            if _same_epoch(itow, epoch.itow_ms):
                del self._waiting[kind]
                yield message.model_copy(update={"sampled_ns": sampled_ns})

    def _take_vehicle(self, kind: str, frame: bytes, received_ns: int) -> Iterator[Output]:
        """Pass inertial data on to the parser of the IMU, and turn wheel ticks into the speed of the vehicle."""
        stream = self.stream
        if kind == "RAW":
            yield ImuRaw(received_ns=received_ns, source=f"{stream.source}/imu", data=frame)
        elif (speed_m_s := self._wheels.take(self.payload(frame))) is not None:
            yield VehicleSpeed(
                sampled_ns=received_ns, received_ns=received_ns, source=f"{stream.source}/wheels", speed_m_s=speed_m_s
            )

    def _satellites(self, payload: bytes, received_ns: int) -> GnssSatellites:
        return GnssSatellites(
            sampled_ns=received_ns,
            received_ns=received_ns,
            source=self.stream.source,
            satellites=messages.decode_satellites(payload),
        )

    def _signals(self, payload: bytes, received_ns: int) -> GnssSignals:
        return GnssSignals(
            sampled_ns=received_ns,
            received_ns=received_ns,
            source=self.stream.source,
            signals=messages.decode_signals(payload),
        )

    def _take_raw(self, kind: str, payload: bytes, received_ns: int) -> Iterator[Output]:
        source = self.stream.source
        if kind == "RAWX":
            decoded = raw.decode_raw(payload, self.stream.rejects)
            if (gps_time_ns := self.stream.dates.gps_time_ns(decoded.gps_time_ns, "ubx_date")) is None:
                return
            epoch = GnssRawEpoch(
                sampled_ns=received_ns, received_ns=received_ns, source=source, gps_time_ns=gps_time_ns,
                leap_seconds=decoded.leap_seconds, clock_reset=decoded.clock_reset, measurements=decoded.measurements,
            )  # fmt: skip
            yield from self._stamped(decoded.itow_ms, epoch)
        elif kind == "SFRBX" and (bits := raw.decode_navigation_bits(payload)):
            yield GnssNavigationBits(
                sampled_ns=received_ns, received_ns=received_ns, source=source,
                constellation=bits.constellation, number=bits.number, signal=bits.signal, words=bits.words,
            )  # fmt: skip

    def _take_signal(self, kind: str, payload: bytes, received_ns: int) -> Iterator[Output]:
        """Collect the parts of an epoch, which its fix completes; without fixes, the next message of a kind does."""
        part = signal.decode(kind, payload)
        if kind in self._signal:
            yield from self._signal_quality(received_ns, received_ns)
        self._signal[kind] = received_ns, part

    def _signal_quality(
        self, sampled_ns: int, received_ns: int, *, of_fix: bool = False
    ) -> Iterator[GnssSignalQuality]:
        """Publish what has been collected, and a step of the clock mapping that stamped this epoch.

        Parts of an epoch whose fix was lost are not part of the epoch of a later fix.
        """
        step_s = None
        if of_fix:
            late = [kind for kind, (part_ns, _) in self._signal.items() if received_ns - part_ns > PART_AGE_NS]
            for kind in late:
                del self._signal[kind]
                self.stream.rejects["ubx_signal_without_fix"] += 1
            if self._clock.resets > self._resets:
                step_s, self._resets = self._clock.step_s, self._clock.resets
        if not self._signal and step_s is None:
            return
        quality = GnssSignalQuality(
            sampled_ns=sampled_ns, received_ns=received_ns, source=self.stream.source, time_step_s=step_s
        )
        fields = {signal.FIELDS[kind]: part for kind, (_, part) in self._signal.items()}
        self._signal.clear()
        yield quality.model_copy(update=fields)

    def _stamped(self, itow: int, message: OfEpoch) -> Iterator[Output]:
        """Stamp a message with the time of its epoch's fix; without fixes, with its arrival time."""
        if self._last_stamp and _same_epoch(self._last_stamp[0], itow):
            yield message.model_copy(update={"sampled_ns": self._last_stamp[1]})
            return
        if type(message) in self._waiting:
            yield self._waiting[type(message)][1]
        self._waiting[type(message)] = itow, message


def _same_epoch(itow: int, other: int) -> bool:
    """Whether two times of week [ms] belong to one epoch, across the end of the week too."""
    apart = abs(itow - other)
    return min(apart, messages.WEEK_MS - apart) <= SAME_EPOCH_MS


@cache
def _name(group: int, number: int) -> str:
    return UBX_MSGIDS.get(bytes((group, number)), f"{group:02X}-{number:02X}")


@cache
def _known() -> frozenset[str]:
    return frozenset(UBX_MSGIDS.values())

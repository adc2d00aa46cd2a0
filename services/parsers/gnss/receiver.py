"""Decoding state of one GNSS receiver."""

from collections import Counter
from collections.abc import Iterator

from shared.faults import Faults
from shared.maths.clock_mapping import ClockMapping
from shared.maths.dates import DAY_NS, NS, WEEK_NS, DeviceDates
from shared.messages.gnss import (
    GnssConfiguration,
    GnssFix,
    GnssNavigationBits,
    GnssRaw,
    GnssRawEpoch,
    GnssSatellites,
    GnssSignalQuality,
    GnssSignals,
)

from . import ubx_messages, ubx_raw, ubx_signal
from .configuration import ANSWERS, Configurator
from .framer import Frame, Framer, Protocol
from .gnss_time import MS, Unwrapper
from .nmea_burst import NmeaAssembler, NmeaEpoch, NmeaError
from .nmea_epoch import fix_from_sentences
from .nmea_satellites import satellites_of
from .seen import Seen
from .ubx_epoch import Epoch, EpochAssembler, fix_from_epoch
from .utc_steps import UtcSteps

NMEA_WAITS_NS = 5 * NS  # time without a UBX fix after which NMEA fixes are published

PART_AGE_NS = 1_500_000_000  # between a part of the signal quality and the next fix; at 1 Hz it is up to one second
SAME_EPOCH_MS = 12  # times of week of one epoch are closer: RXM-RAWX has the receiver's own clock

OfEpoch = GnssSatellites | GnssSignals | GnssRawEpoch
Output = GnssFix | OfEpoch | GnssNavigationBits | GnssSignalQuality | GnssConfiguration


class Receiver:
    """Decodes the bytes of one receiver to fixes, satellites, signals and configuration results."""

    def __init__(self, source: str, *, minimum_delay_s: float, rejects: Counter[str]) -> None:
        self.configurator, self.seen = Configurator(source), Seen(source)
        self._source = source
        self._rejects = rejects
        self._framer = Framer(rejects)
        self._dates, self._faults = DeviceDates(rejects), Faults(rejects)
        self._ubx, self._nmea = EpochAssembler(rejects), NmeaAssembler()
        self._week, self._day, self._utc_steps = Unwrapper(WEEK_NS), Unwrapper(DAY_NS), UtcSteps()
        self._ubx_clock, self._nmea_clock = ClockMapping(minimum_delay_s), ClockMapping(minimum_delay_s)
        # Time of week [ms] and message, pending until the fix of their epoch is stamped; at most one of each kind.
        self._waiting: dict[type[OfEpoch], tuple[int, OfEpoch]] = {}
        self._signal: dict[str, tuple[int, ubx_signal.Part]] = {}  # of this epoch, each with its arrival [ns]
        self._resets: dict[ClockMapping, int] = {}  # of each mapping, published already
        self._last_stamp: tuple[int, int] | None = None  # time of week [ms] and time stamp [ns] of the newest fix
        self._ubx_fix_ns: int | None = None
        self._nmea_stamp: tuple[NmeaEpoch, int] | None = None  # the newest epoch, and the time stamp of its fix [ns]

    def take(self, raw: GnssRaw) -> Iterator[Output]:
        """Process the next bytes; yield the completed messages."""
        self._dates.host_ns = None if raw.recorded else raw.received_ns
        frames = self._framer.feed(raw.data)
        self.seen.note(len(raw.data), frames, raw.received_ns)
        for frame in frames:
            with self._faults.decoding(raw.received_ns):
                yield from self._take_frame(frame, raw.received_ns)

    def _take_frame(self, frame: Frame, received_ns: int) -> Iterator[Output]:
        try:
            if frame.protocol is Protocol.NMEA:
                yield from self._take_nmea(frame, received_ns)
            elif frame.protocol is Protocol.UBX:
                yield from self._take_ubx(frame, received_ns)
        except ubx_messages.UbxError as fault:
            self._rejects[f"ubx_{fault}"] += 1
        except NmeaError as fault:
            self._rejects[str(fault)] += 1

    def _take_ubx(self, frame: Frame, received_ns: int) -> Iterator[Output]:
        if frame.data[2] == ubx_raw.RXM:
            yield from self._take_raw(ubx_raw.KINDS.get(frame.data[3]), frame.data[6:-2], received_ns)
            return
        if signal_kind := ubx_signal.KINDS.get((frame.data[2], frame.data[3])):
            yield from self._take_signal(signal_kind, frame.data[6:-2], received_ns)
            return
        kind = ubx_messages.KINDS.get(frame.data[3]) if frame.data[2] == ubx_messages.NAV else None
        if kind is None:
            if (frame.data[2], frame.data[3]) not in ANSWERS:
                self._rejects["ubx_unused"] += 1
            yield from self.configurator.take(frame.data)
            return
        payload = frame.data[6:-2]
        if kind in ("SAT", "SIG"):
            itow = ubx_messages.itow_ms(payload)
            decoded = self._satellites(payload, received_ns) if kind == "SAT" else self._signals(payload, received_ns)
            yield from self._stamped(itow, decoded)
            return
        for epoch in tuple(self._ubx.take(kind, payload, received_ns)):  # a fault in one costs not the present message
            with self._faults.decoding(received_ns):
                yield from self._ubx_fix(epoch)

    def _ubx_fix(self, epoch: Epoch) -> Iterator[Output]:
        if epoch.pvt is None:
            return
        self._ubx_fix_ns = epoch.last_received_ns
        sampled_ns = self._ubx_clock.stamp(self._week.unwrap(epoch.itow_ms * MS), epoch.first_received_ns)
        self._last_stamp = epoch.itow_ms, sampled_ns
        yield fix_from_epoch(epoch, epoch.pvt, sampled_ns=sampled_ns, source=self._source, dates=self._dates)
        yield from self._signal_quality(sampled_ns, epoch.last_received_ns, self._ubx_clock)
        for kind, (itow, message) in list(self._waiting.items()):
            if _same_epoch(itow, epoch.itow_ms):
                del self._waiting[kind]
                yield message.model_copy(update={"sampled_ns": sampled_ns})

    def _satellites(self, payload: bytes, received_ns: int) -> GnssSatellites:
        return GnssSatellites(
            sampled_ns=received_ns,
            received_ns=received_ns,
            source=self._source,
            satellites=ubx_messages.decode_satellites(payload),
        )

    def _signals(self, payload: bytes, received_ns: int) -> GnssSignals:
        return GnssSignals(
            sampled_ns=received_ns,
            received_ns=received_ns,
            source=self._source,
            signals=ubx_messages.decode_signals(payload),
        )

    def _take_raw(self, kind: str | None, payload: bytes, received_ns: int) -> Iterator[Output]:
        if kind == "RAWX":
            raw = ubx_raw.decode_raw(payload, self._rejects)
            if (gps_time_ns := self._dates.gps_time_ns(raw.gps_time_ns, "ubx_date")) is None:
                return
            epoch = GnssRawEpoch(
                sampled_ns=received_ns, received_ns=received_ns, source=self._source, gps_time_ns=gps_time_ns,
                leap_seconds=raw.leap_seconds, clock_reset=raw.clock_reset, measurements=raw.measurements,
            )  # fmt: skip
            yield from self._stamped(raw.itow_ms, epoch)
        elif kind == "SFRBX" and (bits := ubx_raw.decode_navigation_bits(payload)):
            yield GnssNavigationBits(
                sampled_ns=received_ns, received_ns=received_ns, source=self._source,
                constellation=bits.constellation, number=bits.number, signal=bits.signal, words=bits.words,
            )  # fmt: skip

    def _take_signal(self, kind: str, payload: bytes, received_ns: int) -> Iterator[Output]:
        """Collect the parts of an epoch, which its fix completes; without fixes, the next message of a kind does."""
        part = ubx_signal.decode(kind, payload)
        if kind in self._signal:
            yield from self._signal_quality(received_ns, received_ns)
        self._signal[kind] = received_ns, part

    def _signal_quality(
        self, sampled_ns: int, received_ns: int, clock: ClockMapping | None = None
    ) -> Iterator[GnssSignalQuality]:
        """Publish what has been collected, and a step of the clock mapping that stamped this epoch.

        Parts of an epoch whose fix was lost are not part of the epoch of a later fix.
        """
        if clock is not None:
            late = [kind for kind, (part_ns, _) in self._signal.items() if received_ns - part_ns > PART_AGE_NS]
            for kind in late:
                del self._signal[kind]
                self._rejects["ubx_signal_without_fix"] += 1
        stepped = clock is not None and clock.resets > self._resets.get(clock, 0)
        if clock is not None:
            self._resets[clock] = clock.resets
        if not (self._signal or stepped):
            return
        quality = GnssSignalQuality(
            sampled_ns=sampled_ns, received_ns=received_ns, source=self._source,
            time_step_s=clock.step_s if clock is not None and stepped else None,
        )  # fmt: skip
        fields = {ubx_signal.FIELDS[kind]: part for kind, (_, part) in self._signal.items()}
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

    def _take_nmea(self, frame: Frame, received_ns: int) -> Iterator[Output]:
        epochs = tuple(self._nmea.take(frame.data, received_ns))
        yield from self._nmea_satellites()
        for epoch in epochs:
            if self._ubx_fix_ns is None or abs(epoch.last_received_ns - self._ubx_fix_ns) > NMEA_WAITS_NS:
                with self._faults.decoding(received_ns):
                    yield from self._nmea_outputs(epoch)

    def _nmea_outputs(self, epoch: NmeaEpoch) -> Iterator[Output]:
        device_ns = self._day.unwrap(epoch.time_of_day_ns)
        device_ns, step_s = self._utc_steps.continuous(device_ns, epoch.first_received_ns)
        fix = self._nmea_fix(epoch, device_ns)
        yield fix
        self._nmea_stamp = epoch, fix.sampled_ns
        if step_s:
            yield GnssSignalQuality(
                sampled_ns=fix.sampled_ns, received_ns=fix.received_ns, source=self._source, time_step_s=float(step_s)
            )
        yield from self._signal_quality(fix.sampled_ns, fix.received_ns, self._nmea_clock)

    def _nmea_satellites(self) -> Iterator[GnssSatellites]:
        """Publish the satellites of the newest fix when its burst has ended: they may be told behind it."""
        if self._nmea_stamp is None or not self._nmea.has_ended(self._nmea_stamp[0]):
            return
        epoch, sampled_ns = self._nmea_stamp
        self._nmea_stamp = None
        if (found := satellites_of(epoch, sampled_ns=sampled_ns, source=self._source)) is not None:
            yield found

    def _nmea_fix(self, epoch: NmeaEpoch, device_ns: int) -> GnssFix:
        return fix_from_sentences(
            epoch,
            sampled_ns=self._nmea_clock.stamp(device_ns, epoch.first_received_ns),
            source=f"{self._source}/nmea",
            rejects=self._rejects,
            dates=self._dates,
        )


def _same_epoch(itow: int, other: int) -> bool:
    """Whether two times of week [ms] belong to one epoch, across the end of the week too."""
    apart = abs(itow - other)
    return min(apart, ubx_messages.WEEK_MS - apart) <= SAME_EPOCH_MS

"""Decoding state of one GNSS receiver."""

from collections import Counter
from collections.abc import Iterator

from shared.maths.clock_mapping import ClockMapping
from shared.messages.gnss import GnssConfiguration, GnssFix, GnssRaw, GnssSatellites

from . import ubx_messages
from .configuration import Configurator
from .framer import Frame, Framer, Protocol
from .gnss_time import DAY_NS, MS, NS, WEEK_NS, Unwrapper
from .nmea_epoch import NmeaAssembler, NmeaEpoch, NmeaError, fix_from_sentences
from .ubx_epoch import Epoch, EpochAssembler, fix_from_epoch

NMEA_WAITS_NS = 5 * NS  # time without a UBX fix after which NMEA fixes are published

Output = GnssFix | GnssSatellites | GnssConfiguration


class Receiver:
    """Decodes the bytes of one receiver to fixes, satellites and configuration results."""

    def __init__(self, source: str, *, minimum_delay_s: float, rejects: Counter[str]) -> None:
        self.configurator = Configurator(source)
        self._source = source
        self._rejects = rejects
        self._framer = Framer(rejects)
        self._ubx, self._nmea = EpochAssembler(rejects), NmeaAssembler()
        self._week, self._day = Unwrapper(WEEK_NS), Unwrapper(DAY_NS)
        self._ubx_clock, self._nmea_clock = ClockMapping(minimum_delay_s), ClockMapping(minimum_delay_s)
        self._satellites: tuple[int, GnssSatellites] | None = None  # pending until the fix of their epoch is stamped
        self._last_stamp: tuple[int, int] | None = None  # time of week [ms] and time stamp [ns] of the newest fix
        self._ubx_fix_ns: int | None = None

    def take(self, raw: GnssRaw) -> Iterator[Output]:
        """Process the next bytes; yield the completed messages."""
        for frame in self._framer.feed(raw.data):
            try:
                if frame.protocol is Protocol.NMEA:
                    yield from self._take_nmea(frame, raw.received_ns)
                elif frame.protocol is Protocol.UBX:
                    yield from self._take_ubx(frame, raw.received_ns)
            except ubx_messages.UbxError as fault:
                self._rejects[f"ubx_{fault}"] += 1
            except NmeaError as fault:
                self._rejects[str(fault)] += 1

    def _take_ubx(self, frame: Frame, received_ns: int) -> Iterator[Output]:
        kind = ubx_messages.KINDS.get(frame.data[3]) if frame.data[2] == ubx_messages.NAV else None
        if kind is None:
            yield from self.configurator.take(frame.data)
            return
        payload = frame.data[6:-2]
        if kind == "SAT":
            yield from self._take_satellites(payload, received_ns)
            return
        for epoch in self._ubx.take(kind, payload, received_ns):
            yield from self._ubx_fix(epoch)

    def _ubx_fix(self, epoch: Epoch) -> Iterator[Output]:
        if epoch.pvt is None:
            return
        self._ubx_fix_ns = epoch.last_received_ns
        sampled_ns = self._ubx_clock.stamp(self._week.unwrap(epoch.itow_ms * MS), epoch.first_received_ns)
        self._last_stamp = epoch.itow_ms, sampled_ns
        yield fix_from_epoch(epoch, epoch.pvt, sampled_ns=sampled_ns, source=self._source)
        if self._satellites and self._satellites[0] == epoch.itow_ms:
            yield self._satellites[1].model_copy(update={"sampled_ns": sampled_ns})
            self._satellites = None

    def _take_satellites(self, payload: bytes, received_ns: int) -> Iterator[Output]:
        """Stamp satellites with the time of their epoch's fix; without fixes, with their arrival time."""
        itow = ubx_messages.satellites_itow_ms(payload)
        satellites = GnssSatellites(
            sampled_ns=received_ns,
            received_ns=received_ns,
            source=self._source,
            satellites=ubx_messages.decode_satellites(payload),
        )
        if self._last_stamp and self._last_stamp[0] == itow:
            yield satellites.model_copy(update={"sampled_ns": self._last_stamp[1]})
            return
        if self._satellites:
            yield self._satellites[1]
        self._satellites = (itow, satellites)

    def _take_nmea(self, frame: Frame, received_ns: int) -> Iterator[Output]:
        for epoch in self._nmea.take(frame.data, received_ns):
            if self._ubx_fix_ns is None or abs(epoch.last_received_ns - self._ubx_fix_ns) > NMEA_WAITS_NS:
                yield self._nmea_fix(epoch)

    def _nmea_fix(self, epoch: NmeaEpoch) -> GnssFix:
        device_ns = self._day.unwrap(epoch.time_of_day_ns)
        return fix_from_sentences(
            epoch,
            sampled_ns=self._nmea_clock.stamp(device_ns, epoch.first_received_ns),
            source=f"{self._source}/nmea",
            rejects=self._rejects,
        )

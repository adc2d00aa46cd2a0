"""Decodes the lines of Android's GnssLogger, as an app sends them over TCP.

Fixes and raw measurements are stamped by the receiver's time, through the mapping of its clock. Lines of the inertial
sensors are passed on to `parsers.imu`, as bytes of the source `<receiver>/imu`.
"""

from collections.abc import Iterator

from shared.maths.clock_mapping import ClockMapping
from shared.maths.dates import GPS_EPOCH_UTC_NS, NS
from shared.messages.gnss import MAX_RAW_MEASUREMENTS, Constellation, GnssNavigationBits, GnssRawEpoch, RawMeasurement
from shared.messages.imu import ImuRaw
from shared.messages.operation import MessageUse
from shared.protocols.gnss_logger import (
    DEFAULT_FIELDS,
    HEADER,
    KINDS,
    MAX_FIELDS,
    SENSORS,
    Row,
    fields_of,
    integer,
    number,
)

from ..dialect import ContentError, Dialect, Output, Stream
from ..lateness import MAX_DELAY_S, with_lateness
from .fixes import fix_of
from .measurements import gps_time_ns, measurement

LEAP_SECONDS = 18  # GPS - UTC since 2017, for lines that state none
MAX_LEAP_S = 40
ROUNDING_NS = 2_000_000  # times of a fix and of measurements of one epoch differ by less
EPOCH_NS = 200_000_000  # after its first row an epoch is complete
MIN_FIELDS = 6  # of the oldest version of the app; those behind may be missing
GPS_SUBFRAME, GALILEO_PAGE = 0x0101, 0x0601  # types of a navigation message: L1 C/A, and I/NAV of E1-B or E5b-I
WORDS = 10
PART_BITS, PAGE_BYTES = 114, 29  # of each half of a page, without its tail; four bits of the last byte are not used
SATELLITES = {GPS_SUBFRAME: 32, GALILEO_PAGE: 36}


class GnssLoggerDialect(Dialect):
    """Fixes, raw measurements, navigation words, and the bytes of the inertial sensors of a phone."""

    name = "GnssLogger"
    positions = (frozenset(("Fix",)),)

    def __init__(self, stream: Stream) -> None:
        super().__init__(stream)
        self._fields = dict(DEFAULT_FIELDS)
        self._clock = ClockMapping(stream.minimum_delay_s, longest_delay_s=MAX_DELAY_S)
        self._newest_utc_ns = -1  # that was stamped
        # GPS time, arrival, stamp [ns], and signals
        self._epoch: tuple[int, int, int, list[RawMeasurement]] | None = None
        self._leap_s = LEAP_SECONDS
        self._newest_gps_ns = -1  # of a published epoch
        self._clock_count: int | None = None  # steps of the receiver's clock, of the newest epoch
        self._stepped_ns: int | None = None  # GPS time of the epoch whose count has changed

    def kind(self, frame: bytes) -> str:
        """First field; a line of names is a header."""
        return "header" if frame.startswith(HEADER.encode()) else frame.split(b",", 1)[0].decode()

    def use(self, kind: str) -> MessageUse:
        """Sensors are used where the phone's are those of the vehicle."""
        if kind in SENSORS:
            return MessageUse.USED if self.stream.uses_imu else MessageUse.UNUSED
        if kind in ("header", "Raw", "Fix", "Nav"):
            return MessageUse.USED
        return MessageUse.UNUSED if kind in KINDS else MessageUse.UNKNOWN

    def take(self, frame: bytes, received_ns: int) -> Iterator[Output]:
        """Decode a line; raw measurements are published once those of another time, or 0.2 s, follow."""
        kind = self.kind(frame)
        if self._epoch is not None and not 0 <= received_ns - self._epoch[1] < EPOCH_NS:
            yield from self._epoch_ended()
        match kind:
            case "header":
                self._name(frame)
            case "Raw":
                yield from self._raw(self._row(kind, frame), received_ns)
            case "Fix":
                yield from self._fix(self._row(kind, frame), received_ns)
            case "Nav":
                yield from self._words(self._row(kind, frame), received_ns)
            case _:
                yield ImuRaw(received_ns=received_ns, source=f"{self.stream.source}/imu", data=frame)

    def _name(self, frame: bytes) -> None:
        kind, *names = frame.decode().removeprefix(HEADER).strip().split(",")
        if kind in DEFAULT_FIELDS and len(names) >= MIN_FIELDS - 1:
            self._fields[kind] = fields_of(names)

    def _row(self, kind: str, frame: bytes) -> Row:
        names, values = self._fields[kind], frame.decode().strip().split(",")[1:]
        if not min(len(names), MIN_FIELDS) <= len(values) <= 4 * MAX_FIELDS:
            raise ContentError("phone_fields")
        if kind == "Nav":  # its last field is a list
            values = [*values[: len(names) - 1], ",".join(values[len(names) - 1 :])]
        return {name: value.strip() for name, value in zip(names, values, strict=False)}

    def _raw(self, row: Row, received_ns: int) -> Iterator[Output]:
        gps_ns = gps_time_ns(row)
        if gps_ns is None or not 0 < gps_ns < 1 << 62:
            raise ContentError("phone_clock")
        if self._epoch is not None and self._epoch[0] != gps_ns:
            yield from self._epoch_ended()
        if gps_ns <= self._newest_gps_ns < gps_ns + NS:  # of a larger step back the device has started again
            raise ContentError("phone_epoch")
        count = integer(row, "hardwareclockdiscontinuitycount")
        if None not in (count, self._clock_count) and count != self._clock_count:
            self._stepped_ns = gps_ns
        self._clock_count = count if count is not None else self._clock_count
        measured = measurement(row, gps_ns, clock_stepped=self._stepped_ns == gps_ns)
        if isinstance(measured, str):
            raise ContentError(f"phone_raw_{measured.replace(' ', '_')}")
        leap_s = number(row, "leapsecond")
        self._leap_s = round(leap_s) if leap_s and 0.0 < leap_s <= MAX_LEAP_S else self._leap_s
        if self._epoch is None:
            stamp_ns = self._stamp(gps_ns + GPS_EPOCH_UTC_NS - self._leap_s * NS, received_ns)
            self._epoch = gps_ns, received_ns, stamp_ns, []
        if len(self._epoch[3]) >= MAX_RAW_MEASUREMENTS:
            raise ContentError("phone_measurements")
        self._epoch[3].append(measured)

    def _epoch_ended(self) -> Iterator[GnssRawEpoch]:
        assert self._epoch is not None
        gps_ns, received_ns, stamp_ns, measurements = self._epoch
        self._epoch, self._newest_gps_ns = None, gps_ns
        told_ns = self.stream.dates.gps_time_ns(gps_ns, "phone_clock")
        if told_ns is not None:
            yield GnssRawEpoch(
                sampled_ns=stamp_ns, received_ns=received_ns, source=self.stream.source,
                gps_time_ns=told_ns, leap_seconds=self._leap_s,
                measurements=tuple(measurements),
            )  # fmt: skip

    def _fix(self, row: Row, received_ns: int) -> Iterator[Output]:
        fix = fix_of(row) if row.get("provider", "").lower() == "gps" else None
        if fix is None or fix.utc_ns is None:
            raise ContentError("phone_fix")
        stamp_ns = self._stamp(fix.utc_ns, received_ns)
        self.stream.fix_ns = received_ns
        stated = {
            "sampled_ns": stamp_ns, "received_ns": received_ns, "source": self.stream.source,
            "utc_ns": self.stream.dates.utc_ns(fix.utc_ns, "phone_fix"),
        }  # fmt: skip
        yield with_lateness(fix.model_copy(update=stated), self._clock)

    def _stamp(self, utc_ns: int, received_ns: int) -> int:
        """Stamp by the mapping; a time of the same epoch that is a little before the newest is no step of the clock.

        A fix states a whole millisecond, which may be before or after the time of the measurements.
        """
        behind_ns = self._newest_utc_ns - utc_ns
        behind_ns = behind_ns if 0 < behind_ns < ROUNDING_NS else 0
        self._newest_utc_ns = utc_ns + behind_ns
        return self._clock.stamp(utc_ns + behind_ns, received_ns) - behind_ns

    def _words(self, row: Row, received_ns: int) -> Iterator[Output]:
        """Subframes of GPS L1 C/A, and pages of Galileo I/NAV, whose words are the same on E1-B and on E5b-I.

        References
        ----------
        Android, GnssNavigationMessage.getData.
        """
        kind = integer(row, "type")
        if kind not in SATELLITES:
            return
        satellite = integer(row, "svid")
        try:
            content = bytes(int(text) & 0xFF for text in row.get("data", "").split(",") if text.strip())
        except ValueError as error:
            raise ContentError("phone_nav") from error
        length = 4 * WORDS if kind == GPS_SUBFRAME else PAGE_BYTES
        if satellite is None or not 0 < satellite <= SATELLITES[kind] or len(content) != length:
            raise ContentError("phone_nav")
        if kind == GPS_SUBFRAME:
            constellation, signal = Constellation.GPS, "1C"
            words = tuple(int.from_bytes(content[k : k + 4], "big") & 0x3FFFFFFF for k in range(0, 4 * WORDS, 4))
        else:
            constellation, signal, words = Constellation.GALILEO, "1B", page_words(content)
        yield GnssNavigationBits(
            sampled_ns=received_ns, received_ns=received_ns, source=self.stream.source, constellation=constellation,
            number=satellite, signal=signal, words=words,
        )  # fmt: skip


def page_words(content: bytes) -> tuple[int, ...]:
    """Eight words of a page of I/NAV as a receiver of u-blox gives them: each half in four, its tail zero."""
    page = int.from_bytes(content, "big") >> 8 * PAGE_BYTES - 2 * PART_BITS
    halves = page >> PART_BITS, page & (1 << PART_BITS) - 1
    return tuple(half << 128 - PART_BITS >> shift & 0xFFFFFFFF for half in halves for shift in (96, 64, 32, 0))

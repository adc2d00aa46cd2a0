"""What GNSS receivers stated: kind of fix and corrections over time, tracks of satellites in the sky; pure."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from math import degrees

from shared.messages.base import Message
from shared.messages.gnss import (
    CarrierSolution,
    FixType,
    GnssConfiguration,
    GnssFix,
    GnssRawEpoch,
    GnssSatellites,
    GnssSignalQuality,
    GnssSignals,
)
from shared.topics import BY_NAME

NS = 1_000_000_000
OfReceiver = GnssFix | GnssSatellites | GnssSignals | GnssRawEpoch | GnssSignalQuality | GnssConfiguration
SOURCES_MAXIMUM, SATELLITES_MAXIMUM, CHANGES_MAXIMUM = 8, 160, 500
TRACK_STEP_NS, TRACK_POINTS = 30 * NS, 120  # one hour
SILENT_NS = round((BY_NAME["gnss/fix"].silent_after_s or 5.0) * NS)
NO_DATA = "no_data"
FRESH_CORRECTION_S, OLD_CORRECTION_S = 5.0, 30.0  # a receiver's ambiguities outlive a few seconds without corrections


class Changes:
    """A state over time: its changes, and the pauses in which nothing stated it."""

    def __init__(self) -> None:
        self._changes: deque[tuple[int, str]] = deque(maxlen=CHANGES_MAXIMUM)
        self._newest_ns: int | None = None

    def note(self, time_ns: int, state: str) -> None:
        """Note the state at one time, later than the one before."""
        if self._newest_ns is not None and time_ns - self._newest_ns > SILENT_NS:
            self._changes.append((self._newest_ns + SILENT_NS, NO_DATA))
        if not self._changes or self._changes[-1][1] != state:
            self._changes.append((time_ns, state))
        self._newest_ns = time_ns

    def until(self, now_ns: int) -> Iterator[tuple[int, str]]:
        """Give the changes, with a pause that lasts until now."""
        yield from self._changes
        if self._newest_ns is not None and now_ns - self._newest_ns > SILENT_NS:
            yield self._newest_ns + SILENT_NS, NO_DATA


@dataclass
class ReceiverHistory:
    """One receiver: the newest of each kind of message with its arrival, and what changed."""

    source: str
    fix: GnssFix | None = None
    satellites: GnssSatellites | None = None
    signals: GnssSignals | None = None
    epoch: GnssRawEpoch | None = None
    quality: GnssSignalQuality | None = None
    configuration: GnssConfiguration | None = None
    updated_ns: dict[str, int] = field(default_factory=dict)  # arrival of each of these
    fixes: Changes = field(default_factory=Changes)
    corrections: Changes = field(default_factory=Changes)
    waited_since_ns: int | None = None  # first fix of all, if it had no position
    first_position_ns: int | None = None
    tracks: dict[tuple[str, int], deque[tuple[int, float, float]]] = field(default_factory=dict)

    def note_fix(self, fix: GnssFix, received_ns: int) -> None:
        """Note kind, corrections, and how long the first position took."""
        self.fix = fix
        self.fixes.note(received_ns, kind_of(fix))
        self.corrections.note(received_ns, correction_of(fix))
        located = fix.latitude_deg is not None
        if self.first_position_ns is None and located and self.waited_since_ns is not None:
            self.first_position_ns = received_ns
        elif self.waited_since_ns is None and "fix" not in self.updated_ns and not located:
            self.waited_since_ns = received_ns

    def note_satellites(self, message: GnssSatellites, received_ns: int) -> None:
        """Add a point to each track, twice a minute; a satellite that has not been seen for the length is dropped."""
        self.satellites = message
        for seen in message.satellites:
            if seen.elevation_rad is None or seen.azimuth_rad is None:
                continue
            key = (str(seen.constellation), seen.number)
            if key not in self.tracks and len(self.tracks) >= SATELLITES_MAXIMUM:
                continue
            track = self.tracks.setdefault(key, deque(maxlen=TRACK_POINTS))
            if not track or received_ns - track[-1][0] >= TRACK_STEP_NS:
                track.append((received_ns, degrees(seen.elevation_rad), degrees(seen.azimuth_rad)))
        oldest_ns = received_ns - TRACK_POINTS * TRACK_STEP_NS
        for key in [key for key, track in self.tracks.items() if track[-1][0] < oldest_ns]:
            del self.tracks[key]


class GnssHistory:
    """The receivers of the vehicle, a bounded number."""

    def __init__(self) -> None:
        self.receivers: dict[str, ReceiverHistory] = {}

    def note(self, message: Message, received_ns: int) -> None:
        """Take one message; what is not of a receiver is ignored."""
        if not isinstance(message, OfReceiver):
            return
        receiver = self.receivers.get(message.source)
        if receiver is None:
            if len(self.receivers) >= SOURCES_MAXIMUM:
                return
            receiver = self.receivers[message.source] = ReceiverHistory(message.source)
        match message:
            case GnssFix():
                receiver.note_fix(message, received_ns)
                receiver.updated_ns["fix"] = received_ns
            case GnssSatellites():
                receiver.note_satellites(message, received_ns)
                receiver.updated_ns["satellites"] = received_ns
            case GnssSignals():
                receiver.signals = message
                receiver.updated_ns["signals"] = received_ns
            case GnssRawEpoch():
                receiver.epoch = message
                receiver.updated_ns["epoch"] = received_ns
            case GnssSignalQuality():
                receiver.quality = message
                receiver.updated_ns["quality"] = received_ns
            case GnssConfiguration():
                receiver.configuration = message
                receiver.updated_ns["configuration"] = received_ns


def kind_of(fix: GnssFix) -> str:
    """Name the kind of a fix: by its ambiguities, corrections, or dimensions."""
    if fix.latitude_deg is None or fix.fix_type is FixType.NONE:
        return "time_only" if fix.fix_type is FixType.TIME_ONLY else "none"
    if fix.carrier_solution is not CarrierSolution.NONE:
        return f"rtk_{fix.carrier_solution}"
    return "differential" if fix.differential and fix.fix_type is FixType.THREE_D else str(fix.fix_type)


def correction_of(fix: GnssFix) -> str:
    """Class the age of the corrections."""
    if fix.correction_age_s is None:
        return "used" if fix.differential else "none"
    if fix.correction_age_s <= FRESH_CORRECTION_S:
        return "fresh"
    return "aged" if fix.correction_age_s <= OLD_CORRECTION_S else "old"

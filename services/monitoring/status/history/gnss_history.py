"""What GNSS receivers stated: kind of fix and corrections over time, tracks of satellites in the sky; pure."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from math import degrees
from typing import Literal

from pydantic import BaseModel, ConfigDict

from shared.messages.base import Message
from shared.messages.gnss import (
    CarrierSolution,
    FixType,
    GnssConfiguration,
    GnssFix,
    GnssRawEpoch,
    GnssReceiver,
    GnssSatellites,
    GnssSignalQuality,
    GnssSignals,
)
from shared.messages.operation import DeviceState
from shared.topics import BY_NAME

NS = 1_000_000_000
OfReceiver = (
    GnssFix | GnssSatellites | GnssSignals | GnssRawEpoch | GnssSignalQuality | GnssConfiguration | GnssReceiver
    | DeviceState
)  # fmt: skip
DRIVER = "sensors.gnss"
PLAIN: dict[type[Message], str] = {  # field of a receiver that keeps the newest
    GnssSignals: "signals", GnssRawEpoch: "epoch", GnssSignalQuality: "quality", GnssConfiguration: "configuration",
    GnssReceiver: "said", DeviceState: "device",
}  # fmt: skip
SOURCES_MAXIMUM, SATELLITES_MAXIMUM, CHANGES_MAXIMUM = 8, 160, 500
TRACK_STEP_NS, TRACK_POINTS = 30 * NS, 120  # one hour
PlaceInSky = tuple[str, int, float, float]  # constellation, number, elevation and azimuth in degrees
RETENTION_NS = round(0.95 * NS)  # between two records of an unchanged fix
SILENCE_TIMEOUT_NS = round((BY_NAME["gnss/fix"].silent_after_s or 5.0) * NS)
NO_DATA = "no_data"
FRESH_CORRECTION_S, OLD_CORRECTION_S = 5.0, 30.0  # a receiver's ambiguities outlive a few seconds without corrections


class Changes:
    """A state over time: its changes, and the pauses in which nothing stated it."""

    def __init__(self) -> None:
        self._changes: deque[tuple[int, str]] = deque(maxlen=CHANGES_MAXIMUM)
        self._newest_ns: int | None = None

    def note(self, time_ns: int, state: str) -> None:
        """Note the state at one time, later than the one before."""
        if self._newest_ns is not None and time_ns - self._newest_ns > SILENCE_TIMEOUT_NS:
            self._changes.append((self._newest_ns + SILENCE_TIMEOUT_NS, NO_DATA))
        if not self._changes or self._changes[-1][1] != state:
            self._changes.append((time_ns, state))
        self._newest_ns = time_ns

    def until(self, now_ns: int) -> Iterator[tuple[int, str]]:
        """Give the changes, with a pause that lasts until now."""
        yield from self._changes
        if self._newest_ns is not None and now_ns - self._newest_ns > SILENCE_TIMEOUT_NS:
            yield self._newest_ns + SILENCE_TIMEOUT_NS, NO_DATA


class FixClass(BaseModel):
    """Kind of fix and class of the corrections of a receiver at one time."""

    model_config = ConfigDict(defer_build=True)
    kind: Literal["fix"]
    ns: int
    source: str
    fix: str
    correction: str


class SkyTrackPoints(BaseModel):
    """New points of the tracks of satellites."""

    model_config = ConfigDict(defer_build=True)
    kind: Literal["sky"]
    ns: int
    source: str
    places: tuple[PlaceInSky, ...]


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
    said: GnssReceiver | None = None  # which messages it sends
    device: DeviceState | None = None  # what was found at its port
    updated_ns: dict[str, int] = field(default_factory=dict)  # arrival of each of these
    fixes: Changes = field(default_factory=Changes)
    corrections: Changes = field(default_factory=Changes)
    waited_since_ns: int | None = None  # first fix of all, if it had no position
    first_position_ns: int | None = None
    tracks: dict[tuple[str, int], deque[tuple[int, float, float]]] = field(default_factory=dict)
    kept: FixClass | None = None  # the newest one

    def note_fix(self, fix: GnssFix, received_ns: int) -> Iterator[FixClass]:
        """Note kind, corrections, and how long the first position took; give what a restart must know."""
        self.fix = fix
        found = FixClass(
            kind="fix", ns=received_ns, source=self.source, fix=kind_of(fix), correction=correction_of(fix)
        )
        self.restore_fix(found)
        located = fix.latitude_deg is not None
        if self.first_position_ns is None and located and self.waited_since_ns is not None:
            self.first_position_ns = received_ns
        elif self.waited_since_ns is None and "fix" not in self.updated_ns and not located:
            self.waited_since_ns = received_ns
        last = self.kept
        if (
            last is None
            or found.ns - last.ns >= RETENTION_NS
            or (last.fix, last.correction) != (found.fix, found.correction)
        ):
            self.kept = found
            yield found

    def restore_fix(self, kept: FixClass) -> None:
        """Note kind and corrections at one time."""
        self.fixes.note(kept.ns, kept.fix)
        self.corrections.note(kept.ns, kept.correction)

    def note_satellites(self, message: GnssSatellites, received_ns: int) -> Iterator[SkyTrackPoints]:
        """Add a point to each track, twice a minute; give what a restart must know."""
        self.satellites = message
        places = tuple(
            (str(seen.constellation), seen.number, degrees(seen.elevation_rad), degrees(seen.azimuth_rad))
            for seen in message.satellites
            if seen.elevation_rad is not None and seen.azimuth_rad is not None
        )
        found = SkyTrackPoints(kind="sky", ns=received_ns, source=self.source, places=places)
        if added := self.restore_sky(found):
            yield found.model_copy(update={"places": added})

    def restore_sky(self, kept: SkyTrackPoints) -> tuple[PlaceInSky, ...]:
        """Add points to the tracks and return them; a satellite that has not been seen for the length is dropped."""
        added = tuple(place for place in kept.places if self._append(place, kept.ns))
        oldest_ns = kept.ns - TRACK_POINTS * TRACK_STEP_NS
        for key in [key for key, track in self.tracks.items() if track[-1][0] < oldest_ns]:
            del self.tracks[key]
        return added

    def _append(self, place: PlaceInSky, time_ns: int) -> bool:
        constellation, number, elevation_deg, azimuth_deg = place
        key = (constellation, number)
        if key not in self.tracks and len(self.tracks) >= SATELLITES_MAXIMUM:
            return False
        track = self.tracks.setdefault(key, deque(maxlen=TRACK_POINTS))
        due = not track or time_ns - track[-1][0] >= TRACK_STEP_NS
        if due:
            track.append((time_ns, elevation_deg, azimuth_deg))
        return due


class GnssHistory:
    """The receivers of the vehicle, a bounded number."""

    def __init__(self) -> None:
        self.receivers: dict[str, ReceiverHistory] = {}

    def restore(self, kept: FixClass | SkyTrackPoints) -> None:
        """Take over a record of an earlier life of the process."""
        receiver = self._receiver(kept.source)
        if receiver and isinstance(kept, FixClass):
            receiver.restore_fix(kept)
        elif receiver and isinstance(kept, SkyTrackPoints):
            receiver.restore_sky(kept)

    def note(self, message: Message, received_ns: int) -> list[FixClass | SkyTrackPoints]:
        """Take one message and return what a restart must know; what is not of a receiver is ignored."""
        if isinstance(message, DeviceState) and message.process != DRIVER:
            return []
        if not isinstance(message, OfReceiver) or (receiver := self._receiver(message.source)) is None:
            return []
        kept: list[FixClass | SkyTrackPoints] = []
        match message:
            case GnssFix():
                kept += receiver.note_fix(message, received_ns)
                receiver.updated_ns["fix"] = received_ns
            case GnssSatellites():
                kept += receiver.note_satellites(message, received_ns)
                receiver.updated_ns["satellites"] = received_ns
            case _:
                name = PLAIN[type(message)]
                setattr(receiver, name, message)
                receiver.updated_ns[name] = received_ns
        return kept

    def _receiver(self, source: str) -> ReceiverHistory | None:
        if source not in self.receivers and len(self.receivers) < SOURCES_MAXIMUM:
            self.receivers[source] = ReceiverHistory(source)
        return self.receivers.get(source)


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

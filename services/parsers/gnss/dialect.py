"""What a protocol of a receiver tells: one object a protocol and receiver, made by the rows of `protocols.py`."""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

from shared.faults import Faults
from shared.maths.dates import DeviceDates
from shared.messages.gnss import (
    GnssConfiguration,
    GnssConfigure,
    GnssFix,
    GnssNavigationBits,
    GnssRawEpoch,
    GnssSatellites,
    GnssSignalQuality,
    GnssSignals,
    GnssStart,
)
from shared.messages.imu import ImuRaw
from shared.messages.operation import MessageUse
from shared.messages.vehicle import VehicleSpeed

Output = (
    GnssFix
    | GnssSatellites
    | GnssSignals
    | GnssRawEpoch
    | GnssNavigationBits
    | GnssSignalQuality
    | GnssConfiguration
    | ImuRaw
    | VehicleSpeed
)
PREFERRED_NS = 5_000_000_000  # time without a fix of a better protocol after which those of another are published


class ContentError(ValueError):
    """A frame with a valid checksum and invalid content; the text is the kind of reject."""


@dataclass
class Stream:
    """What the dialects of one receiver share."""

    source: str
    rejects: Counter[str]
    dates: DeviceDates
    faults: Faults
    minimum_delay_s: float
    uses_imu: bool = False  # whether the inertial sensors of the receiver are those of the vehicle
    metres_per_wheel_tick: float = 0.0
    fix_ns: int | None = None  # newest fix of a protocol that tells more than the others

    def has_better(self, received_ns: int) -> bool:
        """Whether a protocol that tells more gives fixes as well."""
        return self.fix_ns is not None and abs(received_ns - self.fix_ns) <= PREFERRED_NS


class Dialogue(ABC):
    """Configures a receiver as the controller asks, with one request at a time."""

    @abstractmethod
    def request(self, wanted: GnssConfigure, rate_baud: int | None) -> Iterator[bytes | GnssConfiguration]:
        """Begin: yield bytes for the receiver, or the result where the request is invalid.

        `rate_baud` is that of the port, None where it has none.
        """

    @abstractmethod
    def take(self, kind: str, payload: bytes) -> Iterator[bytes | GnssConfiguration]:
        """Process a message of the receiver, which may be an answer; yield the next bytes, or the result."""

    @abstractmethod
    def restart(self, start: GnssStart) -> bytes:
        """What lets the receiver start anew; it does not answer."""

    @abstractmethod
    def tick(self) -> Iterator[bytes | GnssConfiguration]:
        """A second has passed: repeat, or end a request without an answer."""


class Dialect(ABC):
    """Decodes the frames of one protocol."""

    name: ClassVar[str]
    positions: ClassVar[tuple[frozenset[str], ...]] = ()  # kinds of messages that together give a position

    def __init__(self, stream: Stream) -> None:
        self.stream = stream
        self.dialogue: Dialogue | None = None  # of protocols by which a receiver is configured

    def payload(self, frame: bytes) -> bytes:
        """What a frame holds, without its framing."""
        return frame

    @abstractmethod
    def kind(self, frame: bytes) -> str:
        """Name of the message in a frame, without the protocol."""

    @abstractmethod
    def use(self, kind: str) -> MessageUse:
        """What follows from messages of a kind."""

    @abstractmethod
    def take(self, frame: bytes, received_ns: int) -> Iterator[Output]:
        """Decode a frame; yield what is complete. Raises ContentError."""

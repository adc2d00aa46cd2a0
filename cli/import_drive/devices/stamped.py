"""What a device file holds: portions of bytes, each with the time that the data themselves tell."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum

NS = 1_000_000_000
WITHOUT_DATE_NS = 946_684_800 * NS  # 2000-01-01: where a clock begins that does not say when
ABSOLUTE_FROM_NS = 1_000_000_000 * NS  # 2001: an earlier stamp is the time since some start


class FileKind(Enum):
    """Kinds of device files, by what is read from them."""

    RECEIVER = "GNSS receiver"
    CORRECTIONS = "corrections (RTCM 3)"
    TRACKER = "inertial sensors (Xbus)"
    CAN = "CAN bus"


class ClockKind(Enum):
    """What is known of the clock of a file."""

    UTC = "UTC"
    DAY = "time of day"  # without a date
    FREE = "free"  # since some start


@dataclass(frozen=True)
class Portion:
    """Bytes that ended at one time [ns] of the clock of their file."""

    time_ns: int
    data: bytes


@dataclass(frozen=True)
class StampedFile:
    """A device file: its portions in order of time, its clock, and what was not used."""

    kind: FileKind
    clock: ClockKind
    portions: Sequence[Portion]
    rows: int  # frames, messages or lines
    rejects: Counter[str] = field(default_factory=Counter)
    notes: tuple[str, ...] = ()

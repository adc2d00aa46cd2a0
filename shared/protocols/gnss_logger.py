"""Lines of Android's GnssLogger, and of apps that send such lines over TCP: a kind, and fields between commas.

A line `# Raw,utcTimeMillis,TimeNanos,...` names the fields of the lines of a kind; the names differ between versions.
"""

import math
from collections.abc import Callable, Sequence

from .framing.finder import Sums
from .framing.framing import Framing
from .protocol import Protocol, Reason

MAX_LINE = 2048  # [bytes]
MAX_FIELDS = 64
_LINE_FEED = 10
SENSORS = ("UncalAccel", "UncalGyro", "Accel", "Gyro", "UncalMag", "Mag", "Pressure")
KINDS = ("Raw", "Fix", "Status", "Nav", *SENSORS, "OrientationDeg", "Agc", "GameRotationVector")
HEADER = "# "
# Names of the same field in several versions, in lower case.
NAMES = {
    "latitude": "latitudedegrees", "longitude": "longitudedegrees", "altitude": "altitudemeters", "speed": "speedmps",
    "accuracy": "accuracymeters", "(utc)timeinms": "unixtimemillis", "bearing": "bearingdegrees",
}  # fmt: skip
# Fields of versions 2 and 3 of the app, for a stream that is joined behind its header.
DEFAULT_FIELDS = {
    "Raw": (
        "utctimemillis", "timenanos", "leapsecond", "timeuncertaintynanos", "fullbiasnanos", "biasnanos",
        "biasuncertaintynanos", "driftnanospersecond", "driftuncertaintynanospersecond",
        "hardwareclockdiscontinuitycount", "svid", "timeoffsetnanos", "state", "receivedsvtimenanos",
        "receivedsvtimeuncertaintynanos", "cn0dbhz", "pseudorangeratemeterspersecond",
        "pseudorangerateuncertaintymeterspersecond", "accumulateddeltarangestate", "accumulateddeltarangemeters",
        "accumulateddeltarangeuncertaintymeters", "carrierfrequencyhz", "carriercycles", "carrierphase",
        "carrierphaseuncertainty", "multipathindicator", "snrindb", "constellationtype", "agcdb",
    ),
    "Fix": (
        "provider", "latitudedegrees", "longitudedegrees", "altitudemeters", "speedmps", "accuracymeters",
        "bearingdegrees", "unixtimemillis", "speedaccuracymps", "bearingaccuracydegrees", "elapsedrealtimenanos",
        "verticalaccuracymeters",
    ),
    "Nav": ("svid", "type", "status", "messageid", "submessageid", "data"),
}  # fmt: skip
Row = dict[str, str]


def fields_of(names: Sequence[str]) -> tuple[str, ...]:
    """Names of the fields of a header line, as all versions of the app are read."""
    lower = (name.strip().lower() for name in names[:MAX_FIELDS])
    return tuple(NAMES.get(name, name) for name in lower)


def number(row: Row, name: str) -> float | None:
    """A finite number of a field, or None."""
    try:
        value = float(row.get(name, ""))
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def integer(row: Row, name: str) -> int | None:
    """An integer, to the last digit; nanoseconds since 1980 do not fit a double. None beyond 20 digits."""
    text = row.get(name, "")
    try:
        return int(text) if len(text) <= 20 else None
    except ValueError:
        value = number(row, name)
        return None if value is None or abs(value) > 1e15 else round(value)


def _beginning(text: str) -> tuple[bytes, ...]:
    return tuple(letter.encode() for letter in text)


class GnssLoggerFraming(Framing):
    """A line that begins with a kind and a comma, or a line of names."""

    protocol, least = "GnssLogger", 3
    words = (*tuple(f"{kind}," for kind in KINDS), HEADER)
    begins = tuple(map(_beginning, words))
    starts = rb"(?:%s)[ -~\t]{1,%d}\r?\n" % (b"|".join(word.encode() for word in words), MAX_LINE - 32)
    most_bytes = MAX_LINE
    begun = b"|".join(
        [word[:stop].encode() for word in words for stop in range(len(word) - 1, 0, -1)]
        + [word.encode() + rb"[ -~\t]{0,%d}\r?" % (MAX_LINE - 32) for word in words]
    )

    def size(self, buffer: bytes | bytearray, start: int, header: int) -> int | None:
        """The whole line is the header."""
        return header if buffer[start + header - 1] == _LINE_FEED else None

    def fault(self, buffer: bytes | bytearray, start: int, stop: int, at: Callable[[int], Sums]) -> str | None:
        """A line has no checksum."""
        return None


_PHONE = "bring the app up to date: docs/how-to/connect-a-phone.md"
PROTOCOL = Protocol(
    GnssLoggerFraming(), "Android GnssLogger", frozenset(("gnss",)),
    reasons={
        "phone_fields": Reason("a line of a phone with another number of fields than its header names", _PHONE),
        "phone_clock": Reason("a raw measurement without the receiver's clock", "wait for satellites"),
        "phone_fix": Reason("a fix of a phone without position or time, or not by GPS", "wait for satellites"),
        "phone_epoch": Reason("raw measurements of an epoch that is over already", _PHONE),
        "phone_measurements": Reason("more raw measurements in an epoch than satellites send", _PHONE),
        "phone_nav": Reason("a subframe of a navigation message that is none", _PHONE),
        "phone_sensor": Reason("a line of a sensor of a phone with what is no number", _PHONE),
        "phone_raw_*": Reason("a raw measurement that its own state does not call valid", "wait for satellites"),
    },
)  # fmt: skip

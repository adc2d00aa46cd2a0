"""NMEA 0183: whole sentences, in an Android log with their arrival behind them, and reasons of rejects."""

import string
from collections.abc import Callable
from functools import reduce
from operator import xor

from .framing.finder import Sums
from .framing.framing import Framing
from .protocol import Protocol, Reason

MAX_SENTENCE = 256  # [bytes] the standard allows 82; proprietary sentences are longer
_LINE_FEED = 10
_LETTERS = string.ascii_uppercase.encode()


class NmeaFraming(Framing):
    """A dollar sign, an address in capital letters, text, an asterisk, two digits of the checksum, end of line."""

    protocol, begins = "NMEA", ((b"$", _LETTERS),)
    starts = rb"\$[A-Z][ -#%-\x7f]{0,247}\*[0-9A-Fa-f]{2}(?:,\d{1,16})?\r{0,3}\n"
    begun = rb"\$(?:[A-Z][ -#%-\x7f]{0,250}\r{0,3})?"
    malformed = too_long = "nmea_form"
    most_bytes = MAX_SENTENCE + 24

    def size(self, buffer: bytes | bytearray, start: int, header: int) -> int | None:
        """The whole sentence is the header."""
        return header if buffer[start + header - 1] == _LINE_FEED else None

    def fault(self, buffer: bytes | bytearray, start: int, stop: int, at: Callable[[int], Sums]) -> str | None:
        """Compare the checksum: the exclusive or of the text between dollar sign and asterisk."""
        body, _, digits = bytes(buffer[start + 1 : stop]).rstrip(b"\r\n").rpartition(b"*")
        return None if reduce(xor, body, 0) == int(digits[:2], 16) else "nmea_checksum"


PROTOCOL = Protocol(
    NmeaFraming(), "NMEA 0183", frozenset(("gnss",)),
    reasons={
        "nmea_checksum": Reason("a sentence with a wrong checksum",
                                "check ground and cable, and that the rate of the port carries what is sent"),
        "nmea_form": Reason("what begins as a sentence and is none: no checksum, no end, or other characters",
                            "switch the checksum on; lines of an IMU, such as $IMU, belong to [sensors.imu]"),
        "nmea_field": Reason("a number of a sentence that cannot be", "bring the receiver's firmware up to date"),
        "nmea_time": Reason("a time of day that cannot be", "wait for satellites; restart the receiver"),
        "nmea_date": Reason("an impossible date; the fix is used without UTC", "wait for satellites"),
    },
)  # fmt: skip

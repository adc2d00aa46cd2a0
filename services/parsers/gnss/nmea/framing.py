"""Frames of NMEA 0183: whole sentences, in an Android log with their arrival behind them."""

from collections.abc import Callable
from functools import reduce
from operator import xor

from shared.devices.framing import Sums

from ..framing import Framing

MAX_SENTENCE = 256  # [bytes] the standard allows 82; proprietary sentences are longer
_LINE_FEED = 10


class NmeaFraming(Framing):
    """A dollar sign, text, an asterisk, two digits of the checksum, end of line."""

    protocol, first = "NMEA", ord("$")
    starts = rb"\$[ -#%-\x7f]{0,248}\*[0-9A-Fa-f]{2}(?:,\d{1,16})?\r{0,3}\n"
    begun = rb"\$[ -#%-\x7f]{0,251}\r{0,3}"
    malformed = {b"$": "nmea_form"}  # noqa: RUF012  # a constant
    most_bytes, too_long, invalid = MAX_SENTENCE + 24, "nmea_form", "nmea_checksum"

    def size(self, buffer: bytearray, start: int, header: int) -> int | None:
        """The whole sentence is the header."""
        return header if buffer[start + header - 1] == _LINE_FEED else None

    def is_valid(self, buffer: bytearray, start: int, stop: int, at: Callable[[int], Sums]) -> bool:
        """Compare the checksum: the exclusive or of the text between dollar sign and asterisk."""
        body, _, digits = bytes(buffer[start + 1 : stop]).rstrip(b"\r\n").rpartition(b"*")
        return reduce(xor, body, 0) == int(digits[:2], 16)

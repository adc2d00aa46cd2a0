"""Protocols of receivers that are recognised, and not decoded: what to switch on in their place.

Sources: SBF: Septentrio mosaic-X5 reference guide 4.14, 4.1.1. NovAtel and Unicore: OEM7 commands and logs
(OM-20000169), 1.3; Unicore N4 reference 2.2. SiRF: SiRF binary protocol reference 2.4.
"""

import zlib
from collections.abc import Callable

from ..maths.crc import crc16_ccitt
from .framing.finder import Sums
from .framing.framing import Framing
from .protocol import Protocol

MAX_BYTES = 8192


class SampleFraming(Framing):
    """Frames that are looked for in samples alone, since checking one costs as much as it is long."""

    most_bytes = MAX_BYTES
    length_at: int  # of the length in the header, two bytes
    byte_order: str
    around: int  # bytes that the length does not count
    check: Callable[[bytes], bool]

    def size(self, buffer: bytes | bytearray, start: int, header: int) -> int | None:
        """By the length in the header."""
        field = buffer[start + self.length_at : start + self.length_at + 2]
        length = field[0] << 8 | field[1] if self.byte_order == "big" else field[1] << 8 | field[0]
        return length + self.around

    def fault(self, buffer: bytes | bytearray, start: int, stop: int, at: Callable[[int], Sums]) -> str | None:
        """Compare the checksum."""
        return None if type(self).check(bytes(buffer[start:stop])) else "checksum"


def _is_sbf(frame: bytes) -> bool:
    return len(frame) >= 8 and len(frame) % 4 == 0 and crc16_ccitt(frame[4:]) == int.from_bytes(frame[2:4], "little")


def _crc32(data: bytes) -> int:
    """CRC-32 of NovAtel: that of Ethernet without the inversions."""
    return zlib.crc32(data, 0xFFFFFFFF) ^ 0xFFFFFFFF


def _is_novatel(frame: bytes) -> bool:
    return _crc32(frame[:-4]) == int.from_bytes(frame[-4:], "little")


def _is_sirf(frame: bytes) -> bool:
    return sum(frame[4:-4]) & 0x7FFF == int.from_bytes(frame[-4:-2], "big")


class SbfFraming(SampleFraming):
    """`$@`, CRC, block number, length, content."""

    protocol, begins = "SBF", ((b"$", b"@"),)
    starts = rb"\$@(?s:.){6}"
    length_at, byte_order, around, check = 6, "little", 0, staticmethod(_is_sbf)


class NovatelFraming(SampleFraming):
    """Three sync bytes, header of 28 bytes, message, CRC."""

    protocol, begins = "NovAtel", ((b"\xaa", b"\x44", b"\x12"),)
    starts = rb"\xaa\x44\x12\x1c(?s:.){6}"
    length_at, byte_order, around, check = 8, "little", 32, staticmethod(_is_novatel)


class UnicoreFraming(SampleFraming):
    """Three sync bytes, header of 24 bytes, message, CRC."""

    protocol, begins = "Unicore", ((b"\xaa", b"\x44", b"\xb5"),)
    starts = rb"\xaa\x44\xb5(?s:.){5}"
    length_at, byte_order, around, check = 6, "little", 28, staticmethod(_is_novatel)


class SirfFraming(SampleFraming):
    """Two sync bytes, length, message, sum, two end bytes."""

    protocol, begins = "SiRF", ((b"\xa0", b"\xa2"),)
    starts = rb"\xa0\xa2[\x00-\x03](?s:.)"
    length_at, byte_order, around, check = 2, "big", 8, staticmethod(_is_sirf)


_NMEA = "RMC, GGA, GSA, GSV and GST at 1 Hz or more"
PROTOCOLS = (
    Protocol(SbfFraming(), "Septentrio SBF",
             remedy=f"switch NMEA on at this port (setNMEAOutput, setDataInOut): {_NMEA}"),
    Protocol(NovatelFraming(), "NovAtel binary", remedy=f"switch NMEA on at this port (LOG GPRMC ONTIME 1): {_NMEA}"),
    Protocol(UnicoreFraming(), "Unicore binary", remedy=f"switch NMEA on at this port (GPRMC 1): {_NMEA}"),
    Protocol(SirfFraming(), "SiRF binary", remedy=f"switch the receiver to NMEA (message 129): {_NMEA}"),
)  # fmt: skip

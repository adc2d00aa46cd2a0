"""Recognises by its bytes what a device speaks, whether or not the unit reads it: of ports whose rate is unknown.

Sources: UBX: u-blox F9 HPG 1.32 (UBX-22008968), 3.2. RTCM 3: RTCM 10403.3, 4. SBF: Septentrio mosaic-X5 reference guide
4.14, 4.1.1. SPARTN: SPARTN interface control document 2.0.1, 3. NovAtel and Unicore: OEM7 commands and logs
(OM-20000169), 1.3; Unicore N4 reference 2.2. SiRF: SiRF binary protocol reference 2.4. Xbus: MT low-level
communication protocol.
"""

import re
import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from operator import xor

from ..maths.crc import crc4, crc16_ccitt, crc24q, fletcher

MOST_BYTES = 8192  # that are looked at
LEAST_OF_TEXT = 3  # lines of a protocol without a checksum, fewer of which may be chance


@dataclass(frozen=True)
class Spoken:
    """What speaks a protocol, and how its frames are told from noise."""

    name: str
    pattern: re.Pattern[bytes]  # a header, with its length in the groups where it has one
    size: Callable[[re.Match[bytes]], int]  # of the frame [bytes]
    is_valid: Callable[[bytes], bool]
    least: int = 1  # frames


@dataclass(frozen=True)
class Recognised:
    """What was found in some bytes: frames of each protocol."""

    frames: dict[str, int]

    @property
    def names(self) -> tuple[str, ...]:
        """The protocols, the one with most frames first."""
        return tuple(sorted(self.frames, key=lambda name: -self.frames[name]))


def recognise(data: bytes) -> Recognised:
    """Find the protocols in some bytes.

    Parameters
    ----------
    data : bytes
        What a device sent, beginning anywhere; the last 8192 bytes are looked at.

    Returns
    -------
    Recognised
        Frames with a valid checksum by protocol. A frame is counted for one protocol only.
    """
    data = data[-MOST_BYTES:]
    found: Counter[str] = Counter()
    for protocol in PROTOCOLS:
        position = number = 0
        while (match := protocol.pattern.search(data, position)) is not None:
            stop = match.start() + protocol.size(match)
            if stop <= len(data) and protocol.is_valid(data[match.start() : stop]):
                number, position = number + 1, stop
            else:
                position = match.start() + 1
        if number >= protocol.least:
            found[protocol.name] = number
    return Recognised(dict(found))


def _little(match: re.Match[bytes]) -> int:
    return int.from_bytes(match[1], "little")


def _whole(match: re.Match[bytes]) -> int:
    return match.end() - match.start()


def _is_ubx(frame: bytes) -> bool:
    return fletcher(frame[2:-2]) == frame[-2:]


def _is_nmea(frame: bytes) -> bool:
    body, _, digits = frame[1:].rpartition(b"*")
    return reduce(xor, body, 0) == int(digits[:2], 16)


def _xbus_size(match: re.Match[bytes]) -> int:
    return 5 + match[1][0] if match[1][0] < 0xFF else 7 + int.from_bytes(match[1][1:3], "big")


def _is_sbf(frame: bytes) -> bool:
    return len(frame) % 4 == 0 and crc16_ccitt(frame[4:]) == int.from_bytes(frame[2:4], "little")


def _is_spartn_header(frame: bytes) -> bool:
    return frame[3] & 15 == crc4(frame[1:4])


def _crc32(data: bytes) -> int:
    """CRC-32 of NovAtel: that of Ethernet without the inversions."""
    return zlib.crc32(data, 0xFFFFFFFF) ^ 0xFFFFFFFF


def _is_novatel(frame: bytes) -> bool:
    return _crc32(frame[:-4]) == int.from_bytes(frame[-4:], "little")


def _is_sirf(frame: bytes) -> bool:
    size = int.from_bytes(frame[2:4], "big")
    return sum(frame[4 : 4 + size]) & 0x7FFF == int.from_bytes(frame[4 + size : 6 + size], "big")


def _anything(_: bytes) -> bool:
    return True


PROTOCOLS = (
    Spoken("UBX", re.compile(rb"\xb5\x62..(.[\x00-\x10])", re.S), lambda m: 8 + _little(m), _is_ubx),
    Spoken("NMEA", re.compile(rb"\$[ -#%-)+-~]{4,248}\*[0-9A-Fa-f]{2}"), _whole, _is_nmea),
    Spoken(
        "RTCM", re.compile(rb"\xd3([\x00-\x03].)", re.S), lambda m: 6 + int.from_bytes(m[1], "big"),
        lambda frame: len(frame) > 8 and crc24q(frame) == 0,
    ),
    Spoken(
        "Xbus", re.compile(rb"\xfa\xff.([\x00-\xfe]|\xff[\x00-\x08].)", re.S), _xbus_size,
        lambda frame: sum(frame[1:]) & 0xFF == 0,
    ),
    Spoken("SBF", re.compile(rb"\$@....(..)", re.S), lambda m: max(_little(m), 8), _is_sbf),
    Spoken("SPARTN", re.compile(rb"s[\x00-\x09]..", re.S), _whole, _is_spartn_header, least=LEAST_OF_TEXT),
    Spoken(
        "NovAtel", re.compile(rb"\xaa\x44\x12\x1c....(..)", re.S), lambda m: 28 + _little(m) + 4, _is_novatel
    ),
    Spoken("Unicore", re.compile(rb"\xaa\x44\xb5...(..)", re.S), lambda m: 24 + _little(m) + 4, _is_novatel),
    Spoken(
        "SiRF", re.compile(rb"\xa0\xa2([\x00-\x03].)", re.S), lambda m: 8 + int.from_bytes(m[1], "big"), _is_sirf,
    ),
    Spoken("ELM327", re.compile(rb"ELM327 v\d|\r>"), _whole, _anything),
    Spoken(
        "slcan", re.compile(rb"t[0-9A-Fa-f]{3}[0-8][0-9A-Fa-f]{0,16}\r"), _whole, _anything, least=LEAST_OF_TEXT
    ),
    Spoken(
        "text lines", re.compile(rb"(?<=\n)[ -~\t]{3,200}\r?\n"), _whole, lambda line: not line.startswith(b"$"),
        least=LEAST_OF_TEXT,
    ),
)  # fmt: skip
BY_NAME = {protocol.name: protocol for protocol in PROTOCOLS}

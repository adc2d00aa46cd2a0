"""SPARTN: frames of corrections.

Source: SPARTN interface control document, version 2.0, section 4: fields TF001 to TF018 of a frame.
"""

from collections.abc import Callable

from ..maths.crc import crc4, crc16_ccitt, crc32_unreflected, crc_of_zeros, crcs_along
from .framing.finder import Sums
from .framing.framing import Framing
from .protocol import Protocol, Reason

HEADER_BYTES = 12  # as many as the longest header has; a shorter one has a payload behind it
MAX_BYTES = 1200  # header 12, payload 1023, authentication 64, CRC 4
_AUTHENTICATION_BYTES = (8, 12, 16, 32, 64)  # by TF015
CRC_8, CRC_16, CRC_24, CRC_32 = range(4)  # TF005


class SpartnFraming(Framing):
    """Preamble, kind (0 to 4, 120), length, CRC of the header, payload, authentication, CRC."""

    protocol, begins = "SPARTN", ((b"s", bytes((*range(10), 0xF0, 0xF1))),)
    starts = rb"s[\x00-\x09\xf0\xf1](?s:.){10}"
    begun = rb"s(?:[\x00-\x09\xf0\xf1](?s:.){0,9})?"
    crc_from = rb"s(?:[\x00-\x09\xf0\xf1]|\Z)"
    most_bytes, too_long, bad_header = MAX_BYTES, "spartn_header", "spartn_header"
    tail, stands_alone = HEADER_BYTES - 1, False  # RXM-PMP holds SPARTN, possibly whole

    def size(self, buffer: bytes | bytearray, start: int, header: int) -> int | None:
        """By the fields of the header, 0 where its CRC is wrong."""
        if header < HEADER_BYTES:
            return None
        head = bytes(buffer[start : start + HEADER_BYTES])
        return spartn_size(head) if head[3] & 0xF == crc4(head[1:4]) else 0

    def fault(self, buffer: bytes | bytearray, start: int, stop: int, at: Callable[[int], Sums]) -> str | None:
        """Compare the CRC of one of four kinds; one of 256 frames of noise has the right 8 bits as well."""
        data = bytes(buffer[start:stop])
        kind = data[3] >> 4 & 3
        if kind == CRC_8:
            return "spartn_crc_8"
        size = kind + 1
        stated = int.from_bytes(data[-size:], "big")
        if kind == CRC_24:  # of all bytes behind the first, from the running CRC before the first
            after_first = crcs_along(at(start)[2], data[:1])[1]
            found = crc_of_zeros(after_first, len(data) - 1 - size) ^ at(stop - size)[2]
        else:
            found = crc16_ccitt(data[1:-size]) if kind == CRC_16 else crc32_unreflected(data[1:-size])
        return None if found == stated else "spartn_checksum"


def spartn_size(head: bytes) -> int:
    """Length of a SPARTN frame by its first twelve bytes, framing and CRC included."""
    bits = int.from_bytes(head, "big")

    def field(at: int, size: int) -> int:
        return bits >> (8 * HEADER_BYTES - at - size) & ((1 << size) - 1)

    payload, encrypted, crc = field(15, 10), field(25, 1), field(26, 2)
    described = 4 + (2 if field(36, 1) else 0)  # subtype, kind of time tag, time tag of 16 or 32 bits, solution
    authentication = 0
    if encrypted:
        indicator = field(32 + 8 * described + 10, 3)
        length = field(32 + 8 * described + 13, 3)
        described += 2
        if indicator > 1:
            authentication = _AUTHENTICATION_BYTES[min(length, 4)]
    return 4 + described + payload + authentication + crc + 1


PROTOCOL = Protocol(
    SpartnFraming(), "SPARTN", frozenset(("corrections",)), reasons={
        "spartn_header": Reason("bytes like a SPARTN header with a wrong CRC", "none: mostly chance within other data"),
        "spartn_checksum": Reason("a SPARTN message with a wrong CRC", "check the source; use another one"),
        "spartn_crc_8": Reason("a SPARTN message with a CRC of 8 bits, too few to tell it from noise",
                               "let the service send CRC-24 or longer"),
    },
)  # fmt: skip

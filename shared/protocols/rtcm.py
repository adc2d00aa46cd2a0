"""RTCM 3: frames of corrections and of bases.

Source: RTCM 10403.3, section 4: the transport layer.
"""

from collections.abc import Callable

from ..maths.crc import crc_of_zeros
from .framing.finder import Sums
from .framing.framing import Framing
from .protocol import Protocol, Reason


class RtcmFraming(Framing):
    """Preamble, length of 10 bits, message, CRC-24Q; the message number is one that is assigned."""

    protocol, begins = "RTCM", ((b"\xd3", bytes(range(4))),)
    starts = rb"\xd3[\x00-\x03](?s:.)[\x3e-\x51\xfa-\xff]"  # 992 to 1311, and from 4000 on
    begun = rb"\xd3(?:[\x00-\x03](?s:.)?)?"
    crc_from = rb"\xd3(?:[\x00-\x03]|\Z)"
    most_bytes, too_long = 1029, "rtcm_length"

    def size(self, buffer: bytes | bytearray, start: int, header: int) -> int | None:
        """By the length in the header."""
        return 6 + (buffer[start + 1] << 8 | buffer[start + 2]) if header == 4 else None

    def fault(self, buffer: bytes | bytearray, start: int, stop: int, at: Callable[[int], Sums]) -> str | None:
        """Compare the CRC of the whole frame, which is 0."""
        return None if crc_of_zeros(at(start)[2], stop - start) == at(stop)[2] else "rtcm_checksum"


PROTOCOL = Protocol(
    RtcmFraming(), "RTCM 3", frozenset(("corrections",)), reasons={
        "rtcm_checksum": Reason("an RTCM message with a wrong CRC",
                                "of a caster: it sends damaged data, use another; of a cable: check ground and rate"),
        "rtcm_length": Reason("an RTCM header with an impossible length", "as rtcm_checksum"),
    },
)  # fmt: skip

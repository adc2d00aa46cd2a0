"""RTCM 3 on the port of a receiver: as that of a base, which is counted here by type and used by nobody.

Source: RTCM 10403.3, section 4: the transport layer.
"""

from collections.abc import Callable, Iterator

from shared.devices.framing import Sums
from shared.maths.crc import crc_of_zeros
from shared.messages.operation import MessageUse

from .dialect import Dialect, Output
from .framing import Framing


class RtcmFraming(Framing):
    """Preamble, length of 10 bits, message, CRC-24Q; the message number is one that is assigned."""

    protocol, first = "RTCM", 0xD3
    starts = rb"\xd3[\x00-\x03](?s:.)[\x3e-\x51\xfa-\xff]"  # 992 to 1311, and from 4000 on
    begun = rb"\xd3(?:[\x00-\x03](?s:.)?)?"
    crc_from = rb"\xd3(?:[\x00-\x03]|\Z)"
    most_bytes, too_long, invalid = 1029, "rtcm_length", "rtcm_checksum"

    def size(self, buffer: bytearray, start: int, header: int) -> int | None:
        """By the length in the header."""
        return 6 + (buffer[start + 1] << 8 | buffer[start + 2]) if header == 4 else None

    def is_valid(self, buffer: bytearray, start: int, stop: int, at: Callable[[int], Sums]) -> bool:
        """Compare the CRC of the whole frame, which is 0."""
        return crc_of_zeros(at(start)[2], stop - start) == at(stop)[2]


class RtcmDialect(Dialect):
    """Names messages by their number; corrections come by `sensors.corrections`, and not from the receiver."""

    name = "RTCM"

    def kind(self, frame: bytes) -> str:
        """Name by the message number."""
        return str(frame[3] << 4 | frame[4] >> 4)

    def use(self, kind: str) -> MessageUse:
        """None is used."""
        return MessageUse.UNUSED

    def take(self, frame: bytes, received_ns: int) -> Iterator[Output]:
        """Nothing follows from it."""
        return iter(())

"""Frames of UBX.

Source: u-blox F9 HPG 1.32 interface description (UBX-22008968), sections 3.2 and 3.4.
"""

from collections.abc import Callable

from shared.devices.framing import Sums

from ..framing import Framing

SYNC = b"\xb5\x62"
MAX_PAYLOAD = 4096  # [bytes] RXM-RAWX of 120 signals is 3856
_SYNC_SUM = sum(SYNC)


class UbxFraming(Framing):
    """Two sync bytes, class, number, length, payload, Fletcher's checksum."""

    protocol, first = "UBX", SYNC[0]
    starts = rb"\xb5\x62(?s:.){3}[\x00-\x10]"
    begun = rb"\xb5(?:\x62(?s:.){0,3})?"
    malformed = {SYNC: "ubx_length"}  # noqa: RUF012  # a constant
    most_bytes, too_long, invalid = 8 + MAX_PAYLOAD, "ubx_length", "ubx_checksum"

    def size(self, buffer: bytearray, start: int, header: int) -> int | None:
        """By the length in the header."""
        return None if header < 6 else 8 + (buffer[start + 5] << 8 | buffer[start + 4])

    def is_valid(self, buffer: bytearray, start: int, stop: int, at: Callable[[int], Sums]) -> bool:
        """Compare the checksum, which is of what lies between the sync bytes and itself."""
        s, w, _ = at(start)
        s, w = s + _SYNC_SUM, w + 2 * s + _SYNC_SUM + SYNC[0]
        s_end, w_end, _ = at(stop - 2)
        a, b = s_end - s & 0xFF, w_end - w - (stop - start - 4) * s & 0xFF
        return a == buffer[stop - 2] and b == buffer[stop - 1]

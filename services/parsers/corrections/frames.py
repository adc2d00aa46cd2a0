"""Extracts frames of corrections from a byte stream that may hold invalid bytes: RTCM 3, SPARTN, and two of UBX.

References
----------
RTCM 10403.3, section 4: transport layer.
SPARTN interface control document, version 2.0, section 4: fields TF001 to TF018 of a frame.
u-blox, ZED-F9 interface description: UBX-RXM-PMP and UBX-RXM-SPARTNKEY as input messages.
"""

import re
from collections import Counter
from dataclasses import dataclass
from itertools import accumulate

from shared.devices.framing import FrameFinder, Sums
from shared.maths.crc import crc4, crc16_ccitt, crc32_unreflected, crc_of_zeros, crcs_along
from shared.messages.corrections import CorrectionProtocol

MAX_UBX_PAYLOAD = 528  # of RXM-PMP; RXM-SPARTNKEY with its two keys has 84
HEADER_BYTES = 12  # of SPARTN: as many as the longest header has; a shorter one has a payload behind it
LONGEST_BYTES = 1200  # SPARTN: header 12, payload 1023, authentication 64, CRC 4
# A header of RTCM whose message number is possible (992 to 1311, and from 4000 on), one of SPARTN of a known kind (0 to
# 4, 120), one of the two UBX messages, or the beginning of one of them at the end of the data.
_STARTS = re.compile(
    rb"\xd3[\x00-\x03](?s:.)[\x3e-\x51\xfa-\xff]|s[\x00-\x09\xf0\xf1](?s:.){10}"
    rb"|\xb5\x62\x02[\x36\x72](?s:.)[\x00-\x02]"
    rb"|(?:\xd3(?:[\x00-\x03](?s:.)?)?|s(?:[\x00-\x09\xf0\xf1](?s:.){0,9})?"
    rb"|\xb5(?:\x62(?:\x02(?:[\x36\x72](?s:.)?)?)?)?)\Z"
)
_RTCM, _SPARTN = 0xD3, 0x73
_AUTHENTICATION_BYTES = (8, 12, 16, 32, 64)  # by TF015
CRC_8, CRC_16, CRC_24, CRC_32 = range(4)  # TF005


@dataclass(frozen=True, slots=True)
class CorrectionFrame:
    """One whole frame with a valid checksum; `kind` is the number of an RTCM message or of a SPARTN or UBX one."""

    protocol: CorrectionProtocol
    kind: tuple[int, int]
    data: bytes


class CorrectionFramer(FrameFinder[CorrectionFrame]):
    """Splits the stream of a source into frames; see `FrameFinder`.

    `rejects` counts `garbage_bytes` and, for invalid frames, `rtcm_checksum`, `spartn_header`, `spartn_checksum`,
    `spartn_crc_8` (a frame with 8 bits of CRC, which one of 256 frames of noise passes as well), `ubx_checksum`,
    `ubx_length`, `cut_frame`, and `ubx_no_correction`: any other UBX message could change the receiver's configuration.
    """

    starts, malformed = _STARTS, re.compile(rb"\xb5\x62")
    kinds = {b"\xb5\x62": "ubx_no_correction"}  # noqa: RUF012  # a constant
    most_bytes = LONGEST_BYTES
    cut = "cut_frame"
    tail = HEADER_BYTES - 1

    def __init__(self, rejects: Counter[str] | None = None) -> None:
        super().__init__(rejects)
        self._c = [0]

    def _sum(self, data: bytes) -> None:
        self._c = crcs_along(self._c[0], data)

    def _sums(self, index: int) -> Sums:
        return (self._c[index],)

    def _carry(self, index: int) -> None:
        self._c = [self._c[index]]

    def _size(self, start: int, match: re.Match[bytes]) -> int | None:
        buffer, header = self._buffer, match.end() - start
        first = buffer[start]
        if first == _RTCM:
            return 6 + (buffer[start + 1] << 8 | buffer[start + 2]) if header == 4 else None
        if first == _SPARTN:
            return self._spartn_size(start) if header == HEADER_BYTES else None
        if header < 6:
            return None
        size = buffer[start + 5] << 8 | buffer[start + 4]
        if size > MAX_UBX_PAYLOAD:
            self._reject(start, "ubx_length")
            return 0
        return 8 + size

    def _spartn_size(self, start: int) -> int:
        head = bytes(self._buffer[start : start + HEADER_BYTES])
        if head[3] & 0xF != crc4(head[1:4]):
            self._reject(start, "spartn_header")
            return 0
        return spartn_size(head)

    def _frame(self, start: int, stop: int, sums: Sums | None) -> CorrectionFrame | None:
        data = bytes(self._buffer[start:stop])
        if data[0] == _RTCM:
            shift = self._base - self._summed_from
            (crc,) = sums or self._sums(start + shift)
            if crc_of_zeros(crc, stop - start) == self._c[stop + shift]:
                return CorrectionFrame(CorrectionProtocol.RTCM3, (data[3] << 4 | data[4] >> 4, 0), data)
            self._reject(start, "rtcm_checksum")
            return None
        return self._spartn(start, data, sums) if data[0] == _SPARTN else self._ubx(start, data)

    def _sure(self, start: int, stop: int) -> bool:
        """Whether a frame inside an incomplete one is none of its content: RXM-PMP holds SPARTN, possibly whole."""
        return self._buffer[start] != _SPARTN

    def _spartn(self, start: int, data: bytes, sums: Sums | None) -> CorrectionFrame | None:
        kind = data[3] >> 4 & 3
        if kind == CRC_8:
            self._reject(start, "spartn_crc_8")
            return None
        size = kind + 1
        stated = int.from_bytes(data[-size:], "big")
        if kind == CRC_24:
            # Of all bytes behind the first, from the running CRC before the first.
            shift = self._base - self._summed_from
            (before,) = sums or self._sums(start + shift)
            after_first = crcs_along(before, data[:1])[1]
            found = crc_of_zeros(after_first, len(data) - 1 - size) ^ self._c[start + len(data) - size + shift]
        else:
            found = crc16_ccitt(data[1:-size]) if kind == CRC_16 else crc32_unreflected(data[1:-size])
        if found != stated:
            self._reject(start, "spartn_checksum")
            return None
        return CorrectionFrame(CorrectionProtocol.SPARTN, (data[1] >> 1, data[4] >> 4), data)

    def _ubx(self, start: int, data: bytes) -> CorrectionFrame | None:
        sums = list(accumulate(data[2:-2]))
        if (sums[-1] & 0xFF, sum(sums) & 0xFF) == (data[-2], data[-1]):
            return CorrectionFrame(CorrectionProtocol.UBX, (data[2], data[3]), data)
        self._reject(start, "ubx_checksum")
        return None


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

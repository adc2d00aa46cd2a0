"""Extracts UBX, NMEA and RTCM 3 messages from a byte stream that may hold invalid bytes."""

import re
from collections import Counter
from dataclasses import dataclass
from enum import Enum, auto
from functools import reduce
from itertools import accumulate
from operator import xor

from shared.devices.framing import FrameFinder, Sums
from shared.maths.crc import crc_of_zeros, crcs_along

UBX_SYNC = b"\xb5\x62"
MAX_UBX_PAYLOAD = 4096  # RXM-RAWX of 120 signals is 3856
MAX_NMEA = 256  # the standard allows 82; proprietary sentences are longer
# A header of UBX whose length is possible, one of RTCM whose message number is (992 to 1311, and from 4000 on), a whole
# sentence (in an Android log with its arrival behind it), or the beginning of one of them at the end of the data.
_STARTS = re.compile(
    rb"\xb5\x62(?s:.){3}[\x00-\x10]|\xd3[\x00-\x03](?s:.)[\x3e-\x51\xfa-\xff]"
    rb"|\$[ -#%-\x7f]{0,248}\*[0-9A-Fa-f]{2}(?:,\d{1,16})?\r{0,3}\n"
    rb"|(?:\xb5(?:\x62(?s:.){0,3})?|\xd3(?:[\x00-\x03](?s:.)?)?|\$[ -#%-\x7f]{0,251}\r{0,3})\Z"
)
_DOLLAR, _RTCM = b"$\xd3"
_SYNC_SUM = sum(UBX_SYNC)


class Protocol(Enum):
    """Protocol of a frame."""

    UBX = auto()
    NMEA = auto()
    RTCM = auto()


@dataclass(frozen=True, slots=True)
class Frame:
    """One complete message with a valid checksum, framing included."""

    protocol: Protocol
    data: bytes


class Framer(FrameFinder[Frame]):
    """Splits the stream of a receiver into frames; see `FrameFinder`.

    `rejects` counts `garbage_bytes` and, for invalid frames, `ubx_checksum`, `ubx_length`, `nmea_checksum`,
    `nmea_form`, `rtcm_checksum` and `cut_frame`. The stream readers of pyubx2 and pynmea2 are not used: they block, do
    not accept chunks, and raise on invalid bytes or accept a corrupted length.

    Notes
    -----
    With the bytes b, their running sum s, the running sum w of s, and the CRC c of all bytes so far, the checksum of
    UBX over the bytes i to j and the CRC over them are::

        s_j - s_i,  w_j - w_i - (j - i) s_i (modulo 256)        c_j - c_i x^(8 (j - i)) (modulo the polynomial)
    """

    starts, malformed = _STARTS, re.compile(rb"\$|\xb5\x62")
    kinds = {b"$": "nmea_form", UBX_SYNC: "ubx_length"}  # noqa: RUF012  # a constant
    most_bytes = MAX_UBX_PAYLOAD
    cut = "cut_frame"

    def __init__(self, rejects: Counter[str] | None = None) -> None:
        super().__init__(rejects)
        self._s, self._w, self._c = [0], [0], [0]

    def _sum(self, data: bytes) -> None:
        self._s = list(accumulate(data, initial=self._s[0]))
        self._w = list(accumulate(self._s[1:], initial=self._w[0]))
        self._c = crcs_along(self._c[0], data)

    def _sums(self, index: int) -> Sums:
        return self._s[index], self._w[index], self._c[index]

    def _carry(self, index: int) -> None:
        self._s, self._w, self._c = [self._s[index] & 0xFF], [self._w[index] & 0xFF], [self._c[index]]

    def _size(self, start: int, match: re.Match[bytes]) -> int | None:
        buffer, header = self._buffer, match.end() - start
        first = buffer[start]
        if first == _DOLLAR:
            return header if buffer[match.end() - 1] == 10 else None
        if first == _RTCM:
            return 6 + (buffer[start + 1] << 8 | buffer[start + 2]) if header == 4 else None
        if header < 6:
            return None
        size = buffer[start + 5] << 8 | buffer[start + 4]
        if size > MAX_UBX_PAYLOAD:
            self._reject(start, "ubx_length")
            return 0
        return 8 + size

    def _frame(self, start: int, stop: int, sums: Sums | None) -> Frame | None:
        first = self._buffer[start]
        if first == _DOLLAR:
            return self._nmea(start, bytes(self._buffer[start:stop]))
        shift = self._base - self._summed_from
        s, w, c = sums or self._sums(start + shift)
        if first == _RTCM:
            if crc_of_zeros(c, stop - start) == self._c[stop + shift]:
                return Frame(Protocol.RTCM, bytes(self._buffer[start:stop]))
            self._reject(start, "rtcm_checksum")
            return None
        # Behind the two sync bytes, where what the checksum is of begins.
        s, w = s + _SYNC_SUM, w + 2 * s + _SYNC_SUM + UBX_SYNC[0]
        end = stop + shift - 2
        a, b = self._s[end] - s & 0xFF, self._w[end] - w - (stop - start - 4) * s & 0xFF
        if a == self._buffer[stop - 2] and b == self._buffer[stop - 1]:
            return Frame(Protocol.UBX, bytes(self._buffer[start:stop]))
        self._reject(start, "ubx_checksum")
        return None

    def _nmea(self, start: int, sentence: bytes) -> Frame | None:
        body, _, digits = sentence[1:].rstrip(b"\r\n").rpartition(b"*")
        if reduce(xor, body, 0) == int(digits[:2], 16):
            return Frame(Protocol.NMEA, sentence)
        self._reject(start, "nmea_checksum")
        return None


def ubx_checksum(data: bytes) -> bytes:
    """8-bit Fletcher checksum (RFC 1145): the sums of the bytes and of their running sums, modulo 256."""
    running = list(accumulate(data))
    return bytes(((running[-1] if running else 0) & 0xFF, sum(running) & 0xFF))

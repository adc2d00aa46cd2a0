"""Extracts the messages of several protocols from a byte stream that may hold invalid bytes."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

from ...maths.crc import crcs_along
from .finder import FrameFinder, Sums
from .framing import Framing


@dataclass(frozen=True, slots=True)
class Frame:
    """One complete message with a valid checksum, framing included."""

    protocol: str
    data: bytes


class Framer(FrameFinder[Frame]):
    """Splits a stream into the frames of some protocols; see `FrameFinder`.

    `rejects` counts `garbage_bytes`, `cut_frame` and, for invalid frames, the kinds of each framing. The stream readers
    of pyubx2 and pynmea2 are not used: they block, do not accept chunks, and raise on invalid bytes or accept a
    corrupted length.

    Notes
    -----
    With the bytes b, their running sum s, the running sum w of s, and the CRC c of all bytes so far, the checksum of
    UBX over the bytes i to j and the CRC over them are::

        s_j - s_i,  w_j - w_i - (j - i) s_i (modulo 256)        c_j - c_i x^(8 (j - i)) (modulo the polynomial)
    """

    cut = "cut_frame"

    def __init__(self, framings: Sequence[Framing], rejects: Counter[str] | None = None) -> None:
        super().__init__(rejects)
        self._s, self._w, self._c = [0], [0], [0]
        self._framings: dict[int, list[Framing]] = {}  # by their first byte: nearly always one
        for framing, first in ((item, first) for item in framings for first in _first_bytes(item)):
            self._framings.setdefault(first, []).append(framing)
        complete = b"|".join(framing.starts for framing in framings)
        begun = b"|".join(framing.begun for framing in framings)
        self.starts = re.compile(complete + rb"|(?:" + begun + rb")\Z")
        self._crc_from = re.compile(b"|".join(framing.crc_from for framing in framings if framing.crc_from) or rb"(?!)")
        malformed = {sync: kind for framing in framings for sync, kind in framing.malformed_beginnings.items()}
        self.malformed, self.kinds = re.compile(b"|".join(map(re.escape, malformed)) or rb"(?!)"), malformed
        self.most_bytes = max(framing.most_bytes for framing in framings)
        self.tail = max(framing.tail for framing in framings)

    def _sum(self, data: bytes) -> None:
        self._s = list(accumulate(data, initial=self._s[0]))
        self._w = list(accumulate(self._s[1:], initial=self._w[0]))
        # Most of the time of framing: only where a frame that has this CRC may begin, or is still open.
        needed = self._open or self._crc_from.search(data)
        self._c = crcs_along(self._c[0], data) if needed else [0] * (len(data) + 1)

    def _sums(self, index: int) -> Sums:
        return self._s[index], self._w[index], self._c[index]

    def _carry(self, index: int) -> None:
        self._s, self._w, self._c = [self._s[index] & 0xFF], [self._w[index] & 0xFF], [self._c[index]]

    def _framing_at(self, start: int) -> Framing:
        """The framing that a candidate is of: the registry has none that begins like another."""
        framings = self._framings[self._buffer[start]]
        if len(framings) == 1:
            return framings[0]
        return next((framing for framing in framings if framing.sync.match(self._buffer, start)), framings[0])

    def _size(self, start: int, match: re.Match[bytes]) -> int | None:
        framing = self._framing_at(start)
        size = framing.size(self._buffer, start, match.end() - start)
        if size == 0 or (size is not None and size > framing.most_bytes):
            self._reject(start, framing.too_long if size else framing.bad_header)
            return 0
        return size

    def _frame(self, start: int, stop: int, sums: Sums | None) -> Frame | None:
        framing, shift = self._framing_at(start), self._base - self._summed_from
        at = lambda index: sums if index == start and sums is not None else self._sums(index + shift)  # noqa: E731
        fault = framing.fault(self._buffer, start, stop, at)
        if fault is None:
            return Frame(framing.protocol, bytes(self._buffer[start:stop]))
        self._reject(start, fault)
        return None

    def _sure(self, start: int, stop: int) -> bool:
        return self._framing_at(start).stands_alone


def _first_bytes(framing: Framing) -> set[int]:
    return {first for beginning in framing.begins for first in beginning[0]}

"""Recognises by its bytes what a device speaks, whether or not the unit reads it: of ports whose rate is unknown."""

import re
from collections import Counter
from dataclasses import dataclass
from functools import cache
from itertools import accumulate

from ..maths.crc import crcs_along
from .framing.finder import Sums
from .framing.framing import Framing
from .registry import PROTOCOLS

MAX_BYTES = 8192  # that are looked at


@dataclass(frozen=True)
class ProtocolCounts:
    """What was found in some bytes: frames of each protocol."""

    frames: dict[str, int]

    @property
    def names(self) -> tuple[str, ...]:
        """The protocols, the one with most frames first."""
        return tuple(sorted(self.frames, key=lambda name: -self.frames[name]))


def recognise(data: bytes) -> ProtocolCounts:
    """Find the protocols in some bytes.

    Parameters
    ----------
    data : bytes
        What a device sent, beginning anywhere; the last 8192 bytes are looked at.

    Returns
    -------
    Recognised
        Frames with a valid checksum by protocol. A line of text with a checksum of NMEA counts as both, unless it is a
        sentence of a receiver.
    """
    data = data[-MAX_BYTES:]
    sums = _SumsOf(data)
    found: Counter[str] = Counter()
    for protocol in PROTOCOLS:
        number = _frames_of(protocol.framing, data, sums)
        if number >= protocol.framing.least:
            found[protocol.name] = number
    return ProtocolCounts(dict(found))


def _frames_of(framing: Framing, data: bytes, sums: "_SumsOf") -> int:
    position = number = 0
    pattern = _compiled(framing.starts)
    while (match := pattern.search(data, position)) is not None:
        start = match.start()
        size = framing.size(data, start, match.end() - start) or 0
        whole = 0 < size <= framing.most_bytes and start + size <= len(data)
        if whole and framing.fault(data, start, start + size, sums) is None:
            number, position = number + 1, start + size
        else:
            position = start + 1
    return number


class _SumsOf:
    """The running sums of some bytes before an index, made when the first header comes."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._sums: list[Sums] | None = None

    def __call__(self, index: int) -> Sums:
        if self._sums is None:
            s = list(accumulate(self._data, initial=0))
            w = accumulate(s[1:], initial=0)
            self._sums = list(zip(s, w, crcs_along(0, self._data), strict=True))
        return self._sums[index]


@cache
def _compiled(pattern: bytes) -> re.Pattern[bytes]:
    return re.compile(pattern)

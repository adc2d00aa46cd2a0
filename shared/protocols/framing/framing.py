"""How the frames of one protocol are found and checked: in a stream by `Framer`, in a sample by `recognise`."""

import re
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property
from itertools import product

from .finder import TAIL, Sums

Beginning = tuple[bytes, ...]  # the bytes that are possible at each place


class Framing(ABC):
    """The frames of one protocol. Patterns are regular expressions of bytes, with `(?s:.)` for any byte."""

    protocol: str  # name, as in `UBX NAV-PVT`
    begins: tuple[Beginning, ...]  # by which a frame is told from those of other protocols
    starts: bytes  # pattern of a complete header that is possible
    most_bytes: int
    least = 1  # frames by which the protocol is recognised: fewer may be chance
    # In streams, which may be hostile: the check of a frame must not cost more than its header.
    begun = b""  # pattern of the beginning of a header, at the end of the data; empty of protocols not read in streams
    malformed: str | None = None  # reject of what begins as a frame without a possible header
    too_long = ""  # reject of a header that states more than `most_bytes`
    bad_header = ""  # reject of a header of the length 0
    crc_from = b""  # pattern of what may begin a frame with a CRC-24Q; empty of protocols without
    tail = TAIL  # [bytes] at the end of the data whose sums may be needed again
    stands_alone = True  # a valid frame inside an incomplete one of another protocol is no content of that

    @cached_property
    def sync(self) -> re.Pattern[bytes]:
        """Pattern of the beginning."""
        return re.compile(b"|".join(b"".join(map(_one_of, beginning)) for beginning in self.begins))

    @property
    def malformed_beginnings(self) -> dict[bytes, str]:
        """Bytes that begin a header, with the reject where it is impossible."""
        if self.malformed is None:
            return {}
        return {bytes(place): self.malformed for beginning in self.begins for place in product(*beginning)}

    @abstractmethod
    def size(self, buffer: bytes | bytearray, start: int, header: int) -> int | None:
        """Length of the frame whose header of so many bytes is at an index; None where it is incomplete.

        0 is that of an impossible header, which is the reject `bad_header`.
        """

    @abstractmethod
    def fault(self, buffer: bytes | bytearray, start: int, stop: int, at: Callable[[int], Sums]) -> str | None:
        """The reject of a frame with a wrong checksum; None of a valid one.

        `at` gives the running sums of the stream before an index, of its first byte and of its last ones: of the
        bytes, of these sums, and CRC-24Q.
        """


def can_begin_alike(one: Framing, other: Framing) -> bool:
    """Whether some bytes begin a frame of either: every place that both state has a byte in common."""
    return any(
        all(set(a) & set(b) for a, b in zip(first, second, strict=False))
        for first in one.begins
        for second in other.begins
    )


def _one_of(place: bytes) -> bytes:
    return b"[" + b"".join(b"\\x%02x" % byte for byte in place) + b"]"

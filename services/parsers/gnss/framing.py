"""What a protocol is told by in a stream: the part of it that `Framer` needs, one object a protocol."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping

from shared.devices.framing import Sums


class Framing(ABC):
    """The frames of one protocol. Patterns are regular expressions of bytes, with `(?s:.)` for any byte."""

    protocol: str  # name, as in `UBX NAV-PVT`
    first: int  # byte with which a frame begins, and none of another protocol
    starts: bytes  # pattern of a complete header that is possible
    begun: bytes  # pattern of the beginning of one, at the end of the data
    malformed: Mapping[bytes, str] = {}  # a constant; bytes that begin a header, and the reject where it is impossible
    most_bytes: int
    too_long: str  # reject of a header that states more
    invalid: str  # reject of a frame with a wrong checksum
    crc_from: bytes = b""  # pattern of what may begin a frame with a CRC-24Q; empty of protocols without

    @abstractmethod
    def size(self, buffer: bytearray, start: int, header: int) -> int | None:
        """Length of the frame whose header of so many bytes is at an index; None where it is incomplete."""

    @abstractmethod
    def is_valid(self, buffer: bytearray, start: int, stop: int, at: Callable[[int], Sums]) -> bool:
        """Whether the checksum of a frame is right.

        `at` gives the running sums of the stream before an index, of its first byte and of its last ones: of the
        bytes, of these sums, and CRC-24Q.
        """

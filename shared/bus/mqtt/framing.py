"""Cuts a stream of bytes into packets."""

from collections.abc import Iterator

from .wire import ProtocolError, Reason


class Framer:
    """Keeps the bytes of a packet that is not complete yet; never more than `limit`, plus one read."""

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self._left = bytearray()

    def feed(self, data: bytes) -> Iterator[tuple[int, bytes]]:
        """Give the first byte and the body of each packet that is complete; raises ProtocolError."""
        source: bytes | bytearray = data
        if self._left:
            self._left += data
            source = self._left
        position = 0
        while (span := self._span(source, position)) is not None:
            start, stop = span
            yield source[position], bytes(source[start:stop])
            position = stop
        if source is data:
            self._left += data[position:]
        else:
            del self._left[:position]

    def only(self, data: bytes) -> tuple[tuple[int, bytes]] | None:
        """Give the one packet that these bytes are, as most reads of a client are; else None, and `feed` them."""
        if self._left or not 2 < len(data) <= self.limit:
            return None
        start, size = 2, data[1]
        if size > 127:
            start, size = 3, size & 0x7F | data[2] << 7
        return ((data[0], data[start:]),) if start + size == len(data) and data[start - 1] < 128 else None

    def _span(self, source: bytes | bytearray, position: int) -> tuple[int, int] | None:
        """Find where the body of the packet at `position` starts and stops; None while bytes are missing."""
        size = 0
        for group, byte in enumerate(source[position + 1 : position + 5]):
            size |= (byte & 0x7F) << 7 * group
            if byte < 0x80:
                start = position + 2 + group
                if start - position + size > self.limit:
                    raise ProtocolError(Reason.PACKET_TOO_LARGE, f"a packet of {size} bytes")
                return (start, start + size) if start + size <= len(source) else None
        if len(source) - position >= 5:
            raise ProtocolError(Reason.MALFORMED_PACKET, "a remaining length of more than four bytes")
        return None

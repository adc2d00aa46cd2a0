"""Decodes the chunked transfer coding of HTTP/1.1 (RFC 9112, section 7.1)."""

import re

from .fault import SourceFault, shown

MAX_LINE = 256  # [bytes] of a size with its extensions
MAX_BYTES = 1 << 20  # of one chunk: casters send one a second, of a few kilobytes
_SIZE = re.compile(rb"([0-9A-Fa-f]{1,8})[ \t]*(?:;[^\r\n]*)?\Z")


class ChunkedDecoder:
    """Decodes a stream in portions; it raises `SourceFault` for what is no such coding."""

    def __init__(self) -> None:
        self._buffer = b""
        self._left = 0  # of the present chunk
        self._ends = False  # a line end must follow the chunk
        self.finished = False  # the last chunk has come

    def feed(self, data: bytes) -> bytes:
        """Decode the next portion; what follows the last chunk is ignored."""
        buffer, out = self._buffer + data, b""
        while buffer and not self.finished:
            if self._left:
                part = buffer[: self._left]
                out, buffer, self._left = out + part, buffer[len(part) :], self._left - len(part)
                self._ends = not self._left
                continue
            line, end, rest = buffer.partition(b"\n")
            if not end:
                if len(buffer) > MAX_LINE:
                    raise SourceFault(f"the caster sends no valid chunk: {shown(buffer, 20)!r}")
                break
            buffer = rest
            self._line(line.rstrip(b"\r"))
        self._buffer = buffer
        return out

    def _line(self, line: bytes) -> None:
        if self._ends:
            if line:
                raise SourceFault(f"a chunk of the caster is longer than it states: {shown(line, 20)!r}")
            self._ends = False
            return
        match = _SIZE.match(line)
        if match is None or int(match[1], 16) > MAX_BYTES:
            raise SourceFault(f"the caster sends no valid size of a chunk: {shown(line, 20)!r}")
        self._left = int(match[1], 16)
        self.finished = not self._left

"""Writes a recording: MCAP in compressed chunks, each written in one go."""

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import IO, Protocol, cast

from mcap.writer import Writer

from ..bus.envelope import Envelope
from .channels import RAW_FORMATS, schema_of
from .foxglove import Foxglove

CHUNK_BYTES = 256 * 1024
VEHICLE_FILE = "vehicle.toml"


class Output(Protocol):
    """The part of an unbuffered file that the writer needs."""

    def write(self, data: memoryview, /) -> int | None:
        """Write as much as possible; returns the number of bytes."""
        ...

    def truncate(self, size: int, /) -> int:
        """Truncate the file."""
        ...

    def seek(self, offset: int, /) -> int:
        """Set the position."""
        ...

    def fileno(self) -> int:
        """File descriptor."""
        ...

    def close(self) -> None:
        """Close the file."""
        ...


Opener = Callable[[Path], Output]


def open_new(path: Path) -> Output:
    """Create a file that must not exist yet, without a buffer of its own."""
    return path.open("xb", buffering=0)


class _WholeChunks:
    """Buffers what `mcap` writes, and writes it to the file in one piece or not at all."""

    def __init__(self, file: Output) -> None:
        self.file = file
        self.bytes_written = 0  # written
        self._waiting = bytearray()

    def write(self, data: bytes) -> int:
        """Append to the buffer."""
        self._waiting += data
        return len(data)

    def tell(self) -> int:
        """Position after the buffered bytes."""
        return self.bytes_written + len(self._waiting)

    def flush(self) -> None:
        """Do nothing: `commit` writes."""

    def commit(self) -> bool:
        """Write the buffer, and return whether it held bytes; after `OSError` file and buffer are as before."""
        data = bytes(self._waiting)
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[self.file.write(rest) or 0 :]
        except OSError:
            self.file.truncate(self.bytes_written)
            self.file.seek(self.bytes_written)
            raise
        self.bytes_written += len(data)
        self._waiting.clear()
        return bool(data)


_USER = re.compile(r"""(?<=://)[^/@\s"']+@""")


def without_users(text: str) -> str:
    """Remove users and passwords from the URLs of a vehicle's file: recordings are passed on to others."""
    return _USER.sub("", text)


class RecordingWriter:
    """A recording being written.

    Channels and schemas stand in the chunk in which they first occur, and in the summary. A write that fails (a full
    disk) raises `OSError`, leaves the file as it was after the chunk before, and is tried once more by whatever writes
    next: at the latest by `close`.
    """

    def __init__(
        self,
        path: Path,
        *,
        vehicle: str = "",
        vehicle_toml: str = "",
        provenance: Mapping[str, str] | None = None,
        chunk_bytes: int = CHUNK_BYTES,
        opener: Opener = open_new,
    ) -> None:
        self.path = path
        self.messages = 0  # written
        self.pending = 0  # not yet written
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._foxglove = Foxglove()
        self._chunks = _WholeChunks(opener(path))
        self._mcap = Writer(cast(IO[bytes], self._chunks), chunk_size=chunk_bytes)
        try:
            self._mcap.start(library="obu")
            self._mcap.add_metadata("obu", {"vehicle": vehicle})
            if provenance is not None:
                self._mcap.add_metadata("provenance", dict(provenance))
            self._mcap.add_attachment(0, 0, VEHICLE_FILE, "application/toml", without_users(vehicle_toml).encode())
            self._commit()
        except OSError:
            self.abandon()
            path.unlink(missing_ok=True)
            raise

    @property
    def bytes_written(self) -> int:
        """Size of the file."""
        return self._chunks.bytes_written

    def write(self, envelope: Envelope) -> None:
        """Add a message; a full chunk is written to the file."""
        topic, arrival_ns = envelope.topic, max(envelope.received_ns, 0)
        if topic not in self._channels:
            metadata = {"data": RAW_FORMATS[topic]} if topic in RAW_FORMATS else {}
            self._channels[topic] = self._mcap.register_channel(topic, "json", self._schema_id(topic), metadata)
            self._commit()  # a chunk that this has made full
        self.pending += 1
        self._mcap.add_message(self._channels[topic], arrival_ns, envelope.payload, arrival_ns)
        for drawn, payload in self._foxglove.messages(envelope):
            if drawn not in self._channels:
                self._channels[drawn] = self._mcap.register_channel(drawn, "json", self._schema_id(drawn))
            self._mcap.add_message(self._channels[drawn], arrival_ns, payload, arrival_ns)
        self._commit()

    def flush(self) -> None:
        """Write the chunk in progress to the file; written chunks survive an end of the process."""
        self._mcap.flush()  # type: ignore[no-untyped-call]  # mcap annotates it by half
        self._commit()

    def fileno(self) -> int:
        """File descriptor, for `os.fdatasync`."""
        return self._chunks.file.fileno()

    def abandon(self) -> None:
        """Close the file without summary, as after a crash."""
        self._chunks.file.close()

    def close(self) -> None:
        """Finish the file with its summary, so that every MCAP tool opens it."""
        try:
            self.flush()
            self._mcap.finish()  # type: ignore[no-untyped-call]
            self._commit()
        finally:
            self.abandon()

    def _commit(self) -> None:
        """Write what `mcap` has finished: it finishes a chunk with the message that makes it full."""
        if self._chunks.commit():
            self.messages, self.pending = self.messages + self.pending, 0

    def _schema_id(self, topic: str) -> int:
        described = schema_of(topic)
        if described is None:
            return 0
        name, text = described
        if name not in self._schemas:
            self._schemas[name] = self._mcap.register_schema(name, "jsonschema", text)
        return self._schemas[name]

"""Writes a recording: MCAP in compressed chunks, each written in one go."""

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import IO, Protocol, cast

from mcap.records import Channel, Schema
from mcap.writer import Writer

from .. import VERSION
from ..bus.envelope import Envelope
from .channels import RAW_FORMATS, schema_of
from .foxglove import Foxglove
from .seals import COPY, SEAL, Sealer

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

    def __init__(self, file: Output, sealer: Sealer | None) -> None:
        self.file = file
        self._sealer = sealer
        self.bytes_written = 0  # written
        self._waiting = bytearray()

    def write(self, data: bytes) -> int:
        """Append to the buffer; what is in it reaches the file in this order, or the file is given up."""
        self._waiting += data
        if self._sealer is not None:
            self._sealer.written(data)
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


_USER = re.compile(r"""(?<=://)[^/\s"']+@""")  # up to the last @: a user may be an address


def without_users(text: str) -> str:
    """Remove users and passwords from the URLs of a vehicle's file: recordings are passed on to others."""
    return _USER.sub("", text)


class RecordingWriter:
    """A recording being written.

    Channels and schemas stand in the chunk in which they first occur, and in the summary. A write that fails (a full
    disk) raises `OSError`, leaves the file as it was after the chunk before, and is tried once more by whatever writes
    next: at the latest by `close`. With a sealer the file is signed every ten seconds and at its end.
    """

    def __init__(  # one argument a part of the file
        self,
        path: Path,
        *,
        vehicle: str = "",
        vehicle_toml: str = "",
        provenance: Mapping[str, str] | None = None,
        chunk_bytes: int = CHUNK_BYTES,
        opener: Opener = open_new,
        sealer: Sealer | None = None,
        copied_by: str = "",  # the program that makes a copy of a signed recording
    ) -> None:
        self.path = path
        self.messages = 0  # written
        self.pending = 0  # not yet written
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._foxglove = Foxglove()
        self._sealer = sealer
        self._chunks = _WholeChunks(opener(path), sealer)
        self._mcap = Writer(cast(IO[bytes], self._chunks), chunk_size=chunk_bytes)
        try:
            self._mcap.start(library="obu")
            metadata = {"obu": {"vehicle": vehicle, "version": VERSION}}
            if provenance is not None:
                metadata["provenance"] = dict(provenance)
            if copied_by:
                metadata[COPY] = {"by": copied_by}
            for name, fields in metadata.items():
                self._mcap.add_metadata(name, fields)
            text = without_users(vehicle_toml).encode()
            self._mcap.add_attachment(0, 0, VEHICLE_FILE, "application/toml", text)
            if sealer is not None:
                sealer.context(metadata, {VEHICLE_FILE: text})
                self._mcap.add_metadata(SEAL, sealer.seal())
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
            self._register(topic, {"data": RAW_FORMATS[topic]} if topic in RAW_FORMATS else {})
            self._commit()  # a chunk that this has made full
        self.pending += 1
        self._add(topic, envelope.payload, arrival_ns)
        for drawn, payload in self._foxglove.messages(envelope):
            if drawn not in self._channels:
                self._register(drawn, {})
            self._add(drawn, payload, arrival_ns)
        if self._sealer is not None:
            self._sealer.notice(envelope)
            if self._sealer.is_due(arrival_ns):
                self._seal()
        self._commit()

    def _register(self, topic: str, metadata: dict[str, str]) -> None:
        schema = self._schema_id(topic)
        number = self._channels[topic] = self._mcap.register_channel(topic, "json", schema, metadata)
        if self._sealer is not None:
            self._sealer.describe(Channel(number, topic, "json", metadata, schema))

    def _add(self, topic: str, payload: bytes, arrival_ns: int) -> None:
        self._mcap.add_message(self._channels[topic], arrival_ns, payload, arrival_ns)
        if self._sealer is not None:
            self._sealer.message(topic, payload, arrival_ns)

    def _seal(self, *, last: bool = False) -> None:
        """Sign what came so far: the chunk in progress is finished for it."""
        assert self._sealer is not None
        self._mcap.flush()  # type: ignore[no-untyped-call]
        self._mcap.add_metadata(SEAL, self._sealer.seal(last=last))

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
            if self._sealer is not None:
                self._seal(last=True)
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
            number = self._schemas[name] = self._mcap.register_schema(name, "jsonschema", text)
            if self._sealer is not None:
                self._sealer.describe(Schema(number, text, "jsonschema", name))
        return self._schemas[name]

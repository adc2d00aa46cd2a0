"""Recordings as other tools rewrite them: another compression, metadata and attachments behind the messages."""

import struct
import zlib
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

MAGIC = b"\x89MCAP0\r\n"


def rewrite(path: Path, to: Path, compression: CompressionType) -> None:
    """Write the messages of a recording anew with the library of MCAP."""
    with path.open("rb") as source, to.open("wb") as target:
        reader, writer = make_reader(source), Writer(target, compression=compression, chunk_size=50_000)
        writer.start("rewritten")
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            if schema is not None and schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas.get(channel.schema_id, 0), channel.metadata
                )
            writer.add_message(
                channels[channel.id], message.log_time, message.data, message.publish_time, message.sequence
            )
        for attachment in reader.iter_attachments():
            writer.add_attachment(
                attachment.create_time, attachment.log_time, attachment.name, attachment.media_type, attachment.data
            )
        for described in reader.iter_metadata():
            writer.add_metadata(described.name, described.metadata)
        writer.finish()  # type: ignore[no-untyped-call]


def chunk(compression: bytes, raw_size: int, data: bytes) -> bytes:
    """A chunk record with any content."""
    head = struct.pack("<QQQII", 1, 2, raw_size, 0, len(compression)) + compression + struct.pack("<Q", len(data))
    return struct.pack("<BQ", 6, len(head) + len(data)) + head + data


def file_of(*chunks: bytes) -> bytes:
    """A closed recording of some chunks, without a summary."""
    header = struct.pack("<BQII", 1, 8, 0, 0)
    footer = struct.pack("<BQQQ", 2, 20, 0, 0)
    return MAGIC + header + b"".join(chunks) + footer + struct.pack("<I", zlib.crc32(footer)) + MAGIC

"""Schemas and channels of a recording that another tool wrote, against the digest of those that were signed.

Another tool may number them as it likes. The unit numbers them by their first message, so that the records that were
signed follow from the content of those in the file and from the order of its messages.
"""

from collections.abc import Iterable
from io import BytesIO
from typing import cast

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from .reader import channel_of
from .seals import described_by, encoded


class Descriptions:
    """Collects the schemas and channels of a file in the order of its records."""

    def __init__(self) -> None:
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._used: dict[str, Channel] = {}  # channel of the first message of each topic
        self._contradicted = False

    def add(self, opcode: int, content: bytes) -> None:
        """Take a record of the data section or of the index; raises one of `MALFORMED`."""
        if opcode == Opcode.SCHEMA:
            schema = cast(Schema, Schema.read(ReadDataStream(BytesIO(content))))
            self._contradicted |= self._schemas.setdefault(schema.id, schema) != schema
        elif opcode == Opcode.CHANNEL:
            channel = channel_of(content)
            self._contradicted |= self._channels.setdefault(channel.id, channel) != channel

    def use(self, number: int) -> None:
        """Note that a message of a channel stands here."""
        channel = self._channels.get(number)
        if channel is None:
            self._contradicted = True
            return
        first = self._used.setdefault(channel.topic, channel)
        if first is not channel:  # a second channel of a topic
            self._contradicted |= self._content(first) != self._content(channel)

    def checked(self, index: Iterable[tuple[int, bytes]], described: str) -> str:
        """Compare with what was signed.

        Parameters
        ----------
        index : iterable of tuple
            Opcode and content of the records behind the data section.
        described : str
            Digest of the schemas and channels in the last seal; empty where that is missing.

        Returns
        -------
        str
            The end of a sentence on what is not proven; empty where all is.

        Raises
        ------
        ValueError
            They are others than those that were signed, or contradict each other; the text says which.
        """
        for opcode, content in index:
            self.add(opcode, content)
        if self._contradicted:
            raise ValueError("its schemas or channels contradict each other")
        if not any(channel.schema_id for channel in self._used.values()):
            return ", without their schemas"
        if not described:
            return ", their schemas are not proven"
        if described_by(self._as_signed()) != described:
            raise ValueError("its schemas or channels are not those that were signed")
        return ""

    def _as_signed(self) -> list[bytes]:
        """The records as the unit numbers them: schemas, then channels, each by its first message."""
        schemas: dict[tuple[str, str, bytes], int] = {}
        records: list[bytes] = []
        channels: list[bytes] = []
        for number, channel in enumerate(self._used.values(), 1):
            schema = self._schemas.get(channel.schema_id)
            place = 0
            if schema is not None:
                key = schema.name, schema.encoding, schema.data
                place = schemas.setdefault(key, len(schemas) + 1)
                if place > len(records):
                    records.append(encoded(Schema(place, schema.data, schema.encoding, schema.name)))
            channels.append(encoded(Channel(number, channel.topic, channel.message_encoding, channel.metadata, place)))
        return [*records, *channels]

    def _content(self, channel: Channel) -> tuple[object, ...]:
        schema = self._schemas.get(channel.schema_id)
        described = None if schema is None else (schema.name, schema.encoding, schema.data)
        return channel.message_encoding, channel.metadata, described

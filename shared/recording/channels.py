"""How an envelope becomes an MCAP message and back, without loss.

One channel a (topic, producer, life of the producer, source). The parts of an envelope that change
from message to message live in the fields that MCAP has for them:

============================  =====================================================
MCAP message                  envelope
============================  =====================================================
``sequence``                  running number of the producer
``log_time``                  arrival at the recorder
``publish_time``              user property ``received_ns`` of raw bytes, else arrival
``data``                      the payload as it is
============================  =====================================================

What does not fit (other user properties, huge numbers, too many channels) travels on the channel
`IRREGULAR` as one line of JSON before the payload.
"""

import json
from dataclasses import dataclass
from functools import cache

from mcap.records import Channel
from pydantic import BaseModel

from ..bus.envelope import Envelope
from ..topics import topic_of

IRREGULAR = "irregular"
MAXIMUM_CHANNELS = 4096
U32, U64 = 1 << 32, 1 << 64

Key = tuple[str, str, int, str | None]


@dataclass(frozen=True)
class Fields:
    """The parts of an MCAP message but for its channel."""

    sequence: int
    publish_time: int
    data: bytes


def key_of(envelope: Envelope) -> Key | None:
    """Name the channel on which an envelope fits; None if it fits on none."""
    properties = envelope.properties
    if not 0 <= envelope.sequence < U32 or not 0 <= envelope.received_ns < U64:
        return None
    if not properties:
        return envelope.topic, envelope.producer, envelope.incarnation, None
    stamp, source = properties.get("received_ns"), properties.get("source")
    if len(properties) != 2 or stamp is None or source is None:
        return None
    if len(stamp) > 19 or not stamp.isascii() or not stamp.isdecimal() or str(int(stamp)) != stamp:
        return None
    return envelope.topic, envelope.producer, envelope.incarnation, source


def metadata_of(key: Key) -> dict[str, str]:
    """Describe a channel in words that other tools show."""
    _, producer, incarnation, source = key
    described = {"from": producer, "life": str(incarnation)}
    return described if source is None else {**described, "source": source}


def encoding_of(topic: str) -> str:
    """Name the encoding of a topic's payloads."""
    row = topic_of(topic)
    return "application/octet-stream" if row is None or row.is_raw else "json"


@cache
def schema_of(topic: str) -> tuple[str, bytes] | None:
    """Describe the payloads of a topic: name and JSON schema; None for raw bytes."""
    row = topic_of(topic)
    if row is None or row.is_raw:
        return None
    return row.message.__name__, json.dumps(row.message.model_json_schema()).encode()


def fields_of(envelope: Envelope, key: Key | None) -> Fields:
    """Fill the MCAP fields of an envelope for the channel of that key."""
    if key is None:
        return Fields(0, max(envelope.received_ns, 0), _framed(envelope))
    publish_time = envelope.received_ns if key[3] is None else int(envelope.properties["received_ns"])
    return Fields(envelope.sequence, publish_time, envelope.payload)


def envelope_of(channel: Channel, fields: Fields, log_time: int) -> Envelope:
    """Rebuild the envelope; raises `ValueError` for a channel that is not ours."""
    if channel.topic == IRREGULAR:
        return _unframed(fields.data)
    source = channel.metadata.get("source")
    return Envelope(
        channel.topic,
        fields.data,
        {} if source is None else {"received_ns": str(fields.publish_time), "source": source},
        log_time,
        channel.metadata.get("from", ""),
        int(channel.metadata.get("life", "0")),
        fields.sequence,
    )


class _Head(BaseModel):
    """All of an envelope but its payload, for what fits on no channel."""

    topic: str
    properties: dict[str, str]
    received_ns: int
    producer: str
    incarnation: int
    sequence: int


def _framed(envelope: Envelope) -> bytes:
    head = _Head.model_validate(envelope, from_attributes=True)
    return head.model_dump_json().encode() + b"\n" + envelope.payload


def _unframed(data: bytes) -> Envelope:
    line, _, payload = data.partition(b"\n")
    head = _Head.model_validate_json(line)
    return Envelope(
        head.topic, payload, head.properties, head.received_ns, head.producer, head.incarnation, head.sequence
    )

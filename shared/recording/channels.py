"""How an envelope becomes an MCAP message and back: one channel a topic, the payload as it is.

The payload says who sent it; ``log_time`` is its arrival at the recorder.
"""

import json
from functools import cache

from mcap.records import Channel

from ..bus import codec
from ..bus.contract import payload_schema
from ..bus.envelope import Envelope
from ..messages.base import RawBytes, Sender
from ..topics import topic_of
from . import foxglove

# What the base64 of the field `data` holds.
RAW_FORMATS = {
    "gnss/raw": "base64 of the receiver's bytes: UBX and NMEA 0183",
    "gnss/write": "base64 of bytes to the receiver: UBX",
    "corrections/raw": "base64 of a source's bytes: RTCM 3, SPARTN, UBX",
    "gnss/correction": "base64 of whole frames to the receiver: RTCM 3, SPARTN, UBX",
    "power/raw": "base64 of registers of the INA219, or of the text of a signal file",
    "imu/raw": "base64 of the sensor's bytes: Xbus",
    "can/raw": "base64 of lines of a candump log",
    "v2x/raw": "base64 of frames of the radio: GeoNetworking, BTP and CAM (UPER)",
    "v2x/send": "base64 of frames for the radio: GeoNetworking, BTP and CAM (UPER)",
}


@cache
def schema_of(topic: str) -> tuple[str, bytes] | None:
    """Describe the payloads of a topic: name and JSON schema; None for a topic that is not of the contract."""
    if (drawn := foxglove.TOPICS.get(topic)) is not None:
        return drawn, json.dumps(foxglove.SCHEMAS[drawn]).encode()
    row = topic_of(topic)
    if row is None:
        return None
    return row.message.__name__, json.dumps(payload_schema(row.message)).encode()


def envelope_of(channel: Channel, data: bytes, log_time: int, sequence: int, publish_time: int) -> Envelope:
    """Rebuild the envelope; raises `BadPayload` for a message that no process of the unit sent."""
    if "life" in channel.metadata:
        data = _from_0_1(channel, data, sequence, publish_time)
    return Envelope.of(channel.topic, data, log_time)


def _from_0_1(channel: Channel, data: bytes, sequence: int, publish_time: int) -> bytes:
    """Make a payload of what version 0.1 recorded: sender, device and stamp of raw bytes stood beside it."""
    row = topic_of(channel.topic)
    if row is not None and issubclass(row.message, RawBytes):
        source = channel.metadata.get("source", "")
        data = codec.encode(row.message(received_ns=publish_time, source=source, data=data))
    incarnation = int(channel.metadata["life"])
    return codec.signed(
        data, Sender(process=channel.metadata.get("from", ""), incarnation=incarnation, sequence=sequence)
    )

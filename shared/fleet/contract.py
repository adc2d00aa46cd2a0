"""The contract between units and a control centre, as an AsyncAPI 3.0 document.

The schemas describe content as it is once CBOR, deflate and the frame of COSE_Sign1 are taken away; what a decoder
refuses besides is in `batch.decode`.
"""

from .. import VERSION
from .batch import (
    DIGEST_BYTES,
    EARLIEST_MS,
    LATEST_MS,
    LIMITS,
    MAX_SEQUENCE,
    MOST_BYTES,
    MOST_EVENTS,
    MOST_REPORTS,
    NAME,
    NOT_NEGATIVE,
    VERDICTS,
    Kind,
    Report,
)
from .batch import VERSION as FORMAT_VERSION
from .receipts import MAX_BATCHES, REASONS
from .sealed import RECEIPT_DIGEST_BYTES
from .topics import BATCH, LIVE, MAX_WATCH_S, RECEIPT, WATCH, WATCHABLE

Json = dict[str, object]
UNITS = {
    "utc_ms": "time [ms, UTC]", "latitude_e7": "latitude [1e-7 deg]", "longitude_e7": "longitude [1e-7 deg]",
    "height_cm": "height above the ellipsoid [cm]", "north_cm_s": "velocity to the north [cm/s]",
    "east_cm_s": "velocity to the east [cm/s]", "level_dm": "horizontal protection level [dm]",
    "verdict": "code of the verdict: " + ", ".join(f"{code} {level}" for code, level in enumerate(VERDICTS)),
}  # fmt: skip
DIGEST: Json = {"type": "string", "contentEncoding": "binary", "description": f"{RECEIPT_DIGEST_BYTES} bytes"}


def asyncapi() -> Json:
    """Describe topics and messages between a unit and a centre."""
    channels = {
        "batch": (BATCH, "one signed batch of reports", "Batch", "send"),
        "receipt": (RECEIPT, "which batches the centre has committed, and which it refuses", "Receipt", "receive"),
        "watch": (WATCH, "asks the unit for live messages, repeated while somebody looks", "Watch", "receive"),
        "live": (f"{LIVE}/{{noun}}/{{name}}", "a message of the unit's bus, while watched", "Live", "send"),
    }
    return {
        "asyncapi": "3.0.0",
        "info": {
            "title": "Units and their control centre",
            "version": VERSION,
            "description": "MQTT 3.1.1 over mutual TLS at QoS 0. What arrives may be lost, repeated or reordered: a "
            "receipt alone says that a batch is stored. Seen from the unit.",
        },
        "servers": {"centre": {"host": "centre.example:8883", "protocol": "mqtts", "protocolVersion": "3.1.1"}},
        "channels": {name: _channel(*row[:3]) for name, row in channels.items()},
        "operations": {
            f"unit.{row[3]}s.{name}": {
                "action": row[3],
                "channel": {"$ref": f"#/channels/{name}"},
                "bindings": {"mqtt": {"qos": 0, "retain": False, "bindingVersion": "0.2.0"}},
            }
            for name, row in channels.items()
        },
        "components": {"messages": _messages()},
    }


def _channel(noun: str, purpose: str, message: str) -> Json:
    parameters: Json = {"vehicle": {"description": "name of the vehicle at the centre, that of its certificate"}}
    if noun.startswith(LIVE):
        parameters |= {
            "noun": {"description": "first part of a topic of the bus"},
            "name": {"description": f"second part; one of {', '.join(WATCHABLE)}"},
        }
    return {
        "address": f"obu/{{vehicle}}/{noun}",
        "description": purpose,
        "parameters": parameters,
        "messages": {message: {"$ref": f"#/components/messages/{message}"}},
    }


def _messages() -> Json:
    cose = 'application/cose; cose-type="cose-sign1"'
    return {
        "Batch": _message("Signed reports, events or a gap, with dense sequence numbers", cose, _batch()),
        "Receipt": _message("Names exactly the batches that it answers", "application/cbor", _receipt()),
        "Watch": _message("Topics that are wanted, and for how long", "application/json", _watch()),
        "Live": _message("As on the bus of the unit: see its own contract", "application/json", {"type": "object"}),
    }


def _message(summary: str, content: str, schema: Json) -> Json:
    form = "application/schema+json;version=draft-2020-12"
    return {"summary": summary, "contentType": content, "payload": {"schemaFormat": form, "schema": schema}}


def _whole(least: int, most: int, description: str) -> Json:
    return {"type": "integer", "minimum": least, "maximum": most, "description": description}


def _batch() -> Json:
    columns = [
        {
            "type": "array",
            "maxItems": MOST_REPORTS,
            "items": {"type": ["integer", "null"]},
            "description": f"{UNITS[name]}, from {0 if number in NOT_NEGATIVE else -LIMITS[number]} to "
            f"{LIMITS[number]}, as differences to the last that is not null",
        }
        for number, name in enumerate(Report._fields)
    ]
    event = [
        _whole(EARLIEST_MS, LATEST_MS, "time [ms, UTC]"),
        {"type": "string", "pattern": f"^{NAME.pattern}$", "description": "topic of the bus"},
        {"type": "object", "description": "content of the message"},
    ]
    digest: Json = {"type": "string", "contentEncoding": "binary"}
    gap = [
        _whole(EARLIEST_MS, LATEST_MS, "time of the first report [ms, UTC]"),
        _whole(EARLIEST_MS, LATEST_MS, "time of the last one"),
        {**digest, "description": "SHA-256 of the last batch it stands for"},
    ]
    return {
        "type": "array",
        "description": f"Payload of COSE_Sign1 (protected header: algorithm, and 8 bytes of the key id; external data: "
        f"name of the vehicle), deflated CBOR; at most {MOST_BYTES} bytes with its signature",
        "prefixItems": [
            {"const": FORMAT_VERSION},
            {"enum": [int(kind) for kind in Kind], "description": ", ".join(f"{k} {k.name.lower()}" for k in Kind)},
            _whole(EARLIEST_MS, LATEST_MS, "epoch: creation time of the outbox [ms, UTC]"),
            _whole(0, MAX_SEQUENCE, "first sequence number"),
            _whole(1, MAX_SEQUENCE, "count of sequence numbers"),
            {**digest, "description": f"SHA-256 of the batch before, {DIGEST_BYTES} bytes"},
            {
                "anyOf": [
                    {"type": "array", "maxItems": 0, "description": "of events"},
                    {"type": "array", "prefixItems": columns, "items": False, "description": "of positions"},
                    {"type": "array", "prefixItems": gap, "items": False, "description": "of a gap"},
                ]
            },
            {"type": "array", "maxItems": MOST_EVENTS, "items": {"type": "array", "prefixItems": event}},
        ],
        "items": False,
    }


def _receipt() -> Json:
    named = [_whole(0, MAX_SEQUENCE, "epoch"), _whole(0, MAX_SEQUENCE, "first sequence number"), DIGEST]
    refused = [*named, {"enum": list(REASONS)}]
    return {
        "type": "object",
        "additionalProperties": False,
        "required": ["stored", "refused"],
        "properties": {
            "stored": {
                "type": "array", "maxItems": MAX_BATCHES,
                "items": {"type": "array", "prefixItems": named, "items": False},
            },
            "refused": {
                "type": "array", "maxItems": MAX_BATCHES,
                "description": "named by the digest alone: epoch and first are 0 where the batch could not be read",
                "items": {"type": "array", "prefixItems": refused, "items": False},
            },
        },
    }  # fmt: skip


def _watch() -> Json:
    return {
        "type": "object",
        "required": ["topics", "for_s", "watchers"],
        "properties": {
            "topics": {"type": "array", "items": {"enum": list(WATCHABLE)}},
            "for_s": {"type": "number", "maximum": MAX_WATCH_S, "description": "seconds from its arrival"},
            "watchers": {"type": "integer", "minimum": 0, "description": "0 ends it"},
        },
    }

"""Prints the topics and processes: Markdown tables, and an AsyncAPI 3.0 document."""

from collections.abc import Sequence
from typing import cast

from pydantic.json_schema import JsonSchemaMode, models_json_schema

from .. import VERSION
from ..messages.base import Message, Sender
from ..processes import LAYERS, PROCESSES
from ..topics import TOPICS, Topic, publications, subscriptions

Json = dict[str, object]


def asyncapi() -> Json:
    """Describe every topic, message and process as an AsyncAPI 3.0 document."""
    return {
        "asyncapi": "3.0.0",
        "info": {
            "title": "On-board unit",
            "version": VERSION,
            "description": "MQTT contract of the on-board unit, derived from shared/topics.py and shared/processes.py.",
        },
        "servers": {
            "vehicle": {"host": "127.0.0.1:1883", "protocol": "mqtt", "protocolVersion": "3.1.1"},
        },
        "channels": {_key(t): _channel(t) for t in TOPICS},
        "operations": _operations(),
        "components": {"messages": {t.message.__name__: _message(t) for t in TOPICS}, "schemas": _schemas()},
    }


def topics_table() -> str:
    """Print the topics as a Markdown table."""
    rows = [
        (
            f"`{t.name}`",
            t.message.__name__,
            t.purpose,
            (f"{t.rate_hz:g}" if t.rate_hz else "on change") + (", fast" if t.fast else ""),
            f"{t.silent_after_s:g}" if t.silent_after_s else "-",
            str(t.qos) + (", retained" if t.retain else ""),
            "every process" if t.per_process else ", ".join(t.producers),
            ", ".join(t.consumers) or "observers",
        )
        for t in TOPICS
    ]
    return table(
        ("topic", "message", "purpose", "rate [Hz]", "silent after [s]", "QoS", "producers", "consumers"), rows
    )


def processes_table() -> str:
    """Print the processes as a Markdown table."""
    rows = [
        (
            f"{row.layer} {list(LAYERS)[row.layer - 1]}",
            f"`{row.name}`",
            row.purpose,
            row.kind.value,
            "everything" if row.observes_all else ", ".join(t.name for t in subscriptions(row.name)) or "-",
            ", ".join(t.name for t in publications(row.name) if not t.per_process) or "-",
        )
        for row in PROCESSES
    ]
    return table(("layer", "process", "purpose", "kind", "consumes", "produces"), rows)


def _key(topic: Topic) -> str:
    return topic.name.replace("/+", "").replace("/", ".")


def _channel(topic: Topic) -> Json:
    address = "obu/{vehicle}/" + topic.name.replace("+", "{process}")
    parameters: Json = {"vehicle": {"description": "name of the vehicle"}}
    if topic.per_process:
        parameters["process"] = {"description": "name of the process", "enum": list(topic.producers)}
    return {
        "address": address,
        "description": topic.purpose,
        "parameters": parameters,
        "messages": {
            topic.message.__name__: {"$ref": f"#/components/messages/{topic.message.__name__}"},
        },
    }


def _operations() -> Json:
    operations: Json = {}
    for topic in TOPICS:
        binding: Json = {"mqtt": {"qos": topic.qos, "retain": topic.retain, "bindingVersion": "0.2.0"}}
        channel = {"$ref": f"#/channels/{_key(topic)}"}
        for name in topic.producers:
            operations[f"{name}.sends.{_key(topic)}"] = {"action": "send", "channel": channel, "bindings": binding}
    for row in PROCESSES:
        for topic in subscriptions(row.name):
            operations[f"{row.name}.receives.{_key(topic)}"] = {
                "action": "receive",
                "channel": {"$ref": f"#/channels/{_key(topic)}"},
            }
    return operations


def _message(topic: Topic) -> Json:
    message = topic.message
    described: Json = {"name": message.__name__, "summary": (message.__doc__ or "").strip().splitlines()[0]}
    described["contentType"] = "application/json"
    described["payload"] = {
        "schemaFormat": "application/schema+json;version=draft-2020-12",
        "schema": {"$ref": f"#/components/schemas/{message.__name__}"},
    }
    return described


def payload_schema(message: type[Message]) -> Json:
    """The JSON schema of a payload: the fields of the message, and its sender."""
    return _with_sender(message.model_json_schema(mode="serialization"), Sender.model_json_schema())


def _with_sender(schema: Json, sender: Json) -> Json:
    properties, required = cast(Json, schema["properties"]), cast(list[str], schema.get("required", []))
    return schema | {"properties": {"sender": sender, **properties}, "required": ["sender", *required]}


def _schemas() -> Json:
    """The schemas of the payloads and of their parts, as `$ref` is resolved from the root of the document."""
    mode: JsonSchemaMode = "serialization"
    kinds: list[type[Message]] = [Sender, *(t.message for t in TOPICS)]
    _, schemas = models_json_schema([(kind, mode) for kind in kinds], ref_template="#/components/schemas/{model}")
    described = cast(Json, schemas["$defs"])
    sender: Json = {"$ref": "#/components/schemas/Sender"}
    payloads = {t.message.__name__: _with_sender(cast(Json, described[t.message.__name__]), sender) for t in TOPICS}
    return described | payloads


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Lay out rows as a Markdown table."""
    lines = ["| " + " | ".join(head) + " |", "|" + " --- |" * len(head)]
    return "\n".join([*lines, *("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows)])

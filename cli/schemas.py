"""Digests of what other programs build on: one short line for each topic, message and HTTP path."""

import json
from collections.abc import Iterator
from hashlib import sha256
from typing import cast

from services.monitoring.status.web.routes import openapi
from shared.bus.contract import Json, asyncapi, table
from shared.fleet.contract import asyncapi as centre_asyncapi

LENGTH = 12  # hexadecimal digits
TEXTS = {"description", "title", "summary", "example", "examples", "tags", "operationId", "deprecated"}
NAMED_OBJECTS = {"properties", "patternProperties", "$defs"}  # objects whose keys are names, not keywords
UNORDERED = {"required", "enum"}
HEAD = (
    "# Digests of the schemas\n\n"
    "Each line is a promise to programs of others: a digest that changes is a change of that topic, message or path, "
    "which [Compatibility](conventions.md#compatibility) judges. A digest is the begin of the SHA-256 of the schema "
    "with all schemas that it refers to, as JSON with sorted keys, without descriptions, titles and examples. "
    "`obu schemas bus|centre|api` prints the whole documents; a unit serves the first and the last at `/asyncapi.json` "
    "and `/openapi.json`.\n"
)


def documents() -> dict[str, Json]:
    """Describe each interface: the bus and the link to a centre in AsyncAPI, the HTTP API in OpenAPI."""
    return {"bus": asyncapi(), "centre": centre_asyncapi(), "api": cast("Json", openapi())}


def schemas_page() -> str:
    """Print the digests."""
    bus, centre, api = (_Document(document) for document in documents().values())
    parts = [HEAD]
    for title, document in (("Bus of a unit", bus), ("Link to a centre", centre)):
        parts += [f"\n## {title}\n\n{table(('topic', 'message', 'digest'), list(document.topics()))}\n"]
        parts += [f"\n{table(('message', 'digest'), list(document.messages()))}\n"]
    parts += [f"\n## HTTP API\n\n{table(('path', 'digest'), list(api.paths()))}\n"]
    return "".join(parts)


def digest(schema: object, document: Json) -> str:
    """Give the digest of a part of a document: it changes with what programs can see, not with words about it."""
    parts: dict[str, object] = {}
    _collect(schema, document, parts)
    text = json.dumps([_essence(schema), {name: _essence(part) for name, part in parts.items()}], sort_keys=True)
    return sha256(text.encode()).hexdigest()[:LENGTH]


class _Document:
    """An AsyncAPI or OpenAPI document, line by line."""

    def __init__(self, document: Json) -> None:
        self._document = document

    def topics(self) -> Iterator[tuple[str, str, str]]:
        """Each topic: its message, and a digest of that name, quality of service and retention."""
        operations = cast("dict[str, Json]", self._document["operations"]).values()
        for key, channel in cast("dict[str, Json]", self._document["channels"]).items():
            (message,) = cast("Json", channel["messages"])
            bindings = [operation["bindings"] for operation in operations
            if operation["channel"] == _reference("channels", key)
                        and "bindings" in operation]  # fmt: skip
            name = str(channel["address"]).removeprefix("obu/{vehicle}/")
            yield f"`{name}`", message, f"`{digest([message, bindings[:1]], {})}`"

    def messages(self) -> Iterator[tuple[str, str]]:
        """Each message with the digest of its payload."""
        components = cast("dict[str, dict[str, Json]]", self._document["components"])
        for name, message in sorted(components["messages"].items()):
            yield name, f"`{digest([message['contentType'], message['payload']], self._document)}`"

    def paths(self) -> Iterator[tuple[str, str]]:
        """Each method of each path with the digest of its parameters, body and answers."""
        for path, methods in cast("dict[str, Json]", self._document["paths"]).items():
            for method, route in methods.items():
                yield f"`{method.upper()} {path}`", f"`{digest(route, self._document)}`"


def _reference(*path: str) -> Json:
    return {"$ref": "#/" + "/".join(path)}


def _collect(node: object, document: Json, parts: dict[str, object]) -> None:
    """Find every part of the document that a part of it refers to."""
    if isinstance(node, dict):
        name = node.get("$ref")
        if isinstance(name, str) and name not in parts:
            parts[name] = found = _find(document, name)
            _collect(found, document, parts)
        for value in node.values():
            _collect(value, document, parts)
    elif isinstance(node, list):
        for value in node:
            _collect(value, document, parts)


def _find(document: Json, reference: str) -> object:
    node: object = document
    for key in reference.removeprefix("#/").split("/"):
        node = cast("Json", node)[key]
    return node


def _essence(node: object, *, names: bool = False) -> object:
    """Leave out what is for people; `names`: the keys are names of fields, which may be called as a keyword is."""
    if isinstance(node, dict):
        kept = {key: value for key, value in node.items() if names or key not in TEXTS}
        return {key: _essence(_sorted(key, value, names=names), names=not names and key in NAMED_OBJECTS)
                for key, value in kept.items()}  # fmt: skip
    return [_essence(value) for value in node] if isinstance(node, list | tuple) else node


def _sorted(key: str, value: object, *, names: bool) -> object:
    """Sort lists whose order means nothing."""
    return sorted(value, key=str) if not names and key in UNORDERED and isinstance(value, list) else value

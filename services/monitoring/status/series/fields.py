"""Names of numeric fields, their units, and their values in a message; pure.

A field is named ``topic[selector]:path``. The selector is needed on topics that carry several things by turns, and is
the value of the first of `SELECTORS` that the message has; without one every message of the topic counts. The path
leads through attributes and positions, ``velocity_ned_m_s.0``, and through lists of records by what identifies each,
``satellites.gps12.cn0_db_hz``. ``@latency_s`` is the time from the stamp of a message to its arrival. What the topic
``computed`` holds is derived from several messages, see `computed`.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import cast

from pydantic import BaseModel

from shared.messages.base import Message, RawBytes
from shared.messages.navigation import AidingKind
from shared.topics import topic_of

COMPUTED, LATENCY = "computed", "@latency_s"
SELECTORS = ("kind", "monitor", "process", "lane", "source")
IDENTITIES = (
    ("constellation", "number", "signal"),
    ("constellation", "number"),
    ("monitor",),
    ("name",),
    ("lane",),
    ("station_id",),
    ("hypothesis",),
    ("number",),
)
FIELD_LENGTH = 200
_NAME = re.compile(r"(?P<topic>[a-z0-9_]+(?:/[a-z0-9_.]+)?)(?:\[(?P<selector>[^\[\]:,]{1,64})\])?:(?P<path>[\w@.\-/]+)")
_STEP = re.compile(r"[\w\-]+")
# Longer endings first: the unit of a number is the end of its field's name.
_ENDINGS = (
    ("_m2_s2", "m²/s²"), ("_m_s2", "m/s²"), ("_rad_s", "rad/s"), ("_db_hz", "dBHz"), ("_rad2", "rad²"), ("_m_s", "m/s"),
    ("_bytes", "B"), ("_deg", "°"), ("_rad", "rad"), ("_m2", "m²"), ("_hz", "Hz"), ("_pa", "Pa"), ("_ns", "ns"),
    ("_m", "m"), ("_s", "s"), ("_k", "K"),
)  # fmt: skip
_KIND_UNITS = {  # of the innovations of each kind, which tests/unit hold to be complete
    AidingKind.GNSS_POSITION: "m", AidingKind.GNSS_VELOCITY: "m/s", AidingKind.ZERO_VELOCITY: "m/s",
    AidingKind.ZERO_ANGULAR_RATE: "rad/s", AidingKind.ODOMETER: "m/s", AidingKind.NON_HOLONOMIC: "m/s",
    AidingKind.BAROMETRIC_HEIGHT: "m", AidingKind.BASELINE_HEADING: "rad", AidingKind.MAGNETIC_HEADING: "rad",
    AidingKind.CARRIER_DISPLACEMENT: "m", AidingKind.EXTERNAL: "",
}  # fmt: skip
_AXES = {"ned": ("north", "east", "down"), "body": ("forward", "right", "down")}


@dataclass(frozen=True)
class Field:
    """A numeric field: where it is found."""

    name: str
    topic: str
    selector: str | None
    path: tuple[str, ...]


@lru_cache(maxsize=1024)
def parse(name: str) -> Field:
    """Read the name of a field; raises ValueError for one that cannot be."""
    match = _NAME.fullmatch(name) if len(name) <= FIELD_LENGTH else None
    if match is None:
        raise ValueError(f"{name[:80]!r} is no field; write topic:field, such as gnss/fix:hdop")
    topic, selector, path = match["topic"], match["selector"], match["path"]
    if topic != COMPUTED and topic_of(topic) is None:
        raise ValueError(f"there is no topic {topic}; /api/state lists them")
    return Field(name, topic, selector, (path,) if topic == COMPUTED else tuple(path.split(".")))


def selector_of(message: Message) -> str | None:
    """Name the source that a message is of, among those that share a topic."""
    return next((str(value) for name in SELECTORS if (value := getattr(message, name, None)) is not None), None)


def value_at(message: object, path: tuple[str, ...]) -> float | None:
    """Find the number at a path; None if there is none."""
    found: object = message
    for step in path:
        found = _inside(found, step)
    number = isinstance(found, int | float) and not isinstance(found, bool)
    return float(cast(float, found)) if number else None


def numbers(message: Message) -> Iterator[tuple[str, float]]:
    """List the paths of the numbers in a message with their values, without time stamps."""
    if not isinstance(message, RawBytes):
        yield from _numbers(message, "")


def unit_of(field: Field) -> str:
    """Name the unit of a field: by the end of its name, otherwise by the schema of its message; "" if it has none."""
    named = [step for step in field.path if not step.isdecimal()]
    last = named[-1].split(".")[0] if named else ""
    by_name = next((unit for ending, unit in _ENDINGS if last.endswith(ending)), None)
    if by_name is not None or field.topic == COMPUTED:
        return by_name or ""
    if "innovation" in last and field.selector in set(AidingKind):
        return _KIND_UNITS.get(AidingKind(field.selector), "")
    row = topic_of(field.topic)
    stated = _stated_unit(row.message, tuple(named)) if row else None
    return stated if stated and stated != "1" and not stated.startswith("of ") else ""


def axis_of(field: Field) -> str:
    """Name the axis of a component of a vector by the frame in the field's name: "north" of `velocity_ned_m_s.0`."""
    if len(field.path) < 2 or not field.path[-1].isdecimal():
        return ""
    place = int(field.path[-1])
    words = field.path[-2].split("_")
    names = next((_AXES[word] for word in words if word in _AXES), ())
    if not names and "bias" in words:
        names = _AXES["body"]
    return names[place] if place < len(names) and "cov" not in words else ""


def _inside(value: object, step: str) -> object:
    match value:
        case BaseModel():
            return getattr(value, step, None) if step in type(value).model_fields else None
        case Mapping():
            return value.get(step)
        case tuple() if step.isdecimal():
            return value[int(step)] if int(step) < len(value) else None
        case tuple():
            return next((entry for entry in value if isinstance(entry, BaseModel) and _identity(entry) == step), None)
        case _:
            return None


def _numbers(value: object, path: str) -> Iterator[tuple[str, float]]:
    inner: Iterator[tuple[str, object]]
    match value:
        case bool():
            return
        case int() | float():
            if not path.endswith("_ns"):
                yield path, float(value)
            return
        case BaseModel():
            inner = ((name, getattr(value, name)) for name in type(value).model_fields)
        case Mapping():
            inner = ((str(key), entry) for key, entry in value.items())
        case tuple():
            inner = ((_identity(entry) or str(place), entry) for place, entry in enumerate(value))
        case _:
            return
    for step, entry in inner:
        if _STEP.fullmatch(step):
            yield from _numbers(entry, f"{path}.{step}" if path else step)


def _identity(entry: object) -> str | None:
    """Name a record of a list by what identifies it, such as gps12 or gps12-1C; None if nothing does."""
    for names in IDENTITIES:
        values = [getattr(entry, name, None) for name in names]
        if all(value is not None for value in values):
            if len(values) == 1:
                return f"{names[0]}{values[0]}" if isinstance(values[0], int) else str(values[0])
            return f"{values[0]}{values[1]}" + "".join(f"-{value}" for value in values[2:])
    return None


def _stated_unit(kind: type[BaseModel], path: tuple[str, ...]) -> str | None:
    schema = _schema(kind)
    for step in path:
        schema = _resolved(schema, _schema(kind))
        properties = cast(dict[str, dict[str, object]], schema.get("properties", {}))
        schema = properties.get(step, schema)
    return _find_unit(schema, _schema(kind))


def _find_unit(schema: dict[str, object], root: dict[str, object]) -> str | None:
    if isinstance(unit := schema.get("unit"), str):
        return unit
    parts = [schema.get("items"), *cast(list[object], schema.get("anyOf", []))]
    parts += cast(list[object], schema.get("prefixItems", []))
    found = (_find_unit(cast(dict[str, object], part), root) for part in parts if isinstance(part, dict))
    return next((unit for unit in found if unit), None)


def _resolved(schema: dict[str, object], root: dict[str, object]) -> dict[str, object]:
    """Follow references and lists to the record that they hold."""
    while "properties" not in schema:
        options = cast(list[dict[str, object]], schema.get("anyOf", []))
        items = schema.get("items")
        if isinstance(reference := schema.get("$ref"), str):
            definitions = cast(dict[str, dict[str, object]], root["$defs"])
            schema = definitions[reference.rsplit("/", 1)[1]]
        elif isinstance(items, dict):
            schema = items
        elif options:
            schema = options[0]
        else:
            break
    return schema


@cache
def _schema(kind: type[BaseModel]) -> dict[str, object]:
    return kind.model_json_schema()

"""The two lists hold together, and what is printed from them is what the code says."""

import importlib
import json
import pkgutil
import re
import typing
from dataclasses import replace
from pathlib import Path
from typing import cast

import jsonschema
from pydantic import BaseModel

from cli.reference import pages as reference
from shared import messages
from shared.bus.contract import asyncapi
from shared.messages.base import Message, Persistent, RawBytes, Sender, StampedMessage, Tick
from shared.messages.gnss import GnssFix, GnssRaw, GnssSatellites
from shared.messages.toll import EvidencePack
from shared.messages.v2x import CamContent
from shared.processes import BY_NAME, PROCESSES, Kind, ProcessRow
from shared.topics import TOPICS, Topic, contradictions, hot_path, subscriptions
from tests.support.cases import each

ROOT = Path(__file__).parents[2]
PRINTED = reference.printed(ROOT)
Schema = dict[str, object]
# The closed list of units that end a field's name; docs/reference/conventions.md explains each.
UNITS = (
    "m",
    "m_s",
    "m_s2",
    "m2",
    "m2_s2",
    "rad",
    "rad_s",
    "rad2",
    "deg",
    "s",
    "ns",
    "hz",
    "k",
    "pa",
    "v",
    "a",
    "db_hz",
    "bytes",
)


def all_messages() -> list[type[Message]]:
    modules = [
        importlib.import_module(f"shared.messages.{iter_module.name}")
        for iter_module in pkgutil.iter_modules(messages.__path__)
    ]
    return sorted(
        {
            kind
            for module in modules
            for kind in vars(module).values()
            if isinstance(kind, type) and issubclass(kind, Message)
        },
        key=lambda kind: kind.__name__,
    )


GOOD = ProcessRow("core.example", Kind.STANDING, "computes", consumes=("gnss/fix",), produces=("v2x/raw",))
FIX, RAW = Topic("gnss/fix", GnssFix, "fixes"), Topic("v2x/raw", GnssRaw, "bytes")
SOURCE = ProcessRow("parsers.gnss", Kind.STANDING, "reads", produces=("gnss/fix",))


def test_tables_that_agree_have_no_contradiction_and_a_topic_may_hold_digits() -> None:
    assert contradictions((SOURCE, GOOD), (FIX, RAW)) == []


@each(
    ("processes", "topics", "text"),
    [
        (
            (SOURCE, replace(GOOD, consumes=("gnss/fixes",))),
            (FIX, RAW),
            "'gnss/fixes', which is no topic; did you mean",
        ),
        (
            (SOURCE, replace(GOOD, produces=("v2x/raw", "toll/x"))),
            (FIX, RAW),
            "'toll/x', which is no topic; add its row",
        ),
        ((GOOD,), (FIX, RAW), "no process produces 'gnss/fix'"),
        ((SOURCE, GOOD, GOOD), (FIX, RAW), "core.example stands in 2 rows"),
        ((SOURCE, GOOD), (FIX, RAW, replace(RAW, message=GnssSatellites)), "v2x/raw stands in 2 rows"),
        ((SOURCE, GOOD), (FIX, replace(RAW, message=GnssFix)), "GnssFix stands in 2 rows"),
        ((SOURCE, replace(GOOD, consumes=("gnss/fix", "gnss/fix"))), (FIX, RAW), "names 'gnss/fix' 2 times"),
        ((SOURCE, replace(GOOD, produces=("v2x/raw", "x/+"))), (FIX, RAW, replace(RAW, name="x/+")), "do not list it"),
        ((SOURCE, replace(GOOD, observes_all=True)), (FIX, RAW), "leave `consumes` out"),
        ((SOURCE, replace(GOOD, name="brain.example")), (FIX, RAW), "'brain.example' is not a layer"),
        ((SOURCE, replace(GOOD, produces=("2x",))), (FIX, replace(RAW, name="2x")), "'2x' is not two lower-case nouns"),
    ],
)
def test_a_row_that_contradicts_another_is_named_with_what_to_change(
    processes: tuple[ProcessRow, ...], topics: tuple[Topic, ...], text: str
) -> None:
    assert [contradiction for contradiction in contradictions(processes, topics) if text in contradiction]


def test_what_every_process_produces_is_derived() -> None:
    assert {topic.name for topic in TOPICS if topic.producers == tuple(BY_NAME)} == {"health/+", "consumed/+"}


def test_every_message_travels_on_a_topic_or_inside_one_that_does() -> None:
    on_topics = {topic.message for topic in TOPICS}
    known: set[type[Message]] = set()
    waiting: list[type[Message]] = [*on_topics, EvidencePack]  # the pack is a file
    while waiting:
        known.add(kind := waiting.pop())
        inside = {part for field in kind.model_fields.values() for part in parts(field.annotation)}
        waiting += [p for p in inside if isinstance(p, type) and issubclass(p, Message) and p not in known]
    assert (
        set(all_messages()) - known - {Message, Persistent, RawBytes, Sender, StampedMessage, Tick, CamContent} == set()
    )


def parts(annotation: object) -> set[object]:
    """List the types that an annotation is made of."""
    return {annotation}.union(*(parts(part) for part in typing.get_args(annotation)))


def test_no_process_of_layers_two_to_four_hears_the_truth() -> None:
    for row in PROCESSES:
        if row.layer in (2, 3, 4):
            assert "truth/state" not in {topic.name for topic in subscriptions(row.name)}, row.name


def test_only_processes_beside_the_hot_path_pause_between_readings_of_the_bus() -> None:
    pausing = [row for row in PROCESSES if row.pause_s]
    assert pausing
    for row in pausing:
        assert row.is_function, f"{row.name} owns its loop, and would ignore its pause_s"
        assert row.name not in hot_path(), f"pause_s of {row.name} would delay the solution"


def test_states_are_retained_and_samples_are_not() -> None:
    for topic in TOPICS:
        assert not topic.retain or topic.qos == 1, f"{topic.name}: a retained message is worth an acknowledgement"
        assert not (topic.retain and (topic.rate_hz or 0) > 2), f"{topic.name}: samples are not retained"


@each("kind", all_messages())
def test_numbers_of_a_message_carry_their_unit_in_the_name_or_in_the_field(kind: type[BaseModel]) -> None:
    for name, schema in kind.model_json_schema().get("properties", {}).items():
        if is_number_without_unit(schema):
            assert name.endswith(tuple(f"_{unit}" for unit in UNITS)), (
                f"{kind.__name__}.{name}: end its name in one of {', '.join(UNITS)}, or make it `Count`, `Ratio` or "
                "what `unit` of shared/messages/base.py makes of it"
            )


def is_number_without_unit(schema: Schema) -> bool:
    if schema.get("type") in ("integer", "number"):
        return "unit" not in schema
    inner = [part for key in ("anyOf", "prefixItems") for part in cast("list[Schema]", schema.get(key, []))]
    inner += [cast(Schema, schema["items"])] if "items" in schema else []
    numbers = [is_number_without_unit(part) for part in inner if part.get("type") != "null"]
    return bool(numbers) and all(numbers)


def test_the_asyncapi_document_refers_only_to_what_it_holds() -> None:
    document = asyncapi()
    text = json.dumps(document)
    for reference_path in set(re.findall(r'"#/([^"]+)"', text)):
        node: object = document
        for part in reference_path.split("/"):
            assert isinstance(node, dict) and part in node, reference_path
            node = node[part]


def test_every_json_message_has_a_valid_schema() -> None:
    for topic in TOPICS:
        if not issubclass(topic.message, RawBytes):
            jsonschema.Draft202012Validator.check_schema(topic.message.model_json_schema())


def test_every_setting_has_a_description() -> None:
    rows = re.findall(r"^\| (`\w+`) \|.*\| (.*) \|$", PRINTED[ROOT / "docs/reference/configuration.md"], re.MULTILINE)
    assert len(rows) > 200
    assert not [name for name, meaning in rows if not meaning.strip()]


@each("path", PRINTED)
def test_what_is_printed_is_what_the_code_says(path: Path) -> None:
    assert path.read_text(encoding="utf-8") == PRINTED[path], "print it anew with `make docs`"


@each("kind", all_messages())
def test_what_may_be_missing_need_not_be_there(kind: type[BaseModel]) -> None:
    for name, field in kind.model_fields.items():
        if type(None) in typing.get_args(field.annotation):
            assert not field.is_required(), f"{kind.__name__}.{name} is left out on the bus when it is None"

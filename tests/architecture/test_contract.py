"""The two lists hold together, and what is printed from them is what the code says."""

import importlib
import json
import pkgutil
import re
import typing
from pathlib import Path

import jsonschema
import pytest
from pydantic import BaseModel

from cli import reference
from shared import messages
from shared.bus.contract import asyncapi
from shared.messages.base import Message, RawBytes, Stamped, Tick
from shared.messages.gnss import Satellite
from shared.messages.operation import ProcessAge, TopicAge
from shared.processes import BY_NAME, PROCESSES
from shared.topics import TOPICS, subscriptions

ROOT = Path(__file__).parents[2]
# The closed list of units that end a field's name; docs/reference/conventions.md explains each.
UNITS = ("m", "m_s", "m_s2", "m2", "m2_s2", "rad", "rad_s", "rad2", "deg", "s", "ns", "hz", "k", "pa", "db_hz", "bytes")
# Numbers without a unit, each with its reason in the message's own comment or docstring.
UNITLESS = {
    "integrity_risk",
    "pdop", "hdop", "vdop", "test_ratio", "seed", "speed", "incarnation", "satellites_used", "number", "request_id",
    "count", "restarts", "messages", "messages_in", "messages_out", "dropped", "reconnections", "fixes_used",
    "fixes_rejected", "samples_used", "samples_rejected", "imu_gaps", "resets", "bytes_written", "innovation",
    "innovation_sd", "weight_ratio", "magnetic_field_body", "epochs_repeated", "measurements_late",
    "quaternion_ned_from_body", "accelerometer_scale", "gyroscope_scale", "parameters", "covariance",
}  # fmt: skip


def all_messages() -> list[type[Message]]:
    modules = [
        importlib.import_module(f"shared.messages.{found.name}") for found in pkgutil.iter_modules(messages.__path__)
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


def test_every_producer_and_consumer_is_a_process() -> None:
    named = {name for topic in TOPICS for name in (*topic.producers, *topic.consumers)}
    assert named <= set(BY_NAME)


def test_a_topic_has_one_message_and_a_message_one_topic() -> None:
    assert len({topic.message for topic in TOPICS}) == len({topic.name for topic in TOPICS}) == len(TOPICS)


def test_every_message_travels_on_a_topic_or_inside_one_that_does() -> None:
    on_topics = {topic.message for topic in TOPICS}
    inside = {Satellite, TopicAge, ProcessAge}
    assert set(all_messages()) - on_topics - inside - {Message, RawBytes, Stamped, Tick} == set()


def test_topic_names_are_two_lower_case_nouns() -> None:
    for topic in TOPICS:
        assert re.fullmatch(r"[a-z_]+/([a-z_]+|\+)", topic.name), topic.name


def test_no_process_of_layers_two_to_four_hears_the_truth() -> None:
    for row in PROCESSES:
        if row.layer in (2, 3, 4):
            assert "truth/state" not in {topic.name for topic in subscriptions(row.name)}, row.name


def test_states_are_retained_and_samples_are_not() -> None:
    for topic in TOPICS:
        assert not topic.retain or topic.qos == 1, f"{topic.name}: a retained message is worth an acknowledgement"
        assert not (topic.retain and (topic.rate_hz or 0) > 2), f"{topic.name}: samples are not retained"


@pytest.mark.parametrize("kind", all_messages(), ids=lambda kind: kind.__name__)
def test_numbers_of_a_message_carry_their_unit_in_the_name(kind: type[BaseModel]) -> None:
    for name, field in kind.model_fields.items():
        if is_number(field.annotation) and name not in UNITLESS:
            assert name.endswith(tuple(f"_{unit}" for unit in UNITS)), f"{kind.__name__}.{name}"


def is_number(annotation: object) -> bool:
    inner = [part for part in typing.get_args(annotation) if part is not type(None)]
    if annotation in (int, float):
        return True
    return bool(inner) and typing.get_origin(annotation) is not dict and all(is_number(p) or p is ... for p in inner)


def test_the_asyncapi_document_refers_only_to_what_it_holds() -> None:
    document = asyncapi()
    text = json.dumps(document)
    for reference_path in set(re.findall(r'"#/(?!\$defs)([^"]+)"', text)):
        node: object = document
        for part in reference_path.split("/"):
            assert isinstance(node, dict) and part in node, reference_path
            node = node[part]


def test_every_json_message_has_a_valid_schema() -> None:
    for topic in TOPICS:
        if not issubclass(topic.message, RawBytes):
            jsonschema.Draft202012Validator.check_schema(topic.message.model_json_schema())


@pytest.mark.parametrize("name", ["topics.md", "processes.md", "configuration.md", "asyncapi.json"])
def test_the_printed_reference_is_what_the_code_says(name: str) -> None:
    page = ROOT / "docs" / "reference" / name
    assert page.read_text(encoding="utf-8") == reference.pages()[name], "print it anew with `make docs`"


@pytest.mark.parametrize("kind", all_messages(), ids=lambda kind: kind.__name__)
def test_what_may_be_missing_need_not_be_there(kind: type[BaseModel]) -> None:
    for name, field in kind.model_fields.items():
        if type(None) in typing.get_args(field.annotation):
            assert not field.is_required(), f"{kind.__name__}.{name} is left out on the bus when it is None"

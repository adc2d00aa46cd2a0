"""Digests of interfaces change with what programs can see, and with nothing else."""

import json
from typing import Any

import pytest
from typer.testing import CliRunner

from cli.main import command_line
from cli.schemas import LENGTH, digest, documents, schemas_page
from shared.topics import TOPICS

FIX: dict[str, Any] = {
    "title": "Fix",
    "description": "A fix.",
    "properties": {
        "title": {"type": "string", "description": "of the receiver"},
        "kind": {"$ref": "#/components/schemas/Kind"},
    },
    "required": ["title", "kind"],
}
KIND: dict[str, Any] = {"title": "Kind", "enum": ["single", "fixed"], "type": "string"}


def digest_of(fix: dict[str, Any], kind: dict[str, Any]) -> str:
    return digest({"$ref": "#/components/schemas/Fix"}, {"components": {"schemas": {"Fix": fix, "Kind": kind}}})


def test_words_about_a_schema_and_orders_without_meaning_do_not_count() -> None:
    fix = {**FIX, "description": "Another text.", "examples": [1], "required": ["kind", "title"]}
    kind = {"type": "string", "enum": ["fixed", "single"]}
    assert digest_of(fix, kind) == digest_of(FIX, KIND)


@pytest.mark.parametrize(
    ("fix", "kind"),
    [
        ({**FIX, "required": ["kind"]}, KIND),
        ({**FIX, "properties": {"kind": FIX["properties"]["kind"]}}, KIND),
        ({**FIX, "properties": {**FIX["properties"], "title": {"type": "integer"}}}, KIND),
        ({**FIX, "additionalProperties": False}, KIND),
        (FIX, {**KIND, "enum": ["single"]}),
    ],
    ids=["no longer required", "a field named as a keyword is gone", "another type", "closed", "a member is gone"],
)
def test_what_a_program_can_see_counts(fix: dict[str, Any], kind: dict[str, Any]) -> None:
    assert digest_of(fix, kind) != digest_of(FIX, KIND)


def test_a_schema_that_refers_to_itself_has_a_digest() -> None:
    tree = {"properties": {"below": {"$ref": "#/components/schemas/Tree"}}}
    document: dict[str, Any] = {"components": {"schemas": {"Tree": tree}}}
    assert len(digest({"$ref": "#/components/schemas/Tree"}, document)) == LENGTH


def test_every_topic_message_and_path_has_a_line() -> None:
    page = schemas_page()
    for topic in TOPICS:
        assert f"| `{topic.name.replace('+', '{process}')}` | {topic.message.__name__} |" in page
    paths = documents()["api"]["paths"]
    assert isinstance(paths, dict)
    for path, methods in paths.items():
        for method in methods:
            assert f"| `{method.upper()} {path}` |" in page
    assert "| Receipt | `" in page


@pytest.mark.parametrize(("interface", "kind"), [("bus", "asyncapi"), ("centre", "asyncapi"), ("api", "openapi")])
def test_the_whole_document_is_printed(interface: str, kind: str) -> None:
    printed = CliRunner().invoke(command_line([]), ["schemas", interface])
    assert printed.exit_code == 0 and kind in json.loads(printed.output)

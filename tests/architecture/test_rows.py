"""What is declared is used: a setting is read, a message is published or handled where the row of a process says."""

import ast
import importlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import cast

import pytest

from shared.processes import PROCESSES, Kind, ProcessRow
from shared.runtime.config import Section, Vehicle, own_fields
from shared.topics import BY_NAME

ROOT = Path(__file__).resolve().parents[2]
# Settings that are read as a group, or by people.
READ_OTHERWISE = {
    *(f"parsers.can.wheel_speed_signals.{wheel}" for wheel in ("front_left", "front_right", "rear_left", "rear_right")),
    "core.spoofing.profile.provenance",
}


@cache
def names(folder: str) -> tuple[frozenset[str], frozenset[str]]:
    """Attributes, and all names, in the code of a folder."""
    attributes, others = set(), set()
    for path in (ROOT / folder).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Attribute):
                attributes.add(node.attr)
            elif isinstance(node, ast.Name):
                others.add(node.id)
            elif isinstance(node, ast.alias):
                others.add(node.name)
    return frozenset(attributes), frozenset(attributes | others)


def package(row: ProcessRow) -> str:
    return f"services/{row.name.replace('.', '/')}"


def settings(section: type[Section], name: str) -> Iterator[tuple[str, str]]:
    """Full name and own name of each setting of a section and of those inside it."""
    for key, field in own_fields(section).items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, Section):
            yield from settings(field.annotation, f"{name}.{key}")
        yield f"{name}.{key}", key


@pytest.mark.parametrize("row", PROCESSES, ids=lambda row: row.name)
def test_every_setting_is_read(row: ProcessRow) -> None:
    config = cast("type[Section]", importlib.import_module(f"services.{row.name}.process").Config)
    read = names(package(row))[0]
    unread = {full for full, key in settings(config, row.name) if key not in read} - READ_OTHERWISE
    assert not unread, f"no code of {package(row)} reads {sorted(unread)}"


def test_every_setting_of_the_vehicle_is_read() -> None:
    read = names("shared")[0].union(*(names(package(row))[0] for row in PROCESSES))
    assert {full for full, key in settings(Vehicle, "vehicle") if key not in read} == set()


@pytest.mark.parametrize("row", PROCESSES, ids=lambda row: row.name)
def test_a_process_makes_what_its_row_produces_and_handles_what_it_consumes(row: ProcessRow) -> None:
    known = names(package(row))[1]
    if row.kind is Kind.DEVICE_DRIVER:
        known |= names("shared/devices")[1]
    for verb, topics in (("produces", row.produces), ("consumes", row.consumes)):
        missing = {BY_NAME[topic].message.__name__ for topic in topics} - known
        assert not missing, f"the row of {row.name} {verb} {sorted(missing)}, which no code of {package(row)} names"

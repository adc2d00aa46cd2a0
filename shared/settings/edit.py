"""Changes of a vehicle's file: comments and order stay, and what the file would mean is checked first."""

import tomllib
from collections.abc import Callable, Mapping, MutableMapping
from dataclasses import dataclass
from typing import cast

import tomlkit
from tomlkit.exceptions import TOMLKitError

from ..errors import UserError
from ..processes import BY_NAME
from ..runtime.config import VehicleFile, parse_vehicle
from ..runtime.migration import table_at
from .catalogue import FACTS, Setting, catalogue, uses_facts, validate, values_of
from .digests import READS

Table = MutableMapping[str, object]
REMOVED = object()  # in the place of a value: the default holds


@dataclass(frozen=True)
class Difference:
    """One setting whose value differs between two files."""

    setting: Setting
    before: object
    after: object


def value_from(text: str, setting: Setting) -> object:
    """Read a value as TOML has it; text of a setting that is text needs no quotes.

    Raises
    ------
    UserError
        The text is no value.
    """
    try:
        value: object = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text
    types = setting.kind.split(" or ")
    if "string" in types and not isinstance(value, str) and not {"array", "object", "table"} & set(types):
        is_other = isinstance(value, bool) and "boolean" in types
        is_number = isinstance(value, int | float) and {"number", "integer"} & set(types)
        value = value if is_other or is_number else text
    if isinstance(value, str) and "string" not in types:
        raise UserError(f"{setting.name} is {setting.kind}, and {text!r} is not; {example(setting)}")
    return value


def example(setting: Setting) -> str:
    """How a value of a setting is written."""
    if setting.choices:
        return f"choose {', '.join(setting.choices)}"
    shown = tomlkit.item(setting.default).as_string() if setting.default is not None else None
    return f"write it as {shown}" if shown else f"`obu config get {setting.name}` describes it"


def edited(text: str, changes: Mapping[str, object]) -> str:
    """Text of a file with other values, by the names of settings; `REMOVED` takes a value away.

    Raises
    ------
    UserError
        The file is no TOML that can be edited.
    """

    def change(file: Table) -> None:
        for name, value in changes.items():
            *sections, key = name.split(".")
            if value is not REMOVED:
                table_at(file, sections)[key] = value
            elif _has(file, sections, key):
                table_at(file, sections).pop(key)

    return _changed(text, change)


def with_sections(text: str, runs: Mapping[str, bool]) -> str:
    """Text of a file with the sections of processes that are to run, and without those of processes that are not.

    Raises
    ------
    UserError
        The file is no TOML that can be edited.
    """

    def change(file: Table) -> None:
        for name, wanted in runs.items():
            layer, process = name.split(".")
            if wanted:
                table_at(file, [layer, process])
            elif _has(file, [layer], process):
                table_at(file, [layer]).pop(process)

    return _changed(text, change)


def _changed(text: str, change: Callable[[Table], None]) -> str:
    """Text of a file with a change; all else stays as it is written."""
    try:
        file = tomlkit.parse(text)
        change(cast(Table, file))
        return tomlkit.dumps(file)
    except TOMLKitError as error:
        raise UserError(f"the file cannot be edited: {error}; correct it by hand") from error


def checked(text: str, path: str) -> VehicleFile:
    """Read a file and every section of it; raises `ConfigError` with what is wrong, before anything is written."""
    file = parse_vehicle(text, path)
    validate(file)
    return file


def differences(before: VehicleFile, after: VehicleFile) -> list[Difference]:
    """Settings whose values differ, in the order of the processes; a section that a file lacks has its defaults."""
    sections = {*before.processes, *after.processes}
    settings = catalogue(after.role, tuple(sections))
    old, new = values_of(before, settings), values_of(after, settings)
    return [Difference(one, old[one], new[one]) for one in settings if old[one] != new[one]]


def touched(changes: list[Difference], after: VehicleFile, before: VehicleFile) -> list[str]:
    """Processes for which the files differ: they take it up when they start again."""
    other = set(after.processes) ^ set(before.processes)  # begins or ends with its section
    sections = {change.setting.section for change in changes} | other
    names = [
        name for name in after.processes
        if name in sections or (FACTS in sections and uses_facts(name)) or (other and BY_NAME[name].observes_all)
        or any(section.startswith(READS.get(name, ())) for section in sections)
    ]  # fmt: skip
    return sorted({*names, *other}, key=[*after.processes, *before.processes].index)


def _has(file: Mapping[str, object], sections: list[str], key: str) -> bool:
    table: object = file
    for section in sections:
        table = table.get(section) if isinstance(table, Mapping) else None
    return isinstance(table, Mapping) and key in table

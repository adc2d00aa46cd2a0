"""Every setting by its name: where it stands, what it is, its bounds, default and value.

A name is that of the section and of the key, `core.fusion.gnss.delay_s`; facts of the vehicle begin with `vehicle.`.
"""

import inspect
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache
from typing import cast

from pydantic import BaseModel

from ..errors import UserError
from ..processes import BY_NAME, Role, running
from ..runtime.config import Section, Vehicle, VehicleFile, VehicleSettings, own_fields, settings_model

FACTS = "vehicle"
# Beginnings of the bounds of JSON schema, and how they are said.
BOUNDS = (
    ("minimum", "at least {}"), ("exclusiveMinimum", "above {}"), ("maximum", "at most {}"),
    ("exclusiveMaximum", "below {}"), ("maxLength", "{} characters at most"), ("maxItems", "{} entries at most"),
)  # fmt: skip
Json = dict[str, object]


@dataclass(frozen=True, eq=False)
class Setting:
    """One setting as the models of the settings describe it."""

    section: str  # `vehicle` or a process
    key: str  # within it, dotted
    kind: str  # JSON type, or types
    bounds: tuple[str, ...]
    choices: tuple[str, ...]
    default: object
    meaning: str

    @property
    def name(self) -> str:
        """Section and key."""
        return f"{self.section}.{self.key}"


def section_of(name: str) -> type[Section]:
    """Model of a section: of the facts of the vehicle, or of a process's settings."""
    return Vehicle if name == FACTS else settings_model(name)


@cache
def settings_of(section: str) -> tuple[Setting, ...]:
    """Every setting of a section."""
    kind = section_of(section)
    schema = kind.model_json_schema()
    return tuple(_settings(section, "", kind, schema, cast("Json", schema.get("$defs", {}))))


def catalogue(role: Role, sections: Sequence[str] = ()) -> list[Setting]:
    """Every setting of a role's standing processes, and of further sections, in the order of the processes."""
    names = [FACTS, *(row.name for row in running(role, sections))]
    return [setting for name in names for setting in settings_of(name)]


def find(name: str) -> Setting:
    """Setting of a name.

    Raises
    ------
    UserError
        There is none; names the most similar one.
    """
    section = FACTS if name.startswith(f"{FACTS}.") else ".".join(name.split(".")[:2])
    if section != FACTS and section not in BY_NAME:
        near = get_close_matches(section, [FACTS, *BY_NAME], n=1)
        raise UserError(
            f"there is no section {section!r}" + (f"; did you mean {near[0]!r}?" if near else "; try `obu config list`")
        )
    known = {setting.name: setting for setting in settings_of(section)}
    if name in known:
        return known[name]
    near = get_close_matches(name, known, n=1) or [
        other for other in known if name.rpartition(".")[2] and other.endswith(name.rpartition(".")[2])
    ]
    hint = f"did you mean {near[0]!r}?" if near else f"`obu config list {section}` lists those of its section"
    raise UserError(f"there is no setting {name!r}; {hint}")


def value_of(file: VehicleFile, setting: Setting) -> object:
    """Value that holds: that of the file, or the default; raises `ConfigError` for an invalid section."""
    return values_of(file, [setting])[setting]


def values_of(file: VehicleFile, settings: Iterable[Setting]) -> dict[Setting, object]:
    """Values that hold, as `value_of`; each section is read once."""
    sections: dict[str, Section] = {}
    values: dict[Setting, object] = {}
    for setting in settings:
        if setting.section not in sections:
            sections[setting.section] = file.section(setting.section, section_of(setting.section))
        found: object = sections[setting.section]
        for step in setting.key.split("."):
            found = getattr(found, step)
        values[setting] = plain(found)
    return values


def plain(value: object) -> object:
    """Value of a model as TOML and JSON have it."""
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json")
    if isinstance(value, dict):
        return {key: plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    if value is None or isinstance(value, bool | int | float):
        return value
    return str(value)


def validate(file: VehicleFile) -> None:
    """Check every section of a file; raises `ConfigError` with the first that is wrong."""
    for name in (FACTS, *file.processes):
        file.section(name, section_of(name))


def uses_facts(process: str) -> bool:
    """Whether a process reads facts of the vehicle beside its own section."""
    return issubclass(section_of(process), VehicleSettings)


def _settings(section: str, inside: str, kind: type[Section], schema: Json, definitions: Json) -> Iterator[Setting]:
    properties = cast("dict[str, Json]", schema.get("properties", {}))
    for key, info in own_fields(kind).items():
        inner, name = info.annotation, f"{inside}{key}"
        if inspect.isclass(inner) and issubclass(inner, Section):
            yield from _settings(section, f"{name}.", inner, inner.model_json_schema(), definitions)
            continue
        field = properties[key]
        options = [_resolved(option, definitions) for option in cast("list[Json]", field.get("anyOf", [field]))]
        choices = [str(choice) for option in options for choice in cast("list[object]", option.get("enum", ()))]
        bounds = [text.format(option[word]) for option in options for word, text in BOUNDS if word in option]
        default = None if info.is_required() else plain(info.get_default(call_default_factory=True))
        kinds = " or ".join(str(option.get("type", "table")) for option in options)
        meaning = str(field.get("description", ""))
        yield Setting(section, name, kinds, tuple(bounds), tuple(choices), default, meaning)


def _resolved(option: Json, definitions: Json) -> Json:
    """What a reference of a schema refers to."""
    reference = option.get("$ref")
    if not isinstance(reference, str):
        return option
    found = definitions.get(reference.rpartition("/")[2], option)
    return cast("Json", found)

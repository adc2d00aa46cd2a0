"""Rewrites vehicle files of earlier versions; comments and order of the file stay."""

from collections.abc import Mapping, MutableMapping
from operator import mul
from typing import cast

import tomlkit
from tomlkit.items import Array, InlineTable

from ..errors import ConfigError
from .config import LEVEL_MOUNTING, Matrix3, mounting_from, read_toml
from .old_keys import (
    EMPTIED,
    FUSION_MOUNTING,
    MOUNTING,
    PARSER_MOUNTING,
    PRESENT_KEYS,
    REMOVED,
    STATED_AGAIN,
    in_section,
    old_keys,
    value_at,
)

DIGITS = 9  # of an element of a matrix that is a product


def migrated(text: str, path: str) -> tuple[str, list[str]]:
    """Rewrite the text of a vehicle's file with the keys of this version.

    Parameters
    ----------
    text : str
        Of the file, of this or an earlier version.
    path : str
        For errors.

    Returns
    -------
    tuple of str and list of str
        The new text, which is the given one where nothing is old; and one sentence a change.

    Raises
    ------
    ConfigError
        The text is not valid TOML, or a value that has to be moved is invalid.
    """
    document = read_toml(text, path)
    found = list(old_keys(document))
    emptied = value_at(document, EMPTIED) is not None
    if not found and not emptied:
        return text, []
    _refuse_rivals(document, found, path)
    mounting = _mounting(document, path) if {PARSER_MOUNTING, FUSION_MOUNTING} & set(found) else None
    file = cast("MutableMapping[str, object]", tomlkit.parse(text))
    changes = []
    for key in found:
        value = _removed(file, key)
        if key in REMOVED:
            changes.append(f"{in_section(key)} is left out; {REMOVED[key]}")
            continue
        new = PRESENT_KEYS[key]
        if key in STATED_AGAIN:
            again = value_at(document, key)
            changes.append(f"{in_section(key)} = {again} is left out; {in_section(new)} is that of all processes")
        elif new != MOUNTING:
            table_at(file, new.split(".")[:-1])[new.rpartition(".")[2]] = value
            changes.append(f"{in_section(key)} -> {in_section(new)}")
    if mounting is not None:
        table_at(file, ["vehicle", "imu"])["body_from_sensor"] = _rows(mounting)
        olds = [in_section(key) for key in found if PRESENT_KEYS.get(key) == MOUNTING]
        changes.append(f"{' and '.join(olds)} -> {in_section(MOUNTING)}")
    if emptied and not table_at(file, EMPTIED.split(".")):
        _removed(file, EMPTIED)
        changes.append(f"[{EMPTIED}] is empty and removed")
    return tomlkit.dumps(cast(tomlkit.TOMLDocument, file)), changes


def _refuse_rivals(document: Mapping[str, object], found: list[str], path: str) -> None:
    """Raise `ConfigError` where a setting stands twice in a file, by keys of different versions."""
    taken = {key: key for key in PRESENT_KEYS.values() if value_at(document, key) is not None}
    for key in found:
        if key in REMOVED or key in STATED_AGAIN or PRESENT_KEYS[key] == MOUNTING:
            continue
        new = PRESENT_KEYS[key]
        if new in taken:
            raise ConfigError(f"{path} holds both {in_section(key)} and {in_section(taken[new])}; remove one")
        taken[new] = key


def mounting_of_samples(text: str, path: str) -> Matrix3:
    """Mounting with which the samples of a recording were turned into published axes, by its vehicle's file."""
    document = read_toml(text, path)
    key = PARSER_MOUNTING if value_at(document, PARSER_MOUNTING) is not None else MOUNTING
    return _matrix(document, key, path, LEVEL_MOUNTING)


def _mounting(document: Mapping[str, object], path: str) -> Matrix3:
    """The one mounting of a file that has it in parts: published axes from the sensor's, then the correction."""
    present = value_at(document, MOUNTING)
    parsed = _matrix(document, PARSER_MOUNTING, path, LEVEL_MOUNTING)
    if present is not None:
        raise ConfigError(f"{path} holds {in_section(MOUNTING)} and an older key for the same; remove the older one")
    corrected = _matrix(document, FUSION_MOUNTING, path, ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
    columns = tuple(zip(*parsed, strict=True))
    product = [[sum(map(mul, row, column)) for column in columns] for row in corrected]
    return mounting_from([[round(value, DIGITS) + 0.0 for value in row] for row in product])  # -0.0 becomes 0.0


def _matrix(document: Mapping[str, object], key: str, path: str, default: Matrix3) -> Matrix3:
    value = value_at(document, key)
    try:
        return default if value is None else mounting_from(value)
    except ValueError as error:
        raise ConfigError(f"{path}: {in_section(key)}: {error}") from error


def _removed(file: MutableMapping[str, object], key: str) -> object:
    *sections, name = key.split(".")
    return table_at(file, sections).pop(name)


def table_at(file: MutableMapping[str, object], sections: list[str]) -> MutableMapping[str, object]:
    """The table of a section, made where it is missing."""
    table = file
    for depth, section in enumerate(sections):
        if section not in table:
            within = tomlkit.table(is_super_table=depth < len(sections) - 1)
            table[section] = tomlkit.inline_table() if isinstance(table, InlineTable) else within
        table = cast("MutableMapping[str, object]", table[section])
    return table


def _rows(matrix: Matrix3) -> Array:
    rows = tomlkit.array()
    for row in matrix:
        rows.append(list(row))
    return rows

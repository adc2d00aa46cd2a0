"""Command-line overrides of the settings of a vehicle file."""

import difflib
import re
from collections.abc import Sequence
from dataclasses import replace
from enum import StrEnum

from shared.bounded import load_toml
from shared.errors import UserError
from shared.processes import BY_NAME
from shared.runtime.config import VehicleFile, with_values


class Aiding(StrEnum):
    """Aiding of the filter in addition to GNSS and standstill."""

    FREE = "free"
    NHC = "nhc"
    ODOMETER = "odometer"


LAYERS = {"vehicle", *(name.partition(".")[0] for name in BY_NAME)}
SWITCHES = {
    Aiding.FREE: ("core.fusion.odometer.enabled=false", "core.fusion.non_holonomic.enabled=false"),
    Aiding.NHC: ("core.fusion.odometer.enabled=false", "core.fusion.non_holonomic.enabled=true"),
    Aiding.ODOMETER: ("core.fusion.odometer.enabled=true", "core.fusion.non_holonomic.enabled=true"),
}


def with_settings(vehicle: VehicleFile, settings: Sequence[str]) -> VehicleFile:
    """Override settings of a vehicle file.

    Parameters
    ----------
    vehicle : VehicleFile
        The original, which is not modified.
    settings : sequence of str
        Each `process.setting=value` or `process.section.setting=value`, the value in TOML syntax; `vehicle` stands
        for a process; without a process it is a setting of core.fusion. Later ones override earlier ones.

    Returns
    -------
    VehicleFile
        A copy with changed tables.

    Raises
    ------
    UserError
        A setting has an invalid syntax or an unknown process.
    """
    tables = dict(vehicle.tables)
    for text in settings:
        name, key, value = _parsed(text)
        tables[name] = with_values(tables.get(name, {}), {key: value})
    return replace(vehicle, tables=tables)


# A name or a path need no quotes, which a shell would take away; what reads like true or false is no word.
WORD = re.compile(r"[A-Za-z/~.][\w/~.-]*")
NO_WORDS = {"true", "false", "yes", "no", "on", "off", "none", "null", "nan", "inf"}


def _parsed(text: str) -> tuple[str, str, object]:
    path, equals, value = text.partition("=")
    parts = path.strip().split(".")
    if parts[0] not in LAYERS:
        parts = ["core", "fusion", *parts]
    name, key = ".".join(parts[:2]), ".".join(parts[2:])
    if not (equals and key and all(parts)):
        raise UserError(f"--set {text} is invalid; write it as --set core.fusion.odometer.enabled=false")
    if parts[0] == "vehicle":
        name, key = "vehicle", ".".join(parts[1:])
    elif name not in BY_NAME:
        near = difflib.get_close_matches(name, BY_NAME, n=1)
        hint = f"did you mean {near[0]}?" if near else "`obu topics --processes` lists them"
        raise UserError(f"--set {text}: unknown process {name!r}; {hint}")
    if WORD.fullmatch(value.strip()) and value.strip().lower() not in NO_WORDS:
        return name, key, value.strip()
    try:
        return name, key, load_toml(f"value = {value.strip()}")["value"]
    except ValueError as error:
        raise UserError(
            f'--set {text}: {value.strip()!r} is not a value; write true, 0.5, [1.0, 0.0, 0.0] or "word"'
        ) from error

"""Settings that the command line puts in the place of those of the vehicle's file."""

import difflib
import tomllib
from collections.abc import Sequence
from dataclasses import replace
from enum import StrEnum

from shared.errors import UserError
from shared.processes import BY_NAME
from shared.runtime.config import VehicleFile


class Aiding(StrEnum):
    """What helps the filter besides GNSS and standstill, as comparisons of filters are made."""

    FREE = "free"
    NHC = "nhc"
    ODOMETER = "odometer"


SWITCHES = {
    Aiding.FREE: ("core.fusion.odometer=false", "core.fusion.non_holonomic=false"),
    Aiding.NHC: ("core.fusion.odometer=false", "core.fusion.non_holonomic=true"),
    Aiding.ODOMETER: ("core.fusion.odometer=true", "core.fusion.non_holonomic=true"),
}


def with_settings(vehicle: VehicleFile, settings: Sequence[str]) -> VehicleFile:
    """Put settings in place of those of the vehicle's file.

    Parameters
    ----------
    vehicle : VehicleFile
        It is left as it is.
    settings : sequence of str
        Each `process.setting=value`, the value as TOML writes it; of two the later counts.

    Returns
    -------
    VehicleFile
        The file with its tables changed.

    Raises
    ------
    UserError
        A setting is not understood, or names no process.
    """
    tables = {name: dict(table) for name, table in vehicle.tables.items()}
    for text in settings:
        name, key, value = _parsed(text)
        tables.setdefault(name, {})[key] = value
    return replace(vehicle, tables=tables)


def _parsed(text: str) -> tuple[str, str, object]:
    path, equals, value = text.partition("=")
    name, _, key = path.strip().rpartition(".")
    if not (equals and name and key):
        raise UserError(f"--set {text} is not understood; write it as --set core.fusion.odometer=false")
    if name not in BY_NAME:
        near = difflib.get_close_matches(name, BY_NAME, n=1)
        hint = f"did you mean {near[0]}?" if near else "`obu topics --processes` lists them"
        raise UserError(f"--set {text}: there is no process {name!r}; {hint}")
    try:
        return name, key, tomllib.loads(f"value = {value.strip()}")["value"]
    except tomllib.TOMLDecodeError as error:
        raise UserError(
            f'--set {text}: {value.strip()!r} is no value; write true, 0.5, [1.0, 0.0, 0.0] or "word"'
        ) from error

"""RTKLIB's solution files (.pos): the time scale that their header states, and the mapping of their columns."""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass

from shared.errors import UserError

# The last line of the header, such as `%  GPST   latitude(deg) longitude(deg)  height(m)   Q  ns ...`; the time is in
# two columns, date and time of day, or GPS week and time of week.
COLUMNS = re.compile(r"%\s*(?P<scale>GPST|UTC|JST)\b(?P<names>.*)")
SCALES: dict[str, dict[str, object]] = {
    "GPST": {"scale": "gps"},
    "UTC": {"scale": "utc"},
    "JST": {"offset_s": -32_400.0},
}
UNIT = re.compile(r"\(.*?\)")
QUALITIES = '{ 1 = "fixed", 2 = "float", 3 = "differential", 4 = "differential", 5 = "single", 6 = "float" }'


@dataclass(frozen=True)
class Header:
    """The line that names the columns, and the number of lines before the first row."""

    scale: str
    names: tuple[str, ...]  # without units, behind the two columns of the time
    lines: int
    geodetic: bool  # whether heights are above mean sea level


def header_of(lines: Sequence[str]) -> Header | None:
    """Find the header among the first lines of a file; None if it is no file of RTKLIB."""
    for number, line in enumerate(lines):
        found = COLUMNS.match(line)
        if found is not None:
            names = re.split(r"[\s,;]+", found["names"].strip(" \t\r\n,;"))
            geodetic = any("height=" in above and "/geodetic" in above for above in lines[:number])
            return Header(found["scale"], tuple(UNIT.sub("", name) for name in names), number + 1, geodetic)
    return None


def mapping_of(header: Header, row: str, file: str) -> str:
    """Write the mapping of a solution file.

    Parameters
    ----------
    header : Header
        Of the file.
    row : str
        The first row; it tells dates from GPS weeks, and the separator.
    file : str
        Name of the file.

    Raises
    ------
    UserError
        The positions are in a form without latitude and longitude in degrees or ECEF.
    """
    separator = next((mark for mark in ",;" if mark in row), "whitespace")
    dates = re.match(r"\s*\d{4}/", row) is not None
    given = ", ".join(f"{key} = {value!r}".replace("'", '"') for key, value in SCALES[header.scale].items())
    clock = ["day", "clock"]
    time = f'date_column = "day", unit = "date", {given}' if dates else f'week_column = "day", {given}'
    if dates and separator != "whitespace":  # the separator is not between date and time of day
        clock, time = ["clock"], f'unit = "date", {given}'
    lines = [
        f"name = {json.dumps(file[:64], ensure_ascii=False)}", 'truth_is = "none"', "[gnss]",
        f"file = {json.dumps(file, ensure_ascii=False)}",
        f'separator = "{separator}"', f"skip_rows = {header.lines}",
        f"header = {[*clock, *header.names]}".replace("'", '"'),
        f'time = {{ column = "clock", {time} }}',
        *_position(header, file),
    ]  # fmt: skip
    if {"vn", "ve", "vu"} <= set(header.names):
        lines.append('velocity = { columns = ["vn", "ve", "vu"], unit = "m/s", axes = "neu" }')
    if "Q" in header.names:
        lines.append(f'quality = {{ column = "Q", values = {QUALITIES} }}')
    if "ns" in header.names:
        lines.append('satellites_used = "ns"')
    return "\n".join(lines) + "\n"


def _position(header: Header, file: str) -> list[str]:
    names = set(header.names)
    if {"latitude", "longitude", "height"} <= names:
        kind = "msl" if header.geodetic else "ellipsoid"
        position = [
            *(f'{name} = {{ column = "{name}", unit = "deg" }}' for name in ("latitude", "longitude")),
            f'height = {{ column = "height", kind = "{kind}" }}',
        ]
        if {"sdn", "sde", "sdu"} <= names:
            position.append('position_sd = { columns = ["sdn", "sde", "sdu"], axes = "neu" }')
        return position
    if {"x-ecef", "y-ecef", "z-ecef"} <= names:
        return ['position_ecef = { columns = ["x-ecef", "y-ecef", "z-ecef"] }']
    raise UserError(
        f"{file} has the columns {', '.join(header.names)}; choose latitude and longitude in degrees, or ECEF, as "
        "the output of RTKLIB, or write a mapping with `position_local`: `obu import --help`"
    )

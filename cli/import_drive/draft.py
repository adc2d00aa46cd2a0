"""A draft of a mapping, from the names and values of a table's columns, with the reason of each guess.

Nothing is decided by a name alone where values can tell: the unit of a speed follows from the positions, that of an
acceleration from gravity. What cannot be known, such as the time scale, is said, and left to whoever knows the file.
"""

import csv
import itertools
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import tomlkit

from shared.errors import UserError
from shared.maths.earth import STANDARD_GRAVITY, FloatArray, Geodetic, ned_from_geodetic_difference

from .mapping.mapping import parse_mapping
from .mapping.units import COORDINATE, DATE, FORCE, RATE, SPEED, TIME
from .readers.dates import is_time_of_day, unix_time

ROWS, LINE_CHARACTERS, COLUMNS = 20_000, 20_000, 400
PREVIEW_S, PREVIEW_ROWS = 60.0, 4
SEPARATORS = ",;\t|"
# Names of columns without case, blanks and units, in the order in which they are preferred.
NAMES = {
    "time": r"((unix|utc|epoch|gps|gpst|system|device|sensor)_)*(time|timestamp|stamp|datetime|unix|utc|gpst)"
    r"(_(unix|utc))*|t|seconds(_elapsed)?",
    "date": r"((utc|gps)_)?(date|day)",
    "latitude": r"lat(itude)?(_deg)?",
    "longitude": r"lon(g|gitude)?|lng",
    "height": r"(h|height|alt|altitude|elev|elevation)(_ell(ipsoid)?|_msl|_wgs84)?",
    "speed": r"((gps|gnss|ground)_?)?(speed|sog|vel(ocity)?)|speed_over_ground",
    "course": r"((gps|gnss)_?)?(course|cog|heading|bearing|track|course_over_ground)",
    "accuracy": r"(horizontal_?accuracy|h_?acc|eph|accuracy)",
    "satellites": r"(satellites(_used)?|num_?sv|nsat|sats|ns)",
    "north": r"(v|vel|velocity)_?(n|north)", "east": r"(v|vel|velocity)_?(e|east)",
    "down": r"(v|vel|velocity)_?(d|down)", "up": r"(v|vel|velocity)_?(u|up)",
    **{f"acc_{axis}": rf"(a|acc|accel|acceleration|accelerometer|f)_?{axis}" for axis in "xyz"},
    **{f"gyro_{axis}": rf"(g|w|gyr|gyro|gyroscope|omega|rate)_?{axis}" for axis in "xyz"},
}  # fmt: skip
SAID = {  # how names write units
    "m/s2": "m/s2", "m/s^2": "m/s2", "mps2": "m/s2", "m_s2": "m/s2", "km/h": "km/h", "kmh": "km/h", "kph": "km/h",
    "m/s": "m/s", "mps": "m/s", "m_s": "m/s", "knot": "kn", "knots": "kn", "kn": "kn", "mph": "mph", "deg/s": "deg/s",
    "dps": "deg/s", "deg_s": "deg/s", "°/s": "deg/s", "rad/s": "rad/s", "rps": "rad/s", "rad_s": "rad/s", "mg": "mg",
    "g": "g", "deg": "deg", "°": "deg", "rad": "rad", "ms": "ms", "us": "us", "ns": "ns", "sec": "s", "s": "s",
    "m": "m", "ft": "ft", "mm/s": "mm/s", "cm/s": "cm/s", "mdeg/s": "mdeg/s",
}  # fmt: skip
UNIT = re.compile(rf"[ _]*[\[(]?({'|'.join(map(re.escape, sorted(SAID, key=len, reverse=True)))})[\])]?$")
FIRST_S, LAST_S, MOST_STEP_S = 946_684_800.0, 4_102_444_800.0, 60.0  # 2000 and 2100 as Unix time; between two rows
ACCURACY_MOST_M = 100.0  # of a receiver; more is said in millimetres
TURN_MOST = 3.5  # [rad/s] of a road vehicle or of a phone in it; in degrees a second it is a slow bend


@dataclass
class Draft:
    """A mapping, the reasons of its guesses by table, and what nobody could guess."""

    text: str = ""
    reasons: list[str] = field(default_factory=list)
    open: list[str] = field(default_factory=list)
    preview: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Table:
    """Columns of the beginning of a file: texts by name."""

    path: Path
    separator: str
    columns: Mapping[str, Sequence[str]]

    def numbers(self, name: str) -> FloatArray:
        """Values of a column; NaN for what is no number."""
        return np.array([_number(text) for text in self.columns[name]])


def draft_of(path: Path) -> Draft:
    """Guess the mapping of a table with a header.

    Raises
    ------
    UserError
        The file is no such table, or holds no position and no inertial values with a time.
    """
    table = read(path)
    found = recognised(table)
    draft = Draft()
    if "time" not in found:
        raise UserError(
            f"{path.name} has no column whose name says time; its columns are {', '.join(table.columns)[:300]}. "
            "Name one `time`, or write a mapping: docs/how-to/import-a-drive.md"
        )
    if "date" in found and not is_time_of_day(table.columns[found["time"]][0]):
        del found["date"]
    time = _time(table, found["time"], draft)
    if (date := found.get("date")) is not None:
        time["date_column"] = date
        draft.reasons.append(f"{date} is the day of {found['time']}")
    tables: dict[str, dict[str, object]] = {}
    common = {"file": path.name, **({} if table.separator == "," else {"separator": table.separator}), "time": time}
    if {"latitude", "longitude"} <= found.keys():
        tables["gnss"] = {**common, **_gnss(table, found, draft)}
    if all(f"acc_{axis}" in found and f"gyro_{axis}" in found for axis in "xyz"):
        tables["imu"] = {**common, **_imu(table, found, draft, estimated="gnss" in tables)}
    if not tables:
        raise UserError(
            f"{path.name} has neither latitude and longitude nor three accelerations with three rates; its columns are "
            f"{', '.join(table.columns)[:300]}. Write a mapping: docs/how-to/import-a-drive.md"
        )
    if unused := [name for name in table.columns if name not in found.values()]:
        draft.open.append(f"not used: {', '.join(unused)[:300]}")
    draft.text = _text(path, tables, draft)
    parse_mapping(draft.text, "the draft")
    draft.preview = list(_preview(table, found, str(time["unit"])))
    return draft


def read(path: Path) -> Table:
    """Read the beginning of a table; raises `UserError`."""
    try:
        with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
            first = file.readline(LINE_CHARACTERS)
            separator = max(SEPARATORS, key=first.count)
            rows = list(itertools.islice(csv.reader([first, *itertools.islice(file, ROWS)], delimiter=separator), ROWS))
    except (OSError, csv.Error) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise UserError(f"cannot read {path}: {reason}; give a table with a header, such as CSV") from error
    header = [name.strip() for name in rows[0]] if rows else []
    full = [row for row in rows[1:] if len(row) == len(header)]
    if len(header) < 2 or len(header) > COLUMNS or len(full) < 2 or all(_is_number(name) for name in header):
        raise UserError(f"{path} is no table with a line of names and rows below it; give one, such as CSV")
    return Table(path, separator, {name: [row[place].strip() for row in full] for place, name in enumerate(header)})


def recognised(table: Table) -> dict[str, str]:
    """Name of the column for each quantity; the first that matches, and no column twice."""
    found: dict[str, str] = {}
    plain = {name: _plain(name) for name in table.columns}
    for quantity, pattern in NAMES.items():
        for name in table.columns:
            if name not in found.values() and re.fullmatch(pattern, plain[name]):
                found[quantity] = name
                break
    if "time" not in found and "date" in found:
        found["time"] = found.pop("date")
    return found


def _plain(name: str) -> str:
    """Name without case, blanks and unit."""
    lower = name.strip().lower()
    without = UNIT.sub("", lower) if _said(name) and not re.fullmatch(r"[a-z]{1,2}_?[xyzs]|t|ns", lower) else lower
    return re.sub(r"[ .\-]+", "_", without or lower).strip("_")


def _said(name: str) -> str | None:
    """Unit that a name ends in."""
    match = UNIT.search(name.strip().lower())
    if match is None or match.start() == 0:
        return None
    before = name.strip()[: match.start() + 1]
    marked = match[0][0] in " _[(" or len(match[1]) > 2
    return SAID[match[1]] if marked and before else None


def _time(table: Table, name: str, draft: Draft) -> dict[str, object]:
    texts = table.columns[name]
    values = table.numbers(name)
    if np.isnan(values[:10]).all():
        try:
            if not is_time_of_day(texts[0]):
                unix_time(texts[0])
        except ValueError as error:
            raise UserError(f"{name} = {texts[0]!r} is no time that is known: {error}; write a mapping") from error
        draft.reasons.append(f"{name} is a date, read as UTC where it states no zone")
        return {"column": name, "unit": DATE}
    if (unit := _unix_unit(values)) is not None:
        draft.reasons.append(f"{name} is Unix time in {unit}, by its size and its steps")
        draft.open.append(f"whether {name} is UTC or GPS time (18 s ahead): set offset_s = -18.0 for GPS time")
        if "gps" in name.lower():
            draft.open.append(f"whether {name} counts from 1970 or, as GPS does, from 1980 (offset_s = 315964782.0)")
        return {"column": name, "unit": unit}
    said = _said(name)
    unit = said if said in TIME else _unit_of_step(values)
    draft.reasons.append(f"{name} counts from a beginning of its own, in {unit}")
    draft.open.append("at which time the file begins: set start_utc_s (Unix time); without it the drive is in 1970")
    return {"column": name, "unit": unit}


def _unix_unit(values: FloatArray) -> str | None:
    """Unit in which stamps are of this century and rows come at least every minute; None without one."""
    first, steps = float(np.nanmedian(values)), np.abs(np.diff(values))
    step = float(np.nanmedian(steps[steps > 0.0])) if np.any(steps > 0.0) else 0.0
    of_century = (unit for unit, factor in TIME.items() if unit != DATE and FIRST_S < first * factor < LAST_S)
    return next((unit for unit in of_century if step * TIME[unit] <= MOST_STEP_S), None)


def _unit_of_step(values: FloatArray) -> str:
    """Unit in which the rows come 0.5 to 2000 times a second."""
    step = float(np.nanmedian(np.abs(np.diff(values)[np.diff(values) != 0.0]))) if len(values) > 2 else 1.0
    return next(
        (
            unit
            for unit, factor in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9))
            if 5e-4 <= step * factor <= 2.0
        ),
        "s",
    )


def _gnss(table: Table, found: Mapping[str, str], draft: Draft) -> dict[str, object]:
    if "height" not in found:
        raise UserError(
            f"{table.path.name} has latitude and longitude and no column whose name says height or altitude; name one, "
            "or add one that is constant"
        )
    gnss: dict[str, object] = {"source": "gnss", "quality": "single"}
    largest = max(float(np.nanmax(np.abs(table.numbers(found[name])))) for name in ("latitude", "longitude"))
    unit = "1e-7 deg" if largest > 1e4 else "rad" if _said(found["latitude"]) == "rad" else "deg"
    draft.reasons.append(f"{found['latitude']} and {found['longitude']} are in {unit}, by their size")
    for name in ("latitude", "longitude"):
        gnss[name] = {"column": found[name], "unit": unit}
    above_sea, unit_of_height = "msl" in _plain(found["height"]), "ft" if _said(found["height"]) == "ft" else "m"
    gnss["height"] = {
        "column": found["height"], "unit": unit_of_height, "kind": "msl" if above_sea else "ellipsoid",
        **({"geoid_separation_m": 0.0} if above_sea else {}),
    }  # fmt: skip
    if above_sea:
        draft.open.append("geoid_separation_m of [gnss] height: how far sea level is above the ellipsoid there")
    else:
        draft.open.append(f"whether {found['height']} is above the ellipsoid (assumed) or above sea level")
    vertical = next((name for name in ("down", "up") if name in found), None)
    if {"north", "east"} <= found.keys() and vertical is not None:
        columns = [found[name] for name in ("north", "east", vertical)]
        gnss["velocity"] = {"columns": columns, "unit": _said(columns[0]) or "m/s", "axes": f"ne{vertical[0]}"}
        draft.reasons.append(f"{', '.join(columns)} are the velocity to north, east and {vertical}, by their names")
    elif {"speed", "course"} <= found.keys():
        unit_of_speed, why = _speed_unit(table, found, unit)
        draft.reasons.append(why)
        turned = float(np.nanmax(np.abs(table.numbers(found["course"]))))
        angle = "rad" if turned <= 2.0 * np.pi + 0.01 else "deg"
        gnss["ground_speed"] = {"column": found["speed"], "unit": unit_of_speed}
        gnss["course"] = {"column": found["course"], "unit": angle}
        draft.reasons.append(f"{found['course']} is in {angle}: the largest value is {turned:.5g}")
        if angle == "rad" and _said(found["course"]) is None:
            draft.open.append(f"whether {found['course']} is in rad: a drive straight to the north looks so in degrees")
    if "accuracy" in found:
        names = [found["accuracy"]] * 3
        middle = float(np.nanmedian(table.numbers(found["accuracy"])))
        gnss["position_sd"] = {"columns": names, **({"scale": 0.001} if middle > ACCURACY_MOST_M else {})}
        if middle > ACCURACY_MOST_M:
            draft.reasons.append(f"{found['accuracy']} is in mm: {middle:.4g} in the middle")
        draft.open.append(f"what share {found['accuracy']} holds: a 68 % radius, as Android's, needs scale = 0.66")
    else:
        gnss["position_sd"] = {"constant_ned": [3.0, 3.0, 6.0]}
        draft.open.append("the accuracy of positions: no column states it; 3 m and 6 m are assumed")
    if "satellites" in found:
        gnss["satellites_used"] = found["satellites"]
    return gnss


def _speed_unit(table: Table, found: Mapping[str, str], coordinates: str) -> tuple[str, str]:
    """Unit of a speed: by its name, or by how far the positions move."""
    name = found["speed"]
    if (said := _said(name)) in SPEED:
        return said, f"{name} is in {said}, by its name"
    factor = COORDINATE[coordinates]
    latitude, longitude = (table.numbers(found[key]) * factor for key in ("latitude", "longitude"))
    seconds = _seconds(table, found["time"])
    speed = table.numbers(name)
    use = np.flatnonzero(np.isfinite(latitude + longitude + seconds + speed))
    moved, told = 0.0, 0.0
    for a, b in itertools.pairwise(use[:: max(1, len(use) // 400)]):
        span = seconds[b] - seconds[a]
        if 0.0 < span < 30.0:
            start, end = (Geodetic(np.radians(latitude[i]), np.radians(longitude[i]), 0.0) for i in (a, b))
            moved += float(np.hypot(*ned_from_geodetic_difference(end, start)[:2]))
            told += float(np.mean(speed[a : b + 1])) * span
    if told <= 0.0 or moved < 20.0:
        return "m/s", f"{name} is taken for m/s: the positions move too little to tell"
    ratio = moved / told
    unit = min(("m/s", "km/h", "mph", "kn"), key=lambda one: abs(np.log(ratio / SPEED[one])))
    return unit, f"{name} is in {unit}: the positions move {moved:.0f} m, and it adds up to {told * SPEED[unit]:.0f} m"


def _imu(table: Table, found: Mapping[str, str], draft: Draft, *, estimated: bool) -> dict[str, object]:
    force = [found[f"acc_{axis}"] for axis in "xyz"]
    rate = [found[f"gyro_{axis}"] for axis in "xyz"]
    norm = float(np.nanmedian(np.linalg.norm([table.numbers(name) for name in force], axis=0)))
    unit = min(("m/s2", "g", "mg"), key=lambda one: abs(np.log(max(norm, 1e-9) * FORCE[one] / STANDARD_GRAVITY)))
    off = abs(norm * FORCE[unit] / STANDARD_GRAVITY - 1.0)
    draft.reasons.append(
        f"{', '.join(force)} are in {unit}: their length is {norm:.4g} in the middle, and gravity is there"
    )
    if off > 0.15:
        middle = norm * FORCE[unit]
        draft.open.append(f"the acceleration has {middle:.2f} m/s2 in the middle, not gravity: is gravity removed?")
    said = next((text for name in rate if (text := _said(name)) in RATE), None)
    largest = float(np.nanpercentile(np.abs([table.numbers(name) for name in rate]), 99.5))
    rates = said or ("deg/s" if largest > TURN_MOST else "rad/s")
    draft.reasons.append(
        f"{', '.join(rate)} are in {rates}, " + ("by their name" if said else f"as nearly all are below {largest:.3g}")
    )
    if said is None and largest <= TURN_MOST:
        draft.open.append(f"whether {', '.join(rate)} are in rad/s: a drive without a bend looks the same in deg/s")
    axes: dict[str, object] = {"estimate_axes": True} if estimated else {"axes": ["forward", "right", "down"]}
    draft.open.append(
        "how the sensor is mounted: it is estimated from gravity and the changes of speed" if estimated
        else "how the sensor is mounted: x forward, y right, z down is assumed"
    )  # fmt: skip
    return {
        "source": "imu", **axes, "specific_force": {"columns": force, "unit": unit},
        "angular_rate": {"columns": rate, "unit": rates},
    }  # fmt: skip


def _seconds(table: Table, name: str) -> FloatArray:
    values = table.numbers(name)
    if np.isnan(values[:10]).all():
        return np.array([_or_nan(unix_time, text) for text in table.columns[name]])
    return values * TIME[_unix_unit(values) or _unit_of_step(values)]


def _text(path: Path, tables: Mapping[str, Mapping[str, object]], draft: Draft) -> str:
    """The mapping as TOML, with reasons and what is open as comments."""
    document = tomlkit.document()
    document.add(tomlkit.comment(f"Draft of a mapping of {path.name}. Guessed:"))
    for line in (*draft.reasons, "", "Not known, and to be checked by you:", *draft.open, "", "Then:",
                 f"    obu import MAPPING.toml {path.parent} -o drive.mcap"):  # fmt: skip
        document.add(tomlkit.comment(line))
    document.add(tomlkit.nl())
    document["name"] = re.sub(r"[^A-Za-z0-9_-]", "_", path.stem)[:64] or "drive"
    for name, content in tables.items():
        section = tomlkit.table()
        for key, value in content.items():
            section[key] = _inline(value) if isinstance(value, dict) else value
        document[name] = section
    return tomlkit.dumps(document)


def _inline(value: Mapping[str, object]) -> object:
    inline = tomlkit.inline_table()
    inline.update(value)
    return inline


def _preview(table: Table, found: Mapping[str, str], unit: str) -> Iterator[str]:
    """Some rows of the first minute, by the quantities that were recognised."""
    seconds = _seconds(table, found["time"])
    begin = float(seconds[0])
    rows = np.flatnonzero(seconds - begin <= PREVIEW_S)
    shown = [(quantity, name) for quantity, name in found.items() if quantity != "time"]
    yield f"the first {min(PREVIEW_S, float(np.nanmax(seconds) - begin)):.0f} s have {len(rows)} rows (time in {unit}):"
    for row in rows[:: max(1, len(rows) // PREVIEW_ROWS)][:PREVIEW_ROWS]:
        values = ", ".join(f"{quantity} {table.columns[name][row]}" for quantity, name in shown)
        yield f"  {seconds[row] - begin:6.2f} s  {values}"


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")


def _is_number(text: str) -> bool:
    return not np.isnan(_number(text))


def _or_nan(read_one: Callable[[str], float], text: str) -> float:
    try:
        return read_one(text)
    except ValueError:
        return float("nan")

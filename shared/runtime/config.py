"""The vehicle's file: one TOML document, one section a process."""

import difflib
import os
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self, TypeVar
from urllib.parse import urlsplit

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from ..errors import ConfigError, UserError
from ..messages.base import Vector3
from ..processes import BY_NAME, Role, running
from .old_keys import PRESENT_KEYS, in_section, old_keys

ADDRESS_FILE = "status.address"  # in the state folder: where monitoring.status serves the dashboard

S = TypeVar("S", bound="Section")
Table = dict[str, object]
Matrix3 = tuple[Vector3, Vector3, Vector3]  # row by row
LEVEL_MOUNTING: Matrix3 = ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))  # x forward, y left, z up
ORTHOGONAL = 1e-3  # largest deviation of rows times rows from the identity: allows matrices with four digits


class Section(BaseModel):
    """Settings of one process, or a group of them; an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    def with_values(self, values: Mapping[str, object]) -> Self:
        """Copy the settings with some replaced; keys may be dotted, as in `gnss.delay_s`."""
        return type(self).model_validate(with_values(self.model_dump(), values))


class ImuMounting(Section):
    """How the inertial sensors are mounted; every process that reads inertial samples reads them in these body axes."""

    body_from_sensor: Matrix3 = Field(
        default=LEVEL_MOUNTING,
        description="rotation matrix from the axes of the IMU to body axes (forward, right, down), row by row; its "
        "columns are the x, y and z axes of the IMU in body axes. Default: mounted level, x forward, y left, z up",
    )

    @field_validator("body_from_sensor")
    @classmethod
    def _is_orthogonal(cls, rows: Matrix3) -> Matrix3:
        product = [sum(a * b for a, b in zip(one, other, strict=True)) for one in rows for other in rows]
        if any(abs(value - (1.0 if place % 4 == 0 else 0.0)) > ORTHOGONAL for place, value in enumerate(product)):
            raise ValueError("the rows must be perpendicular to each other and of length one")
        return rows


class VehicleSection(Section):
    """Name and role of this unit."""

    name: str = Field(
        default="vehicle", pattern=r"^[A-Za-z0-9_-]{1,48}$", description="the second level of every topic"
    )
    role: Role = Field(default=Role.OBU, description="obu: on-board unit of a vehicle; rsu: road-side unit of a plaza")
    imu: ImuMounting = ImuMounting()


@dataclass(frozen=True)
class BrokerAddress:
    """Address of the broker, and credentials."""

    host: str = "127.0.0.1"
    port: int = 1883
    username: str | None = None
    password: str | None = field(default=None, repr=False)

    @classmethod
    def parse(cls, url: str) -> "BrokerAddress":
        """Read mqtt://[user:password@]host[:port]."""
        parts = urlsplit(url if "://" in url else f"mqtt://{url}")
        try:
            port = parts.port or 1883
        except ValueError as error:
            raise UserError(f"the broker's address {url!r} has no valid port: try mqtt://127.0.0.1:1883") from error
        if parts.scheme != "mqtt" or not parts.hostname:
            raise UserError(f"the broker's address {url!r} is not understood: try mqtt://127.0.0.1:1883")
        return cls(parts.hostname, port, parts.username, parts.password)


@dataclass(frozen=True)
class VehicleFile:
    """The parsed file of a vehicle."""

    path: str
    text: str
    tables: dict[str, Table]
    samples_mounting: Matrix3 | None = None  # of a recording: with which its inertial samples were made

    @property
    def mounting(self) -> Matrix3:
        """Rotation from the axes of the IMU to those of the vehicle (forward, right, down)."""
        return self.section("vehicle", VehicleSection).imu.body_from_sensor

    @property
    def name(self) -> str:
        """Name of the vehicle, the second level of every topic."""
        return self.section("vehicle", VehicleSection).name

    @property
    def role(self) -> Role:
        """Role of this unit, which determines the processes that run."""
        return self.section("vehicle", VehicleSection).role

    @property
    def processes(self) -> tuple[str, ...]:
        """Processes of this unit: the standing ones of its role, and each other one that has a section."""
        return tuple(row.name for row in running(self.role, self.tables))

    def section(self, name: str, kind: type[S]) -> S:
        """Read the settings of one process, with defaults for missing keys.

        Validators find this file in the context, for a value that another section or a file beside this one holds.
        """
        try:
            return kind.model_validate(self.tables.get(name, {}), context={"vehicle": self})
        except ValidationError as error:
            raise ConfigError(f"{self.path}: {_explain(name, kind, error)}") from error


def vehicle_in(context: object) -> VehicleFile | None:
    """Find the vehicle's file in the context of a validator; None for settings that were made without one."""
    vehicle = context.get("vehicle") if isinstance(context, Mapping) else None
    return vehicle if isinstance(vehicle, VehicleFile) else None


def mounting_from(value: object) -> Matrix3:
    """Check a matrix of a mounting; raises `ValueError` with the reason."""
    try:
        return ImuMounting.model_validate({"body_from_sensor": value}).body_from_sensor
    except ValidationError as error:
        raise ValueError(error.errors()[0]["msg"]) from error


def with_values(table: Mapping[str, object], values: Mapping[str, object]) -> Table:
    """Copy a table with other values in it; a dotted key names a value of a table inside it."""
    made = dict(table)
    for key, value in values.items():
        head, _, rest = key.partition(".")
        inner = made.get(head)
        made[head] = with_values(inner if isinstance(inner, dict) else {}, {rest: value}) if rest else value
    return made


def dotted_keys(kind: type[Section]) -> Iterator[str]:
    """Name every setting of a section, those of its sections with a dot."""
    for name, info in kind.model_fields.items():
        if isinstance(info.annotation, type) and issubclass(info.annotation, Section):
            yield from (f"{name}.{key}" for key in dotted_keys(info.annotation))
        else:
            yield name


def _explain(section: str, kind: type[Section], error: ValidationError) -> str:
    """Describe the first invalid key in one sentence, with the most similar valid key."""
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"])
    keys = list(dotted_keys(kind))
    if key not in keys and (new := PRESENT_KEYS.get(f"{section}.{key}")):
        return f"[{section}] has no setting {key!r}; it is {in_section(new)} now"
    if first["type"] != "extra_forbidden":
        return f"[{section}] {key} = {first['input']!r}: {first['msg']}"
    names = {known.rpartition(".")[2]: known for known in keys} | {known: known for known in keys}
    near = difflib.get_close_matches(key, names, n=1) or difflib.get_close_matches(key.rpartition(".")[2], names, n=1)
    hint = f"did you mean {names[near[0]]!r}?" if near else f"known keys: {', '.join(sorted(keys)) or 'none'}"
    return f"[{section}] has no setting {key!r}; {hint}"


def read_toml(text: str, path: str) -> dict[str, object]:
    """Read the text of a vehicle's file as it is; raises `ConfigError` if it is no TOML."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path} is not valid TOML: {error}; correct that line") from error


def parse_vehicle(text: str, path: str = "<text>") -> VehicleFile:
    """Parse the text of a vehicle's file into one table a section."""
    document = read_toml(text, path)
    if old := next(old_keys(document), None):
        raise ConfigError(
            f"{path}: {in_section(old)} is of an earlier version; it is {in_section(PRESENT_KEYS[old])} now. "
            f"`obu migrate {path}` rewrites the file"
        )
    tables: dict[str, Table] = {}
    for layer, content in document.items():
        if not isinstance(content, dict):
            raise ConfigError(f"{path}: {layer!r} stands outside a section; put it under [vehicle] or a process")
        if layer == "vehicle":
            tables[layer] = content
            continue
        for process, table in content.items():
            name = f"{layer}.{process}"
            if name not in BY_NAME or not isinstance(table, dict):
                near = difflib.get_close_matches(name, BY_NAME, n=1)
                hint = f"did you mean [{near[0]}]?" if near else "`obu topics --processes` lists them"
                raise ConfigError(f"{path}: [{name}] is no process; {hint}")
            tables[name] = table
    file = VehicleFile(path, text, tables)
    role = file.role
    for name in tables.keys() - {"vehicle"}:
        if role not in BY_NAME[name].roles:
            raise ConfigError(f"{path}: [{name}] does not run in role {role}; remove the section, or set the role")
    return file


def load_vehicle(path: str | Path | None = None) -> VehicleFile:
    """Read the vehicle's file named by the argument or by OBU_VEHICLE; without either, all defaults."""
    name = path or os.environ.get("OBU_VEHICLE")
    if not name:
        return parse_vehicle("", "<no vehicle file>")
    try:
        text = Path(name).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise UserError(
            f"cannot read the vehicle's file {name}: {reason}; see deploy/vehicles/ for examples"
        ) from error
    return parse_vehicle(text, str(name))


def broker_address() -> BrokerAddress:
    """The address in OBU_BROKER, otherwise the default."""
    return BrokerAddress.parse(os.environ.get("OBU_BROKER", "mqtt://127.0.0.1:1883"))


def state_dir() -> Path:
    """The folder of persistent files: OBU_STATE, or .obu in the working folder."""
    path = Path(os.environ.get("OBU_STATE", ".obu"))
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"cannot make the state folder {path}: {error.strerror}; set OBU_STATE to one") from error
    return path

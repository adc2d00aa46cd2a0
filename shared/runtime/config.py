"""The vehicle's file: one TOML document, one section a process."""

import difflib
import importlib
import logging
import os
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from math import pi
from pathlib import Path
from typing import Self, TypeVar, cast
from urllib.parse import quote, unquote, urlsplit

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator
from pydantic.fields import FieldInfo

from .. import shipped
from ..bounded import TOML_BYTES, SizeExceeded, load_toml, read_text
from ..errors import ConfigError, UserError
from ..messages.base import Vector3
from ..processes import BY_NAME, Role, running
from .clock import DISK_FAULTS
from .old_keys import in_section, old_keys, successor
from .overlay import text_over, without_basis
from .private import page_folder

log = logging.getLogger(__name__)

NO_TEXT = "it is not UTF-8 text"
EXAMPLES = f"{shipped(Path('deploy/vehicles'))}/"
# Sockets at which the broker serves the unit's own processes: in the state folder, and of an installed unit.
UNIX, SOCKET, INSTALLED_SOCKET = "mqtt+unix", Path("bus/socket"), Path("/run/obu-broker/socket")
MAX_SOCKET = 107  # bytes of its path, in Linux
ADDRESS_FILE = "status.address"  # where monitoring.status serves the dashboard

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
        product = [sum(a * b for a, b in zip(row, other, strict=True)) for row in rows for other in rows]
        if any(abs(value - (1.0 if place % 4 == 0 else 0.0)) > ORTHOGONAL for place, value in enumerate(product)):
            raise ValueError("the rows must be perpendicular to each other and of length one")
        return rows


class GnssAntenna(Section):
    """Where the GNSS antenna is, and the second one of a receiver that measures a heading."""

    lever_arm_body_m: Vector3 = Field(
        default=(0.0, 0.0, 0.0), description="lever arm from the IMU to the GNSS antenna: forward, right, down"
    )
    lever_arm_sd_m: float | None = Field(
        default=None,
        ge=0.0,
        le=10.0,
        description="standard deviation of the lever arm on each axis, which the protection levels hold until the "
        "check of the set-up agrees; if not given, 0.35 m, or 0.5 m where the lever arm is zero",
    )
    lever_arms_body_m: dict[str, Vector3] = Field(
        default={},
        max_length=8,
        description="lever arms of further receivers by their source, as { gnss1 = [0.3, 0.0, -1.2] }; of another one "
        "`lever_arm_body_m` holds",
    )
    baseline_yaw_body_rad: float = Field(
        default=0.0,
        ge=-pi,
        le=pi,
        description="direction from the first to the second antenna in body axes, clockwise from forward",
    )

    def lever_arm_of(self, receiver: str) -> Vector3:
        """Lever arm of the antenna of a receiver [m, body]."""
        return self.lever_arms_body_m.get(receiver, self.lever_arm_body_m)


class Vehicle(Section):
    """Name and role of this unit, and the facts of its vehicle that more than one process needs."""

    name: str = Field(
        default="vehicle", pattern=r"^[A-Za-z0-9_][A-Za-z0-9_-]{0,47}$", description="the second level of every topic"
    )
    role: Role = Field(default=Role.OBU, description="obu: on-board unit of a vehicle; rsu: road-side unit of a plaza")
    rear_axle_body_m: Vector3 | None = Field(
        default=None,
        description="lever arm from the IMU to the middle of the rear axle: forward, right, down; if not given, the "
        "non-holonomic constraint and the wheel speed are weighted less in bends",
    )
    alert_limit_horizontal_m: float = Field(
        default=10.0,
        gt=0.0,
        description="horizontal alert limit: a larger protection level makes the verdict UNSAFE; reports use it too",
    )
    alert_limit_vertical_m: float = Field(
        default=20.0,
        gt=0.0,
        description="vertical alert limit: a larger protection level makes the verdict UNSAFE; reports use it too",
    )
    imu: ImuMounting = ImuMounting()
    gnss: GnssAntenna = GnssAntenna()

    @property
    def alert_limits_m(self) -> tuple[float, float]:
        """Horizontal and vertical alert limit."""
        return self.alert_limit_horizontal_m, self.alert_limit_vertical_m


class VehicleSettings(Section):
    """Settings of a process that needs facts of the vehicle; they stand in [vehicle], and not in its own section."""

    vehicle: Vehicle = Vehicle()


@dataclass(frozen=True)
class BrokerAddress:
    """Address of the broker, and credentials."""

    host: str = "127.0.0.1"
    port: int = 1883
    username: str | None = None
    password: str | None = field(default=None, repr=False)
    tls: bool = False
    authority: str | None = None  # file of the authority that signed the broker's certificate; None: the system's
    socket: str | None = None  # path of a Unix socket in the place of host and port

    @property
    def place(self) -> str:
        """Where the broker is: the path of its socket, or host:port."""
        return self.socket or f"{self.host}:{self.port}"

    @property
    def url(self) -> str:
        """Address as it stands in OBU_BROKER, without credentials."""
        if self.socket is not None:
            return f"{UNIX}://{quote(self.socket)}"
        return f"{'mqtts' if self.tls else 'mqtt'}://{self.place}"

    @classmethod
    def at(cls, socket: Path) -> "BrokerAddress":
        """Address of a Unix socket."""
        return cls(socket=str(socket))

    @classmethod
    def parse(cls, url: str) -> "BrokerAddress":
        """Read mqtt://[user:password@]host[:port], mqtts://... of a broker that speaks TLS, or mqtt+unix:///path."""
        parts = urlsplit(url if "://" in url else f"mqtt://{url}")
        shown = url.rpartition("@")[2]  # without a password
        try:
            port = parts.port or (8883 if parts.scheme == "mqtts" else 1883)
        except ValueError as error:
            raise UserError(f"the broker's address {shown!r} has no valid port: try mqtt://127.0.0.1:1883") from error
        user, password = (None if part is None else unquote(part) for part in (parts.username, parts.password))
        if parts.scheme == UNIX and parts.path.startswith("/") and not parts.hostname:
            return cls(username=user, password=password, socket=unquote(parts.path))
        if parts.scheme not in ("mqtt", "mqtts") or not parts.hostname:
            raise UserError(
                f"the broker's address {shown!r} is not understood: try mqtt://127.0.0.1:1883, or {UNIX}:///path/of/socket"
            )
        authority = os.environ.get("OBU_BROKER_CA") or None
        return cls(parts.hostname, port, user, password, parts.scheme == "mqtts", authority)


@dataclass(frozen=True)
class VehicleFile:
    """The parsed file of a vehicle."""

    path: str
    text: str
    tables: dict[str, Table]
    samples_mounting: Matrix3 | None = None  # of a recording: with which its inertial samples were made

    @property
    def facts(self) -> Vehicle:
        """What [vehicle] states."""
        return self.section("vehicle", Vehicle)

    @property
    def name(self) -> str:
        """Name of the vehicle, the second level of every topic."""
        return self.facts.name

    @property
    def role(self) -> Role:
        """Role of this unit, which determines the processes that run."""
        return self.facts.role

    @property
    def processes(self) -> tuple[str, ...]:
        """Processes of this unit: the standing ones of its role, and each other one that has a section."""
        return tuple(row.name for row in running(self.role, self.tables))

    def section(self, name: str, kind: type[S]) -> S:
        """Read the settings of one process, with defaults for missing keys.

        Validators find this file in the context, for a value that another section or a file beside this one holds.
        """
        table = self.tables.get(name, {})
        if issubclass(kind, VehicleSettings):
            if "vehicle" in table:
                raise ConfigError(
                    f"{self.path}: [{name}.vehicle]: facts of the vehicle stand in [vehicle]; move it there"
                )
            table = {**table, "vehicle": self.facts}
        try:
            return kind.model_validate(table, context={"vehicle": self})
        except ValidationError as error:
            cause, hint = _explain(name, kind, error)
            raise ConfigError(f"{self.path}: {cause}{hint}", cause) from error


def settings_model(process: str) -> type[Section]:
    """Model of a process's settings."""
    return cast("type[Section]", importlib.import_module(f"services.{process}.process").Config)


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
    for name, info in own_fields(kind).items():
        if isinstance(info.annotation, type) and issubclass(info.annotation, Section):
            yield from (f"{name}.{key}" for key in dotted_keys(info.annotation))
        else:
            yield name


def own_fields(kind: type[Section]) -> dict[str, FieldInfo]:
    """Fields that a section of a vehicle's file may hold: without the facts of [vehicle]."""
    return {name: info for name, info in kind.model_fields.items() if info.annotation is not Vehicle}


def _explain(section: str, kind: type[Section], error: ValidationError) -> tuple[str, str]:
    """Describe the first invalid key with the most similar valid one; where none is, all of them are a hint."""
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"])
    keys = list(dotted_keys(kind))
    if key not in keys and (clause := successor(f"{section}.{key}")):
        return f"[{section}] has no setting {key!r}; {clause}", ""
    if first["type"] != "extra_forbidden":
        return f"[{section}] {key} = {first['input']!r}: {first['msg']}", ""
    facts = dotted_keys(Vehicle) if issubclass(kind, VehicleSettings) else ()
    names = {
        **{fact.rpartition(".")[2]: in_section(f"vehicle.{fact}") for fact in facts},
        **{name: repr(known) for known in keys for name in (known.rpartition(".")[2], known)},
    }
    near = difflib.get_close_matches(key, names, n=1) or difflib.get_close_matches(key.rpartition(".")[2], names, n=1)
    if near:
        return f"[{section}] has no setting {key!r}; did you mean {names[near[0]]}?", ""
    return f"[{section}] has no setting {key!r}", f"; known keys: {', '.join(sorted(keys)) or 'none'}"


def read_toml(text: str, path: str) -> dict[str, object]:
    """Read the text of a vehicle's file as it is; raises `ConfigError` if it is no TOML."""
    try:
        return load_toml(text)
    except SizeExceeded as error:
        raise ConfigError(f"{path} is no vehicle's file: {error}; see {EXAMPLES} for examples") from error
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path} is not valid TOML: {error}; correct that line") from error


def parse_vehicle(text: str, path: str = "<text>") -> VehicleFile:
    """Parse the text of a vehicle's file into one table a section."""
    document = read_toml(text, path)
    if old := next(old_keys(document), None):
        raise ConfigError(
            f"{path}: {in_section(old)} is of an earlier version; {successor(old)}. "
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
    """Read the vehicle's file named by the argument or by OBU_VEHICLE; without either, all defaults.

    In the place of the file of OBU_VEHICLE the text holds that the settings of this unit were changed to.
    """
    name = path or os.environ.get("OBU_VEHICLE")
    if not name:
        return parse_vehicle("", "<no vehicle file>")
    try:
        text = read_text(shipped(Path(name)), TOML_BYTES)
    except (OSError, UnicodeDecodeError, SizeExceeded) as error:
        reason = error.strerror if isinstance(error, OSError) else error if isinstance(error, SizeExceeded) else NO_TEXT
        raise UserError(f"cannot read the vehicle's file {name}: {reason}; see {EXAMPLES} for examples") from error
    if path is None and (changed := text_over(text, _state_path())):
        text = without_basis(changed[1])  # its paths are relative to the file of OBU_VEHICLE too
    return parse_vehicle(text, str(name))


LOGIN_VARIABLE = "OBU_TOKEN"  # a token of the page, for commands that ask it


def address_file(state: Path) -> Path:
    """File in which monitoring.status says where it serves the page; nobody else may write it."""
    return page_folder(state) / ADDRESS_FILE


def page_of(state: Path) -> str | None:
    """Address of the page of the unit that runs with a state folder, without a slash at its end; None of none."""
    try:
        return address_file(state.resolve()).read_text(encoding="utf-8").strip().rstrip("/")
    except (OSError, UnicodeDecodeError):
        return None


def broker_address() -> BrokerAddress:
    """The address in OBU_BROKER, else the socket of the unit of this machine, or its port."""
    if url := os.environ.get("OBU_BROKER"):
        return BrokerAddress.parse(url)
    for path in (_state_path().resolve() / SOCKET, INSTALLED_SOCKET):
        if may_connect(path):
            return BrokerAddress.at(path)
    return BrokerAddress()


def may_connect(path: Path) -> bool:
    """Whether there is a socket to which this user may connect; a broker need not listen."""
    try:
        return path.is_socket() and os.access(path, os.W_OK)
    except OSError:
        return False


def _state_path() -> Path:
    return Path(os.environ.get("OBU_STATE", ".obu"))


def state_dir() -> Path:
    """The folder of persistent files: OBU_STATE, or .obu in the working folder; a full disk may leave it missing."""
    path = _state_path()
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        if error.errno in DISK_FAULTS:
            log.warning("cannot make the state folder %s: %s; nothing is kept until it can", path, error.strerror)
            return path
        raise UserError(f"cannot make the state folder {path}: {error.strerror}; set OBU_STATE to one") from error
    return path

"""The mapping of a drive: a TOML document that defines the meaning of the columns of its files."""

import difflib
import tomllib
from collections.abc import Iterator
from typing import Literal, Self

from pydantic import Field, ValidationError, model_validator

from shared.bounded import SizeExceeded, load_toml
from shared.errors import UserError
from shared.runtime.config import Section

from .schema import (
    Accuracy,
    Angle,
    Angles,
    Coordinate,
    Ecef,
    Force,
    Gnss,
    Gyroscope,
    Height,
    Imu,
    Local,
    Origin,
    Quality,
    Quaternion,
    Rate,
    Scalar,
    Speed,
    TableFile,
    Time,
    Truth,
    Velocity,
    Wheels,
)

TruthKind = Literal["none", "fixes", "recorded"]
TrustedQuantity = Literal["position", "velocity", "attitude"]


class Mapping(Section):
    """The mapping of a drive: one table for each file of its folder."""

    name: str = Field(min_length=1, max_length=64)
    vehicle_file: str | None = None  # path relative to the folder of the mapping
    start_utc_s: float = 0.0  # Unix time of zero of the files' clocks
    truth_is: TruthKind = "none"  # default of the option --truth of `obu solve`
    truth_quantities: tuple[TrustedQuantity, ...] = ("position", "velocity", "attitude")
    imu: Imu | None = None
    gyroscope: Gyroscope | None = None
    gnss: Gnss | None = None
    speed: Speed | None = None
    wheels: Wheels | None = None
    truth: Truth | None = None

    @model_validator(mode="after")
    def _something(self) -> Self:
        if not any((self.imu, self.gnss, self.speed, self.wheels)):
            raise ValueError("nothing to import: add [imu], [gnss], [speed] or [wheels]")
        rates = [table is not None for table in (self.imu and self.imu.angular_rate, self.gyroscope)]
        if (self.imu is not None) != any(rates) or all(rates):
            raise ValueError(
                "an IMU is one [imu] table with `specific_force` and `angular_rate`, or two tables: [imu] with "
                "`specific_force` and [gyroscope] with `angular_rate`"
            )
        if self.imu is None and self.gnss is not None and self.gnss.estimate_delay:
            raise ValueError("`estimate_delay` of [gnss] requires an [imu]: the delay is that relative to the IMU")
        if self.gnss is None and self.truth is not None and self.truth.estimate_delay:
            raise ValueError("`estimate_delay` of [truth] requires a [gnss]: the delay is that relative to the fixes")
        if self.truth_is == "recorded" and self.truth is None:
            raise ValueError('truth_is = "recorded" requires a [truth] table')
        if self.speed is not None and self.speed.clock_by_speed and self.gnss is None:
            raise ValueError("`clock_by_speed` requires a [gnss] table")
        if self.truth_is == "fixes" and self.gnss is None:
            raise ValueError('truth_is = "fixes" requires a [gnss] table')
        return self

    def files(self) -> Iterator[TableFile]:
        """Yield the tables of files, in the order in which rows of equal time are delivered."""
        for table in (self.imu, self.gyroscope, self.speed, self.wheels, self.gnss, self.truth):
            if table is not None:
                yield table

    def made(self) -> list[str]:
        """One sentence for each table whose data are computed instead of measured."""
        return [sentence for sentence in (self.speed.made() if self.speed else None,) if sentence]


def parse_mapping(text: str, path: str) -> Mapping:
    """Parse a mapping; raises `UserError` with one sentence on the first fault."""
    try:
        return Mapping.model_validate(load_toml(text))
    except SizeExceeded as error:
        raise UserError(f"{path} is no mapping: {error}; see benchmarks/recordings/mappings/ for examples") from error
    except tomllib.TOMLDecodeError as error:
        raise UserError(f"{path} is not valid TOML: {error}; correct that line") from error
    except ValidationError as error:
        raise UserError(f"{path}: {_explain(error)}; docs/how-to/import-a-drive.md explains the keys") from error


def _explain(error: ValidationError) -> str:
    """Describe the first fault, with a suggestion for an unknown key; unknown keys are reported before missing ones."""
    first = min(error.errors(), key=lambda error_details: error_details["type"] != "extra_forbidden")
    path = ".".join(str(part) for part in first["loc"]) or "mapping"
    if first["type"] == "missing":
        return f"{path} is missing"
    if first["type"] == "extra_forbidden":
        near = difflib.get_close_matches(str(first["loc"][-1]), _every_key(), n=1)
        return f"there is no setting {path!r}" + (f": did you mean {near[0]!r}?" if near else "")
    return f"{path}: {first['msg'].removeprefix('Value error, ')}"


def _every_key() -> set[str]:
    tables: tuple[type[Section], ...] = (
        Mapping, Imu, Gyroscope, Gnss, Speed, Wheels, Truth, Time, Force, Rate, Angle, Angles, Scalar, Coordinate,
        Height, Ecef, Local, Origin, Quaternion, Velocity, Accuracy, Quality,
    )  # fmt: skip
    return {key for table in tables for key in table.model_fields}

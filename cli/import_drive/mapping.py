"""The mapping of a drive: a TOML document that says what the columns of its files mean."""

import difflib
import tomllib
from collections.abc import Iterator
from typing import Literal, Self

from pydantic import Field, ValidationError, model_validator

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
    Height,
    Imu,
    Quality,
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
    """All of a drive: what each file of its folder means."""

    name: str = Field(min_length=1, max_length=64)
    vehicle_file: str | None = None  # from the folder of the mapping
    start_utc_s: float = 0.0  # Unix time at which the clocks of the files show zero
    truth_is: TruthKind = "none"  # what `obu solve` takes for the truth unless told otherwise
    truth_quantities: tuple[TrustedQuantity, ...] = ("position", "velocity", "attitude")
    imu: Imu | None = None
    gnss: Gnss | None = None
    speed: Speed | None = None
    wheels: Wheels | None = None
    truth: Truth | None = None

    @model_validator(mode="after")
    def _something(self) -> Self:
        if not any((self.imu, self.gnss, self.speed, self.wheels)):
            raise ValueError("there is nothing to import: add [imu], [gnss], [speed] or [wheels]")
        if self.truth_is == "recorded" and self.truth is None:
            raise ValueError('truth_is = "recorded" needs a [truth] table')
        if self.speed is not None and self.speed.clock_by_speed and self.gnss is None:
            raise ValueError("`clock_by_speed` needs a [gnss] table")
        if self.truth_is == "fixes" and self.gnss is None:
            raise ValueError('truth_is = "fixes" needs a [gnss] table')
        return self

    def files(self) -> Iterator[TableFile]:
        """Give the tables that name a file, in the order in which rows of one instant are delivered."""
        for table in (self.imu, self.speed, self.wheels, self.gnss, self.truth):
            if table is not None:
                yield table

    def made(self) -> list[str]:
        """Say of each table that no sensor measured how it was made."""
        return [sentence for sentence in (self.speed.made() if self.speed else None,) if sentence]


def parse_mapping(text: str, path: str) -> Mapping:
    """Read a mapping, or raise `UserError` with one sentence on the first thing that is wrong."""
    try:
        return Mapping.model_validate(tomllib.loads(text))
    except tomllib.TOMLDecodeError as error:
        raise UserError(f"{path} is not valid TOML: {error}; mend that line") from error
    except ValidationError as error:
        raise UserError(f"{path}: {_explain(error)}; docs/how-to/import-a-drive.md explains the keys") from error


def _explain(error: ValidationError) -> str:
    """Say what is wrong with one bad key, and what may have been meant; a misspelt one explains a missing one."""
    first = min(error.errors(), key=lambda found: found["type"] != "extra_forbidden")
    path = ".".join(str(part) for part in first["loc"]) or "mapping"
    if first["type"] == "missing":
        return f"{path} is missing"
    if first["type"] == "extra_forbidden":
        near = difflib.get_close_matches(str(first["loc"][-1]), _every_key(), n=1)
        return f"there is no setting {path!r}" + (f": did you mean {near[0]!r}?" if near else "")
    return f"{path}: {first['msg'].removeprefix('Value error, ')}"


def _every_key() -> set[str]:
    tables: tuple[type[Section], ...] = (
        Mapping, Imu, Gnss, Speed, Wheels, Truth,
        Time, Force, Rate, Angle, Angles, Scalar, Coordinate, Height, Ecef, Velocity, Accuracy, Quality,
    )  # fmt: skip
    return {key for table in tables for key in table.model_fields}

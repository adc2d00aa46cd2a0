"""The toll plaza's file: a GeoJSON feature collection of lanes, lines and the surveyed antenna, with the tariff.

The foreign members `plaza` (name) and `tariff` (version, currency, classes in 1/100 of the currency) stand
beside `features`. A feature's property `kind` is `antenna` (a point with height), `lane` (its centre line in driving
direction; `lane`, `direction`, `width_m`, `mode`, `detector`: whether the lane's pulses are published,
`detector_direction`: whether they state the direction, and `traffic`: `cits_only` or `mixed`), or `approach`, `gate`,
`exit` (a line across a `direction`).
`require_authenticated` (true unless the file says false) refuses to charge by CAM that are not authenticated, and
`operator_keys` are the Ed25519 public keys, 64 hexadecimal digits each, with which the operator signs registrations.
Coordinates are longitude and latitude in degrees, WGS-84.
"""

import hashlib
import json
import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, ValidationError, model_validator

from .. import shipped
from ..bounded import SizeExceeded, load_json, read_bytes
from ..errors import ConfigError
from ..maths.earth import Geodetic, geodetic_from_ned_difference, ned_from_geodetic_difference
from ..messages.fitting import size
from ..messages.toll import GateMode, LaneDescription, LaneTraffic, PlazaDescription, Position
from ..topics import BY_NAME

FloatArray = npt.NDArray[np.float64]
MAXIMUM_LANES = 100  # whose balances of two hours one message holds
MAXIMUM_BYTES = 1_000_000
MAXIMUM_EXTENT_M = 5_000.0  # within it the tangent plane is accurate to a few centimetres
Longitude = Annotated[float, Field(ge=-180.0, le=180.0)]
Latitude = Annotated[float, Field(ge=-90.0, le=90.0)]
Coordinates = tuple[Longitude, Latitude]
OperatorKey = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
MAXIMUM_KEYS = 16


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


class Tariff(_Part):
    """Price of a passage by tariff class, in 1/100 of the currency."""

    version: Annotated[str, Field(min_length=1, max_length=64)]
    currency: Annotated[str, Field(pattern=r"^[A-Z]{3}$")]
    classes: dict[str, Annotated[int, Field(ge=0, le=10_000_000)]]


class _Point(_Part):
    type: Literal["Point"]
    coordinates: tuple[Longitude, Latitude, float]


class _Line(_Part):
    type: Literal["LineString"]
    coordinates: Annotated[tuple[Coordinates, ...], Field(min_length=2, max_length=500)]


class _AntennaProperties(_Part):
    kind: Literal["antenna"]


class _LaneProperties(_Part):
    kind: Literal["lane"]
    lane: Annotated[str, Field(min_length=1, max_length=64)]
    direction: Annotated[str, Field(min_length=1, max_length=64)]
    width_m: Annotated[float, Field(gt=1.0, lt=20.0)]
    mode: GateMode = GateMode.FREE_FLOW
    detector: bool = False
    detector_direction: bool = False
    traffic: LaneTraffic = LaneTraffic.CITS_ONLY


class _LineProperties(_Part):
    kind: Literal["approach", "gate", "exit"]
    direction: Annotated[str, Field(min_length=1, max_length=64)]


class _Antenna(_Part):
    properties: _AntennaProperties
    geometry: _Point


class _Lane(_Part):
    properties: _LaneProperties
    geometry: _Line


class _Across(_Part):
    properties: _LineProperties
    geometry: _Line


def _kind_of(feature: object) -> str:
    """Choose the schema of a feature by its property `kind`, so that an error names the fault in it."""
    properties = feature.get("properties") if isinstance(feature, dict) else None
    kind = properties.get("kind") if isinstance(properties, dict) else None
    return "line" if kind in ("approach", "gate", "exit") else str(kind)


_Feature = Annotated[
    Annotated[_Antenna, Tag("antenna")] | Annotated[_Lane, Tag("lane")] | Annotated[_Across, Tag("line")],
    Discriminator(_kind_of),
]


class _Document(_Part):
    type: Literal["FeatureCollection"]
    plaza: Annotated[str, Field(min_length=1, max_length=64)]
    tariff: Tariff
    require_authenticated: bool = True
    operator_keys: Annotated[tuple[OperatorKey, ...], Field(max_length=MAXIMUM_KEYS)] = ()
    features: Annotated[tuple[_Feature, ...], Field(max_length=500)]

    @model_validator(mode="after")
    def _is_complete(self) -> "_Document":
        lanes = [f.properties for f in self.features if isinstance(f, _Lane)]
        across = [(f.properties.direction, f.properties.kind) for f in self.features if isinstance(f, _Across)]
        if sum(isinstance(f, _Antenna) for f in self.features) != 1:
            raise ValueError("exactly one feature of kind 'antenna' is required")
        if self.require_authenticated and not self.operator_keys:
            raise ValueError(
                "operator_keys is empty: name the public key with which the operator signs registrations, or allow CAM "
                "that are not authenticated by require_authenticated: false"
            )
        if not lanes or len({lane.lane for lane in lanes}) != len(lanes):
            raise ValueError("at least one feature of kind 'lane' is required, each with a name of its own")
        for direction in {lane.direction for lane in lanes}:
            for kind in ("approach", "gate", "exit"):
                if across.count((direction, kind)) != 1:
                    raise ValueError(f"direction {direction!r} needs exactly one line of kind {kind!r}")
        return self


class Lane(_Part):
    """One lane in the local tangent plane: (north, east) in metres from the antenna."""

    model_config = ConfigDict(frozen=True, arbitrary_types_allowed=True)

    name: str
    direction: str
    mode: GateMode
    detector: bool
    detector_direction: bool
    traffic: LaneTraffic
    width_m: float
    centre: FloatArray  # shape (n, 2), in driving direction
    approach: FloatArray  # shape (2, 2): the ends of the line
    gate: FloatArray
    exit: FloatArray


class Plaza(_Part):
    """A toll plaza in the local tangent plane (north, east, down) at its antenna."""

    model_config = ConfigDict(frozen=True, arbitrary_types_allowed=True)

    name: str
    digest: str  # SHA-256 of the file's bytes, hexadecimal
    antenna: Geodetic
    tariff: Tariff
    require_authenticated: bool
    operator_keys: tuple[str, ...]
    lanes: tuple[Lane, ...]

    def plane(self, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
        """Transform a position at the antenna's height to (north, east) [m]."""
        point = Geodetic(math.radians(latitude_deg), math.radians(longitude_deg), self.antenna.height)
        return ned_from_geodetic_difference(point, self.antenna)[:2]

    def position(self, north: float, east: float) -> Position:
        """Transform (north, east) [m] to a position: the inverse of `plane`."""
        point = geodetic_from_ned_difference((north, east, 0.0), self.antenna)
        return Position(latitude_deg=math.degrees(point.latitude), longitude_deg=math.degrees(point.longitude))

    def description(self, now_ns: int) -> PlazaDescription:
        """Make the message that describes the plaza on the bus."""
        return PlazaDescription(
            sampled_ns=now_ns,
            plaza=self.name,
            plaza_digest=self.digest,
            antenna=self.position(0.0, 0.0),
            antenna_height_ellipsoid_m=self.antenna.height,
            lanes=tuple(
                LaneDescription(
                    lane=lane.name,
                    direction=lane.direction,
                    mode=lane.mode,
                    detector=lane.detector,
                    detector_direction=lane.detector_direction,
                    traffic=lane.traffic,
                    width_m=lane.width_m,
                    centre=self._positions(lane.centre),
                    approach_line=self._ends(lane.approach),
                    gate_line=self._ends(lane.gate),
                    exit_line=self._ends(lane.exit),
                )
                for lane in self.lanes
            ),
        )

    def _positions(self, line: FloatArray) -> tuple[Position, ...]:
        return tuple(self.position(north, east) for north, east in line.tolist())

    def _ends(self, line: FloatArray) -> tuple[Position, Position]:
        first, *_, last = self._positions(line)
        return first, last


def parse_plaza(text: bytes, path: str = "<bytes>") -> Plaza:
    """Read a plaza's file.

    Raises
    ------
    ConfigError
        The file is no plaza; the text names the first fault and what to change.
    """
    if len(text) > MAXIMUM_BYTES:
        raise ConfigError(f"{path} has more than {MAXIMUM_BYTES} bytes; a plaza needs a few kilobytes")
    try:
        document = _Document.model_validate(load_json(text, MAXIMUM_BYTES))
    except (UnicodeDecodeError, json.JSONDecodeError, SizeExceeded) as error:
        raise ConfigError(f"{path} is not valid JSON: {error}; compare with deploy/plazas/example.geojson") from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise ConfigError(
            f"{path}: {where + ': ' if where else ''}{first['msg']}; compare with deploy/plazas/example.geojson"
        ) from error
    (point,) = (f.geometry.coordinates for f in document.features if isinstance(f, _Antenna))
    antenna = Geodetic(math.radians(point[1]), math.radians(point[0]), point[2])
    across = {
        (f.properties.direction, f.properties.kind): _plane(f.geometry.coordinates, antenna, path)
        for f in document.features
        if isinstance(f, _Across)
    }
    lanes = tuple(
        Lane(
            name=f.properties.lane,
            direction=f.properties.direction,
            mode=f.properties.mode,
            detector=f.properties.detector,
            detector_direction=f.properties.detector_direction,
            traffic=f.properties.traffic,
            width_m=f.properties.width_m,
            centre=_plane(f.geometry.coordinates, antenna, path),
            approach=across[f.properties.direction, "approach"],
            gate=across[f.properties.direction, "gate"],
            exit=across[f.properties.direction, "exit"],
        )
        for f in document.features
        if isinstance(f, _Lane)
    )
    for lane in lanes:
        _insist_on_order(lane, path)
    digest = hashlib.sha256(text).hexdigest()
    return Plaza(
        name=document.plaza, digest=digest, antenna=antenna, tariff=document.tariff, lanes=lanes,
        require_authenticated=document.require_authenticated, operator_keys=document.operator_keys,
    )  # fmt: skip


def plaza_path(path: Path) -> Path:
    """Find a plaza's file; a relative path is looked for in the working folder, then beside the code."""
    return shipped(path)


def load_plaza(path: Path) -> Plaza:
    """Read a plaza's file."""
    try:
        plaza = parse_plaza(read_bytes(plaza_path(path), MAXIMUM_BYTES), str(path))
    except SizeExceeded as error:
        raise ConfigError(f"{path} is no plaza: {error}; a plaza needs a few kilobytes") from error
    except OSError as error:
        raise ConfigError(f"cannot read the plaza's file {path}: {error.strerror}; see deploy/plazas/") from error
    taken, most = size(plaza.description(0)), BY_NAME["plaza/description"].most_bytes - 1_000
    if len(plaza.lanes) > MAXIMUM_LANES or taken > most:
        raise ConfigError(
            f"{path}: {len(plaza.lanes)} lanes, which take {taken} bytes on the bus; {MAXIMUM_LANES} lanes and {most} "
            "bytes are possible: leave out points of the centre lines, or divide the plaza among several units"
        )
    return plaza


def along(centre: FloatArray, line: FloatArray) -> float | None:
    """Distance [m] along a centre line, shape (n, 2), to where it crosses a line, shape (2, 2); None if it does not."""
    start = 0.0
    across = line[-1] - line[0]
    for a, b in pairwise(centre):
        step = b - a
        length = float(np.hypot(*step))
        determinant = float(step[0] * across[1] - step[1] * across[0])
        if determinant != 0.0:
            away = line[0] - a
            share = float(away[0] * across[1] - away[1] * across[0]) / determinant
            offset = float(away[0] * step[1] - away[1] * step[0]) / determinant
            if 0.0 <= share <= 1.0 and 0.0 <= offset <= 1.0:
                return start + share * length
        start += length
    return None


def _plane(coordinates: Sequence[Coordinates], antenna: Geodetic, path: str) -> FloatArray:
    points = [
        ned_from_geodetic_difference(Geodetic(math.radians(lat), math.radians(lon), antenna.height), antenna)[:2]
        for lon, lat in coordinates
    ]
    if max(math.hypot(*point) for point in points) > MAXIMUM_EXTENT_M:
        raise ConfigError(f"{path}: a point is more than {MAXIMUM_EXTENT_M:.0f} m from the antenna; longitude is first")
    return np.array(points)


def _insist_on_order(lane: Lane, path: str) -> None:
    found = [along(lane.centre, line) for line in (lane.approach, lane.gate, lane.exit)]
    distances = [d for d in found if d is not None]
    if len(distances) < 3 or sorted(distances) != distances:
        raise ConfigError(
            f"{path}: lane {lane.name!r} does not cross its approach, gate and exit line in this order; "
            "its centre line runs in driving direction, and the lines span all lanes of the direction"
        )

"""The tables of a mapping: each defines the columns of one file."""

from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator
from scipy.linalg import polar

from shared.maths.earth import FloatArray
from shared.maths.rotation import ned_from_body
from shared.messages.base import Vector3
from shared.runtime.config import Section

from ..conversion.scales import Scale
from . import units

Columns = tuple[str, str, str]
Four = tuple[str, str, str, str]
Direction = Literal["forward", "backward", "right", "left", "down", "up"]
QualityWord = Literal["fixed", "float", "differential", "single"]
DIRECTIONS: dict[str, Vector3] = {
    "forward": (1.0, 0.0, 0.0),
    "backward": (-1.0, 0.0, 0.0),
    "right": (0.0, 1.0, 0.0),
    "left": (0.0, -1.0, 0.0),
    "down": (0.0, 0.0, 1.0),
    "up": (0.0, 0.0, -1.0),
}


class Time(Section):
    """Sampling time of a row: a column plus an offset, or the row number times a period.

    With `arrival_column`, `column` is the device clock; its offset to the clock of the arrivals is the smallest
    difference of the two, less the minimum latency `least_latency_s`. With `date_column` or `week_column`, `column` is
    the time of that day or of that GPS week.
    """

    column: str | None = None
    unit: units.TimeUnit = "s"
    period_s: float | None = Field(default=None, gt=0.0)
    offset_s: float = 0.0
    date_column: str | None = None
    week_column: str | None = None
    scale: Scale | None = None  # default: UTC, or GPS time with a week; what leap seconds are removed
    wraps_s: float | None = Field(
        default=None, gt=0.0
    )  # period after which the clock starts anew, if it is no known one
    arrival_column: str | None = None
    least_latency_s: float = Field(default=0.0, ge=0.0)

    @model_validator(mode="after")
    def _one_clock(self) -> Self:
        if (self.column is None) == (self.period_s is None):
            raise ValueError("time is either a `column` or `period_s` times the row number")
        if self.arrival_column is not None and self.column is None:
            raise ValueError("`arrival_column` requires a `column` with the device clock")
        if (self.date_column or self.week_column) and (self.column is None or self.arrival_column is not None):
            raise ValueError(
                "`date_column` and `week_column` require a `column` with the time, and no `arrival_column`"
            )
        if self.date_column is not None and self.week_column is not None:
            raise ValueError("the day is given by `date_column` or by `week_column`, not by both")
        if self.unit == units.DATE and (self.week_column is not None or self.wraps_s is not None):
            raise ValueError("`week_column` and `wraps_s` require a `unit` other than date")
        return self

    @property
    def known_scale(self) -> Scale:
        """The time scale of the stamps."""
        return self.scale or ("gps" if self.week_column is not None else "utc")


class TableFile(Section):
    """One file of rows; without `header`, the first line after `skip_rows` names the columns.

    A .npz file holds NumPy arrays: the columns are `name`, or `name[0]`, `name[1]`... of a two-dimensional array.
    """

    file: str
    optional: bool = False  # whether the file may be missing
    separator: Annotated[str, Field(min_length=1, max_length=1)] | Literal["whitespace"] = ","
    decimal: Literal[".", ","] = "."
    skip_rows: int = Field(default=0, ge=0)
    header: tuple[str, ...] = ()
    source: str = Field(default="file", max_length=64)
    time: Time
    stamps_late_s: float = 0.0  # delay of the stamp relative to the time of validity of its row
    latency_s: float = Field(default=0.0, ge=0.0)  # simulated delay of the arrival
    only_changes_of: tuple[str, ...] = ()  # a row is used only if one of these columns changed


class Force(Section):
    """Specific force along the sensor's x, y and z axes, or its velocity increments (delta-v).

    With `opposite` the sign is reversed: -1 g at standstill along the axis that points up.
    """

    columns: Columns
    unit: units.ForceUnit
    opposite: bool = False


class Rate(Section):
    """Angular rate about three axes, or its angle increments (delta-theta)."""

    columns: Columns
    unit: units.RateUnit


class Angles(Section):
    """Roll, pitch and yaw of the body relative to NED."""

    columns: Columns
    unit: units.AngleUnit


class Scalar(Section):
    """A speed; `invalid` is the value of a row in which it is unknown."""

    column: str
    unit: units.SpeedUnit
    invalid: float | None = None


class Angle(Section):
    """One angle; `invalid` is the value of a row in which it is unknown."""

    column: str
    unit: units.AngleUnit
    invalid: float | None = None


class Coordinate(Section):
    """Latitude or longitude."""

    column: str
    unit: units.CoordinateUnit


class Height(Section):
    """Height above the ellipsoid or above mean sea level, and the geoid separation (their difference)."""

    column: str
    unit: units.LengthUnit = "m"
    kind: Literal["ellipsoid", "msl"]
    geoid_separation_m: float | None = None
    upward: bool = False  # somebody has seen that it grows uphill


class Ecef(Section):
    """Cartesian ECEF position."""

    columns: Columns
    unit: units.LengthUnit = "m"


class Origin(Section):
    """Origin of local coordinates; `height_m` is above the ellipsoid."""

    latitude_deg: float = Field(ge=-90.0, le=90.0)
    longitude_deg: float = Field(ge=-180.0, le=180.0)
    height_m: float


class Local(Section):
    """Cartesian position in the plane that touches the ellipsoid's normal frame at an origin."""

    columns: Columns
    unit: units.LengthUnit = "m"
    axes: Literal["ned", "enu", "neu"]
    origin: Origin


class Quaternion(Section):
    """Attitude as a unit quaternion.

    `direction` names the rotation as to_from_from: "ned_from_body" turns vectors in body axes to north, east, down.
    """

    columns: Four
    order: Literal["wxyz", "xyzw"]
    direction: Literal["ned_from_body", "body_from_ned", "enu_from_body", "body_from_enu"]
    body: Literal["frd", "flu"]  # forward, right, down; or forward, left, up


class Velocity(Section):
    """Velocity over ground; `axes` defines the frame and order of the three columns."""

    columns: Columns
    unit: units.SpeedUnit
    axes: Literal["ned", "enu", "neu", "ecef", "body"]


class Accuracy(Section):
    """Standard deviation of each axis: from columns, or constant."""

    columns: Columns | None = None
    axes: Literal["ned", "enu", "neu"] = "ned"
    scale: float = Field(default=1.0, gt=0.0)  # factor of the columns
    constant_ned: Vector3 | None = None

    @model_validator(mode="after")
    def _one_origin(self) -> Self:
        if (self.columns is None) == (self.constant_ned is None):
            raise ValueError("an accuracy is either `columns` or `constant_ned`")
        return self


class Quality(Section):
    """Fix quality by the value of a column; rows with other values are omitted."""

    column: str
    values: dict[str, QualityWord]

    @model_validator(mode="after")
    def _numbers(self) -> Self:
        for key in self.values:
            float(key)
        return self


class Sensor(TableFile):
    """Axes and mounting of an inertial sensor in the vehicle.

    Either `axes` gives the directions of the sensor's x, y and z axes, or `body_from_sensor` the rotation matrix, or
    both are estimated. `mounting_rpy_deg` is an additional rotation of the sensor in the vehicle.
    """

    estimate_axes: bool = False  # whether they are estimated from gravity and the changes of the speed of the fixes
    axes: tuple[Direction, Direction, Direction] | None = None
    body_from_sensor: tuple[Vector3, Vector3, Vector3] | None = None
    mounting_rpy_deg: Vector3 = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _rotation(self) -> Self:
        if sum((self.axes is not None, self.body_from_sensor is not None, self.estimate_axes)) != 1:
            raise ValueError(
                "the sensor axes are given either by `axes` (three of forward, backward, right, left, down, up) or by "
                "`body_from_sensor` (a rotation matrix), or estimated (`estimate_axes = true`)"
            )
        matrix = self._turned()
        if not np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-3) or np.linalg.det(matrix) < 0.0:
            raise ValueError("the sensor axes are not a right-handed set; check the direction of each")
        return self

    def matrix(self) -> FloatArray:
        """Rotation matrix from sensor axes to body axes (forward, right, down)."""
        nearest, _ = polar(self._turned())  # orthonormalises a matrix given with a few digits
        rotation: FloatArray = ned_from_body(*np.radians(self.mounting_rpy_deg)) @ nearest
        return rotation

    def _turned(self) -> FloatArray:
        if self.axes is not None:
            return np.array([DIRECTIONS[word] for word in self.axes]).T
        return np.eye(3) if self.body_from_sensor is None else np.array(self.body_from_sensor)


class Imu(Sensor):
    """The inertial measurement unit; without `angular_rate` its accelerometer, beside a [gyroscope]."""

    source: str = "imu"
    specific_force: Force
    angular_rate: Rate | None = None


class Gyroscope(Sensor):
    """A gyroscope in a file of its own; the specific force of [imu] is interpolated to its stamps."""

    source: str = "imu"
    angular_rate: Rate


class PositionColumns(TableFile):
    """A file with positions in one of three forms."""

    latitude: Coordinate | None = None
    longitude: Coordinate | None = None
    height: Height | None = None
    position_ecef: Ecef | None = None
    position_local: Local | None = None
    estimate_delay: bool = False  # whether the delay of the stamps is estimated, relative to IMU or fixes

    @model_validator(mode="after")
    def _one_position(self) -> Self:
        geodetic = [item is not None for item in (self.latitude, self.longitude, self.height)]
        forms = (all(geodetic), self.position_ecef is not None, self.position_local is not None)
        if any(geodetic) != all(geodetic) or sum(forms) != 1:
            raise ValueError(
                "the position is given in one of three forms: `latitude`, `longitude` and `height`; `position_ecef`; "
                "or `position_local` with `axes` (ned, enu, neu) and `origin`"
            )
        return self


class Gnss(PositionColumns):
    """The GNSS receiver: position and velocity of its antenna."""

    source: str = "gnss"
    velocity: Velocity | None = None
    ground_speed: Scalar | None = None
    course: Angle | None = None  # course over ground, clockwise from north
    hdop: str | None = None
    vdop: str | None = None
    position_sd: Accuracy | None = None  # [m]
    velocity_sd: Accuracy | None = None  # [m/s]
    quality: Quality | QualityWord = "single"
    satellites_used: str | None = None

    @model_validator(mode="after")
    def _earth_axes(self) -> Self:
        if self.velocity is not None and self.velocity.axes == "body":
            raise ValueError("velocity.axes of a receiver must be ned, enu, neu or ecef")
        if (self.ground_speed is None) != (self.course is None):
            raise ValueError("`ground_speed` and `course` must be given together")
        return self


class Speed(TableFile):
    """Speed of the vehicle: from a sensor's column, or computed from the velocity of a reference."""

    source: str = "speed"
    column: str | None = None
    unit: units.SpeedUnit | units.RateUnit = "m/s"
    wheel_radius_m: float | None = Field(default=None, gt=0.0)  # radius of the wheel if the column is its rotation rate
    opposite: bool = False  # whether the column is negative while the vehicle drives forward
    clock_by_speed: bool = False  # whether the clock offset of the file is estimated from the speed of the fixes
    resolution_m_s: float | None = Field(default=None, gt=0.0)
    made_from: Velocity | None = None
    noise_sd_m_s: float = Field(default=0.0, ge=0.0)  # white noise added to a computed speed
    noise_seed: int = Field(default=1, ge=0)

    @model_validator(mode="after")
    def _one_origin(self) -> Self:
        if (self.column is None) == (self.made_from is None):
            raise ValueError("a speed is either a `column` or `made_from` the velocity of a reference")
        if (self.unit in units.RATE) != (self.wheel_radius_m is not None):
            raise ValueError("`wheel_radius_m` is required for a wheel's rotation rate, and not allowed for a speed")
        if self.unit not in units.RATE and self.unit not in units.SPEED:
            raise ValueError(f"{self.unit!r} is neither a unit of speed nor of rotation rate")
        if self.column is not None and self.noise_sd_m_s:
            raise ValueError("`noise_sd_m_s` is allowed with `made_from` only: a measured speed has its own noise")
        return self

    def made(self) -> str | None:
        """A sentence that states how the speed was computed; None for a measured one."""
        if self.made_from is None:
            return None
        return (
            f"The speed is not measured: it is that of the reference in {self.file} with "
            f"{self.noise_sd_m_s:g} m/s of white noise (seed {self.noise_seed})."
        )


class Wheels(TableFile):
    """Speed of each wheel; wheels may be omitted."""

    source: str = "wheels"
    unit: units.SpeedUnit
    front_left: str | None = None
    front_right: str | None = None
    rear_left: str | None = None
    rear_right: str | None = None

    @model_validator(mode="after")
    def _some_wheel(self) -> Self:
        if not (self.front_left or self.front_right or self.rear_left or self.rear_right):
            raise ValueError("no wheel has a column")
        return self


class Truth(PositionColumns):
    """A reference of higher grade: position and, if known, velocity, attitude and angular rate of the body.

    `at` is the point of its positions: "imu", or "antenna" for those of a receiver. With `quality`, rows of unlisted
    values are omitted: the fixes of one quality are then the truth for those of another in [gnss].
    """

    source: str = "truth"
    at: Literal["imu", "antenna"] = "imu"
    quality: Quality | None = None
    velocity: Velocity | None = None
    attitude: Angles | None = None
    quaternion: Quaternion | None = None
    angular_rate: Rate | None = None

    @model_validator(mode="after")
    def _known_attitude(self) -> Self:
        if self.attitude is not None and self.quaternion is not None:
            raise ValueError("the true attitude is `attitude` (roll, pitch, yaw) or `quaternion`, not both")
        if self.velocity is not None and self.velocity.axes == "body" and not (self.attitude or self.quaternion):
            raise ValueError("a velocity in body axes requires `attitude` or `quaternion`; others: ned, enu, neu, ecef")
        if self.height is not None and self.height.kind == "msl" and self.height.geoid_separation_m is None:
            raise ValueError("a true height above sea level requires `geoid_separation_m`")
        return self

    @property
    def quantities(self) -> tuple[str, ...]:
        """What the table holds."""
        known = {"velocity": self.velocity, "attitude": self.attitude or self.quaternion}
        return ("position", *(name for name, given in known.items() if given is not None))

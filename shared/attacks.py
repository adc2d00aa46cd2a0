"""The attacks of the simulator: what each does, its parameters with their limits, and their notation as text.

`drag_off(acceleration=0.1,speed=1)@60:120` is an attack with two parameters that begins 60 s after the start of the
drive and lasts 120 s. A parameter may be shortened as long as it is unique: `drag_off(accel=0.1)@60`.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from math import isfinite

from .messages.simulation import MAX_DURATION_S, AttackName

NOTATION = re.compile(r"(?P<name>\w+)(\((?P<parameters>[^()]*)\))?@(?P<start>[^@:]+)(:(?P<duration>[^@:]+))?")


@dataclass(frozen=True)
class Parameter:
    """A number of an attack: default, limits and unit."""

    name: str
    default: float
    least: float
    greatest: float
    unit: str
    purpose: str


@dataclass(frozen=True)
class AttackRow:
    """One attack: what it does, whom a monitor should accuse, and its parameters."""

    name: AttackName
    purpose: str
    accused: str  # gnss, satellite, odometer, imu, neighbour; empty where a loss of signals is all there is to see
    parameters: tuple[Parameter, ...] = ()
    also: tuple[str, ...] = ()  # further sources that it falsifies: to accuse or to exclude one of them is right too

    @property
    def defaults(self) -> dict[str, float]:
        """Default of each parameter."""
        return {parameter.name: parameter.default for parameter in self.parameters}

    def complete(self, given: Mapping[str, float]) -> dict[str, float]:
        """Fill up given parameters, possibly shortened, with the defaults; raises ValueError for what cannot be."""
        return self.defaults | dict(self._checked(name, value) for name, value in given.items())

    def _checked(self, name: str, value: float) -> tuple[str, float]:
        known = [parameter for parameter in self.parameters if parameter.name == name] or [
            parameter for parameter in self.parameters if name and parameter.name.startswith(name)
        ]
        if len(known) != 1:
            names = ", ".join(parameter.name for parameter in self.parameters) or "none"
            raise ValueError(f"{self.name} has no parameter {name[:40]!r}; its parameters: {names}")
        one = known[0]
        if not (isfinite(value) and one.least <= value <= one.greatest):
            raise ValueError(f"{self.name}: {one.name} must be {one.least:g} to {one.greatest:g} {one.unit}")
        return one.name, float(value)


def _direction(default: float, purpose: str = "clockwise from the vehicle's heading at the start") -> Parameter:
    return Parameter("direction", default, -360.0, 360.0, "deg", purpose)


_DRAG = (
    Parameter("acceleration", 0.3, 0.001, 10.0, "m/s²", "of the drift"),
    Parameter("speed", 3.0, 0.01, 60.0, "m/s", "final speed of the drift"),
    _direction(0.0, "clockwise from the vehicle's heading at the start: 0 along it, 90 across"),
)
_RISE = Parameter("rise", 40.0, 0.0, 3600.0, "s", "in which it grows to its full size; 0: at once")
_BACK = _direction(90.0, "clockwise from the vehicle's heading at the first return of the signals")
_SATELLITES = Parameter("satellites", 1.0, 1.0, 2.0, "satellites", "how many of those in use, drawn by the seed")
_LIE = (
    Parameter("ahead", 0.0, -1000.0, 1000.0, "m", "added to the position, along the course"),
    Parameter("speed", 5.0, -60.0, 60.0, "m/s", "added to the velocity, along the course"),
)

ATTACKS = (
    AttackRow(AttackName.TUNNEL, "all GNSS signals are blocked", ""),
    AttackRow(
        AttackName.JAM, "noise lowers the C/N0 of all satellites until the receiver loses its fix", "",
        (
            Parameter("power", 30.0, 1.0, 60.0, "dB", "final loss of C/N0"),
            Parameter("rise", 6.0, 0.1, 60.0, "dB/s", "how fast the loss grows"),
        ),
    ),
    AttackRow(AttackName.FREEZE, "the receiver repeats its last position and velocity with the time going on", "gnss"),
    AttackRow(AttackName.STATIC_REPLAY, "signals of an antenna that stands where the attack began", "gnss"),
    AttackRow(
        AttackName.STRAIGHT_REPLAY, "signals of a straight drive at constant velocity", "gnss",
        (Parameter("speed", 10.0, 0.1, 60.0, "m/s", "constant speed"), _direction(0.0)),
    ),
    AttackRow(
        AttackName.REPLAY_DRIVE, "signals of another drive of the same scenario, moved to where the attack began",
        "gnss",
        (Parameter("skip", 30.0, 0.0, 600.0, "s", "what is left out of the beginning of the other drive"),),
    ),
    AttackRow(
        AttackName.DELAY, "meaconing: signals of a standing rebroadcaster, late by its delay and the way from it",
        "gnss",
        (
            Parameter("distance", 50.0, 0.0, 5000.0, "m", "from the vehicle to the rebroadcaster at the start"),
            _direction(90.0),
            Parameter("delay", 1.0, 0.0, 1000.0, "µs", "within the rebroadcaster"),
        ),
    ),
    AttackRow(
        AttackName.POSITION_JUMP, "the position steps aside; the velocity stays that of the vehicle", "gnss",
        (Parameter("distance", 100.0, 1.0, 100_000.0, "m", "length of the step"), _direction(90.0)),
    ),
    AttackRow(
        AttackName.DRAG_OFF, "the position drifts away, accelerating to a final velocity", "gnss",
        _DRAG,
    ),
    AttackRow(
        AttackName.CLIMB, "the height drifts upwards, accelerating to a final velocity", "gnss",
        (
            Parameter("acceleration", 0.3, 0.001, 10.0, "m/s²", "of the drift"),
            Parameter("speed", 2.0, -60.0, 60.0, "m/s", "final speed of the drift, negative downwards"),
        ),
    ),
    AttackRow(
        AttackName.TIME_PUSH, "signals of the present place that state another time", "gnss",
        (Parameter("offset", 5.0, -3600.0, 3600.0, "s", "stated time minus true time"),),
    ),
    AttackRow(
        AttackName.STOPWATCH, "the drive goes by more slowly: position and velocity fall back along the track", "gnss",
        (Parameter("share", 0.02, -0.5, 0.5, "", "of the velocity that is missing; negative: too much"), _RISE),
    ),
    AttackRow(
        AttackName.COHERENT_SCALE, "GNSS and the odometer are scaled alike, so that they agree with one another",
        "gnss", (Parameter("factor", 1.1, 0.5, 2.0, "", "reported speed over true speed"), _RISE), ("odometer",),
    ),
    AttackRow(
        AttackName.COLD_START, "the position is aside from the first epoch on, if it begins at 0; true signals follow",
        "gnss",
        (Parameter("distance", 50.0, 1.0, 100_000.0, "m", "from the true place"), _direction(90.0)),
    ),
    AttackRow(
        AttackName.TUNNEL_RETURN, "all signals are blocked, then return from a place aside; the velocity is true",
        "gnss",
        (
            Parameter("gap", 40.0, 0.0, 3600.0, "s", "how long the signals are blocked"),
            Parameter("distance", 80.0, 1.0, 100_000.0, "m", "aside, after the return"), _BACK,
        ),
    ),
    AttackRow(
        AttackName.RATCHET, "the signals are blocked again and again, and return farther aside each time", "gnss",
        (
            Parameter("distance", 4.0, 0.1, 1000.0, "m", "added at each return"),
            Parameter("period", 20.0, 1.0, 3600.0, "s", "from one blockage to the next"),
            Parameter("gap", 5.0, 0.0, 600.0, "s", "how long each blockage lasts"), _BACK,
        ),
    ),
    AttackRow(
        AttackName.STAIRCASE, "the position steps aside again and again; the velocity stays that of the vehicle",
        "gnss",
        (
            Parameter("distance", 8.0, 0.1, 1000.0, "m", "of each step"),
            Parameter("period", 15.0, 0.1, 3600.0, "s", "from one step to the next"), _direction(90.0),
        ),
    ),
    AttackRow(
        AttackName.INTERMITTENT, "the position is aside and true by turns; the velocity stays that of the vehicle",
        "gnss",
        (
            Parameter("distance", 12.0, 0.1, 100_000.0, "m", "aside"),
            Parameter("on", 5.0, 0.1, 3600.0, "s", "how long it is aside"),
            Parameter("off", 20.0, 0.1, 3600.0, "s", "how long it is true then"), _direction(90.0),
        ),
    ),
    AttackRow(
        AttackName.DRAG_HOLD, "the position drifts at a constant speed, of which the velocity shows a share", "gnss",
        (
            Parameter("speed", 1.0, 0.01, 60.0, "m/s", "of the drift"),
            Parameter("share", 0.1, 0.0, 1.0, "", "of that speed, in the velocity"), _direction(90.0),
        ),
    ),
    AttackRow(
        AttackName.CLOCK_DRIFT, "all signals are later and later alike", "gnss",
        (Parameter("rate", 50.0, -1e5, 1e5, "ns/s", "by which the delay grows"),),
    ),
    AttackRow(
        AttackName.UTC_DRIFT, "signals of the present place whose stated time runs away", "gnss",
        (Parameter("rate", 4.0, -1000.0, 1000.0, "ms/s", "stated time minus true time, each second"),),
    ),
    AttackRow(
        AttackName.ACCURACY_LIE, "the receiver states another accuracy of its position, which is true", "gnss",
        (Parameter("accuracy", 0.1, 0.001, 10_000.0, "m", "horizontal; that of the height is 1.5 times as large"),),
    ),
    AttackRow(
        AttackName.MASKED_DRAG, "a drag-off while the receiver states that its velocity is inaccurate", "gnss",
        (*_DRAG, Parameter("deviation", 1.2, 0.01, 100.0, "m/s", "stated standard deviation, of each axis")),
    ),
    AttackRow(
        AttackName.FEW_SATELLITES, "a drag-off while few satellites are left, all on one side", "gnss",
        (*_DRAG, Parameter("satellites", 4.0, 4.0, 12.0, "satellites", "of one constellation, that are left")),
    ),
    AttackRow(
        AttackName.SATELLITE_STEP, "the pseudoranges of one or two satellites step", "satellite",
        (Parameter("error", 50.0, -10_000.0, 10_000.0, "m", "size of the step"), _SATELLITES),
    ),
    AttackRow(
        AttackName.SATELLITE_RAMP, "the pseudoranges of one or two satellites drift", "satellite",
        (
            Parameter("rate", 1.0, -100.0, 100.0, "m/s", "speed of the drift"),
            Parameter("error", 100.0, 0.1, 10_000.0, "m", "at which the drift ends"),
            _SATELLITES,
        ),
    ),
    AttackRow(
        AttackName.SUBSET, "a share of the satellites has consistent signals of a place that moves away", "gnss",
        (
            Parameter("portion", 0.6, 0.01, 1.0, "", "of the satellites in use, drawn by the seed"),
            Parameter("distance", 0.0, 0.0, 100_000.0, "m", "at which that place begins"),
            Parameter("acceleration", 0.3, 0.001, 10.0, "m/s²", "of its drift"),
            Parameter("speed", 3.0, 0.0, 60.0, "m/s", "final speed of its drift; 0: it stays there"),
            _direction(90.0),
        ),
    ),
    AttackRow(
        AttackName.ODOMETER_SCALE, "wheel and OBD-II speeds are scaled", "odometer",
        (Parameter("factor", 1.3, 0.0, 5.0, "", "reported speed over true speed"),),
    ),
    AttackRow(AttackName.ODOMETER_FREEZE, "wheel and OBD-II speeds keep their last value", "odometer"),
    AttackRow(AttackName.WHEEL_ZERO, "wheel and OBD-II speeds stay zero from the next standstill on", "odometer"),
    AttackRow(
        AttackName.TYRE_CHANGE, "other tyres: wheel and OBD-II speeds are scaled by a few per cent", "odometer",
        (Parameter("factor", 1.05, 0.9, 1.1, "", "reported speed over true speed"),),
    ),
    AttackRow(
        AttackName.GYROSCOPE_BIAS, "the yaw rate of the IMU steps", "imu",
        (Parameter("bias", 0.5, -100.0, 100.0, "deg/s", "added to the rate, positive clockwise"),),
    ),
    AttackRow(
        AttackName.ACCELEROMETER_BIAS, "the forward acceleration of the IMU steps", "imu",
        (Parameter("bias", 0.3, -50.0, 50.0, "m/s²", "added to the specific force"),),
    ),
    AttackRow(
        AttackName.NEIGHBOUR_LIE, "one V2X neighbour states a wrong position and velocity", "neighbour", _LIE,
    ),
    AttackRow(
        AttackName.NEIGHBOUR_COLLUSION, "several V2X neighbours state positions and velocities that are wrong alike",
        "neighbour", (Parameter("neighbours", 3.0, 2.0, 6.0, "neighbours", "how many of them lie"), *_LIE),
    ),
)  # fmt: skip
BY_NAME = {row.name: row for row in ATTACKS}


@dataclass(frozen=True)
class ScheduledAttack:
    """An attack of a drive: when it begins, how long it lasts, and its parameters, all of them."""

    attack: AttackName
    start_s: float  # since the start of the drive
    duration_s: float | None = None  # None: until the end
    parameters: Mapping[str, float] = field(default_factory=dict)


def schedule(text: str) -> ScheduledAttack:
    """Read an attack from its notation, such as `drag_off(accel=0.1,speed=1)@60:120`.

    Raises
    ------
    ValueError
        What is wrong, and what is possible instead.
    """
    match = NOTATION.fullmatch(text.strip()[:400])
    if match is None:
        raise ValueError(f"{text[:80]!r} is no attack; write name@start, such as drag_off@60 or jam(power=40)@60:30")
    row = _row(match["name"])
    given = [pair.partition("=") for pair in (match["parameters"] or "").split(",") if pair.strip()]
    parameters = {name.strip(): _number(value, f"{row.name}: {name.strip()}") for name, _, value in given}
    start_s = _number(match["start"], f"{row.name}: the start [s]")
    duration_s = None if match["duration"] is None else _number(match["duration"], f"{row.name}: the duration [s]")
    if not 0.0 <= start_s <= MAX_DURATION_S or (duration_s is not None and not 0.0 < duration_s <= MAX_DURATION_S):
        raise ValueError(f"{row.name}: start and duration must be 0 to {MAX_DURATION_S:g} s")
    return ScheduledAttack(row.name, start_s, duration_s, row.complete(parameters))


def _row(name: str) -> AttackRow:
    if name not in set(AttackName):
        near = get_close_matches(name, list(AttackName), n=1)
        hint = f"did you mean {near[0]}? " if near else ""
        raise ValueError(f"unknown attack {name[:40]!r}; {hint}There are {', '.join(AttackName)}")
    return BY_NAME[AttackName(name)]


def _number(text: str, what: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{what} must be a number, not {text.strip()[:40]!r}") from None

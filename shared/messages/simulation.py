"""Attacks on a simulated vehicle: commands to the simulator, and its answers."""

from enum import StrEnum
from typing import Annotated

from pydantic import Field

from .base import Deviation, Latitude, Longitude, Message, Name, Nanoseconds, Quantity, Reason, unit

Parameters = Annotated[dict[str, Annotated[Quantity, unit("of the parameter")]], Field(max_length=8)]
MAX_DURATION_S = 86_400.0
Duration = Annotated[float, Field(gt=0.0, le=MAX_DURATION_S)]


class AttackName(StrEnum):
    """Attacks and faults that the simulator can produce; shared/attacks.py describes each."""

    TUNNEL = "tunnel"
    JAM = "jam"
    FREEZE = "freeze"
    STATIC_REPLAY = "static_replay"
    STRAIGHT_REPLAY = "straight_replay"
    REPLAY_DRIVE = "replay_drive"
    DELAY = "delay"
    POSITION_JUMP = "position_jump"
    DRAG_OFF = "drag_off"
    CLIMB = "climb"
    TIME_PUSH = "time_push"
    STOPWATCH = "stopwatch"
    COHERENT_SCALE = "coherent_scale"
    COLD_START = "cold_start"
    TUNNEL_RETURN = "tunnel_return"
    RATCHET = "ratchet"
    STAIRCASE = "staircase"
    INTERMITTENT = "intermittent"
    DRAG_HOLD = "drag_hold"
    CLOCK_DRIFT = "clock_drift"
    UTC_DRIFT = "utc_drift"
    ACCURACY_LIE = "accuracy_lie"
    MASKED_DRAG = "masked_drag"
    FEW_SATELLITES = "few_satellites"
    SATELLITE_STEP = "satellite_step"
    SATELLITE_RAMP = "satellite_ramp"
    SUBSET = "subset"
    ODOMETER_SCALE = "odometer_scale"
    ODOMETER_FREEZE = "odometer_freeze"
    WHEEL_ZERO = "wheel_zero"
    TYRE_CHANGE = "tyre_change"
    GYROSCOPE_BIAS = "gyroscope_bias"
    ACCELEROMETER_BIAS = "accelerometer_bias"
    NEIGHBOUR_LIE = "neighbour_lie"
    NEIGHBOUR_COLLUSION = "neighbour_collusion"


class AttackCommand(StrEnum):
    """What to do with an attack."""

    START = "start"  # one that runs already starts again, with the new parameters
    STOP = "stop"


class SimulationAttack(Message):
    """Starts or stops an attack on the simulated vehicle; the answer is the `SimulationState` with its request ID."""

    request_id: Name
    command: AttackCommand
    attack: AttackName | None = None  # None stops every attack
    parameters: Parameters = Field(default_factory=dict)  # those that differ from their defaults
    duration_s: Duration | None = None  # None: until it is stopped


class AttackRun(Message):
    """One attack with all its parameters, from its start to its end."""

    attack: AttackName
    parameters: Parameters = Field(default_factory=dict)
    started_ns: Nanoseconds
    ended_ns: Nanoseconds | None = None  # None while it is active


class SimulationState(Message):
    """The attacks of this drive, and the answer to the last command."""

    sampled_ns: Nanoseconds
    request_id: Name | None = None  # of the last command; None where an attack was scheduled
    refused: Reason | None = None  # why the last command was not executed; None where it was
    attacks: tuple[AttackRun, ...] = ()  # the newest 32, in the order of their start


class RoadLine(Message):
    """Centre line of one road, as many latitudes as longitudes."""

    tunnel: bool  # no GNSS signals
    width_m: Deviation
    latitude_deg: Annotated[tuple[Latitude, ...], Field(min_length=2, max_length=4000)]
    longitude_deg: Annotated[tuple[Longitude, ...], Field(min_length=2, max_length=4000)]


class RoadNetwork(Message):
    """The roads of the simulated world, for a map."""

    sampled_ns: Nanoseconds
    roads: Annotated[tuple[RoadLine, ...], Field(max_length=200)]

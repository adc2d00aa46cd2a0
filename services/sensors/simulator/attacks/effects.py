"""Each attack as a function of the signals without it, of the antenna at its start, and of the time since then.

Attacks on the odometer and on the inertial sensors are functions of their state and readings without them.

A drift d that accelerates with a to the final speed v, with t1 = v/a::

    d = a t²/2  and  d' = a t    until t1,        d = v (t - t1/2)  and  d' = v    after it
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from math import copysign, cos, radians, sin
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shared.maths.earth import Geodetic, ecef_from_geodetic, geodetic_from_ned_difference, ned_from_ecef
from shared.maths.gnss_signals import SPEED_OF_LIGHT
from shared.messages.simulation import AttackName

from ..vehicle import AntennaState, Readings, Vector
from .signals import Odometer, SatelliteFault, Signals

MIN_DISTANCE_M = 1e-3  # below it the direction to a rebroadcaster is not defined
ZERO_VECTOR: Vector = (0.0, 0.0, 0.0)
Parameters = Mapping[str, float]
BoolArray = npt.NDArray[np.bool_]


class Track(NamedTuple):
    """A point of a track: offset from its beginning [m, NED] and velocity [m/s, NED]."""

    offset_n: Vector
    velocity_n: Vector


@dataclass
class Memory:
    """What an attack remembers from epoch to epoch."""

    t: float = 0.0
    offset_n: Vector = ZERO_VECTOR
    velocity_n: Vector = ZERO_VECTOR  # derivative of the offset
    heading: float | None = None  # [rad] of the vehicle when the signals first returned

    def integrate(self, velocity_n: Vector, t: float) -> Vector:
        """Offset [m, NED] at a time, by the trapezoidal rule; the offset is zero at the first time."""
        half = 0.5 * (t - self.t)
        north, east, down = (
            sum_m + half * (a + b) for sum_m, a, b in zip(self.offset_n, self.velocity_n, velocity_n, strict=True)
        )
        self.t, self.offset_n, self.velocity_n = t, (north, east, down), velocity_n
        return self.offset_n


@dataclass(frozen=True)
class Start:
    """What an attack keeps from its start, and what it remembers since then."""

    antenna: AntennaState
    parameters: Parameters
    key: int = 0  # number of the attack
    replayed: Callable[[float], Track] | None = None  # another drive as a function of the time [s]
    memory: Memory = field(default_factory=Memory)


def drift(acceleration: float, speed: float, t: float) -> tuple[float, float]:
    """Distance [m] and speed [m/s] at time t of a drift to a final speed, which may be negative."""
    until = abs(speed) / acceleration
    if t < until:
        a = copysign(acceleration, speed)
        return 0.5 * a * t * t, a * t
    return speed * (t - 0.5 * until), speed


def towards(start: Start) -> tuple[float, float]:
    """North and east components of the direction of an attack."""
    angle = start.antenna.heading + radians(start.parameters["direction"])
    return cos(angle), sin(angle)


def _from(signals: Signals, position: Geodetic, velocity_n: Vector) -> Signals:
    return replace(signals, source=replace(signals.source, position=position, velocity_n=velocity_n))


def _displaced(signals: Signals, offset_n: Vector, velocity_n: Vector) -> Signals:
    """Add an offset and its derivative to position and velocity."""
    north, east, down = (a + b for a, b in zip(signals.source.velocity_n, velocity_n, strict=True))
    position = geodetic_from_ned_difference(offset_n, signals.source.position)
    return _from(signals, position, (north, east, down))


def _from_start(signals: Signals, start: Start, track: Track) -> Signals:
    """Signals of a track that begins where the attack did."""
    position = geodetic_from_ned_difference(track.offset_n, start.antenna.position)
    return _from(signals, position, track.velocity_n)


def _tunnel(signals: Signals, _start: Start, _t: float) -> Signals:
    return replace(signals, source=replace(signals.source, covered=True))


def _jam(signals: Signals, start: Start, t: float) -> Signals:
    rise = min(start.parameters["power"], start.parameters["rise"] * t)
    return replace(signals, noise_rise_db=signals.noise_rise_db + rise)


def _freeze(signals: Signals, _start: Start, _t: float) -> Signals:
    return replace(signals, held=True)


def _static_replay(signals: Signals, start: Start, _t: float) -> Signals:
    return _from(signals, start.antenna.position, ZERO_VECTOR)


def _straight_replay(signals: Signals, start: Start, t: float) -> Signals:
    north, east = (start.parameters["speed"] * part for part in towards(start))
    return _from_start(signals, start, Track((north * t, east * t, 0.0), (north, east, 0.0)))


def _replay_drive(signals: Signals, start: Start, t: float) -> Signals:
    if start.replayed is None:
        raise ValueError("the replay of a drive needs one")
    return _from_start(signals, start, start.replayed(t))


def _delay(signals: Signals, start: Start, _t: float) -> Signals:
    """Signals at the rebroadcaster's antenna, and the way from there to the vehicle's."""
    north, east = (start.parameters["distance"] * part for part in towards(start))
    rebroadcaster = geodetic_from_ned_difference((north, east, 0.0), start.antenna.position)
    here = signals.source
    way_e = np.subtract(ecef_from_geodetic(here.position), ecef_from_geodetic(rebroadcaster))
    way_n = ned_from_ecef(here.position.latitude, here.position.longitude) @ way_e
    length = float(np.linalg.norm(way_n))
    rate = float(way_n @ here.velocity_n) / length if length > MIN_DISTANCE_M else 0.0
    late = SPEED_OF_LIGHT * start.parameters["delay"] * 1e-6
    moved = _from(signals, rebroadcaster, ZERO_VECTOR)
    return replace(moved, path_m=signals.path_m + late + length, path_rate_m_s=signals.path_rate_m_s + rate)


def _jump(parameters: Parameters, _t: float) -> tuple[float, float]:
    return parameters["distance"], 0.0


def _drag(parameters: Parameters, t: float) -> tuple[float, float]:
    return drift(parameters["acceleration"], parameters["speed"], t)


def _steps(parameters: Parameters, t: float) -> tuple[float, float]:
    return parameters["distance"] * (1.0 + t // parameters["period"]), 0.0


def _by_turns(parameters: Parameters, t: float) -> tuple[float, float]:
    away = t % (parameters["on"] + parameters["off"]) < parameters["on"]
    return (parameters["distance"] if away else 0.0), 0.0


def _hold(parameters: Parameters, t: float) -> tuple[float, float]:
    return parameters["speed"] * t, parameters["share"] * parameters["speed"]


# Attacks that move the fix in one direction: distance [m], and what the velocity shows of it [m/s].
OFFSET_DIRECTIONS: Mapping[AttackName, Callable[[Parameters, float], tuple[float, float]]] = {
    AttackName.POSITION_JUMP: _jump,
    AttackName.COLD_START: _jump,
    AttackName.DRAG_OFF: _drag,
    AttackName.MASKED_DRAG: _drag,
    AttackName.FEW_SATELLITES: _drag,
    AttackName.STAIRCASE: _steps,
    AttackName.INTERMITTENT: _by_turns,
    AttackName.DRAG_HOLD: _hold,
}


def _aside(name: AttackName) -> Callable[[Signals, Start, float], Signals]:
    def effect(signals: Signals, start: Start, t: float) -> Signals:
        distance, speed = OFFSET_DIRECTIONS[name](start.parameters, t)
        north, east = towards(start)
        return _displaced(signals, (distance * north, distance * east, 0.0), (speed * north, speed * east, 0.0))

    return effect


def _masked_drag(signals: Signals, start: Start, t: float) -> Signals:
    moved = _aside(AttackName.MASKED_DRAG)(signals, start, t)
    return replace(moved, velocity_sd_m_s=start.parameters["deviation"])


def _few_satellites(signals: Signals, start: Start, t: float) -> Signals:
    moved = _aside(AttackName.FEW_SATELLITES)(signals, start, t)
    return replace(moved, satellites_left=round(start.parameters["satellites"]))


def risen(rise_s: float, t: float) -> float:
    """Share 0 to 1 of an effect that grows to its full size within a time [s]."""
    return 1.0 if t >= rise_s else t / rise_s


def _slipping(signals: Signals, start: Start, t: float, slip: float) -> Signals:
    """Add a share of the velocity to it, and the integral of that to the position."""
    v_north, v_east, v_down = (slip * value for value in signals.source.velocity_n)
    added = (v_north, v_east, v_down)
    return _displaced(signals, start.memory.integrate(added, t), added)


def _stopwatch(signals: Signals, start: Start, t: float) -> Signals:
    return _slipping(signals, start, t, -start.parameters["share"] * risen(start.parameters["rise"], t))


def _coherent_scale(signals: Signals, start: Start, t: float) -> Signals:
    return _slipping(signals, start, t, (start.parameters["factor"] - 1.0) * risen(start.parameters["rise"], t))


def _returned(signals: Signals, start: Start, distance: float) -> Signals:
    """Signals from aside, by the heading that the vehicle had when they first returned."""
    if start.memory.heading is None:
        start.memory.heading = signals.source.heading
    angle = start.memory.heading + radians(start.parameters["direction"])
    return _displaced(signals, (distance * cos(angle), distance * sin(angle), 0.0), ZERO_VECTOR)


def _tunnel_return(signals: Signals, start: Start, t: float) -> Signals:
    if t < start.parameters["gap"]:
        return _tunnel(signals, start, t)
    return _returned(signals, start, start.parameters["distance"])


def _ratchet(signals: Signals, start: Start, t: float) -> Signals:
    before, since_s = divmod(t, start.parameters["period"])
    if since_s < start.parameters["gap"]:
        return _tunnel(signals, start, t)
    return _returned(signals, start, start.parameters["distance"] * (before + 1.0))


def _clock_drift(signals: Signals, start: Start, t: float) -> Signals:
    rate_m_s = SPEED_OF_LIGHT * start.parameters["rate"] * 1e-9
    return replace(signals, path_m=signals.path_m + rate_m_s * t, path_rate_m_s=signals.path_rate_m_s + rate_m_s)


def _utc_drift(signals: Signals, start: Start, t: float) -> Signals:
    return replace(signals, time_offset_s=signals.time_offset_s + start.parameters["rate"] * 1e-3 * t)


def _accuracy_lie(signals: Signals, start: Start, _t: float) -> Signals:
    return replace(signals, position_accuracy_m=start.parameters["accuracy"])


def _subset(signals: Signals, start: Start, t: float) -> Signals:
    distance, speed = drift(start.parameters["acceleration"], start.parameters["speed"], t)
    distance += start.parameters["distance"]
    north, east = towards(start)
    fault = SatelliteFault(
        start.key, portion=start.parameters["portion"],
        offset_n=(distance * north, distance * east, 0.0), velocity_n=(speed * north, speed * east, 0.0),
    )  # fmt: skip
    return replace(signals, faults=(*signals.faults, fault))


def _climb(signals: Signals, start: Start, t: float) -> Signals:
    height, speed = drift(start.parameters["acceleration"], start.parameters["speed"], t)
    return _displaced(signals, (0.0, 0.0, -height), (0.0, 0.0, -speed))


def _time_push(signals: Signals, start: Start, _t: float) -> Signals:
    return replace(signals, time_offset_s=signals.time_offset_s + start.parameters["offset"])


def _satellite_fault(signals: Signals, start: Start, error_m: float, rate_m_s: float) -> Signals:
    fault = SatelliteFault(start.key, round(start.parameters["satellites"]), error_m, rate_m_s)
    return replace(signals, faults=(*signals.faults, fault))


def _satellite_step(signals: Signals, start: Start, _t: float) -> Signals:
    return _satellite_fault(signals, start, start.parameters["error"], 0.0)


def _satellite_ramp(signals: Signals, start: Start, t: float) -> Signals:
    rate, largest = start.parameters["rate"], start.parameters["error"]
    reached = abs(rate) * t >= largest
    error_m = copysign(largest, rate) if reached else rate * t
    return _satellite_fault(signals, start, error_m, 0.0 if reached else rate)


ON_SIGNALS: Mapping[AttackName, Callable[[Signals, Start, float], Signals]] = {
    AttackName.TUNNEL: _tunnel,
    AttackName.JAM: _jam,
    AttackName.FREEZE: _freeze,
    AttackName.STATIC_REPLAY: _static_replay,
    AttackName.STRAIGHT_REPLAY: _straight_replay,
    AttackName.REPLAY_DRIVE: _replay_drive,
    AttackName.DELAY: _delay,
    **{name: _aside(name) for name in OFFSET_DIRECTIONS},
    AttackName.MASKED_DRAG: _masked_drag,
    AttackName.FEW_SATELLITES: _few_satellites,
    AttackName.CLIMB: _climb,
    AttackName.TIME_PUSH: _time_push,
    AttackName.STOPWATCH: _stopwatch,
    AttackName.COHERENT_SCALE: _coherent_scale,
    AttackName.TUNNEL_RETURN: _tunnel_return,
    AttackName.RATCHET: _ratchet,
    AttackName.CLOCK_DRIFT: _clock_drift,
    AttackName.UTC_DRIFT: _utc_drift,
    AttackName.ACCURACY_LIE: _accuracy_lie,
    AttackName.SATELLITE_STEP: _satellite_step,
    AttackName.SATELLITE_RAMP: _satellite_ramp,
    AttackName.SUBSET: _subset,
}


def _scaled(odometer: Odometer, parameters: Parameters, _t: float) -> Odometer:
    return replace(odometer, factor=odometer.factor * parameters["factor"])


def _scaled_alike(odometer: Odometer, parameters: Parameters, t: float) -> Odometer:
    factor = 1.0 + (parameters["factor"] - 1.0) * risen(parameters["rise"], t)
    return replace(odometer, factor=odometer.factor * factor)


def _held(odometer: Odometer, _parameters: Parameters, _t: float) -> Odometer:
    return replace(odometer, held=True)


def _zero(odometer: Odometer, _parameters: Parameters, _t: float) -> Odometer:
    return replace(odometer, zero_from_stop=True)


ON_ODOMETER: Mapping[AttackName, Callable[[Odometer, Parameters, float], Odometer]] = {
    AttackName.ODOMETER_SCALE: _scaled,
    AttackName.TYRE_CHANGE: _scaled,
    AttackName.COHERENT_SCALE: _scaled_alike,
    AttackName.ODOMETER_FREEZE: _held,
    AttackName.WHEEL_ZERO: _zero,
}


def _turned(readings: Readings, parameters: Parameters, active: BoolArray) -> Readings:
    rate_b = readings.rate_b + np.outer(active, (0.0, 0.0, radians(parameters["bias"])))
    return replace(readings, rate_b=rate_b)


def _pushed(readings: Readings, parameters: Parameters, active: BoolArray) -> Readings:
    force_b = readings.force_b + np.outer(active, (parameters["bias"], 0.0, 0.0))
    return replace(readings, force_b=force_b)


# Of a block of readings, and the samples of it during which the attack is active.
ON_INERTIAL: Mapping[AttackName, Callable[[Readings, Parameters, BoolArray], Readings]] = {
    AttackName.GYROSCOPE_BIAS: _turned,
    AttackName.ACCELEROMETER_BIAS: _pushed,
}

ON_NEIGHBOURS = (AttackName.NEIGHBOUR_LIE, AttackName.NEIGHBOUR_COLLUSION)

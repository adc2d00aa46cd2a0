"""Each attack as a function of the signals without it, of the antenna at its start, and of the time since then.

A drift d that accelerates with a to the final speed v, with t1 = v/a::

    d = a t²/2  and  d' = a t    until t1,        d = v (t - t1/2)  and  d' = v    after it
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import copysign, cos, radians, sin
from typing import NamedTuple

import numpy as np

from shared.maths.earth import Geodetic, ecef_from_geodetic, geodetic_from_ned_difference, ned_from_ecef
from shared.maths.gnss_signals import SPEED_OF_LIGHT
from shared.messages.simulation import AttackName

from ..vehicle import AntennaState, Vector
from .signals import Odometer, SatelliteFault, Signals

LEAST_DISTANCE_M = 1e-3  # below it the direction to a rebroadcaster is not defined
STILL: Vector = (0.0, 0.0, 0.0)


class Track(NamedTuple):
    """A point of a track: offset from its beginning [m, NED] and velocity [m/s, NED]."""

    offset_n: Vector
    velocity_n: Vector


@dataclass(frozen=True)
class Start:
    """What an attack keeps from its start."""

    antenna: AntennaState
    parameters: Mapping[str, float]
    key: int = 0  # number of the attack
    replayed: Callable[[float], Track] | None = None  # another drive as a function of the time [s]


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
    return _from(signals, start.antenna.position, STILL)


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
    rate = float(way_n @ here.velocity_n) / length if length > LEAST_DISTANCE_M else 0.0
    late = SPEED_OF_LIGHT * start.parameters["delay"] * 1e-6
    moved = _from(signals, rebroadcaster, STILL)
    return replace(moved, path_m=signals.path_m + late + length, path_rate_m_s=signals.path_rate_m_s + rate)


def _position_jump(signals: Signals, start: Start, _t: float) -> Signals:
    north, east = (start.parameters["distance"] * part for part in towards(start))
    return _displaced(signals, (north, east, 0.0), STILL)


def _drag_off(signals: Signals, start: Start, t: float) -> Signals:
    distance, speed = drift(start.parameters["acceleration"], start.parameters["speed"], t)
    north, east = towards(start)
    return _displaced(signals, (distance * north, distance * east, 0.0), (speed * north, speed * east, 0.0))


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
    AttackName.POSITION_JUMP: _position_jump,
    AttackName.DRAG_OFF: _drag_off,
    AttackName.CLIMB: _climb,
    AttackName.TIME_PUSH: _time_push,
    AttackName.SATELLITE_STEP: _satellite_step,
    AttackName.SATELLITE_RAMP: _satellite_ramp,
}


def _scaled(odometer: Odometer, parameters: Mapping[str, float]) -> Odometer:
    return replace(odometer, factor=odometer.factor * parameters["factor"])


def _held(odometer: Odometer, _parameters: Mapping[str, float]) -> Odometer:
    return replace(odometer, held=True)


ON_ODOMETER: Mapping[AttackName, Callable[[Odometer, Mapping[str, float]], Odometer]] = {
    AttackName.ODOMETER_SCALE: _scaled,
    AttackName.TYRE_CHANGE: _scaled,
    AttackName.ODOMETER_FREEZE: _held,
}

ON_NEIGHBOURS = (AttackName.NEIGHBOUR_LIE, AttackName.NEIGHBOUR_COLLUSION)

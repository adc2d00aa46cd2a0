"""Attacks on a recorded drive: the typed messages of its devices are changed as the attack would change them.

Raw measurements of the receiver are left out while GNSS is attacked, since they would contradict the position. Faults
of single satellites and of neighbours are therefore possible on simulated drives only, as are attacks that block
signals for a time, fall back along the track, or change what the receiver states or the IMU measures.
"""

from collections.abc import Iterable, Iterator, Mapping
from math import atan2, cos, hypot, pi, radians, sin

from services.sensors.simulator.attacks.effects import OFFSET_DIRECTIONS, drift
from shared.attacks import BY_NAME, ScheduledAttack
from shared.errors import UserError
from shared.maths.earth import Geodetic, geodetic_from_ned_difference
from shared.messages.base import Message, RawBytes
from shared.messages.gnss import FixType, GnssFix, GnssNavigationBits, GnssRawEpoch, GnssSatellites
from shared.messages.imu import ImuSamples
from shared.messages.simulation import AttackName
from shared.messages.vehicle import VehicleSpeed, WheelSpeeds
from shared.processes import BY_NAME as PROCESSES
from shared.runtime.config import VehicleFile
from shared.runtime.offline import OfflineUnit

Offset = tuple[float, float, float]  # [m] or [m/s], NED
REPLAYS = (AttackName.STATIC_REPLAY, AttackName.STRAIGHT_REPLAY, AttackName.DELAY)
POSSIBLE = (
    AttackName.TUNNEL, AttackName.JAM, AttackName.FREEZE, *REPLAYS, AttackName.POSITION_JUMP, AttackName.DRAG_OFF,
    AttackName.STAIRCASE, AttackName.INTERMITTENT, AttackName.DRAG_HOLD, AttackName.CLIMB, AttackName.TIME_PUSH,
    AttackName.ODOMETER_SCALE, AttackName.ODOMETER_FREEZE, AttackName.TYRE_CHANGE,
)  # fmt: skip
WHEELS = ("front_left_m_s", "front_right_m_s", "rear_left_m_s", "rear_right_m_s")


def typed(vehicle: VehicleFile, messages: Iterable[Message]) -> Iterator[Message]:
    """Decode raw bytes by the parsers, and yield typed messages only, in the order of arrival."""
    parsers = OfflineUnit(vehicle, [name for name in vehicle.processes if PROCESSES[name].layer == 2])
    return (message for message in parsers.run(messages) if not isinstance(message, RawBytes))


def attacked(messages: Iterable[Message], attack: ScheduledAttack, start_ns: int) -> Iterator[Message]:
    """Yield the messages as the unit would receive them under an attack.

    Parameters
    ----------
    messages : iterable of Message
        Typed, in the order of arrival.
    attack : ScheduledAttack
        With all parameters.
    start_ns : int
        [ns] Start of the drive.

    Raises
    ------
    UserError
        The attack is not possible on a recording.
    """
    if attack.attack not in POSSIBLE:
        raise UserError(f"{attack.attack} is possible on simulated drives only; on recordings: {', '.join(POSSIBLE)}")
    on_odometer = BY_NAME[attack.attack].accused == "odometer"
    state = _Odometer(attack) if on_odometer else _Gnss(attack)
    for message in messages:
        time_s = (_stamp_ns(message) - start_ns) * 1e-9 - attack.start_s
        if not 0.0 <= time_s < (attack.duration_s or float("inf")):
            state.before(message)
            yield message
            continue
        changed = state.during(message, time_s)
        if changed is not None:
            yield changed


def _stamp_ns(message: Message) -> int:
    if isinstance(message, ImuSamples):
        return message.sampled_ns[-1]
    stamp = getattr(message, "sampled_ns", None)
    return int(stamp) if stamp is not None else 0


class _Odometer:
    """Attacks on the speeds of the vehicle."""

    def __init__(self, attack: ScheduledAttack) -> None:
        self._factor = attack.parameters.get("factor")
        self._last: dict[tuple[str, type], dict[str, float | None]] = {}

    def before(self, message: Message) -> None:
        """Keep the last speeds before the attack."""
        if isinstance(message, VehicleSpeed | WheelSpeeds):
            self._last[message.source, type(message)] = _speeds(message)

    def during(self, message: Message, _time_s: float) -> Message | None:
        """Change a speed."""
        if not isinstance(message, VehicleSpeed | WheelSpeeds):
            return message
        if self._factor is None:
            return message.model_copy(update=self._last.get((message.source, type(message)), {}))
        return message.model_copy(
            update={name: value * self._factor for name, value in _speeds(message).items() if value is not None}
        )


def _speeds(message: VehicleSpeed | WheelSpeeds) -> dict[str, float | None]:
    names = WHEELS if isinstance(message, WheelSpeeds) else ("speed_m_s",)
    return {name: getattr(message, name) for name in names}


class _Gnss:
    """Attacks on the receiver."""

    def __init__(self, attack: ScheduledAttack) -> None:
        self._name, self._parameters = attack.attack, attack.parameters
        self._last: dict[str, GnssFix] = {}  # newest fix before the attack, by receiver

    def before(self, message: Message) -> None:
        """Keep the last fix before the attack."""
        if isinstance(message, GnssFix) and message.latitude_deg is not None:
            self._last[message.source] = message

    def during(self, message: Message, time_s: float) -> Message | None:
        """Change a message of the receiver; None removes it."""
        if isinstance(message, GnssRawEpoch | GnssNavigationBits | GnssSatellites):
            return None
        last = self._last.get(message.source) if isinstance(message, GnssFix) else None
        if not isinstance(message, GnssFix) or last is None:
            return message
        if self._name in (AttackName.TUNNEL, AttackName.JAM):
            return without_position(message)
        if self._name is AttackName.TIME_PUSH:
            offset_ns = round(self._parameters["offset"] * 1e9)
            times = {"utc_ns": message.utc_ns, "gps_time_ns": message.gps_time_ns}
            return message.model_copy(update={k: v + offset_ns for k, v in times.items() if v is not None})
        if self._name is AttackName.FREEZE or self._name in REPLAYS:
            return self._replayed(message, last, time_s)
        heading = _course(last)
        position, velocity = displacement(self._name, self._parameters, heading, time_s)
        return moved(message, position, velocity)

    def _replayed(self, message: GnssFix, last: GnssFix, time_s: float) -> GnssFix:
        """Position and velocity of another antenna, at the times of the receiver."""
        stamps = {"sampled_ns": message.sampled_ns, "received_ns": message.received_ns, "utc_ns": message.utc_ns,
                  "gps_time_ns": message.gps_time_ns}  # fmt: skip
        copy = last.model_copy(update=stamps)
        if self._name is AttackName.FREEZE:
            return copy
        heading, speed = _course(last), self._parameters.get("speed", 0.0)
        direction = heading + radians(self._parameters.get("direction", 0.0))
        way = (cos(direction), sin(direction))
        distance = self._parameters.get("distance", speed * time_s)
        still = copy.model_copy(
            update={"velocity_ned_m_s": (0.0, 0.0, 0.0), "ground_speed_m_s": 0.0, "course_rad": direction % (2.0 * pi)}
        )
        return moved(still, (distance * way[0], distance * way[1], 0.0), (speed * way[0], speed * way[1], 0.0))


def displacement(
    name: AttackName, parameters: Mapping[str, float], heading_rad: float, time_s: float
) -> tuple[Offset, Offset]:
    """Offsets of position [m] and velocity [m/s], NED, of a climb or of one of `OFFSET_DIRECTIONS` after a time [s]."""
    if name is AttackName.CLIMB:
        height, speed = drift(parameters["acceleration"], parameters["speed"], time_s)
        return (0.0, 0.0, -height), (0.0, 0.0, -speed)
    distance, speed = OFFSET_DIRECTIONS[name](parameters, time_s)
    direction = heading_rad + radians(parameters["direction"])
    north, east = cos(direction), sin(direction)
    return (distance * north, distance * east, 0.0), (speed * north, speed * east, 0.0)


def moved(fix: GnssFix, position: Offset, velocity: Offset) -> GnssFix:
    """Move a fix by an offset of position [m, NED] and of velocity [m/s, NED]; what it lacks stays missing."""
    update: dict[str, object] = {}
    if fix.latitude_deg is not None and fix.longitude_deg is not None:
        here = Geodetic(radians(fix.latitude_deg), radians(fix.longitude_deg), fix.height_ellipsoid_m or 0.0)
        there = geodetic_from_ned_difference(position, here)
        update |= {"latitude_deg": there.latitude * 180.0 / pi, "longitude_deg": there.longitude * 180.0 / pi}
    for name in ("height_ellipsoid_m", "height_msl_m"):
        if (height := getattr(fix, name)) is not None:
            update[name] = height - position[2]
    own = fix.velocity_ned_m_s
    if own is not None:
        north, east, down = (own[k] + velocity[k] for k in range(3))
        update["velocity_ned_m_s"] = (north, east, down)
        if fix.ground_speed_m_s is not None:
            update["ground_speed_m_s"] = hypot(north, east)
        if fix.course_rad is not None and hypot(north, east) > 0.0:
            update["course_rad"] = atan2(east, north) % (2.0 * pi)
    return fix.model_copy(update=update)


def without_position(fix: GnssFix) -> GnssFix:
    """Remove position and velocity from a fix, as a receiver without signals does."""
    kept = ("sampled_ns", "received_ns", "source", "gps_time_ns", "utc_ns")
    return GnssFix(fix_type=FixType.NONE, satellites_used=0, **{name: getattr(fix, name) for name in kept})


def _course(fix: GnssFix) -> float:
    """Direction of travel [rad], clockwise from north; 0 if the fix states none."""
    if fix.velocity_ned_m_s is not None and hypot(*fix.velocity_ned_m_s[:2]) > 0.0:
        return atan2(fix.velocity_ned_m_s[1], fix.velocity_ned_m_s[0])
    return fix.course_rad or 0.0

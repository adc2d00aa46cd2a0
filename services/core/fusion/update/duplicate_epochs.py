"""Duplicate epochs of a receiver: the same stamp twice, or new stamps on a held value."""

from math import dist, hypot
from typing import NamedTuple

from shared.maths.earth import Geodetic
from shared.maths.rotation import Vector

from ..filter.eskf import ErrorStateFilter
from ..measurements.gnss import GnssPosition, GnssVelocity

WAY_M = 0.5  # distance over which the position of every receiver changes
GAIN_M_S = 0.5  # change of velocity that every receiver shows
ROOM = 64  # most pairs of source and kind that are kept
HELD_S = 10.0  # longest time for which receivers hold a value; later ones are gated as any other


class Seen(NamedTuple):
    """Newest value of a source and kind, its first and last stamp, and the state of the filter at the first."""

    value: Geodetic | Vector
    since_ns: int
    time_ns: int
    speed: float  # [m/s] of the vehicle
    own: Vector | None  # [m/s, NED]


class Epochs(NamedTuple):
    """Newest value of every source; replaced and never changed."""

    seen: dict[tuple[str, type], Seen] = {}  # noqa: RUF012  # never changed in place

    def after(
        self, measurement: GnssPosition | GnssVelocity, navigation: ErrorStateFilter | None
    ) -> tuple["Epochs", bool]:
        """Compare a measurement with the last one of its source; returns the new memory and whether it is a duplicate.

        Parameters
        ----------
        measurement : GnssPosition or GnssVelocity
            The next one in the order of the stamps.
        navigation : ErrorStateFilter or None
            At that time.

        Returns
        -------
        tuple
            A position that is the same to the last bit although the vehicle went `WAY_M`, or a velocity although it
            changed by `GAIN_M_S`, is held. Equal values of a receiver that reports standstill are no duplicates.
        """
        value = measurement.position if isinstance(measurement, GnssPosition) else measurement.velocity
        key, own = (measurement.source, type(measurement)), navigation.velocity if navigation else None
        last = self.seen.get(key)
        if last is not None and last.time_ns == measurement.time_ns:
            return self, True
        speed = self._speed(measurement, own)
        if last is None or last.value != value:
            return self._with(key, Seen(value, measurement.time_ns, measurement.time_ns, speed, own)), False
        held_s = (measurement.time_ns - last.since_ns) * 1e-9
        if isinstance(measurement, GnssPosition):
            moved = min(speed, last.speed) * held_s > WAY_M
        else:
            moved = own is not None and last.own is not None and dist(own, last.own) > GAIN_M_S and speed > 0.0
        after = self._with(key, last._replace(time_ns=measurement.time_ns))
        return after, moved and held_s <= HELD_S

    def _speed(self, measurement: GnssPosition | GnssVelocity, own: Vector | None) -> float:
        """Horizontal speed [m/s]: the receiver's own if it states one, otherwise the filter's."""
        if isinstance(measurement, GnssVelocity):
            return hypot(measurement.velocity[0], measurement.velocity[1])
        beside = self.seen.get((measurement.source, GnssVelocity))
        if beside is not None and abs(measurement.time_ns - beside.time_ns) < 1e9:
            return beside.speed
        return hypot(own[0], own[1]) if own else 0.0

    def _with(self, key: tuple[str, type], seen: Seen) -> "Epochs":
        known = self.seen
        if key not in known and len(known) >= ROOM:
            oldest = min(known, key=lambda one: known[one].time_ns)
            known = {one: value for one, value in known.items() if one != oldest}
        return Epochs({**known, key: seen})

"""Duplicate epochs of a receiver: the same stamp twice, or a repeated value with new stamps."""

from math import dist, hypot
from typing import NamedTuple

from shared.maths.earth import Geodetic
from shared.maths.rotation import Vector

from ...inertial.filter import ErrorStateFilter
from .fix import GnssPosition, GnssVelocity

DISTANCE_M = 0.5  # driven distance after which a receiver cannot repeat its position
VELOCITY_CHANGE_M_S = 0.5  # after which a receiver cannot repeat its velocity
MAX_SOURCES = 64  # largest number of pairs of source and kind
REPEATED_S = 10.0  # longest time for which repeated values are left out; then they are gated as any other


class LatestValue(NamedTuple):
    """LatestValue value of a source and kind, its first and last stamp, and the motion at the first."""

    value: Geodetic | Vector
    since_ns: int
    time_ns: int
    speed: float  # [m/s] of the vehicle
    velocity: Vector | None  # [m/s, NED] of the filter


class Epochs(NamedTuple):
    """Newest value of every source; replaced and never changed."""

    newest: dict[tuple[str, type], LatestValue] = {}  # noqa: RUF012  # never changed in place

    def after(
        self, measurement: GnssPosition | GnssVelocity, navigation: ErrorStateFilter | None
    ) -> tuple["Epochs", bool]:
        """Compare a measurement with the newest of its source; returns the epochs after it and whether it is one.

        Parameters
        ----------
        measurement : GnssPosition or GnssVelocity
            The next measurement in the order of the stamps.
        navigation : ErrorStateFilter or None
            Filter at that time.

        Returns
        -------
        tuple
            Duplicates are a position that is the same to the last bit after `DISTANCE_M`, and a velocity after a change
            of `VELOCITY_CHANGE_M_S`. Equal values of a receiver that reports standstill are not.
        """
        value = measurement.position if isinstance(measurement, GnssPosition) else measurement.velocity
        key, velocity = (measurement.source, type(measurement)), navigation.velocity if navigation else None
        last = self.newest.get(key)
        if last is not None and last.time_ns == measurement.time_ns:
            return self, True
        speed = self._speed(measurement, velocity)
        if last is None or last.value != value:
            return self._with(key, LatestValue(value, measurement.time_ns, measurement.time_ns, speed, velocity)), False
        repeated_s = (measurement.time_ns - last.since_ns) * 1e-9
        if isinstance(measurement, GnssPosition):
            moved = min(speed, last.speed) * repeated_s > DISTANCE_M
        else:
            change = dist(velocity, last.velocity) if velocity and last.velocity else 0.0
            moved = change > VELOCITY_CHANGE_M_S and speed > 0.0
        after = self._with(key, last._replace(time_ns=measurement.time_ns))
        return after, moved and repeated_s <= REPEATED_S

    def _speed(self, measurement: GnssPosition | GnssVelocity, velocity: Vector | None) -> float:
        """Horizontal speed [m/s] of the receiver if it measures one, otherwise of the filter."""
        if isinstance(measurement, GnssVelocity):
            return hypot(measurement.velocity[0], measurement.velocity[1])
        measured = self.newest.get((measurement.source, GnssVelocity))
        if measured is not None and abs(measurement.time_ns - measured.time_ns) < 1e9:
            return measured.speed
        return hypot(velocity[0], velocity[1]) if velocity else 0.0

    def _with(self, key: tuple[str, type], newest: LatestValue) -> "Epochs":
        known = self.newest
        if key not in known and len(known) >= MAX_SOURCES:
            oldest = min(known, key=lambda pair: known[pair].time_ns)
            known = {pair: value for pair, value in known.items() if pair != oldest}
        return Epochs({**known, key: newest})

"""Speed by the wheel ticks or the speed that a receiver was told: UBX-ESF-MEAS.

Source: u-blox M8 interface description (UBX-13003221), section 32.11.2 UBX-ESF-MEAS, and the table of its data types.
"""

import struct

from .messages import UbxError

REAR_LEFT, REAR_RIGHT, SINGLE, SPEED = 8, 9, 10, 11  # data types: ticks of a wheel, of an axle, speed
TICKS = (REAR_LEFT, REAR_RIGHT, SINGLE)
COUNT, BACKWARDS = (1 << 23) - 1, 1 << 23  # of the field with ticks
TAG_WRAP_MS = 1 << 32
MAX_DURATION_MS = 2000  # between two counts of one wheel
_HEAD = struct.Struct("<IHH")


class WheelTicks:
    """Speeds from counts; `metres_per_tick` is that of the vehicle."""

    def __init__(self, metres_per_tick: float) -> None:
        self._metres_per_tick = metres_per_tick
        self._last: dict[int, tuple[int, int]] = {}  # time tag [ms] and count of each data type

    def take(self, payload: bytes) -> float | None:
        """Speed [m/s] by one message; None without one, or for the first count. Raises UbxError for a truncated one.

        Notes
        -----
        With the counts n of a wheel at two time tags t, and the length k of a tick::

            v = k (n_2 - n_1 mod 2^23) / (t_2 - t_1), negative where the direction bit is set
        """
        if len(payload) < _HEAD.size:
            raise UbxError("short")
        tag_ms, flags, _ = _HEAD.unpack_from(payload)
        number = flags >> 11 & 31
        if len(payload) < _HEAD.size + 4 * number:
            raise UbxError("short")
        words = struct.unpack_from(f"<{number}I", payload, _HEAD.size)
        speeds = [
            speed for word in words if (speed := self._speed(word >> 24 & 63, word & 0xFFFFFF, tag_ms)) is not None
        ]
        return sum(speeds) / len(speeds) if speeds else None

    def _speed(self, kind: int, field: int, tag_ms: int) -> float | None:
        if kind == SPEED:
            return (field - (1 << 24) if field >> 23 else field) * 1e-3
        if kind not in TICKS or not self._metres_per_tick:
            return None
        count = field & COUNT
        before, self._last[kind] = self._last.get(kind), (tag_ms, count)
        if before is None or not 0 < (step_ms := (tag_ms - before[0]) % TAG_WRAP_MS) <= MAX_DURATION_MS:
            return None
        speed = self._metres_per_tick * ((count - before[1]) & COUNT) / (step_ms * 1e-3)
        return -speed if field & BACKWARDS else speed

"""Decodes wheel speeds from CAN frames by a DBC file."""

import math
from collections import Counter
from collections.abc import Mapping
from typing import TYPE_CHECKING, cast

from shared.faults import FOREIGN

from .candump import CanFrame

if TYPE_CHECKING:
    from cantools.database.can import Database, Message, Signal

WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
# In lower case and without blanks: files write km/h, KPH, km / h, Kmh ...
UNITS_M_S = {
    **dict.fromkeys(("m/s", "mps", "meter/s", "m/sec"), 1.0), **dict.fromkeys(("cm/s",), 0.01),
    **dict.fromkeys(("mm/s",), 0.001),
    **dict.fromkeys(("km/h", "kph", "kmh", "kmph", "kmp/h", "km/hr", "km/hour", "kilometerperhour", "kilometreperhour"),
                    1 / 3.6),
    **dict.fromkeys(("mph", "mi/h", "mile/h", "miles/h", "milesperhour"), 0.44704),
    **dict.fromkeys(("kn", "kt", "kts", "knot", "knots"), 1852.0 / 3600.0),
}  # fmt: skip
FASTEST_M_S = 150.0
LEAST_RANGE_M_S = 40.0  # a range of a road vehicle's speed reaches at least this far, if its bits do
LARGEST = 1e9  # [unit of the signal]


class WheelSpeedDecoder:
    """Decodes the configured wheel-speed signals of a DBC file.

    Parameters
    ----------
    text : str
        Content of the DBC file.
    signals : mapping
        Wheel (front_left, front_right, rear_left, rear_right) -> name of its signal.
    unit : str or None
        Unit of the signals in place of that of the file.
    period_ns : int
        [ns] Minimum time between two decoded frames of one identifier; frames in between are skipped.
    rejects : Counter
        Counts `dbc_frame` (frame shorter than defined) and `wheel_speed` (value out of range).

    Raises
    ------
    ValueError
        The text is not a DBC file, a signal is missing in it, or its unit is not a unit of speed.
    """

    def __init__(
        self, text: str, signals: Mapping[str, str], period_ns: int, rejects: Counter[str], unit: str | None = None
    ) -> None:
        self._rejects = rejects
        # 10 % tolerance: with jitter, a sender at exactly this period would otherwise lose every second frame.
        self._period_ns = period_ns * 9 // 10
        self._last_ns: dict[tuple[str, int], int] = {}
        self._messages: dict[tuple[int, bool], tuple[Message, dict[str, tuple[str, float]]]] = {}
        from cantools.database.errors import DecodeError

        self._decode_error = DecodeError
        database = load(text)
        for wheel, signal_name in signals.items():
            self._add(database, wheel, signal_name, unit)

    def decode(self, frame: CanFrame, received_ns: int, source: str) -> dict[str, float]:
        """Decode wheel -> speed [m/s]; empty for a frame without wheel speeds."""
        entry = self._messages.get((frame.identifier, frame.extended))
        key = source, frame.identifier
        if entry is None or 0 <= received_ns - self._last_ns.get(key, received_ns - self._period_ns) < self._period_ns:
            return {}
        message, wheels = entry
        if len(frame.data) < message.length:
            self._rejects["dbc_frame"] += 1
            return {}
        try:
            values = cast("dict[str, float]", message.decode(frame.data[: message.length], decode_choices=False))
        except (self._decode_error, *FOREIGN):  # such as an undefined value of the multiplexer
            self._rejects["dbc_frame"] += 1
            return {}
        if wheels.keys() & values:
            self._last_ns[key] = received_ns
        speeds: dict[str, float] = {}
        for signal_name, (wheel, unit_m_s) in wheels.items():
            if signal_name not in values:
                continue  # of another value of the multiplexer
            value = values[signal_name]
            speed_m_s = checked_speed(message.get_signal_by_name(signal_name), value, unit_m_s)
            if speed_m_s is None:
                self._rejects["wheel_speed"] += 1
            else:
                speeds[wheel] = speed_m_s
        return speeds

    def _add(self, database: "Database", wheel: str, signal_name: str, unit: str | None) -> None:
        for message in database.messages:
            for signal in message.signals:
                if signal.name == signal_name:
                    stated = signal.unit if unit is None else unit
                    unit_m_s = unit_of(stated)
                    if unit_m_s is None:
                        raise ValueError(
                            f"signal {signal_name} has the unit {stated!r}: m/s, km/h, mph or kn is required; state it "
                            "as `wheel_speed_unit`"
                        )
                    key = message.frame_id, message.is_extended_frame
                    self._messages.setdefault(key, (message, {}))[1][signal_name] = wheel, unit_m_s
                    return
        raise ValueError(f"there is no signal {signal_name!r}; the file has {_names(database)}")


def unit_of(text: str | None) -> float | None:
    """Factor from a unit to m/s, however it is written; None if it is no known unit of speed."""
    return UNITS_M_S.get("".join((text or "").lower().split()).strip("[]()"))


def checked_speed(signal: "Signal", value: object, unit_m_s: float) -> float | None:
    """Convert a decoded value to m/s; None if it is outside the signal's range or above `FASTEST_M_S`."""
    if not isinstance(value, int | float) or not abs(value) <= LARGEST:  # an integer may be too large for a float
        return None
    low, high = range_of(signal, unit_m_s)
    speed_m_s = value * unit_m_s
    return speed_m_s if low <= value <= high and abs(speed_m_s) <= FASTEST_M_S else None


def range_of(signal: "Signal", unit_m_s: float) -> tuple[float, float]:
    """The range of a signal, or that of its bits without their largest value, where the file's contradicts them.

    Files are made by hand, and many ranges were never looked at: [0|1] of a signal that counts to 655 km/h. A range is
    believed if it reaches the speed of a motorway, or as far as the bits do. The largest value of the bits mostly means
    that there is none.
    """
    first = -(2 ** (signal.length - 1)) if signal.is_signed else 0
    ends = sorted(float(signal.offset + signal.scale * raw) for raw in (first, first + 2**signal.length - 1))
    low = -math.inf if signal.minimum is None else float(signal.minimum)
    high = math.inf if signal.maximum is None else float(signal.maximum)
    believed = signal.is_float or (low < high and high >= min(LEAST_RANGE_M_S / unit_m_s, ends[1]) and low < ends[1])
    return (low, high) if believed else (ends[0], ends[1] - abs(float(signal.scale)))


def load(text: str) -> "Database":
    """Parse a DBC file; raises ValueError for any other text."""
    # Imported here because of its start-up time: only vehicles with a DBC file need it.
    from cantools.database import load_string
    from cantools.database.can import Database
    from cantools.database.errors import Error

    try:
        database = load_string(text, "dbc")
    except Error as error:
        raise ValueError(f"not a DBC file: {error}") from error
    if not isinstance(database, Database):
        raise ValueError("not a DBC file")
    return database


def _names(database: "Database") -> str:
    return ", ".join(sorted(signal.name for message in database.messages for signal in message.signals)[:20])

"""Decodes signals of CAN frames by a DBC file."""

import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

from shared.faults import FOREIGN

from .candump import CanFrame
from .standards import parameter_group, sender_of
from .units import QUANTITIES, examples_of, factor_of

if TYPE_CHECKING:
    from cantools.database.can import Database, Message, Signal

WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
MAX_SPEED_M_S = 150.0
MIN_RANGE_M_S = 40.0  # a range of a road vehicle's speed reaches at least this far, if its bits do
MAX_VALUE = 1e9  # [unit of the signal], and of the published value
UNIT_LENGTH = 16
DBC_BYTES, MOST_MESSAGES, MOST_SIGNALS = 4_000_000, 5000, 50_000
MAX_MESSAGE = 1785  # bytes: of the transport protocol of SAE J1939-21; CAN FD has 64
MESSAGE = re.compile(r"\bBO_\s+-?\d+\s+(\S+?)\s*:\s*(\d+)")
SIGNAL = re.compile(r"\bSG_\s+\S+?(?:\s+[mM]\d*M?)?\s*:\s*(\d+)\s*\|\s*(\d+)")
MAX_STAMPS = 4096  # of messages by bus and sender: more than a vehicle has
J1939_NULL, J1939_GLOBAL = 0xFE, 0xFF  # addresses that nobody sends values with: a file means any sender
PLACEHOLDERS = ((0.0, 0.0), (0.0, 1.0))  # ranges that editors write where nobody has stated one


@dataclass(frozen=True)
class QuantitySignal:
    """A quantity, the signal that it is read from, and what the file states wrong or not at all."""

    name: str  # a wheel, or a quantity
    signal: str  # SIGNAL, or MESSAGE.SIGNAL
    unit: str | None = None  # in place of that of the file
    scale: float | None = None  # factor from the file's value to the published one

    @property
    def quantity(self) -> str:
        """Name by which its unit is known."""
        return "wheel_speed" if self.name in WHEELS else self.name

    @property
    def is_speed(self) -> bool:
        """Whether it is a speed of the vehicle."""
        return QUANTITIES.get(self.quantity) == "m/s"


@dataclass(frozen=True, slots=True)
class Value:
    """A decoded quantity in its unit, and the smallest step of its signal."""

    name: str
    value: float
    unit: str
    resolution: float


@dataclass(frozen=True)
class _Entry:
    """How one signal becomes a quantity."""

    wanted: QuantitySignal
    signal: "Signal"
    factor: float
    unit: str


class SignalDecoder:
    """Decodes the wanted signals of a DBC file.

    Parameters
    ----------
    text : str
        Content of the DBC file.
    wanted : sequence of Wanted
        Quantities and their signals.
    period_ns : int
        [ns] Minimum time between two decoded frames of one identifier; frames in between are skipped.
    rejects : Counter
        Counts `dbc_frame` (too short for a wanted signal, or an undefined value of the multiplexer), `wheel_speed`
        and `signal_value` (value out of range).

    Raises
    ------
    ValueError
        The text is not a DBC file, a signal is missing in it or in more than one message, or its unit is not known.
    """

    def __init__(self, text: str, wanted: Sequence[QuantitySignal], period_ns: int, rejects: Counter[str]) -> None:
        self._rejects = rejects
        # 10 % tolerance: with jitter, a sender at exactly this period would otherwise lose every second frame.
        self._period_ns = period_ns * 9 // 10
        self._last_ns: dict[tuple[str, int, int], int] = {}
        self._entries: dict[tuple[int, bool], list[_Entry]] = {}  # by the identifier of their message in the file
        from cantools.database.errors import DecodeError

        self._decode_error = DecodeError
        database = load(text)
        self._messages = _Messages(database)
        for item in wanted:
            message, signal = _found(database, item.signal)
            self._entries.setdefault(_identifier(message), []).append(_Entry(item, signal, *_factor(item, signal)))

    def name_of(self, frame: CanFrame) -> str | None:
        """Name of the message that a frame is, by the file."""
        message = self._messages.find(frame)
        return None if message is None else str(message.name)

    def uses(self, frame: CanFrame) -> bool:
        """Whether a quantity is read from such frames."""
        message = self._messages.find(frame)
        return message is not None and _identifier(message) in self._entries

    def other_sender(self, frame: CanFrame) -> int | None:
        """Address of the sender of a frame of SAE J1939; None where the file states the identifier as it is."""
        message = self._messages.find(frame)
        same = message is None or sender_of(message.frame_id) == sender_of(frame.identifier)
        return None if same else sender_of(frame.identifier)

    def decode(self, frame: CanFrame, received_ns: int, source: str) -> list[Value]:
        """Decode the quantities of a frame; empty for a frame without any, and within the period of the last one."""
        message = self._messages.find(frame)
        entries = None if message is None else self._entries.get(_identifier(message))
        if message is None or entries is None:
            return []
        key = source, message.frame_id, sender_of(frame.identifier)
        if 0 <= received_ns - self._last_ns.get(key, received_ns - self._period_ns) < self._period_ns:
            return []
        try:
            values = self._values(message, frame.data, entries)
        except (self._decode_error, *FOREIGN):  # such as an undefined value of the multiplexer
            self._rejects["dbc_frame"] += 1
            return []
        present = [
            entry for entry in entries if entry.signal.name in values
        ]  # the others are of other multiplexer values
        if present:
            if len(self._last_ns) >= MAX_STAMPS:
                del self._last_ns[next(iter(self._last_ns))]
            self._last_ns[key] = received_ns
        decoded = (self._checked(entry, values[entry.signal.name]) for entry in present)
        return [value for value in decoded if value is not None]

    def _values(self, message: "Message", data: bytes, entries: list[_Entry]) -> dict[str, float]:
        """Values of the signals that are whole in a frame; an older control unit may send less than the file states."""
        missing = message.length - len(data)
        values = cast(
            "dict[str, float]",
            message.decode(data[: message.length], decode_choices=False, allow_truncated=missing > 0),
        )
        if missing > 0:
            whole = message.decode(data + bytes(missing), decode_choices=False)
            if any(entry.signal.name in whole and entry.signal.name not in values for entry in entries):
                self._rejects["dbc_frame"] += 1
        return values

    def _checked(self, entry: _Entry, raw: object) -> Value | None:
        wanted = entry.wanted
        if wanted.is_speed:
            value = checked_speed(entry.signal, raw, entry.factor)
        else:
            value = checked_value(entry.signal, raw, entry.factor)
        if value is None:
            self._rejects["wheel_speed" if wanted.name in WHEELS else "signal_value"] += 1
            return None
        return Value(wanted.name, value, entry.unit, min(abs(float(entry.signal.scale) * entry.factor), MAX_VALUE))


class _Messages:
    """The messages of a file by the identifiers of frames.

    The identifier of a message of SAE J1939 stands for its parameter group: priority, sender and receiver in it are
    those of one example. A frame is the message of exactly its identifier, else of its group and sender, else of its
    group and of any sender.
    """

    def __init__(self, database: "Database") -> None:
        self._exact = {_identifier(message): message for message in database.messages}
        self._groups: dict[int, dict[int, Message]] = {}  # parameter group -> sender -> message
        for message in database.messages:
            if _is_j1939(database, message):
                senders = self._groups.setdefault(parameter_group(message.frame_id), {})
                senders.setdefault(sender_of(message.frame_id), message)

    def find(self, frame: CanFrame) -> "Message | None":
        """The message that a frame is; None if the file has none."""
        exact = self._exact.get((frame.identifier, frame.extended))
        senders = self._groups.get(parameter_group(frame.identifier), {}) if frame.extended else {}
        if exact is not None or not senders:
            return exact
        for address in (sender_of(frame.identifier), J1939_NULL, J1939_GLOBAL):
            if address in senders:
                return senders[address]
        return next(iter(senders.values())) if len(senders) == 1 else None


def _identifier(message: "Message") -> tuple[int, bool]:
    """Identifier of a message in the file, and whether it has 29 bits."""
    return message.frame_id, message.is_extended_frame


def _is_j1939(database: "Database", message: "Message") -> bool:
    """Whether a message is a parameter group: by its VFrameFormat or the default, else by the network's protocol."""
    if message.protocol == "j1939" or not message.is_extended_frame:
        return message.is_extended_frame
    own = message.dbc.attributes if message.dbc else {}
    network = database.dbc.attributes if database.dbc else {}
    definition = database.dbc.attribute_definitions.get("VFrameFormat") if database.dbc else None
    stated = "VFrameFormat" in own or (definition is not None and definition.default_value == "ExtendedCAN")
    return not stated and "ProtocolType" in network and str(network["ProtocolType"].value).upper() == "J1939"


def _found(database: "Database", name: str) -> "tuple[Message, Signal]":
    """The message and the signal of SIGNAL or MESSAGE.SIGNAL; raises ValueError."""
    message_name, _, signal_name = name.rpartition(".")
    places = [
        (message, signal)
        for message in database.messages
        for signal in message.signals
        if signal.name == signal_name and message_name in ("", message.name)
    ]
    if len(places) == 1:
        return places[0]
    if places:
        choices = ", ".join(f"{message.name}.{signal_name}" for message, _ in places[:8])
        raise ValueError(f"signal {name!r} is in several messages: write one of {choices}")
    raise ValueError(f"there is no signal {name!r}; the file has {_names(database)}")


def _factor(wanted: QuantitySignal, signal: "Signal") -> tuple[float, str]:
    """Factor to the unit of the bus, and that unit; raises ValueError for a unit that is not known."""
    stated = signal.unit if wanted.unit is None else wanted.unit
    si_unit = QUANTITIES.get(wanted.quantity)
    if si_unit is None:
        return (1.0 if wanted.scale is None else wanted.scale), (stated or "")[:UNIT_LENGTH]
    if wanted.scale is not None:
        return wanted.scale, si_unit
    factor = factor_of(stated, si_unit)
    if factor is None:
        key = "`wheel_speed_unit`" if wanted.name in WHEELS else f"unit of [parsers.can.signals.{wanted.name}]"
        remedy = "" if wanted.name in WHEELS else f", or state its factor to {si_unit} as scale"
        found = f"the unit {stated!r}" if stated else "no unit"
        raise ValueError(
            f"signal {wanted.signal} has {found}: {examples_of(si_unit)} is required; state it as {key}{remedy}"
        )
    return factor, si_unit


def checked_speed(signal: "Signal", value: object, unit_m_s: float) -> float | None:
    """Convert a decoded value to m/s; None if it is outside the signal's range or above `MAX_SPEED_M_S`."""
    least = MIN_RANGE_M_S / abs(unit_m_s) if unit_m_s else 0.0
    speed_m_s = checked_value(signal, value, unit_m_s, least)
    return speed_m_s if speed_m_s is not None and abs(speed_m_s) <= MAX_SPEED_M_S else None


def checked_value(signal: "Signal", value: object, factor: float, least: float | None = None) -> float | None:
    """Convert a decoded value to the unit of the bus; None if it is outside the signal's range, or no finite number."""
    if not isinstance(value, int | float) or not abs(value) <= MAX_VALUE:  # an integer may be too large for a float
        return None
    low, high = range_of(signal, least)
    converted = value * factor
    return converted if low <= value <= high and abs(converted) <= MAX_VALUE else None


def range_of(signal: "Signal", least: float | None = None) -> tuple[float, float]:
    """The range of a signal, or that of its bits without their largest value, where the file's contradicts them.

    Files are made by hand, and many ranges were never looked at: [0|1] of a signal that counts to 655 km/h. A range of
    a speed is believed if it reaches `least`, the speed of a motorway, or as far as the bits do; other ranges are,
    unless they are placeholders of an editor. The largest value of the bits mostly means that there is none.
    """
    first = -(2 ** (signal.length - 1)) if signal.is_signed else 0
    ends = sorted(float(signal.offset + signal.scale * raw) for raw in (first, first + 2**signal.length - 1))
    low = -math.inf if signal.minimum is None else float(signal.minimum)
    high = math.inf if signal.maximum is None else float(signal.maximum)
    if least is None:
        one_bit = signal.length == 1
        return (low, high) if one_bit or signal.is_float or (low < high and (low, high) not in PLACEHOLDERS) else (
            ends[0], ends[1] - (0.0 if signal.length < 8 else abs(float(signal.scale)))
        )  # fmt: skip
    believed = signal.is_float or (low < high and high >= min(least, ends[1]) and low < ends[1])
    return (low, high) if believed else (ends[0], ends[1] - abs(float(signal.scale)))


def load(text: str) -> "Database":
    """Parse a DBC file; raises ValueError for any other text."""
    # Imported here because of its start-up time: only vehicles with a DBC file need it.
    from cantools.database import load_string
    from cantools.database.can import Database
    from cantools.database.errors import Error

    _insist_on_bounds(text)
    try:
        database = load_string(text, "dbc")
    except (Error, RecursionError, MemoryError) as error:
        raise ValueError(f"not a DBC file: {error}") from error
    if not isinstance(database, Database):
        raise ValueError("not a DBC file")
    return database


def _insist_on_bounds(text: str) -> None:
    """Raise ValueError for a file whose parsing would take gigabytes: a message is made of all its bits."""
    if len(text) > DBC_BYTES:
        raise ValueError(f"it has more than {DBC_BYTES / 1e6:.0f} MB")
    messages = list(MESSAGE.finditer(text))
    if len(messages) > MOST_MESSAGES or text.count("SG_") > MOST_SIGNALS:
        raise ValueError(f"it has more than {MOST_MESSAGES} messages or {MOST_SIGNALS} signals")
    for message in messages:
        if len(message[2]) > 5 or int(message[2]) > MAX_MESSAGE:
            raise ValueError(f"its message {message[1][:40]} has more than {MAX_MESSAGE} bytes, the most of a bus")
    for match in SIGNAL.finditer(text):
        if any(len(number) > 5 or int(number) > 8 * MAX_MESSAGE for number in match.groups()):
            raise ValueError(f"a signal of it is outside the {MAX_MESSAGE} bytes of a message")


def _names(database: "Database") -> str:
    return ", ".join(sorted(signal.name for message in database.messages for signal in message.signals)[:20])

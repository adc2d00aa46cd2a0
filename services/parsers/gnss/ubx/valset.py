"""Configures a u-blox receiver of generation 9 or later by UBX-CFG-VALSET, and reads back what it took.

Source: u-blox F9 HPG 1.32 interface description (UBX-22008968), UBX-CFG-VALSET, UBX-CFG-VALGET, UBX-ACK.
"""

import math
from collections.abc import Iterable, Iterator

from pyubx2.ubxmessage import UBXMessage
from pyubx2.ubxtypes_configdb import UBX_CONFIG_DATABASE

from shared.messages.gnss import GnssConfigure

from .exchange import DYNAMIC_MODELS, NO_RESPONSE, TIMEOUT_TICKS, Exchange, Result
from .outputs import ONCE_A_SECOND, messages_of, optional, required

VALSET, VALGET = 0x068A, 0x068B
RAM = 1  # volatile layer of VALSET; VALGET numbers the same layer 0
PORTS = ("UART1", "USB")
ELEVATION_MASK, DYNAMIC_MODEL = "CFG_NAVSPG_INFIL_MINELEV", "CFG_NAVSPG_DYNMODEL"


class ValsetExchange(Exchange):
    """Sets the values of a request by UBX-CFG-VALSET, and reads them back.

    A receiver takes over all values of a UBX-CFG-VALSET or none. Each optional setting has one of its own, and they
    come first: responses arrive in the order of the requests, so the last one completes the exchange.
    """

    def __init__(self, wanted: GnssConfigure) -> None:
        self._wanted = wanted
        self._rejected = False
        self._optional: dict[int, int] = {}  # values of the optional settings that the receiver has
        self._awaited = 0  # responses on optional settings that are still to come
        self._reading = True  # whether the values that are only read are still to come; they are polled first
        self._read: dict[int, int] = {}
        self._ticks = 0

    def begin(self) -> Iterator[bytes | Result]:
        """Yield the messages that set and poll the requested values, or the reason why the request is invalid."""
        try:
            values, optional = wanted_values(self._wanted), optional_values(self._wanted)
        except ValueError as error:
            yield self._result({}, str(error))
            return
        self._awaited, keys = len(optional), _database()
        yield UBXMessage.config_poll(0, 0, [keys[ELEVATION_MASK], keys[DYNAMIC_MODEL]]).serialize()
        for asked in (*optional, values):
            setting = UBXMessage.config_set(RAM, 0, list(asked.items()))
            for message in (setting, UBXMessage.config_poll(0, 0, list(asked))):
                yield message.serialize()

    def take(self, kind: str, payload: bytes) -> Iterator[bytes | Result]:
        """Process an answer; yield the result when the exchange is complete."""
        about = payload[0] << 8 | payload[1] if kind.startswith("ACK") and len(payload) >= 2 else 0
        if self._reading and self._take_read(kind, about, payload):
            return
        if self._awaited and self._take_optional(kind, about, payload):
            return
        if kind == "CFG-VALGET":
            rejection = "the receiver rejected UBX-CFG-VALSET: it may not support one of the messages"
            yield self._result(read_values(payload), rejection if self._rejected else None)
        elif kind == "ACK-NAK" and about == VALSET:
            self._rejected = True
        elif kind == "ACK-NAK" and about == VALGET:
            yield self._result({}, "the receiver rejected UBX-CFG-VALGET: a message is not supported")

    def tick(self) -> Iterator[bytes | Result]:
        """End the exchange after the timeout."""
        self._ticks += 1
        if self._ticks >= TIMEOUT_TICKS:
            yield self._result({}, NO_RESPONSE)

    def _take_read(self, kind: str, about: int, payload: bytes) -> bool:
        """Process the response to the first poll; whatever else comes first says that it was lost."""
        self._reading = False
        found = read_values(payload) if kind == "CFG-VALGET" else {}
        if _database()[DYNAMIC_MODEL] in found:
            self._read = found
            return True
        return kind == "ACK-NAK" and about == VALGET

    def _take_optional(self, kind: str, about: int, payload: bytes) -> bool:
        """Process the response to the request for an optional setting, which a receiver that lacks it rejects."""
        if kind == "CFG-VALGET":
            values = read_values(payload)
            if _database()["CFG_RATE_MEAS"] in values:  # the last response: one before it was lost
                self._awaited = 0
                return False
            self._optional |= values
            self._awaited -= 1
            return True
        if kind == "ACK-NAK" and about == VALGET:
            self._awaited -= 1
            return True
        return kind == "ACK-NAK"

    def _result(self, values: dict[int, int], fault: str | None) -> Result:
        keys = _database()
        period_ms, cycles = values.get(keys["CFG_RATE_MEAS"]), values.get(keys["CFG_RATE_NAV"], 1)
        values = {**self._read, **self._optional, **values}
        sent = [name for name in messages_of(self._wanted.outputs) if any(map(values.get, _message_keys(name)))]
        period_s = period_ms * cycles / 1000 if period_ms else None
        return Result(
            fault=fault or _difference(self._wanted, period_s, sent),
            navigation_period_s=period_s,
            messages=tuple(sent),
            dynamic_model=DYNAMIC_MODELS.get(values.get(keys[DYNAMIC_MODEL], -1)),
            elevation_mask_rad=elevation_rad(values.get(keys[ELEVATION_MASK])),
        )


def wanted_values(wanted: GnssConfigure) -> dict[int, int]:
    """Translate a request to configuration keys and values; raises ValueError for an invalid request."""
    keys = _database()
    period_ms = round(wanted.navigation_period_s * 1000)
    if not 25 <= period_ms <= 65535:
        raise ValueError(f"a navigation period of {wanted.navigation_period_s} s is outside 0.025 to 65.535 s")
    return {keys["CFG_RATE_MEAS"]: period_ms, keys["CFG_RATE_NAV"]: 1, **_output_values(required(wanted.outputs))}


def optional_values(wanted: GnssConfigure) -> list[dict[int, int]]:
    """Keys and values of each optional setting: a dynamic model, and messages that not every receiver has.

    The long ones, 1048 bytes for 32 measurements and 976 for 60 signals, are sent once a second.
    """
    every = max(1, round(1.0 / wanted.navigation_period_s))
    found = [_output_values((name,), every if name in ONCE_A_SECOND else 1) for name in optional(wanted.outputs)]
    model = next((number for number, name in DYNAMIC_MODELS.items() if name == wanted.dynamic_model), None)
    if model is not None:
        found.insert(0, {_database()[DYNAMIC_MODEL]: model})
    return [values for values in found if values]


def _output_values(names: Iterable[str], every: int = 1) -> dict[int, int]:
    """Keys of messages that are sent every so many epochs."""
    return {key: every for name in names for key in _message_keys(name)}


def read_values(payload: bytes) -> dict[int, int]:
    """Decode keys and values of a UBX-CFG-VALGET response; a truncated payload gives its complete part."""
    values: dict[int, int] = {}
    position = 4
    while position + 4 < len(payload):
        key = int.from_bytes(payload[position : position + 4], "little")
        end = position + 4 + _size(key)
        values[key] = int.from_bytes(payload[position + 4 : end], "little")
        position = end
    return values


def elevation_rad(value: int | None) -> float | None:
    """Decode the elevation mask, a signed byte of degrees."""
    return None if value is None else math.radians(value - 256 if value > 127 else value)


def _size(key: int) -> int:
    return (1, 1, 1, 2, 4, 8, 8, 8)[key >> 28 & 7]


def _message_keys(name: str) -> list[int]:
    keys = _database()
    names = (f"CFG_MSGOUT_UBX_{name.replace('-', '_')}_{port}" for port in PORTS)
    return [keys[key] for key in names if key in keys]


def _database() -> dict[str, int]:
    return {name: int(entry[0]) for name, entry in UBX_CONFIG_DATABASE.items()}


def _difference(wanted: GnssConfigure, period_s: float | None, sent: list[str]) -> str | None:
    missing = [name for name in required(wanted.outputs) if name not in sent]
    if missing:
        return f"the receiver does not send {', '.join(missing)}"[:400]
    if period_s is None or abs(period_s - wanted.navigation_period_s) > 1e-3:
        return f"the receiver's navigation period is {period_s} s, not {wanted.navigation_period_s} s"
    return None

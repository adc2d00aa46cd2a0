"""Configures a u-blox receiver of generation 9 or later by UBX-CFG-VALSET, and reads back what it took.

Source: u-blox F9 HPG 1.32 interface description (UBX-22008968), UBX-CFG-VALSET, UBX-CFG-VALGET, UBX-ACK.
"""

import math
from collections import deque
from collections.abc import Iterator
from functools import cache

from pyubx2.ubxmessage import UBXMessage
from pyubx2.ubxtypes_configdb import UBX_CONFIG_DATABASE

from shared.messages.gnss import GnssConfigure

from .exchange import DYNAMIC_MODELS, NO_RESPONSE, TIMEOUT_TICKS, Exchange, Result
from .outputs import REQUIRED, OutputPlan

VALSET, VALGET = 0x068A, 0x068B
RAM = 1  # volatile layer of VALSET; VALGET numbers the same layer 0
PORTS = ("UART1", "USB")
ELEVATION_MASK, DYNAMIC_MODEL = "CFG_NAVSPG_INFIL_MINELEV", "CFG_NAVSPG_DYNMODEL"
PERIOD = "CFG_RATE_MEAS"
MAX_LOST = 2  # settings without an answer, after which the receiver is given up
Setting = dict[int, int]  # keys and their values, which a receiver takes over as a whole or not at all


class ValsetExchange(Exchange):
    """Sets the values of a request by UBX-CFG-VALSET, and reads them back.

    A receiver takes over all values of a UBX-CFG-VALSET or none, and answers all keys of a UBX-CFG-VALGET or none. Each
    optional setting has one of its own, and they come first: responses arrive in the order of the requests, so the last
    one completes the first pass. What was refused in it is sent again in parts, one after another: by port, since a
    receiver without USB has no key of one, then key by key.
    """

    def __init__(self, wanted: GnssConfigure, plan: OutputPlan) -> None:
        self._wanted, self._plan = wanted, plan
        self._refusals = False  # in the first pass
        self._settings: list[Setting] = []  # of the first pass, the required one last
        self._values: Setting = {}  # read back
        self._awaited = 0  # responses on optional settings that are still to come
        self._reading = True  # whether the values that are only read are still to come; they are polled first
        self._parts: Parts | None = None  # second pass
        self._ticks = 0

    def begin(self) -> Iterator[bytes | Result]:
        """Yield the messages that set and poll the requested values, or the reason why the request is invalid."""
        try:
            required = required_values(self._plan)
        except ValueError as error:
            yield self._result(str(error))
            return
        optional, keys = optional_values(self._wanted, self._plan), _database()
        self._awaited, self._settings = len(optional), [*optional, required]
        yield UBXMessage.config_poll(0, 0, [keys[ELEVATION_MASK], keys[DYNAMIC_MODEL]]).serialize()
        for setting in self._settings:
            yield from _set_and_poll(setting)

    def take(self, kind: str, payload: bytes) -> Iterator[bytes | Result]:
        """Process an answer; yield the result when the exchange is complete."""
        about = payload[0] << 8 | payload[1] if kind.startswith("ACK") and len(payload) >= 2 else 0
        refused = kind == "ACK-NAK" and about == VALGET
        if self._parts is not None:
            self._ticks = 0
            yield from self._said(self._parts.take(kind, about, read_values(payload) if kind == "CFG-VALGET" else {}))
            return
        if self._reading and self._take_read(kind, about, payload):
            return
        self._refusals |= kind == "ACK-NAK"
        if self._awaited and self._take_optional(kind, about, payload):
            return
        values = read_values(payload) if kind == "CFG-VALGET" else {}
        self._values |= values
        if refused or _database()[PERIOD] in values:  # the last response
            yield from self._second_pass()

    def tick(self) -> Iterator[bytes | Result]:
        """End the exchange, or the wait for one of its parts, after the timeout."""
        self._ticks += 1
        if self._ticks < TIMEOUT_TICKS:
            return
        self._ticks = 0
        if self._parts is None or self._parts.lost >= MAX_LOST:
            yield self._result(NO_RESPONSE)
        else:
            yield from self._said(self._parts.skip())

    def _second_pass(self) -> Iterator[bytes | Result]:
        """Send what was refused again in parts, the required setting first."""
        missing = [setting for setting in reversed(self._settings) if not _granted(setting, self._values)]
        self._parts = Parts(missing if self._refusals else [], self._values)
        self._ticks = 0
        yield from self._said(self._parts.next())

    def _said(self, said: Iterator[bytes]) -> Iterator[bytes | Result]:
        yield from said
        if self._parts is not None and self._parts.done:
            yield self._result(None)

    def _take_read(self, kind: str, about: int, payload: bytes) -> bool:
        """Process the response to the first poll; whatever else comes first says that it was lost."""
        self._reading = False
        found = read_values(payload) if kind == "CFG-VALGET" else {}
        if _database()[DYNAMIC_MODEL] in found:
            self._values |= found
            return True
        return kind == "ACK-NAK" and about == VALGET

    def _take_optional(self, kind: str, about: int, payload: bytes) -> bool:
        """Process the response to the request for an optional setting, which a receiver that lacks it rejects."""
        if kind == "CFG-VALGET":
            values = read_values(payload)
            if _database()[PERIOD] in values:  # the last response: one before it was lost
                self._awaited = 0
                return False
            self._values |= values
            self._awaited -= 1
            return True
        if kind == "ACK-NAK" and about == VALGET:
            self._awaited -= 1
            return True
        return kind == "ACK-NAK"

    def _result(self, fault: str | None) -> Result:
        keys, values, plan = _database(), self._values, self._plan
        period_ms, cycles = values.get(keys[PERIOD]), values.get(keys["CFG_RATE_NAV"], 1)
        sent = [name for name in plan.every if any(values.get(key) for key in _message_keys(name))]
        period_s = period_ms * cycles / 1000 if period_ms else None
        lacking = [name for name in plan.names if self._parts and self._parts.refused.issuperset(_message_keys(name))]
        return Result(
            fault=fault or self._difference(period_s, sent, lacking),
            note=plan.shortage,
            navigation_period_s=period_s,
            messages=tuple(sent),
            dynamic_model=DYNAMIC_MODELS.get(values.get(keys[DYNAMIC_MODEL], -1)),
            elevation_mask_rad=elevation_rad(values.get(keys[ELEVATION_MASK])),
        )

    def _difference(self, period_s: float | None, sent: list[str], lacking: list[str]) -> str | None:
        """What is required and was not granted; of the messages that a receiver lacks, the fix alone is required."""
        excused = {name for name in lacking if name != "NAV-PVT"}
        missing = [name for name in self._plan.names if name in REQUIRED and name not in sent and name not in excused]
        if missing:
            refused = " has refused, so that it" if any(name in lacking for name in missing) else ""
            return f"the receiver{refused} does not send {', '.join(missing)}"[:400]
        if period_s is None or abs(period_s - self._plan.period_s) > 1e-3:
            return f"the receiver's navigation period is {period_s} s, not {self._plan.period_s:g} s"
        if abs(period_s - self._wanted.navigation_period_s) > 1e-3:
            return self._plan.shortage
        return None


class Parts:
    """Settings that a receiver has refused, sent again in smaller parts: one at a time.

    `refused` are the single keys that it does not take; a port whose keys it refuses while it takes those of another
    one is a port that it does not have, and is left out of what follows.
    """

    def __init__(self, settings: list[Setting], values: Setting) -> None:
        self.refused: set[int] = set()
        self.lost = 0  # settings without an answer
        self._values = values
        self._waiting = deque(part for setting in settings for part in _parts_of(setting))
        self._present: Setting | None = None
        self._rejected = False  # by the answer to UBX-CFG-VALSET
        self._granted_ports = {port for key in values if (port := _port_of(key))}
        self._refused_ports: set[str] = set()

    @property
    def done(self) -> bool:
        """Whether nothing is left."""
        return self._present is None and not self._waiting

    def next(self) -> Iterator[bytes]:
        """Send the next part."""
        self._present, self._rejected = None, False
        absent = self._refused_ports - self._granted_ports if self._granted_ports else set()
        while self._waiting and self._present is None:
            part = self._waiting.popleft()
            self.refused |= {key for key in part if _port_of(key) in absent}
            self._present = {key: value for key, value in part.items() if _port_of(key) not in absent} or None
        if self._present is not None:
            yield from _set_and_poll(self._present)

    def take(self, kind: str, about: int, values: Setting) -> Iterator[bytes]:
        """Process an answer."""
        part = self._present
        if part is None:
            return
        if kind == "ACK-NAK" and about == VALSET:
            self._rejected = True
        elif (kind == "ACK-NAK" and about == VALGET) or (kind == "CFG-VALGET" and part.keys() <= values.keys()):
            self._values |= values
            ports = {_port_of(key) for key in part}
            if _granted(part, self._values):
                self._granted_ports |= {port for port in ports if port}
            elif self._rejected or not values:
                self._refuse(part, ports)
            yield from self.next()

    def skip(self) -> Iterator[bytes]:
        """Go on without an answer."""
        self.lost += 1
        yield from self.next()

    def _refuse(self, part: Setting, ports: set[str | None]) -> None:
        if len(ports) == 1:
            self._refused_ports |= {port for port in ports if port}
        smaller = _parts_of(part)
        self._waiting.extendleft(reversed(smaller))
        if not smaller:
            self.refused |= part.keys()


def _parts_of(setting: Setting) -> list[Setting]:
    """Smaller settings: by port, then by key; a single key has no smaller one."""
    ports = [port for port in PORTS if any(_port_of(key) == port for key in setting)]
    if len(ports) > 1:
        first = [{key: value for key, value in setting.items() if _port_of(key) in (None, ports[0])}]
        return first + [{key: value for key, value in setting.items() if _port_of(key) == port} for port in ports[1:]]
    return [{key: value} for key, value in setting.items()] if len(setting) > 1 else []


def _granted(setting: Setting, values: Setting) -> bool:
    """Whether a receiver has all keys of a setting with the values that were asked for."""
    return all(values.get(key) == value for key, value in setting.items())


def _set_and_poll(setting: Setting) -> Iterator[bytes]:
    yield UBXMessage.config_set(RAM, 0, list(setting.items())).serialize()
    yield UBXMessage.config_poll(0, 0, list(setting)).serialize()


def required_values(plan: OutputPlan) -> Setting:
    """Translate a plan to keys and values of what is required; raises ValueError for an invalid period."""
    keys = _database()
    period_ms = round(plan.period_s * 1000)
    if not 25 <= period_ms <= 65535:
        raise ValueError(f"a navigation period of {plan.period_s} s is outside 0.025 to 65.535 s")
    outputs = {key: plan.every[name] for name in plan.every if name in REQUIRED for key in _message_keys(name)}
    return {keys[PERIOD]: period_ms, keys["CFG_RATE_NAV"]: 1, **outputs}


def optional_values(wanted: GnssConfigure, plan: OutputPlan) -> list[Setting]:
    """Keys and values of each optional setting: a dynamic model, and messages that not every receiver has."""
    found = [dict.fromkeys(_message_keys(name), every) for name, every in plan.every.items() if name not in REQUIRED]
    model = next((number for number, name in DYNAMIC_MODELS.items() if name == wanted.dynamic_model), None)
    if model is not None:
        found.insert(0, {_database()[DYNAMIC_MODEL]: model})
    return [values for values in found if values]


def read_values(payload: bytes) -> Setting:
    """Decode keys and values of a UBX-CFG-VALGET response; a truncated payload gives its complete part."""
    values: Setting = {}
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


@cache
def _message_keys(name: str) -> tuple[int, ...]:
    keys = _database()
    names = (f"CFG_MSGOUT_UBX_{name.replace('-', '_')}_{port}" for port in PORTS)
    return tuple(keys[key] for key in names if key in keys)


@cache
def _database() -> dict[str, int]:
    return {name: int(entry[0]) for name, entry in UBX_CONFIG_DATABASE.items()}


@cache
def _ports() -> dict[int, str]:
    """The port of each key of an output message."""
    outputs = ((key, name.rpartition("_")[2]) for name, key in _database().items() if name.startswith("CFG_MSGOUT_"))
    return {key: port for key, port in outputs if port in PORTS}


def _port_of(key: int) -> str | None:
    return _ports().get(key)

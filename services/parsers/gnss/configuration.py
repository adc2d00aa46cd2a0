"""Configures a u-blox receiver of generation 9 or later as requested by the controller, and verifies the result.

Source: u-blox F9 HPG 1.32 interface description (UBX-22008968), UBX-CFG-VALSET, UBX-CFG-VALGET, UBX-ACK, UBX-MON-VER.
"""

import math
from collections.abc import Iterator
from difflib import get_close_matches

from pyubx2.ubxmessage import UBXMessage
from pyubx2.ubxtypes_configdb import UBX_CONFIG_DATABASE

from shared.messages.gnss import GnssConfiguration, GnssConfigure, GnssWrite

ACK, CFG, MON = 0x05, 0x06, 0x0A
VALSET, VALGET, VER = 0x8A, 0x8B, 0x04
ANSWERS = ((ACK, 0), (ACK, 1), (CFG, VALGET), (MON, VER))  # that are used
RAM = 1  # volatile layer of VALSET; VALGET numbers the same layer 0
MAX_KEYS = 64
TIMEOUT_TICKS = 3  # seconds without a response
PORTS = ("UART1", "USB")
ELEVATION_MASK, DYNAMIC_MODEL = "CFG_NAVSPG_INFIL_MINELEV", "CFG_NAVSPG_DYNMODEL"
DYNAMIC_MODELS = {
    0: "portable", 2: "stationary", 3: "pedestrian", 4: "automotive", 5: "sea", 6: "airborne below 1 g",
    7: "airborne below 2 g", 8: "airborne below 4 g", 9: "wrist", 10: "bike", 11: "mower", 12: "scooter",
}  # fmt: skip
VERSION_HEAD, VERSION_LINE = 40, 30  # [bytes] software and hardware, and each further line
ONCE_A_SECOND = (
    "RXM-RAWX",
    "NAV-STATUS",
    "NAV-CLOCK",
    "MON-RF",
    "SEC-SIG",
    "NAV-SIG",
)  # whatever the navigation period


class Configurator:
    """Executes one request at a time: write, then read back; a new request replaces a pending one."""

    def __init__(self, source: str) -> None:
        self._source = source
        self._request: GnssConfigure | None = None
        self._rejected = False
        self._optional: dict[int, int] = {}  # values of the optional messages that the receiver has
        self._awaited = 0  # responses on optional messages that are still to come
        self._reading = False  # whether the values that are only read are still to come; they are polled first
        self._read: dict[int, int] = {}
        self._version: dict[str, str] = {}
        self._ticks = 0

    def request(self, wanted: GnssConfigure, now_ns: int) -> Iterator[GnssWrite | GnssConfiguration]:
        """Yield the messages that set and poll the requested values, or the reason why the request is invalid.

        A receiver takes over all values of a UBX-CFG-VALSET or none. Each optional message has one of its own, and they
        come first: responses arrive in the order of the requests, so the last one completes the exchange.
        """
        self._request, self._rejected, self._ticks = wanted, False, 0
        try:
            values, optional = wanted_values(wanted), optional_values(wanted)
        except ValueError as error:
            yield from self._result({}, str(error))
            return
        self._optional, self._awaited = {}, len(optional)
        self._read, self._reading, keys = {}, True, _database()
        version = UBXMessage(bytes((MON,)), bytes((VER,)), 2)  # 2: poll
        for message in (version, UBXMessage.config_poll(0, 0, [keys[ELEVATION_MASK], keys[DYNAMIC_MODEL]])):
            yield GnssWrite(received_ns=now_ns, source=self._source, data=message.serialize())
        for asked in (*optional, values):
            setting = UBXMessage.config_set(RAM, 0, list(asked.items()))
            for message in (setting, UBXMessage.config_poll(0, 0, list(asked))):
                yield GnssWrite(received_ns=now_ns, source=self._source, data=message.serialize())

    def take(self, frame: bytes) -> Iterator[GnssConfiguration]:
        """Process a UBX frame; yield the result when the exchange is complete."""
        if self._request is None or len(frame) < 10:
            return
        kind, payload = (frame[2], frame[3]), frame[6:-2]
        if kind == (MON, VER):
            self._version = read_version(payload)
            return
        if self._reading and self._take_read(kind, payload):
            return
        if self._awaited and self._take_optional(kind, payload):
            return
        if kind == (CFG, VALGET):
            rejection = "the receiver rejected UBX-CFG-VALSET: it may not support one of the messages"
            yield from self._result(read_values(payload), rejection if self._rejected else None)
        elif kind == (ACK, 0) and payload[0] == CFG and payload[1] == VALSET:
            self._rejected = True
        elif kind == (ACK, 0) and payload[0] == CFG and payload[1] == VALGET:
            yield from self._result(
                {}, "the receiver rejected UBX-CFG-VALGET: older than generation 9, or a message is not supported"
            )

    def _take_read(self, kind: tuple[int, int], payload: bytes) -> bool:
        """Process the response to the first poll; whatever else comes first says that it was lost."""
        self._reading = False
        found = read_values(payload) if kind == (CFG, VALGET) else {}
        if _database()[DYNAMIC_MODEL] in found:
            self._read = found
            return True
        return kind == (ACK, 0) and payload[1] == VALGET

    def _take_optional(self, kind: tuple[int, int], payload: bytes) -> bool:
        """Process the response to the request for an optional message, which a receiver that lacks it rejects."""
        if kind == (CFG, VALGET):
            values = read_values(payload)
            if _database()["CFG_RATE_MEAS"] in values:  # the last response: one before it was lost
                self._awaited = 0
                return False
            self._optional |= values
            self._awaited -= 1
            return True
        if kind == (ACK, 0) and payload[0] == CFG and payload[1] == VALGET:
            self._awaited -= 1
            return True
        return kind == (ACK, 0)

    def tick(self) -> Iterator[GnssConfiguration]:
        """End a pending request after the timeout; called every second."""
        self._ticks += 1
        if self._request and self._ticks >= TIMEOUT_TICKS:
            yield from self._result({}, "no response from the receiver: check that its RX line is connected")

    def _result(self, values: dict[int, int], fault: str | None) -> Iterator[GnssConfiguration]:
        if (wanted := self._request) is None:
            return
        self._request = None
        keys = _database()
        period_ms, cycles = values.get(keys["CFG_RATE_MEAS"]), values.get(keys["CFG_RATE_NAV"], 1)
        values = {**self._read, **self._optional, **values}
        messages = tuple(name for name in wanted.messages if any(values.get(key) for key in _message_keys(name)))
        optional = tuple(
            name for name in wanted.optional_messages if any(values.get(key) for key in _message_keys(name))
        )
        period_s = period_ms * cycles / 1000 if period_ms else None
        fault = fault or _difference(wanted, period_s, messages)
        yield GnssConfiguration(
            request_id=wanted.request_id,
            source=self._source,
            accepted=fault is None,
            navigation_period_s=period_s,
            messages=messages + optional,
            reason=fault,
            model=self._version.get("MOD"),
            firmware=self._version.get("FWVER"),
            dynamic_model=DYNAMIC_MODELS.get(values.get(keys[DYNAMIC_MODEL], -1)),
            elevation_mask_rad=_elevation_rad(values.get(keys[ELEVATION_MASK])),
        )


def wanted_values(wanted: GnssConfigure) -> dict[int, int]:
    """Translate a request to configuration keys and values; raises ValueError for an invalid request."""
    keys = _database()
    period_ms = round(wanted.navigation_period_s * 1000)
    if not 25 <= period_ms <= 65535:
        raise ValueError(f"a navigation period of {wanted.navigation_period_s} s is outside 0.025 to 65.535 s")
    values = {keys["CFG_RATE_MEAS"]: period_ms, keys["CFG_RATE_NAV"]: 1, **_output_values(wanted.messages)}
    if len(values) > MAX_KEYS:
        raise ValueError(f"{len(wanted.messages)} messages are too many for one request: at most {MAX_KEYS // 2 - 1}")
    return values


def optional_values(wanted: GnssConfigure) -> list[dict[int, int]]:
    """Keys and values of each optional message.

    The long ones, 1048 bytes for 32 measurements and 976 for 60 signals, are sent once a second.
    """
    every = max(1, round(1.0 / wanted.navigation_period_s))
    names = wanted.optional_messages
    return [_output_values((name,), every if name in ONCE_A_SECOND else 1) for name in names]


def _output_values(messages: tuple[str, ...], every: int = 1) -> dict[int, int]:
    """Keys of messages that are sent every so many epochs; raises ValueError for one that u-blox does not have."""
    keys, values = _database(), dict[int, int]()
    for name in messages:
        if not (found := _message_keys(name)):
            known = [
                key[15:-4].replace("_", "-") for key in keys if key.startswith("CFG_MSGOUT_UBX_") and key[-3:] == "USB"
            ]
            near = get_close_matches(name, known, n=1)
            raise ValueError(f"unknown u-blox message {name}" + (f"; did you mean {near[0]}?" if near else ""))
        values.update(dict.fromkeys(found, every))
    return values


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


def read_version(payload: bytes) -> dict[str, str]:
    """Decode UBX-MON-VER to its lines of the form KEY=value; FWVER is the software version where no line has it."""
    if len(payload) < VERSION_HEAD:
        return {}
    lines = [_text(payload[start : start + VERSION_LINE]) for start in range(VERSION_HEAD, len(payload), VERSION_LINE)]
    stated = dict(line.split("=", 1) for line in lines if "=" in line)
    return {"FWVER": _text(payload[:VERSION_LINE]), **stated}


def _text(field: bytes) -> str:
    return field.split(b"\0", 1)[0].decode("ascii", "replace").strip()


def _elevation_rad(value: int | None) -> float | None:
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


def _difference(wanted: GnssConfigure, period_s: float | None, messages: tuple[str, ...]) -> str | None:
    missing = [name for name in wanted.messages if name not in messages]
    if missing:
        return f"the receiver does not send {', '.join(missing)}"[:400]
    if period_s is None or abs(period_s - wanted.navigation_period_s) > 1e-3:
        return f"the receiver's navigation period is {period_s} s, not {wanted.navigation_period_s} s"
    return None

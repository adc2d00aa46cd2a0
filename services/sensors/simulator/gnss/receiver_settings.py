"""The configuration of the simulated receiver, and the messages that change and read it.

Source: u-blox F9 HPG 1.32 interface description (UBX-22008968), UBX-CFG-VALSET, UBX-CFG-VALGET, chapter 5.
"""

import struct
from collections.abc import Iterator

from shared.messages.gnss import GnssStart
from shared.protocols.framing.framer import Framer
from shared.protocols.registry import BY_NAME
from shared.protocols.ubx import ubx_frame

from .ubx_encoder import CFG, MON, VALGET, VALSET, acknowledge, mon_ver

RATE_MEAS, RATE_NAV, RATE_TIMEREF, DYNAMIC_MODEL = 0x30210001, 0x30210002, 0x20210003, 0x20110021
ELEVATION_MASK = 0x201100A4  # [deg]
# Key of each output message on I2C; UART1, UART2, USB and SPI follow in that order.
OUTPUTS = {
    "UBX_NAV_PVT": 0x20910006,
    "UBX_NAV_HPPOSLLH": 0x20910033,
    "UBX_NAV_DOP": 0x20910038,
    "UBX_NAV_COV": 0x20910083,
    "UBX_NAV_SAT": 0x20910015,
    "UBX_NAV_RELPOSNED": 0x2091008D,
    "UBX_NAV_STATUS": 0x2091001A,
    "UBX_NAV_CLOCK": 0x20910065,
    "UBX_NAV_EOE": 0x2091015F,
    "UBX_RXM_RAWX": 0x209102A4,
    "UBX_RXM_SFRBX": 0x20910231,
    "UBX_MON_RF": 0x20910359,
    "UBX_SEC_SIG": 0x20910634,
    "UBX_NAV_SIG": 0x20910345,  # the last of UBX: its 80 ms on the line delay no other message
    "NMEA_ID_RMC": 0x209100AB,
    "NMEA_ID_GGA": 0x209100BA,
    "NMEA_ID_GSA": 0x209100BF,
}
PORTS = 5
OUR_PORT = 1  # UART1
LIMITS = {
    RATE_MEAS: (25, 65535),
    RATE_NAV: (1, 127),
    RATE_TIMEREF: (0, 4),
    DYNAMIC_MODEL: (0, 12),
    ELEVATION_MASK: (0, 90),
}
RAM, DEFAULTS = 0, 7  # layers of VALGET
RST, EPHEMERIDES = 0x04, 0x0001  # UBX-CFG-RST, and the bit of its mask


class Settings:
    """Current keys and values, and the receiver's side of the configuration exchange."""

    def __init__(self, protocols: tuple[str, ...]) -> None:
        self._values = {RATE_MEAS: 1000, RATE_NAV: 1, RATE_TIMEREF: 1, DYNAMIC_MODEL: 4, ELEVATION_MASK: 10}
        for name, key in OUTPUTS.items():
            sent = name.split("_", maxsplit=1)[0].lower() in protocols
            self._values.update({key + port: int(sent and port == OUR_PORT) for port in range(PORTS)})
        self._defaults = dict(self._values)
        self._framer = Framer((BY_NAME["UBX"].framing,))
        self.restart: GnssStart | None = None  # that was asked for and has not begun

    @property
    def period_ms(self) -> int:
        """Time between navigation epochs."""
        return self._values[RATE_MEAS] * self._values[RATE_NAV]

    def due(self, epoch: int) -> Iterator[str]:
        """Names of the messages to send in an epoch."""
        for name, key in OUTPUTS.items():
            every = self._values[key + OUR_PORT]
            if every and epoch % every == 0:
                yield name

    def feed(self, data: bytes) -> Iterator[bytes]:
        """Process bytes written to the receiver; yield its responses."""
        for command in self._framer.feed(data):
            group, number, payload = command.data[2], command.data[3], command.data[6:-2]
            yield from self._respond(group, number, payload)

    def _respond(self, message_class: int, message_id: int, payload: bytes) -> Iterator[bytes]:
        if (message_class, message_id) == (MON, 0x04) and not payload:
            yield mon_ver()
        elif (message_class, message_id) == (CFG, RST) and len(payload) == 4:
            self.restart = _start_of(int.from_bytes(payload[:2], "little"))
        elif (message_class, message_id) == (CFG, VALSET):
            yield acknowledge(CFG, VALSET, accepted=self._set(payload))
        elif (message_class, message_id) == (CFG, VALGET):
            reply = self._get(payload)
            if reply is not None:
                yield reply
            yield acknowledge(CFG, VALGET, accepted=reply is not None)

    def _set(self, payload: bytes) -> bool:
        """Apply all values, or none of them if one is invalid."""
        values = _read_values(payload)
        if values is None or not all(self._allowed(key, value) for key, value in values.items()):
            return False
        self._values.update(values)
        return True

    def _get(self, payload: bytes) -> bytes | None:
        if len(payload) < 4 or len(payload) % 4 or payload[1] not in {RAM, DEFAULTS}:
            return None
        values = self._values if payload[1] == RAM else self._defaults
        keys = [key for (key,) in struct.iter_unpack("<I", payload[4:])]
        if not keys or not all(key in values for key in keys):
            return None
        items = (key.to_bytes(4, "little") + values[key].to_bytes(_size(key), "little") for key in keys)
        return ubx_frame(CFG, VALGET, b"\x01" + payload[1:4] + b"".join(items))

    def _allowed(self, key: int, value: int) -> bool:
        low, high = LIMITS.get(key, (0, 255))
        return key in self._values and low <= value <= high


def _start_of(cleared: int) -> GnssStart:
    """Start by what UBX-CFG-RST clears: all, the ephemerides, or nothing."""
    if cleared & ~EPHEMERIDES:
        return GnssStart.COLD
    return GnssStart.WARM if cleared else GnssStart.HOT


def _read_values(payload: bytes) -> dict[int, int] | None:
    values: dict[int, int] = {}
    position = 4
    while position + 4 <= len(payload):
        key = int.from_bytes(payload[position : position + 4], "little")
        end = position + 4 + _size(key)
        if end > len(payload):
            return None
        values[key] = int.from_bytes(payload[position + 4 : end], "little")
        position = end
    return values if position == len(payload) else None


def _size(key: int) -> int:
    """Size of a value [bytes], encoded in bits 28 to 30 of its key."""
    return (1, 1, 1, 2, 4, 8, 8, 8)[key >> 28 & 7]

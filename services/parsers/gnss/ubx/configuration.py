"""Configures a u-blox receiver: finds out its generation, switches UBX on, and leaves the rest to that generation.

Source: u-blox F9 HPG 1.32 interface description (UBX-22008968), UBX-MON-VER; u-blox M8 (UBX-13003221), UBX-CFG-PRT.
"""

import struct
from collections.abc import Iterator

from pyubx2.ubxmessage import UBXMessage

from shared.messages.gnss import GnssConfiguration, GnssConfigure, GnssStart
from shared.protocols.ubx import ubx_frame

from ..dialect import Dialogue
from .exchange import NO_RESPONSE, Exchange, Result
from .legacy import LegacyExchange
from .outputs import plan_outputs
from .reset import reset
from .valset import RAM, ValsetExchange

MON, VER, CFG, PRT = 0x0A, 0x04, 0x06, 0x00
ANSWERS = ("ACK-ACK", "ACK-NAK", "CFG-VALGET", "CFG-RATE", "CFG-NAV5", "MON-VER")  # that are used
VALSET_SINCE = 27.0  # protocol version of generation 9
IDENTIFY_TICKS = 3  # seconds for an answer to UBX-MON-VER, which is polled in each
VERSION_HEAD, VERSION_LINE = 40, 30  # [bytes] software and hardware, and each further line
UART1, USB = 1, 3
EIGHT_BITS_NO_PARITY = 0x08D0
UBX_NMEA_RTCM, UBX_NMEA = 0x27, 0x03  # masks of the protocols of a port, in and out


class UbxDialogue(Dialogue):
    """Executes one request at a time; a new request replaces a pending one."""

    def __init__(self, source: str) -> None:
        self._source = source
        self._wanted: GnssConfigure | None = None
        self._rate_baud: int | None = None
        self._exchange: Exchange | None = None  # None until the generation is known
        self._version: dict[str, str] = {}
        self._ticks = 0

    def request(self, wanted: GnssConfigure, rate_baud: int | None) -> Iterator[bytes | GnssConfiguration]:
        """Begin by asking for the version."""
        self._wanted, self._rate_baud, self._exchange, self._ticks = wanted, rate_baud, None, 0
        yield ubx_frame(MON, VER, b"")

    def take(self, kind: str, payload: bytes) -> Iterator[bytes | GnssConfiguration]:
        """Process an answer."""
        if self._wanted is None:
            return
        if kind == "MON-VER" and self._exchange is None:
            self._version = read_version(payload)
            legacy = protocol_version(self._version) < VALSET_SINCE
            plan = plan_outputs(self._wanted, self._rate_baud)
            self._exchange = (LegacyExchange if legacy else ValsetExchange)(self._wanted, plan)
            yield from self._said(self._exchange.begin())
        elif self._exchange is not None and kind in ANSWERS:
            yield from self._said(self._exchange.take(kind, payload))

    def restart(self, start: GnssStart) -> bytes:
        """UBX-CFG-RST."""
        return reset(start)

    def tick(self) -> Iterator[bytes | GnssConfiguration]:
        """Ask again, with UBX switched on; end a pending request after the timeout."""
        if self._wanted is None:
            return
        if self._exchange is not None:
            yield from self._said(self._exchange.tick())
            return
        self._ticks += 1
        if self._ticks < IDENTIFY_TICKS:
            yield from switch_on(self._rate_baud)
            yield ubx_frame(MON, VER, b"")
        else:
            yield from self._said(iter((Result(NO_RESPONSE),)))

    def _said(self, said: Iterator[bytes | Result]) -> Iterator[bytes | GnssConfiguration]:
        for result in said:
            if isinstance(result, bytes):
                yield result
            elif self._wanted is not None:
                yield self._configuration(self._wanted, result)
                self._wanted = None

    def _configuration(self, wanted: GnssConfigure, result: Result) -> GnssConfiguration:
        return GnssConfiguration(
            request_id=wanted.request_id,
            source=self._source,
            accepted=result.fault is None,
            navigation_period_s=result.navigation_period_s,
            messages=tuple(f"UBX {name}" for name in result.messages),
            reason=result.fault or result.note,
            model=self._version.get("MOD"),
            firmware=self._version.get("FWVER"),
            protocol=f"UBX {self._version['PROTVER']}" if "PROTVER" in self._version else None,
            dynamic_model=result.dynamic_model,
            elevation_mask_rad=result.elevation_mask_rad,
        )


def switch_on(rate_baud: int | None) -> Iterator[bytes]:
    """Switch UBX output on, in the volatile memory: a receiver that sends NMEA alone does not answer otherwise.

    Receivers of generation 9 take the first two, older ones the others, which state the rate of a serial port as well:
    without it that port is left as it is.
    """
    for key in ("CFG_UART1OUTPROT_UBX", "CFG_USBOUTPROT_UBX"):
        yield UBXMessage.config_set(RAM, 0, [(key, 1)]).serialize()
    protocols = struct.pack("<HHHH", UBX_NMEA_RTCM, UBX_NMEA, 0, 0)
    if rate_baud is not None:
        yield ubx_frame(CFG, PRT, struct.pack("<BxHII", UART1, 0, EIGHT_BITS_NO_PARITY, rate_baud) + protocols)
    yield ubx_frame(CFG, PRT, struct.pack("<BxHII", USB, 0, 0, 0) + protocols)


def read_version(payload: bytes) -> dict[str, str]:
    """Decode UBX-MON-VER to its lines of the form KEY=value; FWVER is the software version where no line has it."""
    if len(payload) < VERSION_HEAD:
        return {}
    lines = [_text(payload[start : start + VERSION_LINE]) for start in range(VERSION_HEAD, len(payload), VERSION_LINE)]
    stated = dict(line.split("=", 1) for line in lines if "=" in line)
    older = dict(line.split(" ", 1) for line in lines if line.startswith(("PROTVER ", "FWVER ", "MOD ")))
    return {"FWVER": _text(payload[:VERSION_LINE]), **older, **stated}


def protocol_version(version: dict[str, str]) -> float:
    """Version of the protocol; 0 where a receiver does not state it, as those before generation 7."""
    try:
        return float(version.get("PROTVER", "0"))
    except ValueError:
        return 0.0


def _text(field: bytes) -> str:
    return field.split(b"\0", 1)[0].decode("ascii", "replace").strip()

"""Decodes the standardised vehicle speeds of OBD-II and J1939.

Sources: SAE J1979 (mode 01, PID 0D), ISO 15765-4 (identifiers); SAE J1939-71 (CCVS, SPN 84; TCO1, SPN 1624).
"""

from dataclasses import dataclass

from .candump import CanFrame

KM_H = 1 / 3.6  # [m/s]
OBD_RESPONSES = ((0x7E8, False), (0x18DAF110, True))  # identifiers of the engine ECU
OBD_SPEED = b"\x41\x0d"  # response to mode 01, PID 0D
J1939_SPEEDS = {65265: ("j1939", 1), 65132: ("tachograph", 6)}  # PGN -> (name, first byte): CCVS, TCO1
J1939_RESOLUTION_M_S = KM_H / 256
J1939_FIRST_INVALID = 0xFB00  # values from here on mean error or not available


@dataclass(frozen=True, slots=True)
class Speed:
    """A vehicle speed and the name of its standard."""

    name: str
    speed_m_s: float
    resolution_m_s: float


def standard_speed(frame: CanFrame) -> Speed | None:
    """Decode the speed of a frame; None for other frames and for speeds marked as not available."""
    if (frame.identifier, frame.extended) in OBD_RESPONSES:
        return _obd(frame.data)
    return _j1939(frame) if frame.extended else None


def _obd(data: bytes) -> Speed | None:
    # A single frame of ISO 15765-2: the first byte is the payload length.
    if len(data) < 4 or not 3 <= data[0] <= 7 or data[1:3] != OBD_SPEED:
        return None
    return Speed("obd", data[3] * KM_H, KM_H)


def _j1939(frame: CanFrame) -> Speed | None:
    group = frame.identifier >> 8 & 0x3FFFF
    if group not in J1939_SPEEDS:
        return None
    name, first = J1939_SPEEDS[group]
    raw = int.from_bytes(frame.data[first : first + 2], "little")
    if len(frame.data) < first + 2 or raw >= J1939_FIRST_INVALID:
        return None
    return Speed(name, raw * J1939_RESOLUTION_M_S, J1939_RESOLUTION_M_S)

"""Decodes the standardised vehicle speeds of OBD-II and J1939.

Sources: SAE J1979 (mode 01, PID 0D, length of each PID), ISO 15765-2 (frames of an answer), ISO 15765-4 (identifiers);
SAE J1939-71 (CCVS, SPN 84; TCO1, SPN 1624).
"""

from dataclasses import dataclass

from .candump import CanFrame

KM_H = 1 / 3.6  # [m/s]
# Identifiers of answers: 7E8 to 7EF of the eight legislated control units, 18DAF1xx of the unit xx to the tester F1.
OBD_ANSWERS = range(0x7E8, 0x7F0)
OBD_ANSWERS_29 = 0x18DAF1
ENGINES = (0x7E8, 0x18DAF110)  # the control unit of the engine
CURRENT_DATA, SPEED_PID = 0x41, 0x0D  # answer to mode 01
# Bytes of the value of each PID from 00 on; an answer to several PIDs is a sequence of a PID and its value.
PID_BYTES = bytes(int(digit) for digit in (
    "4422111111112111" "2111222222221112" "4222444444441111" "1221444444442222"
    "4422211111111224" "4112222222111221" "411252537"
))  # fmt: skip
LONGEST_ANSWER = 4095
MOST_ANSWERS = 32  # answers of several frames at a time, of all control units
J1939_SPEEDS = {65265: ("j1939", 1), 65132: ("tachograph", 6)}  # PGN -> (name, first byte): CCVS, TCO1
J1939_RESOLUTION_M_S = KM_H / 256
J1939_FIRST_INVALID = 0xFB00  # values from here on mean error or not available


@dataclass(frozen=True, slots=True)
class Speed:
    """A vehicle speed, and the name of its standard with the address of its sender."""

    name: str
    speed_m_s: float
    resolution_m_s: float


class StandardSpeeds:
    """Decodes the speeds of frames; answers of several frames are joined by sender."""

    def __init__(self) -> None:
        self._answers: dict[tuple[str, int], tuple[int, bytes, int]] = {}  # length, bytes so far, next number

    def decode(self, frame: CanFrame) -> Speed | None:
        """Decode the speed of a frame; None for other frames and for speeds marked as not available."""
        identifier = frame.identifier
        if (frame.extended and identifier >> 8 == OBD_ANSWERS_29) or (not frame.extended and identifier in OBD_ANSWERS):
            answer = self._joined(frame)
            value = None if answer is None else speed_of_answer(answer)
            name = "obd" if identifier in ENGINES else f"obd/{identifier:03X}"
            return None if value is None else Speed(name, value * KM_H, KM_H)
        return _j1939(frame) if frame.extended else None

    def _joined(self, frame: CanFrame) -> bytes | None:
        """The answer that a frame completes: alone, or as the last of several; None if it completes none."""
        data, key = frame.data, (frame.interface, frame.identifier)
        kind = data[0] >> 4 if data else None
        if kind == 0:
            return data[1 : 1 + data[0]] if 0 < data[0] < len(data) else None
        length, joined, number = self._answers.pop(key, (0, b"", 0))
        if kind == 1 and len(data) == 8:
            length, joined, number = (data[0] & 0x0F) << 8 | data[1], data[2:], 0
        elif kind != 2 or data[0] & 0x0F != number & 0x0F or not length:
            return None
        else:
            joined += data[1:]
        if len(joined) >= length:
            return joined[:length]
        if len(self._answers) < MOST_ANSWERS:
            self._answers[key] = length, joined, number + 1
        return None


def speed_of_answer(answer: bytes) -> int | None:
    """The speed [km/h] of an answer to one or several PIDs of mode 01; None if it has none."""
    if not answer or answer[0] != CURRENT_DATA:
        return None
    place = 1
    while place + 1 < len(answer):
        pid = answer[place]
        if pid == SPEED_PID:
            return answer[place + 1]
        if pid >= len(PID_BYTES):  # of unknown length: what follows is not known
            return None
        place += 1 + PID_BYTES[pid]
    return None


def _j1939(frame: CanFrame) -> Speed | None:
    group = frame.identifier >> 8 & 0x3FFFF
    if group not in J1939_SPEEDS:
        return None
    name, first = J1939_SPEEDS[group]
    raw = int.from_bytes(frame.data[first : first + 2], "little")
    if len(frame.data) < first + 2 or raw >= J1939_FIRST_INVALID:
        return None
    address = frame.identifier & 0xFF
    return Speed(f"{name}/{address:02X}", raw * J1939_RESOLUTION_M_S, J1939_RESOLUTION_M_S)

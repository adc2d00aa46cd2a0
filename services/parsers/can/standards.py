"""Decodes the standardised vehicle speeds of OBD-II and J1939.

Sources: SAE J1979 (mode 01, PID 0D, length of each PID; mode 09, PID 02), ISO 15765-2 (frames of an answer), ISO
15765-4 (identifiers); SAE J1939-71 (CCVS, SPN 84; TCO1, SPN 1624).
"""

import re
from collections import Counter
from dataclasses import dataclass

from shared.messages.operation import MessageUse

from .candump import CanFrame
from .isotp import MessageJoiner

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
OBD_REQUESTS = (0x7DF, *range(0x7E0, 0x7E8))  # of a tester on the same bus
VIN_ANSWER = b"\x49\x02"  # to mode 09, PID 02; the next byte counts the items
_VIN = re.compile(r"[A-HJ-NPR-Z0-9]{17}")
J1939_SPEEDS = {65265: ("j1939", 1), 65132: ("tachograph", 6)}  # PGN -> (name, first byte): CCVS, TCO1
J1939_FIRST_BROADCAST = 240  # format of a group without a receiver (PDU2)
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

    def __init__(self, rejects: Counter[str]) -> None:
        self._joiner = MessageJoiner(rejects)
        self.vin: str | None = None  # of the frame that was decoded last

    def decode(self, frame: CanFrame) -> Speed | None:
        """Decode the speed of a frame; None for other frames and for speeds marked as not available."""
        identifier = frame.identifier
        self.vin = None
        if is_obd_answer(frame):
            answer = self._joiner.take(frame)
            if answer is None:
                return None
            self.vin = vin_of_answer(answer)
            value = speed_of_answer(answer)
            name = "obd" if identifier in ENGINES else f"obd/{identifier:03X}"
            return None if value is None else Speed(name, value * KM_H, KM_H)
        return _j1939(frame) if frame.extended else None


def is_obd_answer(frame: CanFrame) -> bool:
    """Whether a frame has the identifier of an answer to an OBD tester."""
    return frame.identifier >> 8 == OBD_ANSWERS_29 if frame.extended else frame.identifier in OBD_ANSWERS


def standard_use(frame: CanFrame) -> MessageUse | None:
    """What is done with a frame by its standard; None if its identifier is of none that is known here."""
    if is_obd_answer(frame):
        return MessageUse.USED
    if frame.extended:
        return MessageUse.USED if parameter_group(frame.identifier) in J1939_SPEEDS else None
    return MessageUse.UNUSED if frame.identifier in OBD_REQUESTS else None


def parameter_group(identifier: int) -> int:
    """Number of the parameter group (PGN) of a 29-bit identifier, after SAE J1939-21, 5.2.

    Below the format 240 (PDU1) the eight bits behind it are the address of the receiver, and no part of the number.
    """
    group = identifier >> 8 & 0x3FFFF
    return group if group >> 8 & 0xFF >= J1939_FIRST_BROADCAST else group & 0x3FF00


def sender_of(identifier: int) -> int:
    """Address of the sender in a 29-bit identifier of SAE J1939."""
    return identifier & 0xFF


def vin_of_answer(answer: bytes) -> str | None:
    """The vehicle identification number in an answer to mode 09, PID 02; None if it has none that can be one.

    ISO 3779 allows digits and letters without I, O and Q; shorter numbers are padded in front with zero bytes.
    """
    if answer[:2] != VIN_ANSWER:
        return None
    text = answer[3:].strip(b"\x00").decode("ascii", errors="replace")
    return text if _VIN.fullmatch(text) else None


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
    group = parameter_group(frame.identifier)
    if group not in J1939_SPEEDS:
        return None
    name, first = J1939_SPEEDS[group]
    raw = int.from_bytes(frame.data[first : first + 2], "little")
    if len(frame.data) < first + 2 or raw >= J1939_FIRST_INVALID:
        return None
    return Speed(f"{name}/{sender_of(frame.identifier):02X}", raw * J1939_RESOLUTION_M_S, J1939_RESOLUTION_M_S)

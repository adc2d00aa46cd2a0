"""The lines of an ELM327's answer to a request, as frames.

Source: ELM Electronics, ELM327DSJ, "Interpreting Trouble Codes", "Multiline Responses" and "Bus Initiation"; message
formats of ISO 15765-2, ISO 9141-2, ISO 14230-2 and SAE J1850.
"""

import re
from dataclasses import dataclass

ENGINE = 0x7E8  # of answers without an identifier
OLDER = "12345"  # protocols whose messages have three bytes of header and one that checks them: J1850 and K-line
WITH_SUM = "345"  # the last byte is the sum of those before it
ANSWERS = (*range(0x41, 0x4B), 0x7F)  # first byte: to modes 01 to 0A, and that a request is refused (SAE J1979)
MAX_DIGITS = 24  # an identifier of 29 bits and eight bytes
_HEX = re.compile(r"[0-9A-F]+")
_IDENTIFIER = re.compile(r"7E[89A-F]")
_LENGTH = re.compile(r"[0-9A-F]{3}")  # of an answer of several lines, without identifiers
_PART = re.compile(r"([0-9A-F]):((?:[0-9A-F]{2}){1,7})")


@dataclass(frozen=True, slots=True)
class ElmFrame:
    """One frame of the vehicle; an error frame has no data."""

    identifier: int
    extended: bool
    data: bytes
    is_error: bool = False


class AnswerLines:
    """Reads the lines of one vehicle's answers."""

    def __init__(self) -> None:
        self.without_identifiers = False
        self._length: int | None = None  # of an answer in numbered lines

    def end(self) -> None:
        """The answer is over."""
        self._length = None

    def frame(self, digits: str, protocol: str) -> ElmFrame | None:
        """The frame of a line without blanks; None for the length that precedes numbered lines.

        Parameters
        ----------
        digits : str
            The line, in upper case.
        protocol : str
            Number of the protocol, as ATDPN states it.

        Raises
        ------
        ValueError
            The line is no frame, or half of one.
        """
        if part := _PART.fullmatch(digits):
            return self._numbered(int(part[1], 16), bytes.fromhex(part[2]))
        if not _HEX.fullmatch(digits) or len(digits) > MAX_DIGITS:
            raise ValueError("no frame")
        if _LENGTH.fullmatch(digits) and not _IDENTIFIER.fullmatch(digits):
            self._length = int(digits, 16)
            return None
        if protocol in OLDER:
            return _of_older_bus(bytes.fromhex(digits), has_sum=protocol in WITH_SUM)
        if len(digits) % 2:  # an identifier of 11 bits has three digits
            return _checked(int(digits[:3], 16), False, bytes.fromhex(digits[3:]))
        if digits.startswith("18") and len(digits) > 8:
            return _checked(int(digits[:8], 16), True, bytes.fromhex(digits[8:]))
        return self._bare(bytes.fromhex(digits))

    def _bare(self, payload: bytes) -> ElmFrame:
        """An answer without an identifier, of a clone that ignores ATH1."""
        if payload[0] not in ANSWERS or len(payload) > 7:
            raise ValueError("no answer")
        self.without_identifiers = True
        return ElmFrame(ENGINE, False, bytes((len(payload),)) + payload)

    def _numbered(self, number: int, data: bytes) -> ElmFrame:
        """A part of an answer of several lines without identifiers, as the frame of ISO 15765-2 that it was in."""
        length = self._length
        if length is None or (number == 0 and len(data) != 6):
            raise ValueError("a part without a beginning")
        self.without_identifiers = True
        head = bytes((0x10 | length >> 8, length & 0xFF)) if number == 0 else bytes((0x20 | number,))
        return ElmFrame(ENGINE, False, head + data)


def _checked(identifier: int, extended: bool, data: bytes) -> ElmFrame:
    """A frame with an identifier, unless a half line has cut it: its first byte states how long it is."""
    if not data or len(data) > 8 or (data[0] >> 4 == 0 and not 0 < data[0] < len(data)):
        raise ValueError("half a frame")
    return ElmFrame(identifier, extended, data)


def _of_older_bus(message: bytes, *, has_sum: bool) -> ElmFrame:
    """An answer on K-line or J1850, as the frame with the 29-bit identifier of the same control unit."""
    payload = message[3:-1]
    if not 0 < len(payload) <= 7 or (has_sum and sum(message[:-1]) & 0xFF != message[-1]):
        raise ValueError("no message of this bus")
    return ElmFrame(0x18DAF100 | message[2], True, bytes((len(payload),)) + payload)

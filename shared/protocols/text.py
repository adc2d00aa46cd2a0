"""Protocols of text: adapters of CAN buses, and lines of any form, such as those of an inertial unit.

A line may begin with anything: it is a line where no other protocol of the registry claims it.
"""

import re
import string
from collections.abc import Callable

from .framing.finder import Sums
from .framing.framing import Framing
from .protocol import Protocol, Reason

MIN_LINES = 3  # lines of a protocol without a checksum, fewer of which may be chance
MAX_LINE = 1024  # [bytes]
_HEXADECIMAL = string.hexdigits.encode()
_SLCAN = rb"t[0-9A-Fa-f]{3}[0-8][0-9A-Fa-f]{0,16}\r"
# Sentences of receivers, which are no lines of another device even if their checksum is switched off.
_OF_RECEIVER = re.compile(rb"\$(?:(?:G[ABILNPQ]|BD|QZ|PQ)[A-Z]{3}|P(?:UBX|MTK|QTM|STM|SSN|SRF|CAS|AIR)[A-Z0-9]*),")


class LineFraming(Framing):
    """Frames that are whole where their pattern matches, without a checksum."""

    most_bytes = MAX_LINE

    def size(self, buffer: bytes | bytearray, start: int, header: int) -> int | None:
        """The whole frame is the header."""
        return header

    def fault(self, buffer: bytes | bytearray, start: int, stop: int, at: Callable[[int], Sums]) -> str | None:
        """Nothing is left to be checked."""
        return None


class Elm327Framing(LineFraming):
    """The adapter's name, or its prompt."""

    protocol, begins = "ELM327", (tuple(bytes([letter]) for letter in b"ELM327 v"), (b"\r", b">"))
    starts = rb"ELM327 v\d|\r>"


class SlcanFraming(LineFraming):
    """A frame of a CAN bus as a line."""

    protocol, begins, least = "slcan", ((b"t", _HEXADECIMAL, _HEXADECIMAL, _HEXADECIMAL, b"012345678"),), MIN_LINES
    starts = _SLCAN


class TextFraming(LineFraming):
    """A line of printable characters that is no sentence of a receiver and no line of an adapter."""

    protocol, begins, least = "text lines", (), MIN_LINES
    starts = rb"(?<=[\r\n])[ -~\t]{3,%d}[\r\n]" % MAX_LINE

    def fault(self, buffer: bytes | bytearray, start: int, stop: int, at: Callable[[int], Sums]) -> str | None:
        """Leave to the other protocols what is theirs."""
        line = bytes(buffer[start:stop])
        return "of another protocol" if _OF_RECEIVER.match(line) or re.fullmatch(_SLCAN, line) else None


_FORM = "compare a line with [parsers.imu.line]: docs/how-to/connect-devices.md"
LINES = Protocol(
    TextFraming(), "text lines", frozenset(("imu",)), reasons={
        "line_form": Reason("a line that is not of the form that is configured (csv or json)", _FORM),
        "line_column": Reason("a line in which a column is missing, or is no number", _FORM),
        "line_length": Reason("a line of more than 1024 bytes", _FORM),
        "line_not_described": Reason("lines of text of a device whose form is not known",
                                     "write their columns as [parsers.imu.line]: docs/how-to/connect-devices.md"),
    },
)  # fmt: skip
ELM327 = Protocol(
    Elm327Framing(), "ELM327 adapter", frozenset(("can",)), remedy="name it in [sensors.can] as elm327:///dev/...",
    reasons={
        "adapter_byte": Reason("a byte that no adapter sends", "check the rate of the port, and try another adapter"),
        "adapter_line": Reason("a line of an adapter that is no frame", "as adapter_byte"),
        "adapter_silent": Reason("an adapter that does not answer", "plug it in again; switch the ignition on"),
        "adapter_refuses_*": Reason("a command that the adapter does not know", "use a genuine ELM327 or STN adapter"),
        "adapter_*": Reason("an error that the adapter names", "look it up in the manual of the ELM327"),
    },
)  # fmt: skip
SLCAN = Protocol(
    SlcanFraming(), "slcan adapter", frozenset(("can",)), remedy="name it in [sensors.can] as slcan:///dev/..."
)

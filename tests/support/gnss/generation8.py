"""A u-blox M8 after its interface description: a fake, since no hardware is here."""

import struct
from typing import Any

from pyubx2.ubxmessage import UBXMessage
from pyubx2.ubxreader import UBXReader
from pyubx2.ubxtypes_core import UBX_MSGIDS

from shared.protocols.ubx import ubx_frame


def acknowledge(message_id: int, *, good: bool = True) -> bytes:
    name = "ACK-ACK" if good else "ACK-NAK"
    return bytes(UBXMessage("ACK", name, 0, clsID=6, msgID=message_id).serialize())


def parse_ubx_command(frame: bytes) -> Any:
    """Parse what is sent to a receiver."""
    return UBXReader.parse(frame, msgmode=1)


class Generation8:
    """A u-blox M8 as its interface description says it: settings in volatile memory, each acknowledged."""

    def __init__(self, *, protver: str = "PROTVER=18.00", refuses: tuple[str, ...] = (), mute: bool = False) -> None:
        self.protver, self.refuses, self.mute = protver, refuses, mute
        self.period_ms, self.model, self.rates = 1000, 0, dict[str, int]()
        self.commands: list[Any] = []

    def answer(self, frame: bytes) -> bytes:
        """Answer one command, and note it."""
        command = parse_ubx_command(frame)
        kind = command.identity
        if kind == "MON-VER":
            lines = [b"FWVER=SPG 3.01", self.protver.encode(), b"MOD=NEO-M8N-0"]
            texts = b"EXT CORE 3.01 (107888)".ljust(30, b"\0") + b"00080000".ljust(10, b"\0")
            return ubx_frame(0x0A, 0x04, texts + b"".join(line.ljust(30, b"\0") for line in lines))
        if self.mute:
            return b""
        payload = frame[6:-2]
        self.commands.append(command)
        if kind == "CFG-RATE" and not payload:
            return ubx_frame(6, 8, struct.pack("<HHH", self.period_ms, 1, 1))
        if kind == "CFG-NAV5" and not payload:
            return bytes(UBXMessage("CFG", "CFG-NAV5", 0, dynModel=self.model, minElev=5).serialize())
        name = UBX_MSGIDS.get(payload[:2], "") if kind == "CFG-MSG" else kind
        good = name not in self.refuses and kind in ("CFG-RATE", "CFG-NAV5", "CFG-MSG")
        if good and kind == "CFG-RATE":
            self.period_ms = command.measRate
        elif good and kind == "CFG-NAV5":
            self.model = command.dynModel
        elif good and kind == "CFG-MSG":
            self.rates[name] = payload[2]
        return acknowledge(frame[3], good=good)

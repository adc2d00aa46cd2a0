"""UBX-CFG-RST: starts a receiver anew, with or without what it knows."""

import struct

from shared.messages.gnss import GnssStart
from shared.protocols.ubx import ubx_frame

# navBbrMask: what is cleared of the battery-backed memory. Interface description of u-blox 8 and F9, UBX-CFG-RST.
CLEARED = {GnssStart.HOT: 0x0000, GnssStart.WARM: 0x0001, GnssStart.COLD: 0xFFFF}
GNSS_ONLY = 0x02  # resetMode: controlled software reset of GNSS; ports and configuration stay


def reset(start: GnssStart) -> bytes:
    """Frame that lets a receiver start hot, warm or cold; it is not answered."""
    return ubx_frame(0x06, 0x04, struct.pack("<HBx", CLEARED[start], GNSS_ONLY))

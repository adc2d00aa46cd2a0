"""Makes frames of UBX."""

from shared.maths.crc import fletcher

from .framing import SYNC


def ubx_frame(group: int, number: int, payload: bytes) -> bytes:
    """Frame a message of a class and number."""
    body = bytes((group, number)) + len(payload).to_bytes(2, "little") + payload
    return SYNC + body + fletcher(body)

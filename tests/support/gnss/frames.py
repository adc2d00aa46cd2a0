"""Frames of corrections as bytes, for tests that need many of them and not their content."""

from binascii import crc_hqx

from pyubx2.ubxhelpers import calc_checksum


def crc(data: bytes, bits: int, polynomial: int, initial: int = 0) -> int:
    """Compute a CRC bit by bit, as its definition says."""
    register = initial
    for byte in data:
        register ^= byte << (bits - 8)
        for _ in range(8):
            register = (register << 1 ^ polynomial if register >> (bits - 1) else register << 1) & ((1 << bits) - 1)
    return register


def rtcm(number: int, size: int = 40) -> bytes:
    """Make an RTCM 3 frame of a message number with `size` bytes of payload."""
    payload = (number << 4).to_bytes(2, "big") + bytes(k * 37 & 0xFF for k in range(size - 2))
    frame = b"\xd3" + len(payload).to_bytes(2, "big") + payload
    return frame + crc(frame, 24, 0x864CFB).to_bytes(3, "big")


def spartn(kind: int, subtype: int, size: int = 60, crc_kind: int = 2) -> bytes:
    """Make an encrypted SPARTN frame with a time tag of 16 bits, no authentication and one of the four kinds of CRC."""
    head = kind << 17 | size << 7 | 1 << 6 | crc_kind << 4
    register = 0
    for byte in head.to_bytes(3, "big"):  # x⁴ + x + 1, lowest bit first
        for bit in range(8):
            feedback = (register ^ byte >> bit) & 1
            register = register >> 1 ^ (9 if feedback else 0)
    described = (subtype << 28 | 1234 << 11).to_bytes(4, "big") + b"\x00\x00"
    body = (head | register).to_bytes(3, "big") + described + bytes(k * 29 & 0xFF for k in range(size))
    checksum = (
        crc(body, 8, 0x07),
        crc_hqx(body, 0),
        crc(body, 24, 0x864CFB),
        crc(body, 32, 0x04C11DB7, 0xFFFFFFFF) ^ 0xFFFFFFFF,
    )[crc_kind]
    return b"s" + body + checksum.to_bytes(crc_kind + 1, "big")


def ubx(kind: int, number: int, payload: bytes) -> bytes:
    """Make a UBX frame."""
    content = bytes((kind, number)) + len(payload).to_bytes(2, "little") + payload
    return b"\xb5\x62" + content + calc_checksum(content)

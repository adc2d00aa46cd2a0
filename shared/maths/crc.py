"""Checksums of device protocols: CRC-24Q of RTCM 3 and SPARTN, other CRC of SPARTN and SBF, Fletcher of UBX."""

from binascii import crc_hqx
from functools import cache
from itertools import accumulate
from zlib import crc32

_REVERSED = bytes(int(f"{value:08b}"[::-1], 2) for value in range(256))


def crc24q(data: bytes) -> int:
    """CRC-24Q of RTCM 3 (polynomial 0x1864CFB); 0 over a complete frame."""
    crc = 0
    for byte in data:
        crc = (crc << 8 & 0xFFFFFF) ^ _CRC_TABLE[crc >> 16 ^ byte]
    return crc


def crcs_along(crc: int, data: bytes) -> list[int]:
    """Continue a CRC-24Q over data; give it before the first byte, and after each byte."""
    table = _CRC_TABLE
    return [crc, *[crc := (crc << 8 & 0xFFFFFF) ^ table[crc >> 16 ^ byte] for byte in data]]


def crc_of_zeros(crc: int, count: int) -> int:
    """Continue a CRC over `count` zero bytes: multiply it by x^(8 count), first 32 bytes at a time, then the rest.

    `count` is less than 1248: the longest frame, of SPARTN, has 1107 bytes.
    """
    many, few = _zeros_tables()
    table = many[count >> 5]
    crc = table[crc >> 16] ^ table[256 | crc >> 8 & 0xFF] ^ table[512 | crc & 0xFF]
    table = few[count & 31]
    return table[crc >> 16] ^ table[256 | crc >> 8 & 0xFF] ^ table[512 | crc & 0xFF]


@cache
def _zeros_tables() -> tuple[list[tuple[int, ...]], list[tuple[int, ...]]]:
    """Tables of 0, 32, 64 ... 1216 zero bytes, and of 0 to 31; made when the first header comes."""
    return [_zeros_table(count) for count in range(0, 1217, 32)], [_zeros_table(count) for count in range(32)]


def _zeros_table(count: int) -> tuple[int, ...]:
    """What each of the three bytes of a CRC becomes over so many zero bytes, from the highest byte on.

    The CRC is linear: of a byte it is the sum (exclusive or) of those of its bits.
    """
    entries: list[int] = []
    for shift in (16, 8, 0):
        table = [0]
        for bit in range(8):
            crc = 1 << bit << shift
            for _ in range(count):
                crc = (crc << 8 & 0xFFFFFF) ^ _CRC_TABLE[crc >> 16]
            table += [crc ^ entry for entry in table]
        entries += table
    return tuple(entries)


def _crc_entry(value: int) -> int:
    crc = value << 16
    for _ in range(8):
        crc = crc << 1 ^ (0x1864CFB if crc & 0x800000 else 0)
    return crc


_CRC_TABLE = tuple(_crc_entry(value) for value in range(256))


def crc16_ccitt(data: bytes) -> int:
    """CRC-16 of the polynomial 0x1021, initial value 0."""
    return crc_hqx(data, 0)


def crc32_unreflected(data: bytes) -> int:
    """CRC-32 of the polynomial 0x04C11DB7 with the highest bit first, from that of zlib with the lowest first."""
    return int(f"{crc32(data.translate(_REVERSED)):032b}"[::-1], 2)


def crc4(head: bytes) -> int:
    """CRC of the header of a SPARTN frame (TF006): x⁴ + x + 1, reflected, over TF002 to TF005 and four zero bits."""
    crc = 0
    for byte in (head[0], head[1], head[2] & 0xF0):
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x9 if crc & 1 else 0)
    return crc & 0xF


def fletcher(data: bytes) -> bytes:
    """8-bit Fletcher checksum of UBX (RFC 1145): the sums of the bytes and of their running sums, modulo 256."""
    running = list(accumulate(data))
    return bytes(((running[-1] if running else 0) & 0xFF, sum(running) & 0xFF))

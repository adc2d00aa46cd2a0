"""Check bits and units of navigation words: parity of GPS LNAV, CRC of Galileo I/NAV.

References
----------
IS-GPS-200N, 20.3.5.2 and table 20-XIV; Galileo OS SIS ICD 2.1, 5.1.9.4.
"""

GPS_PI = 3.1415926535898  # [-] the value that IS-GPS-200 and the Galileo ICD prescribe for semicircles
# Each row: the bits of D29*, D30* and d1 to d24 (from bit 31 down to 6) that make one parity bit, D25 first.
PARITY_MASKS = (0xBB1F3480, 0x5D8F9A40, 0xAEC7CD00, 0x5763E680, 0x6BB1F340, 0x8B7A89C0)  # table 20-XIV
CRC24Q = 0x1864CFB  # generator polynomial: Galileo OS SIS ICD 2.1, 5.1.9.4


def parity(word: int) -> int:
    """Six parity bits of a 32-bit word [D29* D30* d1 ... d24 and 6 bits that are ignored]."""
    value = 0
    for mask in PARITY_MASKS:
        value = value << 1 | (word & mask).bit_count() & 1
    return value


def crc24q(value: int, bits: int) -> int:
    """CRC-24Q of a bit string that is held as an integer; leading zeros do not change it."""
    value <<= 24
    for bit in range(bits + 23, 23, -1):
        if value >> bit & 1:
            value ^= CRC24Q << (bit - 24)
    return value

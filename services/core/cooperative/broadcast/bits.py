"""Fields of navigation messages, which are strings of bits with the most significant bit first."""


class Bits:
    """Reads successive fields of a bit string that is held as one integer."""

    def __init__(self, value: int, length: int) -> None:
        self._value, self._left = value, length

    def unsigned(self, bits: int) -> int:
        """Read an unsigned integer.

        Raises
        ------
        ValueError
            The string is shorter.
        """
        if bits > self._left:
            raise ValueError(f"a field of {bits} bits, but {self._left} are left")
        self._left -= bits
        return (self._value >> self._left) & ((1 << bits) - 1)

    def signed(self, bits: int) -> int:
        """Read an integer in two's complement."""
        value = self.unsigned(bits)
        return value - (1 << bits) if value >> (bits - 1) else value

    def skip(self, bits: int) -> None:
        """Pass over bits that are reserved or not needed."""
        self.unsigned(bits)


def joined(words: tuple[int, ...], bits: int) -> int:
    """Concatenate the lowest bits of words into one integer."""
    value = 0
    for word in words:
        value = value << bits | word & ((1 << bits) - 1)
    return value

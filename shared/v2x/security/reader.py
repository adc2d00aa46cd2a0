"""Decodes encoded parts one after the other, each with its bytes as received: hashes are of those."""

from functools import cache
from pathlib import Path
from typing import Any

import asn1tools
from asn1tools.codecs.oer import Decoder
from asn1tools.compiler import Specification
from asn1tools.errors import Error

from ...errors import RejectedFrame
from ...faults import FOREIGN

Record = dict[str, Any]  # a SEQUENCE as asn1tools represents it
ENCODING = "security_encoding"


@cache
def specification() -> Specification:
    """Compile the ASN.1 module, once a process."""
    return asn1tools.compile_files(str(Path(__file__).with_name("security.asn")), "oer")


def encoded(name: str, value: object) -> bytes:
    """Encode a value of a named type; raises `RejectedFrame` for one that the module cannot code."""
    try:
        return bytes(specification().encode(name, value))
    except (Error, *FOREIGN) as error:
        raise RejectedFrame(ENCODING, error) from error


class Reader:
    """A place in some bytes."""

    def __init__(self, data: bytes, position: int = 0) -> None:
        self.data = data
        self._decoder = Decoder(bytearray(data))
        self._decoder.skip_bits(8 * position)

    @property
    def position(self) -> int:
        """Number of bytes that are read."""
        return int(self._decoder.number_of_read_bits()) // 8

    def take(self, name: str) -> tuple[Any, bytes]:
        """Decode the next part, of a named type; raises `RejectedFrame`."""
        compiled, begin = specification().types[name], self.position
        try:
            record = compiled.type.decode(self._decoder)
            compiled.check_constraints(record)
        except (Error, *FOREIGN) as error:
            raise RejectedFrame(ENCODING, error) from error
        return record, self.data[begin : self.position]

    def accept(self, expected: bytes) -> bool:
        """Skip bytes if they are the next ones."""
        is_next = self.data.startswith(expected, self.position)
        if is_next:
            self._decoder.skip_bits(8 * len(expected))
        return is_next

    def expect(self, expected: bytes) -> None:
        """Skip bytes that must be the next ones; raises `RejectedFrame`."""
        if not self.accept(expected):
            raise RejectedFrame(ENCODING, f"no {expected.hex()} at {self.position}")

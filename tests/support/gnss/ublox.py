"""Parsing by pyubx2 and pynmea2, which set the attributes of messages at run time, hence `Any`."""

from collections.abc import Sequence
from typing import Any

import pynmea2
from pyubx2.ubxmessage import UBXMessage
from pyubx2.ubxreader import UBXReader


def parse_ubx(frame: bytes) -> Any:
    """Parse one UBX message that a receiver sent, and check its checksum."""
    return UBXReader.parse(frame, validate=1)


def parse_nmea(sentence: bytes) -> Any:
    """Parse one NMEA sentence and check its checksum."""
    parse: Any = pynmea2.parse
    return parse(sentence.decode(), check=True)


def valset(values: Sequence[tuple[str, int]]) -> bytes:
    """Encode UBX-CFG-VALSET for the RAM layer."""
    return bytes(UBXMessage.config_set(1, 0, [(key, value) for key, value in values]).serialize())


def valget(keys: Sequence[str], layer: int = 0) -> bytes:
    """Encode a poll of UBX-CFG-VALGET."""
    return bytes(UBXMessage.config_poll(layer, 0, list(keys)).serialize())

"""All protocols that are recognised. Two that can begin alike are an error at import."""

from collections.abc import Iterable
from itertools import combinations

from . import gnss_logger, nmea, rtcm, spartn, text, ubx, undecoded, xbus
from .framing.framing import can_begin_alike
from .protocol import Protocol

# Those with a checksum first; lines of text last, since they claim what is of no other protocol.
PROTOCOLS = (
    ubx.PROTOCOL, nmea.PROTOCOL, rtcm.PROTOCOL, xbus.PROTOCOL, spartn.PROTOCOL, *undecoded.PROTOCOLS,
    gnss_logger.PROTOCOL, text.ELM327, text.SLCAN, text.LINES,
)  # fmt: skip
BY_NAME = {protocol.name: protocol for protocol in PROTOCOLS}


def check(protocols: Iterable[Protocol]) -> None:
    """Raise ValueError for two protocols that can begin alike, or have one name; the text says which."""
    for protocol, other in combinations(protocols, 2):
        if protocol.name == other.name:
            raise ValueError(f"two protocols have the name {protocol.name}")
        if can_begin_alike(protocol.framing, other.framing):
            raise ValueError(f"{protocol.name} and {other.name} can begin alike: make `begins` of one of them longer")


def read_at(kind: str) -> tuple[str, ...]:
    """Names of the protocols that are read at a kind of port, as gnss or imu."""
    return tuple(protocol.name for protocol in PROTOCOLS if kind in protocol.read_at)


check(PROTOCOLS)

"""The protocols of GNSS receivers: one row a protocol, those that tell more first."""

from dataclasses import dataclass

from shared.protocols.framing.framing import Framing
from shared.protocols.registry import BY_NAME

from .android.dialect import GnssLoggerDialect
from .dialect import Dialect
from .nmea.dialect import NmeaDialect
from .rtcm import RtcmDialect
from .ubx.dialect import UbxDialect


@dataclass(frozen=True)
class ProtocolRow:
    """Frames of a protocol, and what they tell."""

    framing: Framing
    dialect: type[Dialect]


PROTOCOLS = (
    ProtocolRow(BY_NAME["UBX"].framing, UbxDialect),
    ProtocolRow(BY_NAME["NMEA"].framing, NmeaDialect),
    ProtocolRow(BY_NAME["GnssLogger"].framing, GnssLoggerDialect),
    ProtocolRow(BY_NAME["RTCM"].framing, RtcmDialect),
)
FRAMINGS = tuple(row.framing for row in PROTOCOLS)

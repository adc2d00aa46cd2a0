"""The protocols of GNSS receivers: one row a protocol, those that tell more first."""

from dataclasses import dataclass

from .dialect import Dialect
from .framing import Framing
from .nmea.dialect import NmeaDialect
from .nmea.framing import NmeaFraming
from .rtcm import RtcmDialect, RtcmFraming
from .ubx.dialect import UbxDialect
from .ubx.framing import UbxFraming


@dataclass(frozen=True)
class ProtocolRow:
    """Frames of a protocol, and what they tell."""

    framing: Framing
    dialect: type[Dialect]


PROTOCOLS = (
    ProtocolRow(UbxFraming(), UbxDialect),
    ProtocolRow(NmeaFraming(), NmeaDialect),
    ProtocolRow(RtcmFraming(), RtcmDialect),
)
FRAMINGS = tuple(row.framing for row in PROTOCOLS)

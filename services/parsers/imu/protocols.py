"""The protocols of inertial measurement units: one row a protocol, by the name with which its bytes are recognised."""

from collections.abc import Callable

from .decoder import Decoder, Stream
from .gnss_logger import PhoneImu
from .ublox import ReceiverImu
from .xsens import Tracker

PROTOCOLS: dict[str, Callable[[Stream], Decoder]] = {
    "Xbus": Tracker,
    "UBX": ReceiverImu,
    "GnssLogger": PhoneImu,
}
DEFAULT_PROTOCOL = "Xbus"  # of bytes that are not recognised: its rejects say what they are not

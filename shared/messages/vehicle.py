"""What the vehicle's own network says."""

from typing import ClassVar

from .base import Quantity, RawBytes, Speed, Stamped


class CanRaw(RawBytes):
    """CAN frames as lines of a candump log, stamped on the OBU time line."""

    is_stream: ClassVar[bool] = True


class VehicleSpeed(Stamped):
    """Speed of the vehicle as one number: OBD-II, tachograph or dashboard."""

    speed_m_s: Speed
    resolution_m_s: Quantity | None = None


class WheelSpeeds(Stamped):
    """Speed of each wheel over ground; a wheel without a sensor is missing."""

    front_left_m_s: Speed | None = None
    front_right_m_s: Speed | None = None
    rear_left_m_s: Speed | None = None
    rear_right_m_s: Speed | None = None

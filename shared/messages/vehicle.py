"""What the vehicle's own network says."""

from typing import Annotated, ClassVar

from pydantic import Field

from .base import MAX_VALUE, Name, Quantity, RawBytes, Speed, StampedMessage, unit


class CanRaw(RawBytes):
    """CAN frames as lines of a candump log, stamped on the OBU time line."""

    is_stream: ClassVar[bool] = True


class VehicleSpeed(StampedMessage):
    """Speed of the vehicle as one number: OBD-II, tachograph or dashboard."""

    speed_m_s: Speed
    resolution_m_s: Quantity | None = None


class VehicleSignal(StampedMessage):
    """A further quantity of the vehicle's network: yaw rate, steering angle, gear, distance, and what a file names."""

    name: Annotated[str, Field(min_length=1, max_length=32)]
    value: Annotated[float, Field(ge=-MAX_VALUE, le=MAX_VALUE), unit("that of `unit`")] | None = None  # None of a text
    unit: Annotated[str, Field(max_length=16)] = ""  # SI for the names that the unit knows, else as the file states it
    text: Name | None = None  # of a quantity that is none, such as the VIN


class WheelSpeeds(StampedMessage):
    """Speed of each wheel over ground; a wheel without a sensor is missing."""

    front_left_m_s: Speed | None = None
    front_right_m_s: Speed | None = None
    rear_left_m_s: Speed | None = None
    rear_right_m_s: Speed | None = None

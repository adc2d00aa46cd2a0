"""The power supply of the unit: an uninterruptible supply (UPS), or a signal that says whether the mains are there."""

from enum import StrEnum
from typing import Annotated

from pydantic import Field

from .base import Message, Name, Nanoseconds, Quantity, RawBytes, Reason, Seconds, unit


class PowerProtocol(StrEnum):
    """What the bytes of a supply are."""

    INA219 = "ina219"  # registers 1 and 2: shunt voltage and bus voltage, two bytes each
    SIGNAL = "signal"  # text of a file: 1 with mains, 0 without


class LowReason(StrEnum):
    """Why the battery counts as nearly empty."""

    CHARGE = "charge"  # its share of charge
    AUTONOMY = "autonomy"  # it lasts less than is wanted, by its own fall
    TIME = "time"  # so long on a supply of which no voltage is known


class PowerRaw(RawBytes):
    """One reading of a supply."""

    protocol: PowerProtocol


class PowerState(Message):
    """Whether the unit runs on its battery, and what is left of it."""

    sampled_ns: Nanoseconds
    source: Name
    on_battery: bool | None = None  # None: not known yet
    since_ns: Nanoseconds | None = None
    voltage_v: Quantity | None = None  # of the battery
    current_a: Quantity | None = None  # into the battery; negative while it discharges
    charge_ratio: Annotated[float, Field(ge=0.0, le=1.0), unit("1")] | None = None  # estimated from the voltage
    low: bool = False  # the unit should save its state and be switched off
    low_reason: LowReason | None = None  # of `low`
    low_s: Seconds | None = None  # since the battery is below the threshold
    consumption_w: Annotated[float, Field(ge=0.0, le=1000.0), unit("W")] | None = None  # of the battery; None on mains
    autonomy_s: Seconds | None = None  # until the charge is low, by its fall since the mains were lost
    reason: Reason


class PowerEvent(Message):
    """The mains were lost, came back, or the battery is nearly empty."""

    sampled_ns: Nanoseconds
    source: Name
    on_battery: bool
    low: bool
    low_reason: LowReason | None = None  # of `low`
    reason: Reason

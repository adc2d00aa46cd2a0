"""All aids: which measurements a message holds. A new aid is one file, and one row here."""

from collections.abc import Callable, Iterable, Mapping
from itertools import chain
from typing import Any

from shared.messages.base import Message
from shared.messages.gnss import FaultFreeFix, GnssFix
from shared.messages.imu import ImuSamples
from shared.messages.vehicle import VehicleSpeed, WheelSpeeds

from ..settings import Settings
from . import barometer, dual_antenna, magnetometer, odometer
from .base import Measurement
from .external import external_kinds
from .gnss import epoch

KINDS: Mapping[type[Message], tuple[Callable[[Any, Settings], Iterable[Measurement]], ...]] = {
    GnssFix: (epoch.of_fix, dual_antenna.of_fix),
    FaultFreeFix: (epoch.of_fault_free_fix,),
    VehicleSpeed: (odometer.of_speed,),
    WheelSpeeds: (odometer.of_wheels,),
    ImuSamples: (barometer.of_samples, magnetometer.of_samples),
}


def measurements_of(message: Message, settings: Settings) -> list[Measurement]:
    """Measurements that a message holds; none of a message that is no aid."""
    kind = type(message)
    converters = (*KINDS.get(kind, ()), *external_kinds().get(kind, ()))
    return list(chain.from_iterable(convert(message, settings) for convert in converters))

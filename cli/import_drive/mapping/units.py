"""The units allowed in mappings, each with its factor to the unit of the messages."""

import difflib
from collections.abc import Callable, Mapping
from math import degrees, radians
from typing import Annotated

from pydantic import AfterValidator

from shared.maths.earth import STANDARD_GRAVITY

DATE = "date"  # ISO 8601, such as 2026-11-22T10:00:00.5+01:00 or 2026-11-22 09:00:00.5 (UTC); read as seconds
TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, DATE: 1.0}
FORCE = {"m/s2": 1.0, "g": STANDARD_GRAVITY, "mg": 1e-3 * STANDARD_GRAVITY}
RATE = {"rad/s": 1.0, "deg/s": radians(1.0), "mdeg/s": radians(1e-3)}
# Some sensors output increments over each sample (delta-v, delta-theta) instead of means.
FORCE_INCREMENT = {"m/s": 1.0}
RATE_INCREMENT = {"rad": 1.0, "deg": radians(1.0)}
ANGLE = {"rad": 1.0, "deg": radians(1.0)}
COORDINATE = {"deg": 1.0, "1e-7 deg": 1e-7, "rad": degrees(1.0)}  # latitude and longitude are degrees in messages
LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "ft": 0.3048}
SPEED = {"m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704, "kn": 1852.0 / 3600.0, "cm/s": 1e-2, "mm/s": 1e-3}


def _known(units: Mapping[str, float]) -> Callable[[str], str]:
    def check(unit: str) -> str:
        if unit not in units:
            near = difflib.get_close_matches(unit, units, n=1, cutoff=0.5)
            hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(units)}"
            raise ValueError(f"unknown unit {unit!r}; {hint}")
        return unit

    return check


TimeUnit = Annotated[str, AfterValidator(_known(TIME))]
ForceUnit = Annotated[str, AfterValidator(_known(FORCE | FORCE_INCREMENT))]
RateUnit = Annotated[str, AfterValidator(_known(RATE | RATE_INCREMENT))]
AngleUnit = Annotated[str, AfterValidator(_known(ANGLE))]
CoordinateUnit = Annotated[str, AfterValidator(_known(COORDINATE))]
LengthUnit = Annotated[str, AfterValidator(_known(LENGTH))]
SpeedUnit = Annotated[str, AfterValidator(_known(SPEED))]

"""Decides whether an odometer that indicates zero is at standstill or faulty."""

from typing import NamedTuple

DEAD_ZONE_M_S = 2.0  # speed below which wheel sensors may indicate zero
ODOMETER_SILENT_NS = 2_000_000_000  # silence of the odometer in use after which another one is used
NO_TIME_NS = -(2**62)
BRAKING_LIMIT_M_S2 = 12.0  # largest deceleration of a vehicle; that of a locked wheel is larger


class ZeroSpeeds(NamedTuple):
    """Newest speed of the odometer in use, and the reason why its zero may not be a standstill.

    A sensor that has never indicated motion may be faulty; one that falls to zero faster than a vehicle brakes is
    faulty, or its wheel is locked. The next speed above zero ends either doubt.
    """

    time_ns: int = 0
    speed: float = 0.0
    doubt: str | None = "the odometer has not yet indicated motion"

    @property
    def stand_until_ns(self) -> int:
        """Time up to which the wheels are known to stand, unless another speed comes before."""
        stands = self.speed == 0.0 and self.doubt is None
        return self.time_ns + ODOMETER_SILENT_NS if stands else NO_TIME_NS

    def after(self, time_ns: int, speed: float) -> "ZeroSpeeds":
        """State after the next speed [m/s]."""
        if speed != 0.0:
            return ZeroSpeeds(time_ns, abs(speed), None)
        span_s = max(0.0, (time_ns - self.time_ns) * 1e-9)
        fell = self.speed > DEAD_ZONE_M_S + BRAKING_LIMIT_M_S2 * span_s
        return ZeroSpeeds(
            time_ns, 0.0, "the odometer fell to zero faster than a vehicle brakes" if fell else self.doubt
        )

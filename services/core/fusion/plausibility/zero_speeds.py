"""Decides whether an odometer that indicates zero is at standstill or has failed."""

from typing import NamedTuple

DEAD_ZONE_M_S = 2.0  # below it wheel sensors may be silent: a reading may jump from there to zero
BRAKING_LIMIT_M_S2 = 12.0  # no vehicle brakes harder; wheels that lock do


class ZeroSpeeds(NamedTuple):
    """Newest speed of the odometer in use, and why a zero of it is not yet a standstill.

    A sensor that has never indicated motion may have failed; one that falls to zero faster than a vehicle brakes has
    failed, or its wheel is locked. The next speed above zero ends either doubt.
    """

    time_ns: int = 0
    speed: float = 0.0
    doubt: str | None = "the odometer has not yet indicated motion"

    def after(self, time_ns: int, speed: float) -> "ZeroSpeeds":
        """Take the next speed [m/s]."""
        if speed != 0.0:
            return ZeroSpeeds(time_ns, abs(speed), None)
        span_s = max(0.0, (time_ns - self.time_ns) * 1e-9)
        fell = self.speed > DEAD_ZONE_M_S + BRAKING_LIMIT_M_S2 * span_s
        return ZeroSpeeds(
            time_ns, 0.0, "the odometer fell to zero faster than a vehicle brakes" if fell else self.doubt
        )

"""Exclusion of GNSS and of the odometer by the verdict of core.trust, as events in the order of the measurements."""

from dataclasses import dataclass, replace

from ..measurements.base import FilterEvent, Measurement
from ..measurements.dual_antenna import BaselineHeading
from ..measurements.gnss import GnssPosition, GnssVelocity
from ..measurements.odometer import WheelSpeed

GNSS = (GnssPosition, GnssVelocity, BaselineHeading)


@dataclass(frozen=True)
class GnssExcluded(FilterEvent):
    """From this instant on GNSS is not used.

    `since_ns` is the suspect time from which no GNSS is part of the state. Where the state at this instant does contain
    GNSS since the suspect time, `unreached_s` [s] is how long.
    """

    since_ns: int
    unreached_s: float = 0.0


@dataclass(frozen=True)
class GnssReadmitted(FilterEvent):
    """From this instant on GNSS is used again."""


@dataclass(frozen=True)
class OdometerExclusion(FilterEvent):
    """From this instant on the odometer is excluded, or used again."""

    excluded: bool


@dataclass(frozen=True)
class Exclusions:
    """What is excluded at one instant; replaced and never changed."""

    gnss_since_ns: int | None = None
    odometer: bool = False
    satellites: tuple[str, ...] = ()  # left out of the newest position that was used
    fixes: int = 0  # positions that were not used for it
    test_ratio: float | None = None  # of the newest of them
    readmitted_after_s: float | None = None  # how long GNSS was excluded, until the first position is used again

    def after(self, event: "GnssExcluded | GnssReadmitted | OdometerExclusion") -> "Exclusions":
        """Exclusions after an event. An exclusion of GNSS that lasts keeps the earlier of the two suspect times."""
        match event:
            case GnssExcluded():
                known = event.since_ns if self.gnss_since_ns is None else min(event.since_ns, self.gnss_since_ns)
                return replace(self, gnss_since_ns=known, readmitted_after_s=None)
            case GnssReadmitted() if self.gnss_since_ns is not None:
                outage_s = (event.time_ns - self.gnss_since_ns) * 1e-9
                return replace(self, gnss_since_ns=None, test_ratio=None, readmitted_after_s=outage_s)
            case OdometerExclusion():
                return replace(self, odometer=event.excluded)
        return self

    def reason(self, measurement: Measurement) -> str | None:
        """Why a measurement is not used, None if it may be."""
        if self.gnss_since_ns is not None and isinstance(measurement, GNSS):
            return "GNSS is excluded by core.trust"
        if self.odometer and isinstance(measurement, WheelSpeed):
            return "odometer is excluded by core.trust"
        return None

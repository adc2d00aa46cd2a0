"""Exclusion of GNSS and of the odometer by core.trust, as events in the order of the measurements."""

from dataclasses import dataclass, replace

from ..integrity.disagreement import Disagreement
from ..aids.base import FilterEvent, Measurement
from ..aids.dual_antenna import BaselineHeading
from ..aids.gnss.fix import GnssPosition, GnssVelocity
from ..aids.odometer import WheelSpeed

GNSS = (GnssPosition, GnssVelocity, BaselineHeading)


@dataclass(frozen=True)
class GnssExcluded(FilterEvent):
    """From this instant on GNSS is not used.

    `since_ns` is the suspect time; no GNSS with a later stamp is used. `contaminated_s` [s] is the time since then of
    which GNSS is in the state already, because no snapshot is old enough for a roll-back.
    """

    since_ns: int
    contaminated_s: float = 0.0


@dataclass(frozen=True)
class GnssReadmitted(FilterEvent):
    """From this instant on GNSS is used again."""


@dataclass(frozen=True)
class OdometerExclusion(FilterEvent):
    """From this instant on the odometer is excluded, or used again."""

    excluded: bool


@dataclass(frozen=True)
class Held(FilterEvent):
    """From this instant on the level holds a disagreement of two solutions."""

    disagreement: Disagreement


@dataclass(frozen=True)
class Exclusions:
    """Exclusions at one instant; replaced and never changed in place."""

    gnss_since_ns: int | None = None
    odometer: bool = False
    satellites: tuple[str, ...] = ()  # satellites without which the newest position was computed
    fixes: int = 0  # number of excluded positions
    test_ratio: float | None = None  # of the newest excluded position
    readmitted_after_s: float | None = None  # duration of an exclusion, until the first position is used again

    def after(self, event: "GnssExcluded | GnssReadmitted | OdometerExclusion") -> "Exclusions":
        """Exclusions after an event; a second exclusion of GNSS keeps the earlier suspect time."""
        match event:
            case GnssExcluded():
                since_ns = event.since_ns if self.gnss_since_ns is None else min(event.since_ns, self.gnss_since_ns)
                return replace(self, gnss_since_ns=since_ns, readmitted_after_s=None)
            case GnssReadmitted() if self.gnss_since_ns is not None:
                outage_s = (event.time_ns - self.gnss_since_ns) * 1e-9
                return replace(self, gnss_since_ns=None, test_ratio=None, readmitted_after_s=outage_s)
            case OdometerExclusion():
                return replace(self, odometer=event.excluded)
        return self

    def reason(self, measurement: Measurement) -> str | None:
        """Reason why a measurement is excluded, or None."""
        if self.gnss_since_ns is not None and isinstance(measurement, GNSS):
            return "GNSS is excluded by core.trust"
        if self.odometer and isinstance(measurement, WheelSpeed):
            return "odometer is excluded by core.trust"
        return None

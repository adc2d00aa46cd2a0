"""The one rule for dates and stamps of all protocols: from 1980 to 2100, live in the era that the host's clock shows.

A receiver counts GPS weeks modulo 1024, and one whose firmware is old tells a date that is a multiple of 1024 weeks
(19.6 years) off. Live, a date is therefore taken in the era that is nearest to the host's stamp of its bytes. A host
without a battery clock may start years early: no unit runs long before its own release, so the release date less
400 days takes the place of an earlier clock. Dates in a file are taken as recorded.
"""

from collections import Counter
from datetime import date

from .. import RELEASED

NS = 1_000_000_000
WEEK_NS = 604_800 * NS
DAY_NS = 86_400 * NS
ERA_NS = 1024 * WEEK_NS  # of the week number of GPS L1 C/A
# UTC in ns since 1970
MIN_DATE_NS = 315_532_800 * NS  # 1980-01-01
END_DATE_NS = 4_133_980_800 * NS  # 2101-01-01, the first that is too late
GPS_EPOCH_UTC_NS = 315_964_800 * NS  # 1980-01-06
EARLIEST_HOST_NS = ((RELEASED - date(1970, 1, 1)).days - 400) * DAY_NS


def is_plausible(utc_ns: int) -> bool:
    """Whether a time [ns since 1970] is one from 1980 to 2100."""
    return MIN_DATE_NS <= utc_ns < END_DATE_NS


def plausible_host_ns(host_ns: int) -> int:
    """The host's clock [ns since 1970]; the release date less 400 days for one that is earlier, or beyond 2100."""
    return host_ns if EARLIEST_HOST_NS <= host_ns < END_DATE_NS else EARLIEST_HOST_NS


def in_nearest_era(utc_ns: int, host_ns: int) -> int:
    """Move a time by whole eras of 1024 weeks so that it is nearest to the host's clock (both ns since 1970)."""
    return utc_ns + (plausible_host_ns(host_ns) - utc_ns + ERA_NS // 2) // ERA_NS * ERA_NS


class DeviceDates:
    """Applies the rule to what one device tells; `host_ns` is the host's stamp of the present bytes, None of a file.

    `rejects` counts a date outside the rule under the kind that is given with it.
    """

    def __init__(self, rejects: Counter[str]) -> None:
        self.host_ns: int | None = None
        self._rejects = rejects

    def utc_ns(self, told_ns: int | None, kind: str) -> int | None:
        """UTC [ns since 1970] by the rule; None, and counted, for an impossible date (None: not of the calendar)."""
        if told_ns is not None and is_plausible(told_ns):
            utc_ns = told_ns if self.host_ns is None else in_nearest_era(told_ns, self.host_ns)
            if is_plausible(utc_ns):
                return utc_ns
        self._rejects[kind] += 1
        return None

    def gps_time_ns(self, told_ns: int, kind: str) -> int | None:
        """GPS time [ns since 1980-01-06] by the same rule, without regard to leap seconds."""
        utc_ns = self.utc_ns(told_ns + GPS_EPOCH_UTC_NS, kind)
        return None if utc_ns is None else utc_ns - GPS_EPOCH_UTC_NS

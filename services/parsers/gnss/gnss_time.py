"""Calendar, GPS time and time of week, in nanoseconds."""

from datetime import UTC, datetime, timedelta

NS = 1_000_000_000
MS = 1_000_000
GPS_EPOCH_UTC_NS = 315_964_800 * NS  # 1980-01-06
WEEK_NS = 604_800 * NS
DAY_NS = 86_400 * NS
MAXIMUM_LEAP_S = 40  # 18 since 2017


def utc_ns(calendar: tuple[int, int, int, int, int, int], nanosecond: int) -> int | None:
    """Count nanoseconds since 1970 (POSIX, so a leap second repeats); None for a date that is none."""
    *date, hour, minute, second = calendar
    if not (0 <= hour < 24 and 0 <= minute < 60 and 0 <= second <= 60 and abs(nanosecond) <= NS):
        return None
    try:
        midnight = datetime(*date, tzinfo=UTC)  # type: ignore[misc, arg-type]  # three integers, mypy cannot count
    except ValueError:
        return None
    seconds = (midnight - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(seconds=1)
    return (seconds + hour * 3600 + minute * 60 + second) * NS + nanosecond


def gps_time_ns(utc: int, itow_ms: int) -> int | None:
    """Find the GPS time that belongs to a UTC time and a GPS time of week.

    The difference of the two is the number of leap seconds, so no table of them is needed, and no week number
    that could roll over before or after the time of week does. None where the two contradict each other.
    """
    elapsed = utc - GPS_EPOCH_UTC_NS
    ahead = (itow_ms * MS - elapsed) % WEEK_NS
    leap_s = round(ahead / NS) % (WEEK_NS // NS)
    # The time of week is rounded to 1 ms.
    if leap_s > MAXIMUM_LEAP_S or abs((ahead - leap_s * NS + WEEK_NS // 2) % WEEK_NS - WEEK_NS // 2) > 2 * MS:
        return None
    return elapsed + leap_s * NS


class Unwrapper:
    """Continues a time that starts again at 0 every `period_ns`."""

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._base_ns = self._last_ns = 0

    def unwrap(self, time_ns: int) -> int:
        """Give the time since the first wrap's start; a small step back stays a step back."""
        if time_ns < self._last_ns - self._period_ns // 2:
            self._base_ns += self._period_ns
        elif time_ns > self._last_ns + self._period_ns // 2 and self._base_ns:
            self._base_ns -= self._period_ns
        self._last_ns = time_ns
        return self._base_ns + time_ns

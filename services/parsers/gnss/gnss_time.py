"""Conversions between calendar date, UTC, GPS time and time of week, in nanoseconds."""

from datetime import UTC, datetime, timedelta

from shared.maths.dates import GPS_EPOCH_UTC_NS, NS, WEEK_NS

MS = 1_000_000
MAXIMUM_LEAP_S = 40  # 18 since 2017


def utc_ns(calendar: tuple[int, int, int, int, int, int], nanosecond: int) -> int | None:
    """Nanoseconds since 1970 (POSIX: a leap second repeats); None for an invalid date or time."""
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
    """GPS time [ns] from UTC [ns] and the GPS time of week [ms].

    Their difference gives the number of leap seconds, so that neither a leap-second table nor the week number is
    needed. None if the two are inconsistent.
    """
    elapsed = utc - GPS_EPOCH_UTC_NS
    ahead = (itow_ms * MS - elapsed) % WEEK_NS
    leap_s = round(ahead / NS) % (WEEK_NS // NS)
    # The time of week is rounded to 1 ms.
    if leap_s > MAXIMUM_LEAP_S or abs((ahead - leap_s * NS + WEEK_NS // 2) % WEEK_NS - WEEK_NS // 2) > 2 * MS:
        return None
    return elapsed + leap_s * NS


class Unwrapper:
    """Unwraps a time that rolls over every `period_ns`."""

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._base_ns = self._last_ns = 0

    def unwrap(self, time_ns: int) -> int:
        """Time since the start of the first period; a step back by less than half a period is preserved."""
        if time_ns < self._last_ns - self._period_ns // 2:
            self._base_ns += self._period_ns
        elif time_ns > self._last_ns + self._period_ns // 2 and self._base_ns:
            self._base_ns -= self._period_ns
        self._last_ns = time_ns
        return self._base_ns + time_ns

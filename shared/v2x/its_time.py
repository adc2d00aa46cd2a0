"""ITS time: milliseconds of TAI since 2004-01-01 00:00 UTC (TimestampIts), and its remainder in a CAM."""

NS_PER_MS = 1_000_000
EPOCH_UTC_NS = 1_072_915_200 * 1_000_000_000  # 2004-01-01T00:00:00Z
LEAP_SECONDS_NS = 5 * 1_000_000_000  # inserted since the epoch (the last one at the end of 2016): ITS = UTC + 5 s
CYCLE_MS = 65536  # of generationDeltaTime


def its_time_ms(utc_ns: int) -> int:
    """Milliseconds of ITS time at a UTC time in ns since 1970-01-01, rounded down."""
    return (utc_ns - EPOCH_UTC_NS + LEAP_SECONDS_NS) // NS_PER_MS


def utc_ns_from_its_time(time_ms: int) -> int:
    """UTC in ns since 1970-01-01 of an ITS time."""
    return time_ms * NS_PER_MS + EPOCH_UTC_NS - LEAP_SECONDS_NS


def generation_age_ms(generation_delta_time: int, received_its_ms: int) -> int:
    """Age of a CAM at reception in [-32768, 32767] ms: generationDeltaTime is known modulo 65536 ms only.

    Negative for a CAM from the future, which a clock difference between the stations produces.
    """
    return difference_ms(received_its_ms, generation_delta_time, CYCLE_MS)


def difference_ms(later_ms: int, earlier_ms: int, cycle_ms: int) -> int:
    """Difference of two times of which one or both are known modulo a cycle only, in [-cycle/2, cycle/2) ms."""
    half = cycle_ms // 2
    return (later_ms - earlier_ms + half) % cycle_ms - half

"""Time scales: UTC from GPS time, BeiDou time and TAI, which have no leap seconds."""

from datetime import UTC, datetime
from typing import Literal

import numpy as np

from shared.maths.dates import GPS_EPOCH_UTC_NS, NS, WEEK_NS
from shared.maths.earth import FloatArray

Scale = Literal["utc", "gps", "beidou", "tai"]
GPS_EPOCH_S, WEEK_S = GPS_EPOCH_UTC_NS / NS, WEEK_NS / NS  # the former is the Unix time of 1980-01-06
AHEAD_OF_GPS_S: dict[str, float] = {"gps": 0.0, "beidou": -14.0, "tai": 19.0}
# The days on which GPS time became one second more ahead of UTC (IERS Bulletin C).
LEAP_DAYS = (
    (1981, 7), (1982, 7), (1983, 7), (1985, 7), (1988, 1), (1990, 1), (1991, 1), (1992, 7), (1993, 7), (1994, 7),
    (1996, 1), (1997, 7), (1999, 1), (2006, 1), (2009, 1), (2012, 7), (2015, 7), (2017, 1),
)  # fmt: skip
LEAPS_S = np.array([datetime(year, month, 1, tzinfo=UTC).timestamp() for year, month in LEAP_DAYS])


def utc_of(seconds: FloatArray, scale: Scale) -> FloatArray:
    """Unix time [s] of stamps that count the seconds of a scale since 1970, leap seconds included where it has them."""
    if scale == "utc":
        return seconds
    gps = seconds - AHEAD_OF_GPS_S[scale]
    # The n-th leap second ends when GPS time is n ahead of the day's beginning.
    leap_s = np.searchsorted(LEAPS_S + np.arange(1.0, len(LEAPS_S) + 1.0), gps, side="right")
    utc: FloatArray = gps - leap_s
    return utc

"""Events of the smart tachograph, as its annex lists them: when they begin and end, and why a record is kept."""

from enum import IntEnum, StrEnum
from typing import Annotated

from pydantic import Field

from .base import Count, Message, Name, Nanoseconds, Seconds

MAX_RECORDS = 80  # ten days and five longest of each of five kinds, and one of each that lasts


class TachographKind(StrEnum):
    """What has happened; the number of the requirement of Annex IC beside it."""

    MOTION_CONFLICT = "motion_conflict"
    # the distance rule on positions that no signature authenticates: not an event of the annex
    DISTANCE_UNAUTHENTICATED = "distance_unauthenticated"
    GNSS_ANOMALY = "gnss_anomaly"  # 88a
    TIME_CONFLICT = "time_conflict"  # 86
    POSITION_ABSENT = "position_absent"  # 81


class RecordPurpose(IntEnum):
    """Why a record is kept: EventFaultRecordPurpose of Appendix 1."""

    LONGEST_OF_DAY = 1  # of one of the last ten days of occurrence
    LONGEST_OF_YEAR = 2  # one of the five longest of the last 365 days
    MOST_SERIOUS_OF_DAY = 4
    MOST_SERIOUS_OF_YEAR = 5
    ACTIVE = 7


class TachographEvent(Message):
    """One event: at its begin and at its end, and in `tachograph/records`."""

    kind: TachographKind
    begin_utc_ns: Nanoseconds
    end_utc_ns: Nanoseconds | None = None  # None: it lasts
    seen_utc_ns: Nanoseconds | None = None  # in records, of one that lasts: until when it did
    cards_begin: Annotated[tuple[Name, ...], Field(max_length=2)] = ()  # this unit reads none
    cards_end: Annotated[tuple[Name, ...], Field(max_length=2)] = ()
    similar_that_day: Count = 0  # events of the kind that began on that day (UTC), this one included
    purposes: Annotated[tuple[RecordPurpose, ...], Field(max_length=8)] = ()
    difference_s: Seconds | None = None  # of a time conflict: clock of the unit against GNSS, the greatest


class TachographRecords(Message):
    """The records that are kept of all kinds, oldest first: at each change, and each minute while one lasts.

    It is published each minute of driving without a position, too.
    """

    sampled_ns: Nanoseconds
    records: Annotated[tuple[TachographEvent, ...], Field(max_length=MAX_RECORDS)] = ()
    driven_s: Seconds = 0.0  # since the newest position: goes on after a restart
    absent_since_utc_ns: Nanoseconds | None = None  # begin of that drive

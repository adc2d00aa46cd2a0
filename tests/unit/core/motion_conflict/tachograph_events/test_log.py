"""Records of the annex: longest of a day, five longest of a year, similar events of the day, and what is bounded."""

import numpy as np
import pytest

from services.core.motion_conflict.tachograph_events.log import DAY_NS, NS, TachographLog
from shared.messages.tachograph import MAX_RECORDS, RecordPurpose, TachographEvent, TachographKind

KIND, TIME = TachographKind.MOTION_CONFLICT, TachographKind.TIME_CONFLICT
DAY, YEAR = RecordPurpose.LONGEST_OF_DAY, RecordPurpose.LONGEST_OF_YEAR
START_NS = 20_000 * DAY_NS


def happen(
    log: TachographLog, begin_s: float, length_s: float, kind: TachographKind = KIND, difference_s: float | None = None
) -> tuple[TachographEvent, TachographEvent]:
    begin_ns = START_NS + round(begin_s * NS)
    (begun,) = log.update(kind, begin_ns, begin_ns, difference_s)
    (ended,) = log.update(kind, None, begin_ns + round(length_s * NS))
    return begun, ended


def test_an_event_has_its_begin_end_count_of_the_day_and_purposes() -> None:
    log = TachographLog()
    begun, ended = happen(log, 3600.0, 60.0)
    assert begun.end_utc_ns is None and begun.purposes == (RecordPurpose.ACTIVE,) and begun.similar_that_day == 1
    assert ended.end_utc_ns == begun.begin_utc_ns + 60 * NS and ended.purposes == (DAY, YEAR)
    _, longer = happen(log, 7200.0, 90.0)
    assert longer.similar_that_day == 2 and longer.purposes == (DAY, YEAR)
    first, second = log.records(START_NS + DAY_NS)
    assert (first.purposes, second.purposes) == ((YEAR,), (DAY, YEAR)), "the longest of the day is the second one"
    assert first.similar_that_day == second.similar_that_day == 2
    assert ended.cards_begin == ended.cards_end == ()


def test_ten_days_and_five_of_the_year_are_kept_and_no_more() -> None:
    """Against a straightforward choice over all events, of 400 that chance made."""
    log, rng, everything = TachographLog(), np.random.default_rng(4), []
    begins = np.sort(rng.uniform(0.0, 500.0 * 86_400.0, 400))
    for begin in begins.tolist():
        everything.append(happen(log, begin, float(rng.uniform(1.0, 3000.0)))[1])
        assert len(log.records(everything[-1].end_utc_ns or 0)) <= 16
    now_ns = everything[-1].end_utc_ns
    assert now_ns is not None

    def length(event: TachographEvent) -> int:
        return (event.end_utc_ns or 0) - event.begin_utc_ns

    days = sorted({event.begin_utc_ns // DAY_NS for event in everything}, reverse=True)[:10]
    of_days = {max((e for e in everything if e.begin_utc_ns // DAY_NS == d), key=length).begin_utc_ns for d in days}
    recent = [event for event in everything if now_ns - event.begin_utc_ns <= 365 * DAY_NS]
    kept = log.records(now_ns)
    assert {event.begin_utc_ns for event in kept if DAY in event.purposes} == of_days
    longest = {event.begin_utc_ns for event in sorted(recent, key=length, reverse=True)[:5]}
    assert {event.begin_utc_ns for event in kept if YEAR in event.purposes} == longest
    assert all(event.purposes for event in kept)


def test_time_conflicts_are_ranked_by_their_difference() -> None:
    log = TachographLog()
    happen(log, 0.0, 1000.0, TIME, 70.0)
    happen(log, 2000.0, 10.0, TIME, 4000.0)
    small, great = log.records(START_NS + DAY_NS)
    assert great.purposes == (RecordPurpose.MOST_SERIOUS_OF_DAY, RecordPurpose.MOST_SERIOUS_OF_YEAR)
    assert small.purposes == (RecordPurpose.MOST_SERIOUS_OF_YEAR,)


def test_an_active_event_of_an_earlier_run_that_was_not_published_again_has_no_length() -> None:
    log = TachographLog()
    (begun,) = log.update(KIND, START_NS, START_NS)
    after = TachographLog()
    after.adopt([begun])
    (record,) = after.records(START_NS + DAY_NS)
    assert record.end_utc_ns == record.begin_utc_ns and RecordPurpose.ACTIVE not in record.purposes
    (again,) = after.update(KIND, START_NS + NS, START_NS + NS)
    assert again.similar_that_day == 2, "the day goes on counting"


def test_all_kinds_at_their_fullest_fit_into_the_message() -> None:
    log = TachographLog()
    for kind in TachographKind:
        for day in range(60):
            happen(log, day * 86_400.0, 1000.0 - day if day < 40 else 10.0, kind, float(60 - day))
        assert list(log.update(kind, START_NS + 70 * DAY_NS, START_NS + 70 * DAY_NS))
    records = log.records(START_NS + 70 * DAY_NS)
    assert len(records) == len(TachographKind) * 16 <= MAX_RECORDS


@pytest.mark.parametrize("late_s", [-5.0, 0.0])
def test_an_end_is_never_before_its_begin(late_s: float) -> None:
    log = TachographLog()
    list(log.update(KIND, START_NS, START_NS))
    (ended,) = log.update(KIND, None, START_NS + round(late_s * NS))
    assert ended.end_utc_ns == START_NS

"""From speeds, positions, verdicts and clocks to events of the tachograph."""

from services.core.motion_conflict.monitor import MotionMonitor
from services.core.motion_conflict.process import Config, Process
from services.core.motion_conflict.tachograph_events.recorder import TachographRecorder
from shared.messages.base import Message, Tick
from shared.messages.gnss import GnssFix
from shared.messages.operation import HostClock
from shared.messages.tachograph import RecordPurpose, TachographEvent, TachographKind, TachographRecords
from shared.messages.trust import Outcome, TrustLevel, TrustMonitor, TrustState
from tests.unit.core.motion_conflict.test_process import SECOND_NS, fix, odometer

UTC_NS = 1_700_000_000 * SECOND_NS


def dated_fix(second: int, speed_m_s: float) -> GnssFix:
    return fix(second * SECOND_NS, speed_m_s).model_copy(update={"utc_ns": UTC_NS + second * SECOND_NS})


def drive(process: Process, seconds: range, gnss_m_s: float, odometer_m_s: float) -> list[Message]:
    out: list[Message] = []
    for k in seconds:
        inputs = (dated_fix(k, gnss_m_s), odometer(k * SECOND_NS, odometer_m_s), Tick(now_ns=k * SECOND_NS))
        for message in inputs:
            out += process.handle(message)
    return out


def events(out: list[Message]) -> list[TachographEvent]:
    return [message for message in out if isinstance(message, TachographEvent)]


def state(second: float, *, accused: bool) -> TrustState:
    evidence = TrustMonitor(
        sampled_ns=round(second * SECOND_NS), monitor="evidence", reason="",
        outcome=Outcome.ACCUSES if accused else Outcome.PASS, accused=("gnss",) if accused else (),
    )  # fmt: skip
    return TrustState(
        sampled_ns=evidence.sampled_ns, state=TrustLevel.CAUTION, since_ns=0, row=6, reasons=("",),
        monitors=(evidence,),
        alert_limit_horizontal_m=10.0, alert_limit_vertical_m=20.0,
    )  # fmt: skip


def test_a_motion_conflict_begins_where_the_contradiction_does() -> None:
    """The odometer stands for a minute while GNSS moves: the rule on the motion sensor."""
    process = Process(Config())
    assert events(drive(process, range(1, 20), 20.0, 20.0)) == []
    begun = events(out := drive(process, range(20, 100), 20.0, 0.0))
    assert [event.kind for event in begun] == [TachographKind.MOTION_CONFLICT]
    assert abs(begun[0].begin_utc_ns - UTC_NS - 20 * SECOND_NS) <= 2 * SECOND_NS
    (records,) = [message for message in out if isinstance(message, TachographRecords)]
    (active,) = records.records
    assert active.model_copy(update={"seen_utc_ns": None}) == begun[0] and active.seen_utc_ns is not None


def recorded(recorder: TachographRecorder, second: float) -> list[TachographEvent]:
    verdicts = MotionMonitor().verdicts(round(second * SECOND_NS))
    return events(list(recorder.events(verdicts, 0.0, round(second * SECOND_NS))))


def test_without_a_time_of_gnss_nothing_is_recorded() -> None:
    recorder = TachographRecorder()
    recorder.trust(state(1.0, accused=True))
    assert recorded(recorder, 2.0) == []
    recorder.conditions.position(3 * SECOND_NS, UTC_NS + 3 * SECOND_NS)
    (event,) = recorded(recorder, 3.0)
    assert (event.kind, event.begin_utc_ns) == (TachographKind.GNSS_ANOMALY, UTC_NS + SECOND_NS)
    recorder.trust(state(9.0, accused=False))
    (event,) = recorded(recorder, 9.0)
    assert event.end_utc_ns == UTC_NS + 9 * SECOND_NS and RecordPurpose.LONGEST_OF_DAY in event.purposes


def test_a_clock_that_is_a_minute_off_is_a_time_conflict() -> None:
    recorder = TachographRecorder()
    recorder.conditions.position(0, UTC_NS)
    for second, off_s, kinds in ((1, 59.0, []), (2, 61.0, [TachographKind.TIME_CONFLICT]), (3, 90.0, [])):
        utc_ns = UTC_NS + round((second + off_s) * SECOND_NS)
        recorder.follow(HostClock(sampled_ns=second * SECOND_NS, utc_ns=utc_ns, synchronised=False))
        assert [event.kind for event in recorded(recorder, second)] == kinds
    recorder.follow(HostClock(sampled_ns=4 * SECOND_NS, utc_ns=UTC_NS + 4 * SECOND_NS, synchronised=True))
    (event,) = recorded(recorder, 4.0)
    assert event.difference_s == 90.0 and event.end_utc_ns == UTC_NS + 4 * SECOND_NS


def test_three_hours_of_driving_without_a_position_are_an_event_and_parking_does_not_count() -> None:
    recorder = TachographRecorder()
    recorder.conditions.position(0, UTC_NS)
    for second in range(1, 7200):
        recorder.conditions.speed(second * SECOND_NS, 10.0)
    for second in range(7200, 14400):
        recorder.conditions.speed(second * SECOND_NS, 0.0)
    assert recorded(recorder, 14400.0) == []
    for second in range(14400, 18100):
        recorder.conditions.speed(second * SECOND_NS, 10.0)
    (event,) = recorded(recorder, 18100.0)
    assert event.kind is TachographKind.POSITION_ABSENT and event.begin_utc_ns == UTC_NS + 2 * SECOND_NS
    recorder.conditions.position(18200 * SECOND_NS, None)
    (event,) = recorded(recorder, 18200.0)
    assert event.end_utc_ns == UTC_NS + 18200 * SECOND_NS


def records(recorder: TachographRecorder, second: float) -> TachographRecords | None:
    verdicts = MotionMonitor().verdicts(round(second * SECOND_NS))
    out = recorder.events(verdicts, 0.0, round(second * SECOND_NS))
    return next((message for message in out if isinstance(message, TachographRecords)), None)


def restarted(kept: TachographRecords, second: float) -> TachographRecorder:
    recorder = TachographRecorder()
    recorder.follow(kept)
    recorder.conditions.position(round(second * SECOND_NS), None)
    recorder.conditions.utc_offset_ns = UTC_NS
    return recorder


def test_an_event_that_lasts_at_a_restart_ends_at_its_last_minute() -> None:
    recorder, kept = TachographRecorder(), None
    recorder.conditions.position(0, UTC_NS)
    recorder.trust(state(1.0, accused=True))
    published = [second for second in range(1, 200) if (one := records(recorder, second)) and (kept := one)]
    assert published == [1, 61, 121, 181]
    assert kept is not None
    after = restarted(kept, 300.0)
    after.trust(state(301.0, accused=True))
    again = records(after, 301.0)
    assert again is not None
    ended, active = again.records
    assert (ended.begin_utc_ns, ended.end_utc_ns) == (UTC_NS + SECOND_NS, UTC_NS + 181 * SECOND_NS)
    assert active.end_utc_ns is None and active.similar_that_day == 2


def test_driving_without_a_position_goes_on_over_a_restart() -> None:
    recorder, kept = TachographRecorder(), None
    recorder.conditions.position(0, UTC_NS)
    for second in range(1, 7300):
        recorder.conditions.speed(second * SECOND_NS, 10.0)
        if second % 60 == 0:
            kept = records(recorder, second) or kept
    assert kept is not None and abs(kept.driven_s - 7260.0) <= 60.0
    after = TachographRecorder()
    after.follow(kept)
    after.conditions.utc_offset_ns = UTC_NS
    for second in range(8000, 11700):
        after.conditions.speed(second * SECOND_NS, 10.0)
    (event,) = recorded(after, 11700.0)
    assert event.kind is TachographKind.POSITION_ABSENT and event.begin_utc_ns == UTC_NS + 2 * SECOND_NS


def test_a_spoofed_time_of_gnss_dates_no_record() -> None:
    """GNSS says ten years later; the clock of the unit, or the verdict, says that it is false."""
    years_ns = 10 * 365 * 86_400 * SECOND_NS
    by_clock, by_verdict = TachographRecorder(), TachographRecorder()
    for recorder in (by_clock, by_verdict):
        recorder.follow(HostClock(sampled_ns=0, utc_ns=UTC_NS, synchronised=True))
        recorder.conditions.position(0, UTC_NS)
    by_verdict.trust(state(1.0, accused=True))
    for second in range(2, 10):
        for recorder in (by_clock, by_verdict):
            recorder.conditions.position(second * SECOND_NS, UTC_NS + years_ns + second * SECOND_NS)
        by_clock.follow(HostClock(sampled_ns=second * SECOND_NS, utc_ns=UTC_NS + second * SECOND_NS, synchronised=True))
    (conflict,) = recorded(by_clock, 10.0)
    (anomaly,) = recorded(by_verdict, 10.0)
    assert (conflict.kind, conflict.begin_utc_ns) == (TachographKind.TIME_CONFLICT, UTC_NS + 2 * SECOND_NS)
    assert (anomaly.kind, anomaly.begin_utc_ns) == (TachographKind.GNSS_ANOMALY, UTC_NS + SECOND_NS)
    by_clock.conditions.position(11 * SECOND_NS, UTC_NS + 11 * SECOND_NS)
    by_clock.follow(HostClock(sampled_ns=11 * SECOND_NS, utc_ns=UTC_NS + 11 * SECOND_NS, synchronised=True))
    (ended,) = recorded(by_clock, 11.0)
    assert ended.end_utc_ns == UTC_NS + 11 * SECOND_NS

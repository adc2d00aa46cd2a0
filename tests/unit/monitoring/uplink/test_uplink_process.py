"""The process in virtual time, without a centre: what it reports, and what it says when it cannot."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from pydantic import ValidationError

from services.monitoring.uplink.outbox import alone
from services.monitoring.uplink.process import CLOCK_NOT_SET, Config
from services.monitoring.uplink.sampling import event_of
from shared.errors import UserError
from shared.fleet.batch import Batch, Event, Kind, Report
from shared.fleet.sealed import unsealed
from shared.fleet.times import MAX_AGE_S, RESTING_S, RETRY_S
from shared.fleet.topics import WATCHABLE
from shared.messages.operation import HostClock, Origin, OriginKind, Outage
from shared.messages.trust import Outcome, TrustEvent, TrustLevel, TrustMonitor
from shared.messages.uplink import UplinkState
from shared.processes import BY_NAME
from tests.support.bus.envelopes import sent
from tests.support.fleet.uplink_unit import NS, START_NS, UplinkUnit
from tests.support.outputs import solution, verdict
from tests.support.patience import HANGS_S

REPOSITORY = Path(__file__).resolve().parents[4]
IN_A_NAMESPACE = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-ec"]
DAY_NS, YEAR_NS = 86_400 * NS, 365 * 86_400 * NS


@pytest.fixture
def unit(tmp_path: Path) -> Iterator[UplinkUnit]:
    made = UplinkUnit(tmp_path)
    yield made
    made.close()


def batches(unit: UplinkUnit) -> list[Batch]:
    sending = unit.process._reporting.sending
    assert sending is not None
    outbox = sending.outbox
    outbox.flush(unit.signer)
    return [unsealed(outbox.content(row.id) or b"").batch for row in outbox.open_rows(most=100_000)]


def reports(unit: UplinkUnit) -> list[Report]:
    return [report for batch in batches(unit) for report in batch.reports]


def events(unit: UplinkUnit) -> list[Event]:
    return [event for batch in batches(unit) for event in batch.events]


def clock(at_ns: int, utc_ns: int, *, synchronised: bool = True) -> HostClock:
    return HostClock(sampled_ns=at_ns, utc_ns=utc_ns, synchronised=synchronised, maximum_error_s=0.1)


def test_a_report_a_second_is_made_and_a_batch_every_ten_seconds(unit: UplinkUnit) -> None:
    unit.drive(101)
    found = batches(unit)
    assert [len(b.reports) for b in found[1:-1]] == [10] * (len(found) - 2) and len(found) >= 10
    first = reports(unit)[1]
    assert first == Report(START_NS // 10**6 + 2000, 481_234_568, 115_678_912, 56_000, 500, 0, 33, 0)
    assert [r.utc_ms for r in reports(unit)] == [START_NS // 10**6 + 1000 * n for n in range(1, 102)]


def test_a_vehicle_that_stands_for_five_minutes_is_reported_once_a_minute_and_at_once_when_it_drives(
    unit: UplinkUnit,
) -> None:
    unit.drive(301, speed_m_s=0.0)
    before = len(reports(unit))
    unit.drive(600, speed_m_s=0.0)
    assert len(reports(unit)) - before in (9, 10, 11)
    unit.drive(3, speed_m_s=3.0)
    assert reports(unit)[-1].north_cm_s == 300


@pytest.mark.parametrize("tracking", ["live", "trips", "verdict"])
def test_what_a_vehicle_at_rest_has_sent_is_never_older_than_a_minute(tmp_path: Path, tracking: str) -> None:
    unit = UplinkUnit(tmp_path, tracking=tracking)
    unit.drive(7)
    unit.drive(310, speed_m_s=0.0)
    ages_s = list[float]()
    for _ in range(300):
        unit.drive(1, speed_m_s=0.0)
        sending = unit.process._reporting.sending
        assert sending is not None
        newest = sending.outbox.open_rows(most=10_000)[-1]
        reported = unsealed(sending.outbox.content(newest.id) or b"").batch.reports
        ages_s.append(unit.now_ns / NS - reported[-1].utc_ms / 1000)
    assert max(ages_s) <= RESTING_S + 1 < MAX_AGE_S - RETRY_S
    assert sum(age < 1 for age in ages_s) in (4, 5, 6), "and no more is sent than before"
    unit.close()


def test_a_change_of_the_verdict_is_signed_at_once(unit: UplinkUnit) -> None:
    unit.drive(15)
    unit.drive(1, TrustLevel.UNSAFE)
    sending = unit.process._reporting.sending
    assert sending is not None
    rows = sending.outbox.open_rows(most=100)
    newest = unsealed(sending.outbox.content(rows[-1].id) or b"").batch
    assert newest.reports[-1].verdict == 5 and newest.reports[-1].latitude_e7 is not None


def test_without_a_recent_solution_or_verdict_there_is_no_position(unit: UplinkUnit) -> None:
    unit.drive(5)
    for _ in range(5):
        unit.turn(verdict(unit.now_ns + NS), step_s=1.0)  # the solution is silent
    silent = reports(unit)[-1]
    assert silent.latitude_e7 is None and silent.verdict == 4 and silent.utc_ms == unit.now_ns // 10**6
    unit.drive(2)
    for _ in range(8):
        unit.turn(solution(unit.now_ns + NS), step_s=1.0)  # the verdict is
    assert reports(unit)[-1].verdict == 4 and reports(unit)[-1].latitude_e7 is None
    unit.drive(2, TrustLevel.INITIALISING)
    assert reports(unit)[-1].verdict == 3 and reports(unit)[-1].latitude_e7 is None


def test_nothing_is_reported_before_the_clock_is_set_and_that_is_said(tmp_path: Path) -> None:
    unit = UplinkUnit(tmp_path)
    unit.drive(20, utc=False)
    unit.turn(clock(unit.now_ns, unit.now_ns + YEAR_NS, synchronised=False), step_s=2.0)
    assert unit.state_message().offline == CLOCK_NOT_SET and unit.process._reporting.sending is None
    unit.turn(clock(unit.now_ns, unit.now_ns + 5 * NS), step_s=1.0)
    unit.drive(12, utc=False)
    assert reports(unit)[-1].utc_ms == unit.now_ns // 10**6 + 5000
    assert unit.state_message().offline != CLOCK_NOT_SET
    unit.close()


def test_excluded_gnss_does_not_set_the_clock_and_a_held_host_clock_overrules_it(tmp_path: Path) -> None:
    unit = UplinkUnit(tmp_path)
    unit.turn(clock(unit.now_ns, unit.now_ns), step_s=1.0)
    unit.offset_ns = DAY_NS
    unit.drive(10)
    assert reports(unit)[-1].utc_ms == unit.now_ns // 10**6
    unit.close()


@pytest.mark.parametrize("jump_ns", [DAY_NS, -DAY_NS, 10 * YEAR_NS])
def test_a_clock_that_jumps_is_noted_in_the_chain(unit: UplinkUnit, jump_ns: int) -> None:
    unit.drive(15)
    unit.offset_ns = jump_ns
    unit.drive(15)
    (event,) = [event for event in events(unit) if event.name == "uplink/clock"]
    after, before = event.content["after_ms"], event.content["before_ms"]
    assert isinstance(after, int) and isinstance(before, int) and after - before == jump_ns // 10**6
    assert unit.bus.rejects["clock jump"] == 1
    assert len(reports(unit)) == 30


def test_stamps_before_2020_never_enter_a_batch(unit: UplinkUnit) -> None:
    unit.drive(15)
    unit.offset_ns = -20 * YEAR_NS
    unit.drive(15)
    assert min(report.utc_ms for report in reports(unit)) >= START_NS // 10**6
    assert unit.bus.rejects["stamp"] >= 14


def test_events_are_reported_without_what_a_centre_does_not_need(unit: UplinkUnit) -> None:
    unit.drive(5)
    monitors = tuple(
        TrustMonitor(sampled_ns=unit.now_ns, monitor=name, outcome=outcome, reason="a reason")
        for name, outcome in (("one", Outcome.ACCUSES), ("two", Outcome.PASS))
    )
    change = TrustEvent(sampled_ns=unit.now_ns, before=TrustLevel.SAFE, after=TrustLevel.UNSAFE, reasons=("why",),
                        monitors=monitors)  # fmt: skip
    outage = Outage(what="sensors.gnss", since_ns=unit.now_ns, cause="it is silent", affected=("gnss/fix",))
    unit.drive(1, also=(change, outage))
    found = events(unit)
    assert [event.name for event in found] == ["trust/event", "outage/event"]
    assert [m["monitor"] for m in found[0].content["monitors"]] == ["one"]  # type: ignore[attr-defined]
    assert found[1].content["what"] == "sensors.gnss"


def test_where_the_data_come_from_is_an_event_when_it_changes_and_not_each_time_that_it_is_said(
    unit: UplinkUnit,
) -> None:
    unit.drive(3)
    for kind in (OriginKind.LIVE, OriginKind.LIVE, OriginKind.SIMULATED, OriginKind.SIMULATED, OriginKind.LIVE):
        unit.drive(1, also=(Origin(now_ns=unit.now_ns, kind=kind, name="car"),))
    assert [event.content["kind"] for event in events(unit)] == ["live", "simulated", "live"]


def test_messages_of_a_replay_are_not_reported(unit: UplinkUnit) -> None:
    unit.drive(3)
    before = len(reports(unit))
    replayed = [
        sent(message, unit.now_ns)._replace(recorded_ns=unit.now_ns)
        for message in (verdict(unit.now_ns), solution(unit.now_ns))
    ]
    for envelope in replayed:
        unit.process._take(unit.bus.as_bus(), envelope)
    unit.turn(step_s=1.5)
    assert len(reports(unit)) == before and unit.bus.rejects["replay"] == 2


def test_tracking_off_reports_nothing(tmp_path: Path) -> None:
    unit = UplinkUnit(tmp_path, tracking="off")
    outage = Outage(what="sensors.gnss", since_ns=unit.now_ns, cause="it is silent")
    unit.drive(30, also=(outage,))
    assert not batches(unit)
    unit.close()


def test_tracking_verdict_reports_no_position_not_even_in_events(tmp_path: Path) -> None:
    unit = UplinkUnit(tmp_path, tracking="verdict")
    unit.drive(30)
    found = reports(unit)
    assert len(found) >= 29 and all(report[1:7] == (None,) * 6 and report.verdict == 0 for report in found)
    unit.close()


def test_tracking_trips_reports_positions_while_the_vehicle_moves_and_sends_them_each_minute(tmp_path: Path) -> None:
    unit = UplinkUnit(tmp_path, tracking="trips")
    unit.drive(125)
    sizes = [len(b.reports) for b in batches(unit) if b.kind is Kind.POSITIONS]
    assert 60 in sizes and len(sizes) <= 4
    unit.drive(60, speed_m_s=0.0)
    assert reports(unit)[-1].latitude_e7 is None and reports(unit)[100].latitude_e7 is not None
    assert reports(unit)[130].latitude_e7 is not None, "a stop at a light is a part of the trip"
    unit.close()


@pytest.mark.parametrize("tracking", ["off", "verdict", "trips"])
def test_nobody_watches_a_unit_that_does_not_allow_it(tmp_path: Path, tracking: str) -> None:
    unit = UplinkUnit(tmp_path, tracking=tracking)
    unit.process._begin_watch(unit.bus.as_bus(), b'{"topics":["gnss/fix"],"for_s":30,"watchers":1}', unit.now_ns)
    unit.turn(step_s=1.0)
    assert unit.bus.rejects["watch"] == 1 and unit.state_message().watchers == 0 and not unit.bus.asked
    unit.close()


def test_who_watches_is_said_and_further_topics_are_asked_for_until_the_time_is_over(unit: UplinkUnit) -> None:
    body = b'{"topics":["imu/sample","gnss/fix","toll/transaction","../x"],"for_s":20,"watchers":2}'
    unit.process._begin_watch(unit.bus.as_bus(), body, unit.now_ns)
    unit.drive(2)
    assert unit.bus.asked == {"imu/sample"} and unit.state_message().watchers == 2
    assert unit.state_message().watched_until_ns is not None
    unit.drive(30)
    assert not unit.bus.asked and unit.state_message().watchers == 0
    assert sum(len(b.reports) == 1 for b in batches(unit)) >= 15, "a batch a second while watched"


def test_the_row_of_the_process_allows_whatever_may_be_watched() -> None:
    row = BY_NAME["monitoring.uplink"]
    assert set(WATCHABLE) <= {*row.consumes, *row.on_request}
    assert set(row.on_request) <= set(WATCHABLE) and not set(row.on_request) & set(row.consumes)


def test_a_unit_that_is_not_enrolled_says_what_to_do(tmp_path: Path) -> None:
    unit = UplinkUnit(tmp_path)
    for path in (tmp_path / "uplink").iterdir():
        path.unlink()
    unit.drive(12)
    state = unit.state_message()
    assert not state.connected and state.centre is None and "obu enrol URL TOKEN" in (state.offline or "")
    assert unit.process._reporting.sending is None
    unit.close()


def test_a_second_process_on_an_outbox_ends_and_leaves_the_first_alone(tmp_path: Path) -> None:
    unit = UplinkUnit(tmp_path)
    with alone(tmp_path / "uplink"):
        unit.drive(25)
        second = UplinkUnit(tmp_path, enrolled=True)
        second.bus.stopping = True
        with pytest.raises(UserError, match="has the outbox in"):
            second.process.run(second.bus.as_bus())
        second.close()
        unit.drive(10)
    assert len(reports(unit)) == 35
    second.process.run(second.bus.as_bus())
    unit.close()


def test_a_damaged_file_is_set_aside_and_said_and_the_next_epoch_begins(tmp_path: Path) -> None:
    unit = UplinkUnit(tmp_path)
    unit.drive(25)
    epoch = batches(unit)[0].epoch_ms
    unit.close()
    path = tmp_path / "uplink" / "outbox.sqlite"
    path.write_bytes(path.read_bytes()[:3000] + b"\xff" * 30_000)

    again = UplinkUnit(tmp_path)
    again.turn(step_s=100.0)
    again.drive(25)
    (event,) = events(again)
    assert event.name == "uplink/gap" and event.content["why"] == "damaged"
    assert batches(again)[0].epoch_ms > epoch and len(reports(again)) == 25
    assert (tmp_path / "uplink" / "outbox.damaged.sqlite").exists()
    again.close()


def test_the_state_is_published_when_it_changes_and_every_ten_seconds(unit: UplinkUnit) -> None:
    for _ in range(100):
        unit.turn(step_s=1.0)
    assert 10 <= len(unit.of(UplinkState)) <= 60


@pytest.mark.parametrize("settings", [{"outbox_mb": 0}, {"tracking": "all"}, {"tls": False}, {"port": 1883}])
def test_settings_out_of_range_or_for_plaintext_are_refused(settings: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        Config.model_validate(settings)


def test_a_message_that_is_no_event_makes_none() -> None:
    assert event_of(verdict(START_NS), "trust/state", 1, places=True) is None


ON_A_SMALL_DISK = """
import os, sys
from pathlib import Path
from tests.support.fleet.uplink_unit import UplinkUnit
from tests.unit.monitoring.uplink.test_uplink_process import batches
from shared.fleet.batch import Kind

disk = Path(sys.argv[1])
unit = UplinkUnit(disk)
unit.drive(30)
filler = (disk / "filler").open("wb", buffering=0)
try:
    while True:
        filler.write(bytes(4096))
except OSError:
    pass
unit.drive(2000)
said = unit.state_message()
assert "make room on its disk" in said.offline, said
assert said.dropped > 1000, said
os.unlink(disk / "filler")
filler.close()
unit.drive(60)
found = batches(unit)
gaps = sum(b.count for b in found if b.kind is Kind.GAP)
reports = [r.utc_ms for b in found for r in b.reports]
assert reports == sorted(set(reports))
assert gaps == unit.state_message().dropped, (gaps, unit.state_message().dropped)
assert gaps + len(reports) == 2090, (gaps, len(reports))
previous, following = bytes(32), 0
for b in found:
    assert b.first == following
    following += b.count
print("whole")
"""


def test_on_a_disk_that_is_really_full_reports_are_counted_and_the_rest_goes_on(tmp_path: Path) -> None:
    small = f"mount -t tmpfs -o size=3m none {tmp_path}"
    if subprocess.run([*IN_A_NAMESPACE, small], capture_output=True, check=False).returncode:
        pytest.skip("this system lets no ordinary user mount a small disk")
    command = [*IN_A_NAMESPACE, f'{small} && exec "$@"', "sh", sys.executable, "-c", ON_A_SMALL_DISK, str(tmp_path)]
    done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, timeout=HANGS_S, check=False)
    assert done.stdout.endswith("whole\n"), done.stdout[-2000:] + done.stderr[-3000:]

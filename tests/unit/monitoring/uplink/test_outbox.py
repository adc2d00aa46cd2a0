"""The outbox: nothing is lost by a kill, by a full disk, or in silence by its limit."""

import os
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import pytest

from services.monitoring.uplink.outbox import LostReports, Outbox, OutboxDamaged, OutboxFault, alone, set_aside
from shared.errors import UserError
from shared.evidence.signer import FileSigner
from shared.fleet.batch import Batch, Event, Kind, Report
from shared.fleet.receipts import StoredBatch
from shared.fleet.sealed import receipt_digest, unsealed
from tests.support.fleet.small_centre import Memory

REPOSITORY = Path(__file__).resolve().parents[4]
EPOCH_MS = 1_796_000_000_000
SIGNER = FileSigner(bytes(32))
KILLS = 24
# Tells each report that is committed, until it is killed; goes on with the number after the last of an earlier run.
REPORTER = """
import sys
from pathlib import Path
from services.monitoring.uplink.outbox import Outbox
from shared.evidence.signer import FileSigner
from shared.fleet.batch import Event, Report

outbox = Outbox(Path(sys.argv[1]), "car", 1_796_000_000_000, 10**9)
signer, number = FileSigner(bytes(32)), int(sys.argv[2])
while True:
    outbox.add(Report(1_796_000_000_000 + number, None, None, None, None, None, None, 0))
    print(number, flush=True)
    number += 1
    if number % 7 == 0:
        outbox.add(Event(1_796_000_000_000 + number, "test/event", {"number": number}))
    if number % 5 == 0:
        outbox.flush(signer)
"""


HOLDER = """
import sys, time
from pathlib import Path
from services.monitoring.uplink.outbox import alone

with alone(Path(sys.argv[1])):
    print("holds", flush=True)
    time.sleep(60.0)
"""


def report(number: int) -> Report:
    return Report(EPOCH_MS + 1000 * number, 481_000_000 + number, 115_000_000, 50_000, 100, 0, 35, 0)


def opened(path: Path, most_bytes: int = 10**9, vehicle: str = "car") -> Outbox:
    return Outbox(path / "outbox.sqlite", vehicle, EPOCH_MS, most_bytes)


def batches(outbox: Outbox) -> list[tuple[int, bytes]]:
    return [(row.id, outbox.content(row.id) or b"") for row in outbox.open_rows(most=100_000)]


def stored(*sealed: bytes) -> list[StoredBatch]:
    found = [unsealed(data).batch for data in sealed]
    return [StoredBatch(b.epoch_ms, b.first, receipt_digest(d)) for b, d in zip(found, sealed, strict=True)]


def chain(outbox: Outbox) -> list[Batch]:
    """What the outbox holds, as a centre would have stored it."""
    memory = Memory(outbox.vehicle, SIGNER.public_key)
    for _, data in batches(outbox):
        assert memory.receive(data).stored
    return memory.chain()


def test_no_kill_at_any_moment_loses_or_repeats_a_report_that_was_committed(tmp_path: Path) -> None:
    told: list[int] = []
    path = tmp_path / "outbox.sqlite"
    for turn in range(KILLS):
        process = subprocess.Popen(
            [sys.executable, "-c", REPORTER, str(path), str(told[-1] + 2 if told else 0)],
            cwd=REPOSITORY, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert process.stdout is not None
        told.append(int(process.stdout.readline()))
        time.sleep(0.003 * turn)  # another moment each time
        process.send_signal(signal.SIGKILL)
        told += [int(line) for line in process.stdout if line.endswith("\n")]
        process.stdout.close()
        process.wait()

    outbox = Outbox(path, "car", EPOCH_MS + 1, 10**9)
    outbox.flush(SIGNER)
    found = [report.utc_ms - EPOCH_MS for batch in chain(outbox) for report in batch.reports]
    assert outbox.epoch_ms == EPOCH_MS
    assert len(found) == len(set(found)) and set(told) <= set(found)
    assert len(found) - len(told) <= KILLS, "each kill may come between the commit and the word of it"
    outbox.close()


def test_each_flush_makes_one_signed_batch_of_a_kind_with_dense_numbers_and_an_unbroken_chain(tmp_path: Path) -> None:
    outbox = opened(tmp_path)
    for flush in range(3):
        for number in range(10):
            outbox.add(report(10 * flush + number))
        outbox.add(Event(EPOCH_MS, "trust/event", {"flush": flush}))
        assert outbox.flush(SIGNER) == 2

    found = chain(outbox)
    assert [(b.kind, b.first, b.count) for b in found] == [
        (Kind.EVENTS, 0, 1), (Kind.POSITIONS, 1, 10), (Kind.EVENTS, 11, 1), (Kind.POSITIONS, 12, 10),
        (Kind.EVENTS, 22, 1), (Kind.POSITIONS, 23, 10),
    ]  # fmt: skip
    assert [r.utc_ms for b in found for r in b.reports] == [report(n).utc_ms for n in range(30)]
    assert outbox.flush(SIGNER) == 0
    outbox.close()


def test_more_than_a_batch_holds_is_divided(tmp_path: Path) -> None:
    outbox = opened(tmp_path)
    for number in range(1500):
        outbox.add(report(number))
    for number in range(8):
        outbox.add(Event(EPOCH_MS + number, "trust/event", {"text": os.urandom(7000).hex()}))
    outbox.flush(SIGNER)
    outbox.flush(SIGNER)
    found = chain(outbox)
    assert sum(len(b.reports) for b in found) == 1500 and sum(len(b.events) for b in found) == 8
    assert max(b.count for b in found) == 600
    outbox.close()


def test_a_receipt_deletes_what_it_names_exactly_and_nothing_else(tmp_path: Path) -> None:
    outbox = opened(tmp_path)
    for number in range(3):
        outbox.add(report(number))
        outbox.flush(SIGNER)
    first, second, third = (data for _, data in batches(outbox))
    (name,) = stored(second)

    strange = [StoredBatch(name.epoch_ms + 1, name.first, name.digest),
               StoredBatch(name.epoch_ms, name.first + 1, name.digest),
               StoredBatch(name.epoch_ms, name.first, b"12345678")]  # fmt: skip
    assert outbox.settle(strange) == []
    assert len(outbox.settle([name, name])) == 1
    assert [data for _, data in batches(outbox)] == [first, third]
    assert outbox.backlog().batches == 2
    outbox.close()

    again = opened(tmp_path)
    assert [data for _, data in batches(again)] == [first, third]
    again.add(report(3))
    again.flush(SIGNER)
    assert unsealed(batches(again)[-1][1]).batch.first == 3
    again.close()


def test_a_full_outbox_drops_the_oldest_positions_never_events_and_signs_a_gap_for_them(tmp_path: Path) -> None:
    outbox = opened(tmp_path, most_bytes=200_000)
    made = 0
    for number in range(3000):
        outbox.add(report(number))
        made += 1
        if number % 500 == 250:
            outbox.add(Event(EPOCH_MS, "toll/transaction", {"number": number}))
        outbox.flush(SIGNER)

    found = chain(outbox)
    gaps = [b for b in found if b.kind is Kind.GAP]
    events = [e.content["number"] for b in found for e in b.events]
    assert events == [250, 750, 1250, 1750, 2250, 2750]
    assert outbox.dropped == sum(gap.count for gap in gaps) == made - sum(len(b.reports) for b in found)
    assert outbox.dropped > 1000 and len(gaps) <= 6, "adjoining gaps are one"
    assert [r.utc_ms for b in found for r in b.reports] == [report(n).utc_ms for n in range(outbox.dropped, 3000)]
    assert gaps[0].gap is not None and gaps[0].gap.from_ms == report(0).utc_ms
    assert outbox.backlog().bytes <= 220_000
    outbox.close()


def test_reports_that_were_never_stored_are_a_gap_of_their_own(tmp_path: Path) -> None:
    outbox = opened(tmp_path)
    outbox.add(report(0))
    outbox.flush(SIGNER)
    outbox.add(LostReports(7, report(1).utc_ms, report(7).utc_ms))
    outbox.add(report(8))
    outbox.flush(SIGNER)
    assert [(b.kind, b.first, b.count) for b in chain(outbox)] == [(0, 0, 1), (2, 1, 7), (0, 8, 1)]
    outbox.close()


def test_what_conflicts_is_put_into_another_epoch_with_a_chain_of_its_own(tmp_path: Path) -> None:
    outbox = opened(tmp_path)
    for number in range(3):
        outbox.add(report(number))
        outbox.flush(SIGNER)
    ids = [row_id for row_id, _ in batches(outbox)]
    outbox.begin_epoch(EPOCH_MS)
    outbox.make_anew(ids[1], SIGNER)
    outbox.make_anew(ids[2], SIGNER)
    outbox.add(report(3))
    outbox.flush(SIGNER)
    found = chain(outbox)
    assert [(b.epoch_ms - EPOCH_MS, b.first) for b in found] == [(0, 0), (1, 0), (1, 1), (1, 2)]
    assert [b.reports for b in found] == [(report(n),) for n in range(4)]
    outbox.close()


def test_a_full_disk_stores_nothing_by_halves_and_is_used_again_when_there_is_room(tmp_path: Path) -> None:
    outbox = opened(tmp_path)
    outbox.add(report(0))
    outbox.flush(SIGNER)
    pages = outbox._db.execute("PRAGMA page_count").fetchone()[0]
    outbox._db.execute(f"PRAGMA max_page_count={pages}")
    stored_reports = 0
    with pytest.raises(OutboxFault, match="make room on its disk"):
        for number in range(1, 10_000):
            outbox.add(report(number))
            stored_reports = number
    with pytest.raises(OutboxFault):
        for _ in range(100):
            outbox.add(Event(EPOCH_MS, "trust/event", {"text": "x" * 5000}))
            outbox.flush(SIGNER)

    outbox._db.execute("PRAGMA max_page_count=100000")
    outbox.flush(SIGNER)
    found = [report for batch in chain(outbox) for report in batch.reports]
    assert found == [report(number) for number in range(stored_reports + 1)]
    outbox.close()


@pytest.mark.parametrize("content", [b"", b"no database" * 1000, b"SQLite format 3\0" + bytes(4080)])
def test_a_file_of_something_else_is_named_and_moved_away(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "outbox.sqlite"
    path.write_bytes(content)
    if not content:
        opened(tmp_path).close()  # as after a power cut at its creation
        return
    with pytest.raises(OutboxDamaged, match="damaged"):
        opened(tmp_path)
    place = set_aside(path)
    assert place.read_bytes()[:11] == content[:11] and not path.exists()
    opened(tmp_path).close()


def test_content_that_was_changed_on_the_disk_is_never_sent(tmp_path: Path) -> None:
    outbox = opened(tmp_path)
    outbox.add(report(0))
    outbox.flush(SIGNER)
    outbox.close()
    with sqlite3.connect(tmp_path / "outbox.sqlite") as db:
        db.execute("UPDATE batch SET content = substr(content, 1, 50)")
    db.close()
    again = opened(tmp_path)
    with pytest.raises(OutboxDamaged, match="not as it was made"):
        again.content(again.open_rows()[0].id)
    again.close()


def test_an_outbox_of_another_unit_or_of_a_newer_version_is_not_used(tmp_path: Path) -> None:
    outbox = opened(tmp_path)
    outbox.add(report(0))
    outbox.flush(SIGNER)
    outbox.close()
    with pytest.raises(OutboxDamaged, match="'car', and this unit is 'bus' now"):
        opened(tmp_path, vehicle="bus")
    with sqlite3.connect(tmp_path / "outbox.sqlite") as db:
        db.execute("PRAGMA user_version=2")
    db.close()
    with pytest.raises(OutboxDamaged, match="version 2"):
        opened(tmp_path)


def test_one_process_has_an_outbox_until_it_is_killed(tmp_path: Path) -> None:
    folder = tmp_path / "uplink"
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(folder)], cwd=REPOSITORY, stdout=subprocess.PIPE, text=True
    )
    try:
        assert holder.stdout is not None and holder.stdout.readline() == "holds\n"
        with pytest.raises(UserError, match="end it, or give this unit a state folder"), alone(folder):
            pass
    finally:
        holder.kill()
        holder.communicate()
    with alone(folder):
        opened(folder).close()


def test_a_folder_that_cannot_be_made_is_told_by_the_outbox_and_ends_nothing(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "uplink").write_text("a file")
    with alone(tmp_path / "uplink"), pytest.raises(OutboxFault, match="cannot"):
        opened(tmp_path / "uplink")
    assert [record.args for record in caplog.records] == [(tmp_path / "uplink", "File exists")]


def test_the_folder_of_an_outbox_is_made_for_its_owner_alone(tmp_path: Path) -> None:
    outbox = Outbox(tmp_path / "state" / "uplink" / "outbox.sqlite", "car", EPOCH_MS, 10**6)
    assert (tmp_path / "state" / "uplink").stat().st_mode & 0o777 == 0o700
    outbox.close()

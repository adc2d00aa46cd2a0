"""Which batches are sent when; time is an argument."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from services.monitoring.uplink.outbox import Outbox
from services.monitoring.uplink.sending import BatchCounters, BatchSelection
from shared.evidence.signer import FileSigner
from shared.fleet.batch import Event, Kind, Report
from shared.fleet.receipts import Receipt, RejectedBatch, StoredBatch
from shared.fleet.sealed import receipt_digest, unsealed

NS = 1_000_000_000
EPOCH_MS = 1_796_000_000_000
SIGNER = FileSigner(bytes(32))


class Sender:
    """An outbox with batches of one report, and what was sent of it."""

    def __init__(self, folder: Path) -> None:
        self.outbox = Outbox(folder / "outbox.sqlite", "car", EPOCH_MS, 10**9)
        self.rejects: Counter[str] = Counter()
        self.tally = BatchCounters()
        self.sending = BatchSelection(self.outbox, self.tally, self.rejects)
        self.made = 0

    def make(self, number: int = 1, *, event: bool = False) -> None:
        for _ in range(number):
            at_ms = EPOCH_MS + self.made
            self.made += 1
            self.outbox.add(
                Event(at_ms, "trust/event", {}) if event else Report(at_ms, None, None, None, None, None, None, 0)
            )
            self.outbox.flush(SIGNER)

    def sent(self, now_s: float) -> list[int]:
        """First sequence numbers of everything that is sent now."""
        found = []
        while (one := self.sending.next(round(now_s * NS))) is not None:
            found.append(one[0].first)
        return found

    def name(self, first: int) -> tuple[int, int, bytes]:
        (row,) = [row for row in self.outbox.open_rows(most=10_000) if row.first == first]
        return row.epoch_ms, first, receipt_digest(self.outbox.content(row.id) or b"")

    def receipt(self, now_s: float, *firsts: int) -> None:
        receipt = Receipt(stored=tuple(StoredBatch(*self.name(first)) for first in firsts))
        self.sending.take(receipt, SIGNER, round(now_s * NS), EPOCH_MS + 10**6)

    def refusal(self, now_s: float, first: int, reason: str) -> None:
        # As of a centre that cannot verify it: named by its digest alone.
        receipt = Receipt(refused=(RejectedBatch(0, 0, self.name(first)[2], reason),))
        self.sending.take(receipt, SIGNER, round(now_s * NS), EPOCH_MS + 10**6)


@pytest.fixture
def sender(tmp_path: Path) -> Iterator[Sender]:
    made = Sender(tmp_path)
    yield made
    made.outbox.close()


def test_four_are_in_flight_the_newest_first_then_the_oldest_and_a_receipt_frees_a_place(sender: Sender) -> None:
    sender.make(10)
    assert sender.sent(0) == [9, 0, 1, 2]
    assert sender.sent(5) == []
    sender.receipt(5, 0, 1)
    assert sender.sent(5) == [3, 4]
    sender.make()
    sender.receipt(6, 3)
    assert sender.sent(6) == [10], "what is new goes before the backlog"


def test_an_event_goes_first_and_takes_the_place_of_positions_once(sender: Sender) -> None:
    sender.make(10)
    sender.sent(0)
    sender.make(2, event=True)
    assert sender.sent(1) == [10, 11]
    assert sender.sent(2) == []


def test_what_gets_no_receipt_is_sent_again_after_ten_seconds_and_ever_later(sender: Sender) -> None:
    sender.make()
    at = [second for second in range(2000) if sender.sent(second)]
    assert at == [0, 10, 30, 70, 150, 310, 610, 910, 1210, 1510, 1810]


def test_one_batch_without_an_answer_does_not_hold_up_the_others(sender: Sender) -> None:
    sender.make(60)
    for second in range(200):
        for first in sender.sent(second):
            if first != 7:
                sender.receipt(second, first)
    assert [row.first for row in sender.outbox.open_rows(most=100)] == [7]


def test_a_silent_centre_is_sent_less_and_less_and_everything_once_it_answers(sender: Sender) -> None:
    sender.make(200)
    sent = [len(sender.sent(second)) for second in range(1000)]
    assert sum(sent[:10]) == 4 and sum(sent[300:]) <= 16
    for second in range(1000, 1400):
        for first in sender.sent(second):
            sender.receipt(second, first)
    assert not sender.outbox.open_rows()


def test_a_new_connection_sends_again_at_once(sender: Sender) -> None:
    sender.make(2)
    assert sender.sent(0) == [1, 0]
    sender.sending.restart()
    assert sender.sent(1) == [1, 0]


def test_what_is_refused_stays_is_tried_again_once_an_hour_and_stops_nothing(sender: Sender) -> None:
    sender.make(3)
    sender.sent(0)
    sender.refusal(1, 1, "format")
    sender.receipt(1, 0, 2)
    assert sender.outbox.backlog().refused == 1
    at = []
    for second in range(2, 9000, 7):
        if sender.sent(second):
            at.append(second)
            (row,) = sender.outbox.refused_rows(2**62, 2**62)
            again = Receipt(refused=(RejectedBatch(row.epoch_ms, row.first, row.digest[:8], "format"),))
            sender.sending.take(again, SIGNER, second * NS, EPOCH_MS)
    assert len(at) == 2 and 3600 <= at[0] < 3610
    assert sender.outbox.backlog().batches == 1 and sender.rejects == {}


def test_while_the_centre_takes_nothing_one_refused_batch_a_minute_is_sent_and_all_when_it_takes_one(
    sender: Sender,
) -> None:
    sender.make(20)
    while sender.sent(0):
        for row in sender.outbox.open_rows(most=100):
            sender.refusal(0, row.first, "key")
    assert sender.outbox.backlog().refused == 20 and not sender.sent(3599)

    tried = []
    for second in range(3600, 3900):
        for first in sender.sent(second):
            tried.append(first)
            row = next(row for row in sender.outbox.refused_rows(2**62, 2**62, 100) if row.first == first)
            again = Receipt(refused=(RejectedBatch(0, 0, row.digest[:8], "key"),))
            sender.sending.take(again, SIGNER, second * NS, EPOCH_MS)
    assert len(tried) == len(set(tried)) == 5

    for second in range(3900, 3910):
        sender.sent(second)
        rows = sender.outbox.refused_rows(2**62, 2**62, 100)
        stored = tuple(StoredBatch(row.epoch_ms, row.first, row.digest[:8]) for row in rows if row.first not in tried)
        sender.sending.take(Receipt(stored=stored), SIGNER, second * NS, EPOCH_MS)
    assert sender.outbox.backlog().batches == 5, "those that were tried wait for their hour"


def test_a_conflict_begins_another_epoch_once_and_keeps_what_was_reported(sender: Sender) -> None:
    sender.make(4)
    sender.sent(0)
    sender.refusal(1, 1, "conflict")
    sender.refusal(1, 2, "conflict")
    found = [unsealed(sender.outbox.content(row.id) or b"").batch for row in sender.outbox.open_rows(most=10)]
    epochs = sorted({batch.epoch_ms for batch in found})
    assert len(epochs) == 2 and epochs[1] == EPOCH_MS + 10**6
    assert [(b.epoch_ms == epochs[1], b.first, b.reports[0].utc_ms - EPOCH_MS) for b in found] == [
        (False, 0, 0), (False, 3, 3), (True, 0, 1), (True, 1, 2),
    ]  # fmt: skip

    sender.sent(2)
    row = sender.outbox.open_rows(most=10)[2]
    again = Receipt(refused=(RejectedBatch(row.epoch_ms, row.first, row.digest[:8], "conflict"),))
    sender.sending.take(again, SIGNER, 60 * NS, EPOCH_MS + 2 * 10**6)
    assert sender.outbox.epoch_ms == epochs[1] and sender.outbox.backlog().refused == 1, "not in a loop"


def test_a_key_that_is_registered_later_opens_what_was_refused_for_it(sender: Sender) -> None:
    sender.make(2)
    sender.sent(0)
    sender.refusal(1, 0, "key")
    sender.outbox.reopen("key")
    assert sender.sent(30) != [] and sender.outbox.backlog().refused == 0


def test_a_receipt_of_nothing_is_counted(sender: Sender) -> None:
    sender.make()
    sender.sending.take(Receipt(stored=(StoredBatch(EPOCH_MS, 5, bytes(8)),)), SIGNER, NS, EPOCH_MS)
    assert sender.rejects["receipt of no batch"] == 1 and sender.tally.receipted == 0
    assert sender.outbox.open_rows(kind=Kind.POSITIONS)

"""Charges: one for a passage, whatever is lost, repeated or killed; and nothing kept of who is not charged."""

import hashlib
from collections.abc import Iterator
from pathlib import Path

import pytest

from services.monitoring.ledger.ledger import PASSAGES_BYTES, RECENT_PASSAGES, Ledger, Settings
from services.monitoring.ledger.store import LedgerFault, Row, Store, Value
from shared.bus.codec import encode
from shared.messages.explanation import QuotedText, explain
from shared.messages.toll import MAX_SETTLED, STATIONS, EvidencePack, PassageState, RegisteredStation, TransactionKind
from shared.topics import MANY_BYTES
from tests.support.v2x.tolling import NS, PLAZA, START_NS, STATION, Vehicle, answer, ledger_at

OPEN, CROSSED, CHARGED = PassageState.OPEN, PassageState.CROSSED, PassageState.CHARGED
LATER_NS = START_NS + 30 * NS


@pytest.fixture
def opened(tmp_path: Path) -> Iterator[tuple[Ledger, Store]]:
    ledger, store = ledger_at(tmp_path / "ledger.sqlite")
    yield ledger, store
    store.close()


def drive(ledger: Ledger, vehicle: Vehicle, *, registered: bool = True, end: PassageState = CHARGED) -> None:
    if registered:
        ledger.register(vehicle.registration(), START_NS)
    for state in (OPEN, CROSSED, end):
        ledger.passage(vehicle.says(state), LATER_NS)


def outcomes(ledger: Ledger) -> dict[str, PassageState]:
    return {row.passage_id: row.state for row in ledger.state(LATER_NS).recent}


def test_a_registered_passage_is_charged_once_with_the_tariff_of_its_class(opened: tuple[Ledger, Store]) -> None:
    ledger, _ = opened
    vehicle = Vehicle()
    drive(ledger, vehicle)
    (transaction,) = ledger.due(LATER_NS)
    assert (transaction.contract, transaction.lane, transaction.amount_cents) == ("contract-1", "n2", 240)
    assert transaction.currency == "EUR" and transaction.tariff_version == "2026-1"
    assert not transaction.authenticated
    assert outcomes(ledger) == {vehicle.passage_id: CHARGED}


def test_repeated_late_and_reordered_statements_charge_no_second_time(opened: tuple[Ledger, Store]) -> None:
    ledger, _ = opened
    vehicle = Vehicle()
    drive(ledger, vehicle)
    for state in (CHARGED, OPEN, CROSSED, CHARGED, PassageState.UNDECIDED):
        ledger.passage(vehicle.says(state), LATER_NS + NS)
    assert ledger.state(LATER_NS).transactions == 1
    assert ledger.open_passages(LATER_NS).passages == ()
    assert ledger.open_passages(LATER_NS).settled == (vehicle.passage_id,)


def test_the_database_itself_refuses_a_second_charge_of_a_passage(opened: tuple[Ledger, Store]) -> None:
    ledger, store = opened
    drive(ledger, Vehicle())
    (row,) = store.rows("SELECT * FROM booking")
    with pytest.raises(LedgerFault, match="UNIQUE"), store.transaction():
        store.execute("INSERT INTO booking VALUES ('other', ?, 'charge', 1, 1, '{}')", row["passage_id"])


@pytest.mark.parametrize(
    ("changes", "registered", "state"),
    [
        ({}, False, PassageState.UNREGISTERED),
        ({"lane": None}, True, PassageState.SUSPECT),
        ({"lane": None}, False, PassageState.UNDECIDED),
        ({"state": PassageState.VOID}, True, PassageState.VOID),
        ({"state": PassageState.SUSPECT}, True, PassageState.SUSPECT),
        ({"crossing_ns": None}, True, PassageState.SUSPECT),
    ],
)
def test_what_cannot_be_charged_ends_in_a_state_of_its_own(
    opened: tuple[Ledger, Store], changes: dict[str, object], registered: bool, state: PassageState
) -> None:
    ledger, _ = opened
    vehicle = Vehicle()
    if registered:
        ledger.register(vehicle.registration(), START_NS)
    ledger.passage(vehicle.says(CHARGED).model_copy(update=changes), LATER_NS)
    assert outcomes(ledger) == {vehicle.passage_id: state}
    assert ledger.due(LATER_NS) == []


def test_without_evidence_nothing_is_charged(opened: tuple[Ledger, Store]) -> None:
    ledger, _ = opened
    vehicle = Vehicle()
    ledger.register(vehicle.registration(), START_NS)
    ledger.passage(vehicle.says(CHARGED, evidence=None), LATER_NS)
    assert outcomes(ledger) == {vehicle.passage_id: PassageState.SUSPECT}


def test_the_evidence_of_the_crossing_is_that_of_the_statement_that_decided_it(opened: tuple[Ledger, Store]) -> None:
    ledger, _ = opened
    vehicle = Vehicle()
    drive(ledger, vehicle)
    (transaction,) = ledger.due(LATER_NS)
    text = ledger.evidence(vehicle.passage_id)
    assert text is not None and hashlib.sha256(text).hexdigest() == transaction.evidence_digest
    pack = EvidencePack.model_validate_json(text)
    assert pack.crossed == vehicle.says(CROSSED) and pack.charged == vehicle.says(CHARGED)
    assert hashlib.sha256(pack.plaza_file.encode()).hexdigest() == PLAZA.digest


@pytest.mark.parametrize("registers", [True, False])
def test_a_new_station_id_on_the_way_keeps_the_contract_only_if_that_registers_it(
    opened: tuple[Ledger, Store], registers: bool
) -> None:
    ledger, _ = opened
    ledger.register(Vehicle().registration(), START_NS)
    ledger.passage(Vehicle().says(OPEN), START_NS)
    changed = Vehicle(station_ids=(STATION, 7))
    if registers:
        ledger.register(changed.registration(), START_NS)
    for state in (CROSSED, CHARGED):
        ledger.passage(changed.says(state), LATER_NS)
    assert ledger.state(LATER_NS).transactions == registers
    if not registers:
        assert [review.reason_code for review in ledger.reviews()] == [explain("ledger.new_ticket")]


def test_station_ids_of_two_contracts_are_suspect(opened: tuple[Ledger, Store]) -> None:
    ledger, _ = opened
    vehicle = Vehicle(station_ids=(STATION, 7))
    ledger.register(vehicle.registration("contract-1", station_id=STATION), START_NS)
    ledger.register(vehicle.registration("contract-2", station_id=7), START_NS)
    ledger.passage(vehicle.says(CHARGED), LATER_NS)
    assert outcomes(ledger) == {vehicle.passage_id: PassageState.SUSPECT}
    (review,) = ledger.reviews()
    assert (review.contract, review.contracts) == (None, ("contract-1", "contract-2"))


def test_station_ids_of_one_contract_with_two_tariff_classes_are_suspect(opened: tuple[Ledger, Store]) -> None:
    ledger, _ = opened
    vehicle = Vehicle(station_ids=(STATION, 7))
    for station_id, tariff_class in ((STATION, "car"), (7, "truck")):
        ledger.register(vehicle.registration("contract-1", tariff_class, station_id=station_id), START_NS)
    ledger.passage(vehicle.says(CHARGED), LATER_NS)
    (review,) = ledger.reviews()
    assert (review.contract, review.contracts) == ("contract-1", ())
    assert review.reason_code == explain("ledger.two_classes")


@pytest.mark.parametrize("is_first", [True, False])
def test_station_ids_of_two_contracts_are_suspect_beside_the_passage_of_one_of_them(
    opened: tuple[Ledger, Store], is_first: bool
) -> None:
    """It is no second passage of the one vehicle alone: the other has passed as well, and nobody else states it."""
    ledger, _ = opened
    both, one = Vehicle("both", station_ids=(STATION, 7)), Vehicle("one", station_ids=(7,))
    ledger.register(both.registration("contract-1", station_id=STATION), START_NS)
    ledger.register(one.registration("contract-2", station_id=7), START_NS)
    for vehicle in (both, one) if is_first else (one, both):
        ledger.passage(vehicle.says(CHARGED), LATER_NS)
    assert outcomes(ledger) == {both.passage_id: PassageState.SUSPECT, one.passage_id: PassageState.CHARGED}
    assert [charge.contract for charge in ledger.due(LATER_NS)] == ["contract-2"]


def test_two_contracts_of_a_station_id_are_reviewed_and_an_expired_one_does_not_count(
    opened: tuple[Ledger, Store],
) -> None:
    ledger, _ = opened
    vehicle = Vehicle()
    ledger.register(vehicle.registration("new", sampled_ns=START_NS + 2), START_NS)
    ledger.register(vehicle.registration("old", sampled_ns=START_NS + 1), START_NS)
    ledger.passage(vehicle.says(CHARGED), LATER_NS)
    assert ledger.due(LATER_NS) == []
    assert [review.contracts for review in ledger.reviews()] == [("new", "old")]
    other = Vehicle("b", station_ids=(9,))
    ledger.register(other.registration(valid_until_ns=START_NS + NS), START_NS)
    ledger.passage(other.says(CHARGED), LATER_NS)
    assert outcomes(ledger)[other.passage_id] is PassageState.UNREGISTERED


def test_a_transaction_is_sent_again_with_growing_pauses_until_the_receipt(opened: tuple[Ledger, Store]) -> None:
    ledger, _ = opened
    drive(ledger, Vehicle())
    sent = [(second, t.attempt) for second in range(20) for t in ledger.due(LATER_NS + second * NS)]
    assert sent == [(0, 1), (1, 2), (3, 3), (7, 4), (15, 5)]
    (transaction,) = ledger.due(LATER_NS + 100 * NS)
    assert ledger.state(LATER_NS).outbox == 1
    ledger.receipt(answer(transaction, LATER_NS), LATER_NS)
    ledger.receipt(answer(transaction, LATER_NS), LATER_NS)
    assert ledger.due(LATER_NS + 1000 * NS) == []
    assert ledger.state(LATER_NS).outbox == 0
    assert ledger.state(LATER_NS).recent[0].receipt


def test_a_receipt_of_an_unknown_transaction_is_counted(opened: tuple[Ledger, Store]) -> None:
    ledger, _ = opened
    drive(ledger, Vehicle())
    (transaction,) = ledger.due(LATER_NS)
    ledger.receipt(answer(transaction.model_copy(update={"transaction_id": "0" * 64}), LATER_NS), LATER_NS)
    assert ledger.rejects == {"receipt of an unknown transaction": 1}
    assert ledger.state(LATER_NS).outbox == 1


@pytest.mark.parametrize("cause", ["refused", "void"])
def test_a_correction_is_one_reversal_and_the_charge_stays_as_it_is(opened: tuple[Ledger, Store], cause: str) -> None:
    ledger, store = opened
    vehicle = Vehicle()
    drive(ledger, vehicle)
    (charge,) = ledger.due(LATER_NS)
    before = store.rows("SELECT content FROM booking")[0]["content"]
    for _ in range(2):
        if cause == "refused":
            ledger.receipt(answer(charge, LATER_NS, accepted=False), LATER_NS)
        else:
            ledger.passage(vehicle.says(PassageState.VOID, reason="turned"), LATER_NS)
    rows = {row["kind"]: row for row in store.rows("SELECT * FROM booking")}
    assert rows[TransactionKind.CHARGE]["content"] == before
    assert rows[TransactionKind.REVERSAL]["amount_cents"] == -240
    assert ledger.state(LATER_NS).amount_cents == 0 and len(rows) == 2


def test_a_passage_in_progress_is_published_after_a_restart(tmp_path: Path) -> None:
    ledger, store = ledger_at(tmp_path / "ledger.sqlite")
    vehicle = Vehicle()
    ledger.register(vehicle.registration(), START_NS)
    ledger.passage(vehicle.says(CROSSED), LATER_NS)
    store.close()
    again, store = ledger_at(tmp_path / "ledger.sqlite", LATER_NS)
    assert again.open_passages(LATER_NS).passages == (vehicle.says(CROSSED, evidence=None),)
    again.passage(vehicle.says(CHARGED, evidence=None), LATER_NS)  # the crossing's evidence is on the disk
    assert again.state(LATER_NS).transactions == 1
    store.close()


def test_valid_registrations_are_published_for_a_new_core_toll(opened: tuple[Ledger, Store]) -> None:
    ledger, _ = opened
    vehicle = Vehicle()
    ledger.register(vehicle.registration(), START_NS)
    (station,) = ledger.open_passages(START_NS).registered
    assert station.station_id == vehicle.station_ids[0]
    assert not ledger.open_passages(station.valid_until_ns + 1).registered


def test_a_passage_that_falls_silent_is_settled_but_not_for_the_silence_of_the_ledger_itself(tmp_path: Path) -> None:
    ledger, store = ledger_at(tmp_path / "ledger.sqlite")
    before, behind = Vehicle("a"), Vehicle("b", station_ids=(7,))
    for vehicle, state in ((before, OPEN), (behind, CROSSED)):
        ledger.register(vehicle.registration(), START_NS)
        ledger.passage(vehicle.says(state), START_NS)
    store.close()
    late_ns = START_NS + 1000 * NS
    again, store = ledger_at(tmp_path / "ledger.sqlite", late_ns)
    again.expire(late_ns)
    assert len(again.open_passages(late_ns).passages) == 2
    again.expire(late_ns + 121 * NS)
    assert outcomes(again) == {before.passage_id: PassageState.VOID, behind.passage_id: PassageState.SUSPECT}
    (review,) = again.reviews()
    assert review.contract is not None and again.evidence(behind.passage_id) is not None
    store.close()


@pytest.mark.parametrize("step", range(1, 16))
def test_a_kill_between_any_two_steps_of_a_charge_leaves_all_of_it_or_nothing(tmp_path: Path, step: int) -> None:
    """The statement is repeated until it is settled, so that the next life completes what this one did not."""
    path = tmp_path / "ledger.sqlite"
    ledger, store = ledger_at(path)
    vehicle = Vehicle()
    ledger.register(vehicle.registration(), START_NS)
    ledger.passage(vehicle.says(CROSSED), START_NS)
    execute, calls = store.execute, 0

    def killed(sql: str, *values: str | float | bytes | None) -> int:
        nonlocal calls
        calls += 1
        if calls == step:
            raise KeyboardInterrupt
        return execute(sql, *values)

    store.execute = killed  # type: ignore[method-assign]
    died = False
    try:
        with store.transaction():
            ledger.passage(vehicle.says(CHARGED), LATER_NS)
    except KeyboardInterrupt:
        died = True
    store.close()
    ledger, store = ledger_at(path, LATER_NS)
    stored = [store.row(f"SELECT COUNT(*) AS n FROM {table}") for table in ("booking", "outbox", "evidence", "settled")]
    assert {row["n"] for row in stored if row} == {0 if died else 1}
    with store.transaction():
        ledger.passage(vehicle.says(CHARGED), LATER_NS)
    assert ledger.state(LATER_NS).transactions == 1
    assert died or step > 6, "a charge has at least six steps"
    store.close()


def bytes_on_disk(folder: Path) -> bytes:
    return b"".join(path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file())


def test_ten_minutes_later_nothing_of_an_uncharged_vehicle_is_on_the_disk(tmp_path: Path) -> None:
    """Searched for in every byte of the files: contract, frames, passage, station ID."""
    ledger, store = ledger_at(tmp_path / "ledger.sqlite")
    charged = Vehicle("charged")
    secrets: list[bytes] = []
    for n, end in enumerate((PassageState.VOID, PassageState.SUSPECT, PassageState.UNDECIDED, CROSSED, CHARGED)):
        vehicle = Vehicle(f"uncharged-{n}", (1_000_000 + n,), frames=(f"frame of {n}".encode(),))
        with store.transaction():
            if end in (PassageState.VOID, PassageState.SUSPECT):  # the others have no contract
                ledger.register(vehicle.registration(f"contract-of-{n}"), START_NS)
        with store.transaction():
            for state in (OPEN, CROSSED, end):
                ledger.passage(vehicle.says(state), LATER_NS)
        secrets += [f"contract-of-{n}".encode(), vehicle.passage_id.encode(), str(vehicle.station_ids[0]).encode(),
                    vehicle.says(CROSSED).model_dump_json(include={"evidence"})[-60:-10].encode()]  # fmt: skip
    with store.transaction():
        drive(ledger, charged)
    assert sum(secret in bytes_on_disk(tmp_path) for secret in secrets) > 6, "the search finds what is there"
    for minute in range(1, 10):
        now_ns = LATER_NS + minute * 60 * NS
        with store.transaction():
            ledger.reconcile(now_ns)
            ledger.expire(now_ns)
        store.scrub()
    left = bytes_on_disk(tmp_path)
    assert [secret for secret in secrets if secret in left] == []
    assert charged.passage_id.encode() in left
    assert ledger.evidence(charged.passage_id) is not None
    ledger.expire(LATER_NS + 61 * 86_400 * NS)
    assert ledger.evidence(charged.passage_id) is None
    store.close()


GROWING = {"booking", "settled", "receipt", "evidence", "pulse", "balance"}


class StatementLog(Store):
    """A store that remembers its statements."""

    said: dict[str, int]

    def rows(self, sql: str, *values: Value) -> list[Row]:
        self.said[sql] = len(values)
        return super().rows(sql, *values)

    def execute(self, sql: str, *values: Value) -> int:
        self.said[sql] = len(values)
        return super().execute(sql, *values)


def test_what_is_done_every_second_reads_no_growing_table_from_end_to_end(tmp_path: Path) -> None:
    store = StatementLog(tmp_path / "ledger.sqlite")
    store.said = {}
    ledger = Ledger(store, PLAZA, "", Settings(), START_NS)
    drive(ledger, Vehicle())
    ledger.detect(Vehicle().pulse(), LATER_NS)
    store.said.clear()
    later_ns = LATER_NS + 200 * NS
    ledger.expire(later_ns)
    ledger.reconcile(later_ns)
    ledger.due(later_ns)
    ledger.open_passages(later_ns)
    ledger.state(later_ns)
    assert len(store.said) > 15
    for sql, values in store.said.items():
        for row in Store.rows(store, f"EXPLAIN QUERY PLAN {sql}", *[0] * values):
            words = row["detail"].split()
            is_indexed = "INDEX" in words  # an ordered scan that LIMIT ends
            assert words[0] != "SCAN" or words[1] not in GROWING or is_indexed, (sql, row["detail"])
    assert ledger.state(later_ns).amount_cents == 240
    store.close()


def test_totals_are_those_of_all_bookings_also_after_a_restart(tmp_path: Path) -> None:
    ledger, store = ledger_at(tmp_path / "ledger.sqlite")
    for name in "abc":
        drive(ledger, Vehicle(name))
        ledger.state(LATER_NS)
    ledger.passage(Vehicle("b").says(PassageState.VOID), LATER_NS)
    found = ledger.state(LATER_NS)
    assert (found.transactions, found.reversals, found.amount_cents) == (3, 1, 480)
    store.close()
    ledger, store = ledger_at(tmp_path / "ledger.sqlite")
    again = ledger.state(LATER_NS)
    assert (again.transactions, again.reversals, again.amount_cents) == (3, 1, 480)
    store.close()


def test_a_class_that_the_tariff_has_lost_is_not_charged_and_counted(tmp_path: Path) -> None:
    """The plaza's file was edited between the registration and the exit line."""
    ledger, store = ledger_at(tmp_path / "ledger.sqlite")
    vehicle = Vehicle()
    ledger.register(vehicle.registration(tariff_class="van"), START_NS)
    ledger.passage(vehicle.says(OPEN), START_NS)
    classes = {"car": 240}
    plaza = PLAZA.model_copy(update={"tariff": PLAZA.tariff.model_copy(update={"classes": classes})})
    ledger = Ledger(store, plaza, "", Settings(), START_NS)
    ledger.passage(vehicle.says(CHARGED), LATER_NS)
    assert outcomes(ledger) == {vehicle.passage_id: PassageState.SUSPECT}
    why = explain("ledger.no_class", tariff_class=QuotedText(quoted="van"))
    assert ledger.state(LATER_NS).recent[0].reason_code == why
    assert ledger.due(LATER_NS) == []
    assert ledger.rejects == {"tariff class": 1}
    store.close()


def test_the_list_of_settled_passages_is_bounded_and_has_the_newest(opened: tuple[Ledger, Store]) -> None:
    ledger, store = opened
    with store.transaction():
        for k in range(MAX_SETTLED + 10):
            store.execute("INSERT INTO settled VALUES (?, ?, '{}')", f"{k:064x}", LATER_NS + k)
    found = ledger.open_passages(LATER_NS + NS).settled
    assert len(found) == MAX_SETTLED
    assert found[0] == f"{MAX_SETTLED + 9:064x}"


def test_a_registration_that_was_lost_while_the_ledger_was_down_is_waited_for(opened: tuple[Ledger, Store]) -> None:
    ledger, _ = opened
    vehicle = Vehicle()
    exit_ns = vehicle.crossing_ns + 2 * NS
    charged = vehicle.says(CHARGED, exit_ns=exit_ns)
    ledger.passage(charged, exit_ns)
    assert outcomes(ledger) == {}
    ledger.register(vehicle.registration(), exit_ns + 9 * NS)
    ledger.passage(charged.model_copy(update={"checkpoint": True}), exit_ns + 10 * NS)
    assert outcomes(ledger) == {vehicle.passage_id: CHARGED}
    other = Vehicle("b", station_ids=(9,))
    for waited_s in (1, 16):
        ledger.passage(other.says(CHARGED, exit_ns=exit_ns), exit_ns + waited_s * NS)
    assert outcomes(ledger)[other.passage_id] is PassageState.UNREGISTERED


def test_a_clock_that_jumps_ahead_between_two_starts_deletes_no_evidence_at_once(tmp_path: Path) -> None:
    ledger, store = ledger_at(tmp_path / "ledger.sqlite")
    vehicle = Vehicle("a")
    with store.transaction():
        drive(ledger, vehicle)
    assert ledger.evidence(vehicle.passage_id) is not None
    store.close()
    day_ns, jumped_ns = 86_400 * NS, LATER_NS + 3652 * 86_400 * NS
    again, store = ledger_at(tmp_path / "ledger.sqlite", jumped_ns)
    again.expire(jumped_ns + day_ns - 1)
    assert again.evidence(vehicle.passage_id) is not None
    again.expire(jumped_ns + day_ns)
    assert again.evidence(vehicle.passage_id) is None, "a date that stays is the right one"
    store.close()


def test_the_longest_list_of_settled_passages_and_stations_leaves_room_for_the_open_ones(
    opened: tuple[Ledger, Store], monkeypatch: pytest.MonkeyPatch
) -> None:
    ledger, store = opened
    with store.transaction():
        for k in range(MAX_SETTLED + 10):
            store.execute("INSERT INTO settled VALUES (?, ?, '{}')", f"{k:064x}", LATER_NS + k)
    longest = RegisteredStation(station_id=2**32 - 1, valid_until_ns=4 * 10**18)
    found = ledger.open_passages(LATER_NS + NS).model_copy(update={"registered": STATIONS * (longest,)})
    assert len(encode(found)) + PASSAGES_BYTES + 1_000 <= MANY_BYTES
    for vehicle in (Vehicle(), Vehicle(name="second")):
        ledger.passage(vehicle.says(PassageState.OPEN), LATER_NS)
    first, second = ledger.open_passages(LATER_NS).passages
    monkeypatch.setattr("services.monitoring.ledger.ledger.PASSAGES_BYTES", len(encode(first)) + 10)
    assert ledger.open_passages(LATER_NS).passages == (first,) != (second,)
    assert ledger.rejects["passages left out"] == 1


def test_the_newest_50_vehicles_without_a_contract_are_listed(tmp_path: Path) -> None:
    ledger, store = ledger_at(tmp_path / "ledger.sqlite")
    for n in range(RECENT_PASSAGES + 2):
        ledger.passage(Vehicle(f"v{n}", (n,)).says(OPEN), START_NS + n)
    listed = [row.passage_id for row in ledger.state(LATER_NS).recent]
    assert listed == [Vehicle(f"v{n}", (n,)).passage_id for n in range(2, RECENT_PASSAGES + 2)]
    store.close()

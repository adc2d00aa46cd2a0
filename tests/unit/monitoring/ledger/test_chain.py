"""The chain of the ledger's bookings while it runs: what is signed, and what is never signed as if it were whole."""

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from services.monitoring.ledger.chain import CURRENT, ENTRY, genuine, link_of
from services.monitoring.ledger.ledger import Ledger
from services.monitoring.ledger.proof import prove_ledger
from services.monitoring.ledger.store import Store
from shared.evidence import KeyFile, KeyRing, Outcome
from shared.evidence.statement import is_genuine
from shared.messages.toll import PassageState
from tests.support.v2x.tolling import NS, START_NS, Vehicle, ledger_at

DAY_NS = 86_400 * NS


@pytest.fixture
def key(tmp_path: Path) -> KeyFile:
    return KeyFile(tmp_path / "keys")


def charge(ledger: Ledger, store: Store, name: str, now_ns: int = START_NS) -> None:
    vehicle = Vehicle(name)
    with store.transaction():
        ledger.register(vehicle.registration(), START_NS)
        for state in (PassageState.OPEN, PassageState.CROSSED, PassageState.CHARGED):
            ledger.passage(vehicle.says(state), now_ns)
        ledger.reconcile(now_ns)


def ledger_of(folder: Path, key: KeyFile | None, names: str, now_ns: int = START_NS) -> Path:
    ledger, store = ledger_at(folder / "ledger.sqlite", now_ns, key=key)
    for name in names:
        charge(ledger, store, name, now_ns)
    store.close()
    return folder / "ledger.sqlite"


def change(path: Path, *statements: str) -> None:
    with closing(sqlite3.connect(path)) as database, database:
        for statement in statements:
            database.execute(statement)


def hashed_anew(path: Path) -> None:
    with closing(sqlite3.connect(path)) as database, database:
        database.row_factory = sqlite3.Row
        previous = ""
        rows = database.execute("SELECT * FROM entry JOIN booking USING (transaction_id) ORDER BY number").fetchall()
        for row in rows:
            previous = link_of(previous, row["number"], dict(row))
            database.execute("UPDATE entry SET link = ? WHERE number = ?", (previous, row["number"]))


def test_charges_and_reversals_are_chained_and_signed(tmp_path: Path, key: KeyFile) -> None:
    ledger, store = ledger_at(tmp_path / "ledger.sqlite", key=key)
    for name in "abc":
        charge(ledger, store, name)
    with store.transaction():
        ledger.passage(Vehicle("b").says(PassageState.VOID), START_NS + NS)
    store.close()
    proof = prove_ledger(tmp_path / "ledger.sqlite", key.ring)
    assert (proof.outcome, proof.changed, proof.unsigned) == (Outcome.VERIFIED, {}, set())
    assert proof.text.startswith("4 entries, signed until 2026-09-21 14:20:01 UTC")


def test_a_transaction_is_sent_with_its_signed_place_in_the_chain(tmp_path: Path, key: KeyFile) -> None:
    ledger, store = ledger_at(tmp_path / "ledger.sqlite", key=key)
    for name in "ab":
        charge(ledger, store, name)
    sent = ledger.due(START_NS + NS)
    assert [toll_transaction.seal.number for toll_transaction in sent if toll_transaction.seal] == [1, 2]
    for toll_transaction in sent:
        assert toll_transaction.seal is not None
        fields = {
            "ledger": toll_transaction.seal.ledger, "number": str(toll_transaction.seal.number),
            "link": toll_transaction.seal.link,
            "transaction_id": toll_transaction.transaction_id, "key": toll_transaction.seal.key,
            "public_key": toll_transaction.seal.public_key,
            "signature": toll_transaction.seal.signature,
        }  # fmt: skip
        assert is_genuine(ENTRY, fields) and not is_genuine(CURRENT, fields)
        row = store.row("SELECT link FROM entry WHERE number = ?", toll_transaction.seal.number)
        assert row is not None and row["link"] == toll_transaction.seal.link
    again = ledger.due(START_NS + 100 * NS)
    assert [toll_transaction.seal for toll_transaction in again] == [toll_transaction.seal for toll_transaction in sent]
    store.close()


def test_without_a_key_it_charges_and_chains_and_the_ledger_is_unsigned(tmp_path: Path, key: KeyFile) -> None:
    path = ledger_of(tmp_path, None, "ab")
    proof = prove_ledger(path, key.ring)
    assert proof.outcome is Outcome.UNSIGNED and len(proof.unsigned) == 2
    ledger, store = ledger_at(path)
    assert [toll_transaction.seal for toll_transaction in ledger.due(START_NS)] == [None, None]
    store.close()


def test_a_key_that_cannot_be_used_stops_no_charge_and_is_named(tmp_path: Path) -> None:
    (tmp_path / "keys").write_text("a file where the folder should be")
    ledger, store = ledger_at(tmp_path / "ledger.sqlite", key=KeyFile(tmp_path / "keys"))
    charge(ledger, store, "a")
    assert ledger.state(START_NS).transactions == 1
    assert ledger.chain.problem is not None and "bookings are not signed" in ledger.chain.problem
    store.close()


def test_bookings_made_without_a_key_stay_unsigned_when_it_is_back(tmp_path: Path, key: KeyFile) -> None:
    ledger_of(tmp_path, key, "a")
    ledger_of(tmp_path, None, "bc")
    path = ledger_of(tmp_path, key, "d")
    proof = prove_ledger(path, key.ring)
    assert proof.outcome is Outcome.UNSIGNED
    assert proof.unsigned == {Vehicle(name).passage_id for name in "bc"}
    assert "2 entries are unsigned" in proof.text


def test_a_ledger_that_was_hashed_anew_while_it_did_not_run_is_never_signed_as_whole(
    tmp_path: Path, key: KeyFile
) -> None:
    """Otherwise the next signature would prove what somebody has made of it."""
    path = ledger_of(tmp_path, key, "abc")
    change(path, "UPDATE booking SET amount_cents = 1 WHERE rowid = 2")
    hashed_anew(path)
    ledger_of(tmp_path, key, "d")
    proof = prove_ledger(path, key.ring)
    assert proof.outcome is Outcome.EDITED
    assert "it was changed while the ledger did not run: entry 3 was not as it had been signed" in proof.text


def test_an_end_that_was_removed_while_it_did_not_run_is_never_signed_as_whole(tmp_path: Path, key: KeyFile) -> None:
    path = ledger_of(tmp_path, key, "abc")
    change(path, *(f"DELETE FROM {table} WHERE transaction_id = (SELECT transaction_id FROM entry WHERE number = 3)"
                   for table in ("outbox", "booking")), "DELETE FROM entry WHERE number = 3",
           "DELETE FROM evidence WHERE passage_id NOT IN (SELECT passage_id FROM booking)",
           "DELETE FROM settled WHERE passage_id NOT IN (SELECT passage_id FROM booking)")  # fmt: skip
    assert "entries are missing: 3 to 3" in prove_ledger(path, key.ring).text
    ledger_of(tmp_path, key, "de")
    proof = prove_ledger(path, key.ring)
    assert proof.outcome is Outcome.EDITED and "entry 3 was not as it had been signed" in proof.text


def test_a_row_that_is_changed_while_the_ledger_runs_is_named(tmp_path: Path, key: KeyFile) -> None:
    ledger, store = ledger_at(tmp_path / "ledger.sqlite", key=key)
    charge(ledger, store, "a")
    change(tmp_path / "ledger.sqlite", "UPDATE booking SET amount_cents = 1 WHERE rowid = 1")
    hashed_anew(tmp_path / "ledger.sqlite")
    charge(ledger, store, "b")
    store.close()
    proof = prove_ledger(tmp_path / "ledger.sqlite", key.ring)
    assert proof.outcome is Outcome.EDITED and "entry 1 was not as it had been signed" in proof.text
    assert ledger.chain.problem is not None and "operator's copies" in ledger.chain.problem


def test_each_day_has_a_signature_of_its_own(tmp_path: Path, key: KeyFile) -> None:
    ledger, store = ledger_at(tmp_path / "ledger.sqlite", key=key)
    for day, name in enumerate("abc"):
        charge(ledger, store, name, START_NS + day * DAY_NS)
        for _ in range(2):
            with store.transaction():
                ledger.expire(START_NS + day * DAY_NS)
    assert [row["name"] for row in store.rows("SELECT name FROM head ORDER BY name")] == [
        "2026-09-21", "2026-09-22", "2026-09-23", "current",
    ]  # fmt: skip
    assert prove_ledger(tmp_path / "ledger.sqlite", key.ring).outcome is Outcome.VERIFIED
    of_day = store.row("SELECT statement FROM head WHERE name = '2026-09-22'")
    assert of_day is not None and genuine(CURRENT, of_day["statement"]) is None
    with store.transaction():
        store.execute("UPDATE head SET statement = ? WHERE name = 'current'", of_day["statement"])
    assert prove_ledger(tmp_path / "ledger.sqlite", key.ring).outcome is Outcome.EDITED
    store.close()


def test_evidence_that_may_not_be_kept_longer_is_not_missed(tmp_path: Path, key: KeyFile) -> None:
    ledger, store = ledger_at(tmp_path / "ledger.sqlite", key=key)
    charge(ledger, store, "a")
    with store.transaction():
        ledger.expire(START_NS + 61 * DAY_NS)
    charge(ledger, store, "b", START_NS + 61 * DAY_NS)
    assert len(store.rows("SELECT 1 FROM evidence")) == 1
    assert prove_ledger(tmp_path / "ledger.sqlite", key.ring).outcome is Outcome.VERIFIED
    with store.transaction():
        store.execute("DELETE FROM evidence")
    proof = prove_ledger(tmp_path / "ledger.sqlite", key.ring)
    assert proof.outcome is Outcome.EDITED and f"the evidence of passage {Vehicle('b').passage_id[:8]}" in proof.text
    store.close()


def test_a_rotated_key_goes_on_in_the_same_chain(tmp_path: Path, key: KeyFile) -> None:
    ledger, store = ledger_at(tmp_path / "ledger.sqlite", key=key)
    charge(ledger, store, "a")
    old = key.signer().key_id
    KeyFile(key.folder).rotate(START_NS)
    charge(ledger, store, "b")
    store.close()
    proof = prove_ledger(tmp_path / "ledger.sqlite", key.ring)
    assert proof.outcome is Outcome.VERIFIED
    newest = KeyRing(tuple(public_key for public_key in key.ring.keys if public_key.key_id != old))
    assert prove_ledger(tmp_path / "ledger.sqlite", newest).changed.keys() == {Vehicle("a").passage_id}


def test_what_is_rolled_back_leaves_no_gap(tmp_path: Path, key: KeyFile) -> None:
    ledger, store = ledger_at(tmp_path / "ledger.sqlite", key=key)
    charge(ledger, store, "a")
    vehicle = Vehicle("b")
    with pytest.raises(ZeroDivisionError), store.transaction():
        ledger.register(vehicle.registration(), START_NS)
        for state in (PassageState.OPEN, PassageState.CROSSED, PassageState.CHARGED):
            ledger.passage(vehicle.says(state), START_NS)
        ledger.reconcile(START_NS)
        raise ZeroDivisionError
    charge(ledger, store, "c")
    store.close()
    proof = prove_ledger(tmp_path / "ledger.sqlite", key.ring)
    assert proof.outcome is Outcome.VERIFIED and proof.text.startswith("2 entries")

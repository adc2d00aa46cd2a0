"""`obu verify-toll`: charges are recomputed from their evidence, and changes of the evidence are found."""

import json
import sqlite3
import zlib
from contextlib import closing
from hashlib import sha256
from pathlib import Path

import pytest

from benchmarks.toll_campaign import Campaign
from cli.verify_toll import Evidence, differences_of, parse, read, verify_toll, with_seal
from services.monitoring.ledger.chain import CURRENT, Chain, link_of
from shared.errors import UserError
from shared.evidence import KeyFile, Outcome
from shared.evidence.outcome import OTHER_RELEASE
from shared.evidence.statement import signed
from shared.messages.toll import PassageState
from shared.unpacked import MIN_LIMIT_BYTES
from tests.support.v2x.tolling import START_NS, Vehicle, ledger_at


@pytest.fixture(scope="module")
def ledger(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ledger of at least three charges at the simulated plaza, without kills."""
    folder = tmp_path_factory.mktemp("toll")
    made = Campaign(folder, 1, 6, float("inf"))
    made.run(12)
    assert made.store is not None
    made.store.close()
    return made.path


@pytest.fixture(autouse=True)
def keys(ledger: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The campaign keeps its key beside the ledger."""
    monkeypatch.setenv("OBU_KEYS", str(ledger.parent))


def test_every_charge_is_recomputed_bit_for_bit(ledger: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert verify_toll([ledger]) == 0
    *_, last = capsys.readouterr().out.splitlines()
    number = int(last.split()[0])
    assert number >= 3 and last == f"{number} of {number} charges verified"


def test_an_exported_pack_is_verified_without_the_ledger(ledger: Path, tmp_path: Path) -> None:
    first = next(iter(read(ledger)))
    assert verify_toll([ledger], first.name, tmp_path) == 0
    (path,) = tmp_path.iterdir()
    assert path.stem == first.name and verify_toll([path]) == 0


@pytest.mark.parametrize("change", ["lane", "frame", "amount", "plaza", "crossing"])
def test_a_change_of_the_evidence_is_found(ledger: Path, change: str) -> None:
    evidence = next(iter(read(ledger)))
    pack = parse(evidence)
    assert pack.crossed.evidence is not None
    shown = pack.crossed.evidence
    changes: dict[str, dict[str, object]] = {
        "lane": {"crossed": pack.crossed.model_copy(update={"lane": "s9"})},
        "frame": {"crossed": pack.crossed.model_copy(
            update={"evidence": shown.model_copy(update={"frames": shown.frames[:20] + shown.frames[21:]})})},
        "amount": {"amount_cents": pack.amount_cents + 1},
        "plaza": {"plaza_file": pack.plaza_file + " "},
        "crossing": {"crossed": pack.crossed.model_copy(update={"crossing_ns": (pack.crossed.crossing_ns or 0) + 1})},
    }  # fmt: skip
    forged = pack.model_copy(update=changes[change])
    assert differences_of(evidence, pack) == []
    assert differences_of(evidence, forged)


def test_a_pack_of_earlier_algorithms_is_left_to_the_release_that_made_it(
    ledger: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    evidence = next(iter(read(ledger)))
    pack = parse(evidence)
    assert pack.crossed.evidence is not None
    older = pack.crossed.evidence.model_copy(update={"version": "2"})
    earlier = pack.model_copy(update={"crossed": pack.crossed.model_copy(update={"evidence": older})})
    path = tmp_path / "pack.json"
    path.write_text(earlier.model_dump_json())
    assert verify_toll([path]) == Outcome.UNSIGNED
    printed = capsys.readouterr().out
    assert "of version 2 of the algorithms" in printed and "0 of 1 charges verified" in printed
    path.write_text(earlier.model_copy(update={"amount_cents": pack.amount_cents + 1}).model_dump_json())
    assert verify_toll([path]) == 1, "what does not depend on the version is judged"
    signed = path.with_name("signed.json")
    signed.write_bytes(with_seal(sealed(ledger, earlier.model_dump_json().encode(), pack.charged.passage_id)))
    assert verify_toll([signed]) == OTHER_RELEASE


def sealed(ledger: Path, pack: bytes, passage_id: str) -> Evidence:
    """A pack with the signature of the ledger's unit."""
    (_, store) = ledger_at(ledger.parent / "other.sqlite", key=KeyFile(ledger.parent))
    try:
        seal = Chain(store, KeyFile(ledger.parent), "").pack_seal(passage_id, sha256(pack).hexdigest(), START_NS)
    finally:
        store.close()
    return Evidence(passage_id, pack, seal=seal)


def test_trusted_certificates_that_judge_no_charge_are_named(
    ledger: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert verify_toll([ledger], trust=tmp_path) in (0, 1)
    printed = capsys.readouterr().out
    assert "--trust has judged no chain" in printed or "not trusted by the folder" in printed


def test_a_pack_that_differs_from_that_of_the_transaction_is_reported(ledger: Path) -> None:
    evidence = next(iter(read(ledger)))
    other = type(evidence)(evidence.name, evidence.pack + b" ", evidence.transaction)
    assert differences_of(other, parse(evidence))[0] == "the pack is not the one of the transaction"


@pytest.mark.parametrize("content", [b"", b"{}", b"SQLite format 3\0garbage"])
def test_a_file_without_evidence_is_a_user_error(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "file"
    path.write_bytes(content)
    with pytest.raises(UserError, match="file"):
        verify_toll([path])


def test_an_unknown_passage_is_a_user_error(ledger: Path) -> None:
    with pytest.raises(UserError, match="no evidence of ffffffffff"):
        verify_toll([ledger], "ffffffffff")


@pytest.mark.parametrize(
    ("column", "damage"),
    [("pack", b"no zlib"), ("pack", b""), ("pack", "a text"), ("pack", zlib.compress(b"{}")),
     ("pack", zlib.compress(b"\xff")), ("pack", zlib.compress(bytes(MIN_LIMIT_BYTES + 1))),
     ("content", "{"), ("content", b"\x00")],
)  # fmt: skip
def test_a_damaged_row_is_a_sentence_and_the_other_charges_are_verified(
    ledger: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], column: str, damage: str | bytes
) -> None:
    copy = tmp_path / "ledger.sqlite"
    copy.write_bytes(ledger.read_bytes())
    first, *others = [evidence.name for evidence in read(ledger)]
    table = "evidence" if column == "pack" else "booking"
    with sqlite3.connect(copy) as database:
        database.execute(f"UPDATE {table} SET {column} = ? WHERE passage_id = ?", (damage, first))
    assert verify_toll([copy]) == (1 if column == "pack" else Outcome.EDITED)
    lines = capsys.readouterr().out.splitlines()
    what = "evidence" if column == "pack" else "transaction"
    said = next(line for line in lines if line.startswith(first))
    assert f"its {what} is damaged" in said and "restore the ledger" in said
    assert lines[-1] == f"{len(others)} of {len(others) + 1} charges verified"
    assert verify_toll([copy], others[0]) == 0


def edited(ledger: Path, to: Path, *statements: str) -> Path:
    to.write_bytes(ledger.read_bytes())
    with closing(sqlite3.connect(to)) as database, database:
        for statement in statements:
            database.execute(statement)
    return to


def bookings(ledger: Path) -> list[tuple[int, str, str]]:
    """Number, transaction and passage of each charge that has evidence."""
    with sqlite3.connect(ledger) as database:
        return database.execute(
            "SELECT number, transaction_id, passage_id FROM entry JOIN booking USING (transaction_id) "
            "JOIN evidence USING (passage_id) ORDER BY number"
        ).fetchall()


def test_the_signed_chain_is_named(ledger: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert verify_toll([ledger]) == Outcome.VERIFIED
    first = capsys.readouterr().out.splitlines()[0]
    assert first.startswith("ledger.sqlite: ") and " entries, signed until " in first


@pytest.mark.parametrize(
    ("change", "said"),
    [("UPDATE booking SET amount_cents = 1 WHERE transaction_id = '{id}'", "is not the one that was signed"),
     ("UPDATE booking SET booked_ns = booked_ns + 1 WHERE transaction_id = '{id}'", "is not the one that was signed"),
     ("UPDATE booking SET content = replace(content, 'contract', 'Contract') WHERE transaction_id = '{id}'",
      "is not the one that was signed"),
     ("DELETE FROM booking WHERE transaction_id = '{id}'", "was removed"),
     ("DELETE FROM evidence WHERE passage_id = '{passage}'", "was removed"),
     ("UPDATE evidence SET digest = '{other}' WHERE passage_id = '{passage}'", "is not the one that was signed"),
     ("UPDATE evidence SET seal = replace(seal, '\"stored_ns\": \"1', '\"stored_ns\": \"2')", "does not fit it"),
     ("UPDATE head SET statement = replace(statement, 'ledger', 'Ledger') WHERE name = 'current'", "does not fit it"),
     ("INSERT INTO booking SELECT 'x', passage_id, 'reversal', booked_ns, -amount_cents, content FROM booking "
      "WHERE transaction_id = '{id}'", "was added beside the chain")],
)  # fmt: skip
def test_a_change_of_the_ledger_is_named(
    ledger: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], change: str, said: str
) -> None:
    _, transaction, passage = bookings(ledger)[1]
    statement = change.format(id=transaction, passage=passage, other="0" * 64)
    copy = edited(ledger, tmp_path / "ledger.sqlite", statement)
    assert verify_toll([copy], passage) == Outcome.EDITED
    assert said in capsys.readouterr().out


def test_a_row_removed_with_its_entry_is_named_in_the_middle_and_at_the_end(
    ledger: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = bookings(ledger)
    with closing(sqlite3.connect(ledger)) as database:
        (last,) = database.execute("SELECT MAX(number) FROM entry").fetchone()
    for number in (1, 2, last):
        remove = (
            f"DELETE FROM booking WHERE transaction_id = (SELECT transaction_id FROM entry WHERE number = {number})",
            "DELETE FROM evidence WHERE passage_id NOT IN (SELECT passage_id FROM booking)",
            "DELETE FROM settled WHERE passage_id NOT IN (SELECT passage_id FROM booking)",
            "DELETE FROM receipt WHERE transaction_id NOT IN (SELECT transaction_id FROM booking)",
            f"DELETE FROM entry WHERE number = {number}",
        )
        assert verify_toll([edited(ledger, tmp_path / f"{number}.sqlite", *remove)], rows[2][2]) == Outcome.EDITED
        assert f"entries are missing: {number} to {number}" in capsys.readouterr().out


def hashed_anew(path: Path) -> None:
    """Compute every link of a ledger, as somebody who knows the format would."""
    with closing(sqlite3.connect(path)) as database, database:
        database.row_factory = sqlite3.Row
        previous = ""
        rows = database.execute("SELECT * FROM entry JOIN booking USING (transaction_id) ORDER BY number").fetchall()
        for number, row in enumerate(rows, 1):
            previous = link_of(previous, number, dict(row))
            database.execute("UPDATE entry SET number = ?, link = ? WHERE transaction_id = ?",
                             (number, previous, row["transaction_id"]))  # fmt: skip


def test_a_chain_that_was_hashed_anew_is_named(
    ledger: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    change = "UPDATE booking SET amount_cents = 1, content = replace(content, '240', '1')"
    copy = edited(ledger, tmp_path / "ledger.sqlite", f"{change} WHERE transaction_id = '{bookings(ledger)[1][1]}'")
    hashed_anew(copy)
    assert verify_toll([copy], bookings(ledger)[0][2]) == Outcome.EDITED
    assert "the chain was computed anew" in capsys.readouterr().out


def test_a_ledger_of_another_unit_is_of_an_unknown_key(
    ledger: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    passage = bookings(ledger)[0][2]
    monkeypatch.setenv("OBU_KEYS", str(tmp_path / "elsewhere"))
    assert verify_toll([ledger], passage) == Outcome.FOREIGN
    assert "which is not among the accepted ones" in capsys.readouterr().out
    assert verify_toll([ledger], passage, key=[ledger.parent / "ring.json"]) == Outcome.VERIFIED


def test_a_signature_of_another_key_does_not_stand_for_that_of_the_ledger(ledger: Path, tmp_path: Path) -> None:
    """A row is changed, everything computed anew, and signed with a key that is at hand."""
    change = "UPDATE booking SET amount_cents = 1, content = replace(content, '240', '1')"
    copy = edited(ledger, tmp_path / "ledger.sqlite", f"{change} WHERE transaction_id = '{bookings(ledger)[1][1]}'")
    hashed_anew(copy)
    with closing(sqlite3.connect(copy)) as database, database:
        (text,) = database.execute("SELECT statement FROM head WHERE name = 'current'").fetchone()
        (link,) = database.execute("SELECT link FROM entry ORDER BY number DESC LIMIT 1").fetchone()
        fields = {**json.loads(text), "link": link}
        forged = signed(CURRENT, fields, KeyFile(tmp_path / "keys").signer())
        database.execute("UPDATE head SET statement = ? WHERE name = 'current'", (json.dumps(forged),))
    assert verify_toll([copy], bookings(ledger)[0][2]) == Outcome.FOREIGN


def test_without_its_signatures_a_chain_is_unsigned(ledger: Path, tmp_path: Path) -> None:
    copy = edited(ledger, tmp_path / "ledger.sqlite", "DELETE FROM head")
    assert verify_toll([copy], bookings(ledger)[0][2]) == Outcome.UNSIGNED


def test_a_pack_is_signed_and_a_change_of_it_is_named(ledger: Path, tmp_path: Path) -> None:
    first = next(iter(read(ledger)))
    verify_toll([ledger], first.name, tmp_path)
    (path,) = tmp_path.iterdir()
    content = path.read_bytes()
    assert verify_toll([path]) == Outcome.VERIFIED
    path.write_bytes(content + b"\n")
    assert verify_toll([path]) == Outcome.VERIFIED
    path.write_bytes(content.replace(b'"stored_ns": "1', b'"stored_ns": "2'))
    assert verify_toll([path]) == Outcome.EDITED
    path.write_bytes(content.replace(b'"contract":"', b'"contract":"x', 1))
    assert verify_toll([path]) == Outcome.EDITED
    path.write_bytes(first.pack)
    assert verify_toll([path]) == Outcome.UNSIGNED


def test_a_pack_of_another_unit_is_of_an_unknown_key(
    ledger: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = next(iter(read(ledger)))
    verify_toll([ledger], first.name, tmp_path / "packs")
    (path,) = (tmp_path / "packs").iterdir()
    monkeypatch.setenv("OBU_KEYS", str(tmp_path / "elsewhere"))
    assert verify_toll([path]) == Outcome.FOREIGN
    assert verify_toll([path], key=[ledger.parent / "ring.json"]) == Outcome.VERIFIED


def test_a_ledger_of_a_version_without_signatures_is_unsigned(
    ledger: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    old = edited(ledger, tmp_path / "ledger.sqlite", "DROP TABLE head", "DROP TABLE entry",
                 "ALTER TABLE evidence DROP COLUMN seal", "PRAGMA user_version = 2")  # fmt: skip
    assert verify_toll([old], bookings(ledger)[0][2]) == Outcome.UNSIGNED
    assert "of a version without signatures" in capsys.readouterr().out


def test_an_old_ledger_is_chained_and_its_charges_stay_unsigned(
    ledger: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    old = edited(ledger, tmp_path / "ledger.sqlite", "DROP TABLE head", "DROP TABLE entry",
                 "ALTER TABLE evidence DROP COLUMN seal", "PRAGMA user_version = 2",
                 "DELETE FROM outbox")  # fmt: skip
    (_, _, passage), *_ = bookings(ledger)
    opened, store = ledger_at(old, key=KeyFile(ledger.parent))
    with store.transaction():
        opened.expire(START_NS + 60_000_000_000)
    vehicle = Vehicle("new")
    with store.transaction():
        opened.register(vehicle.registration(), START_NS)
        opened.passage(vehicle.says(PassageState.OPEN), START_NS)
        opened.passage(vehicle.says(PassageState.CHARGED), START_NS + 30_000_000_000)
        opened.reconcile(START_NS + 30_000_000_000)
    store.close()
    assert verify_toll([old], passage) == Outcome.UNSIGNED
    assert "entries are unsigned" in capsys.readouterr().out
    changed = edited(old, tmp_path / "b.sqlite", "UPDATE booking SET amount_cents = 1 WHERE rowid = 1")
    assert verify_toll([changed]) == Outcome.EDITED


def test_what_the_operator_has_kept_names_a_ledger_that_was_put_back(
    ledger: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with closing(sqlite3.connect(ledger)) as database:
        (statement,) = database.execute("SELECT statement FROM head WHERE name = 'current'").fetchone()
    kept = tmp_path / "seal.json"
    kept.write_text(f"{statement}\n")
    assert verify_toll([ledger], seal=[kept]) == Outcome.VERIFIED
    number, transaction, _ = bookings(ledger)[-1]
    early = edited(
        ledger, tmp_path / "early.sqlite", f"DELETE FROM entry WHERE number = {number}",
        f"DELETE FROM outbox WHERE transaction_id = '{transaction}'",
    )  # fmt: skip
    assert verify_toll([early], seal=[kept]) == Outcome.EDITED
    assert f"it was put back: the operator has entry {number}" in capsys.readouterr().out

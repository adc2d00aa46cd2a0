"""Checks the chain and the signatures of a ledger: no booking was changed, removed or added beside the ledger."""

import json
import sqlite3
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from shared.evidence import KeyRing, Outcome, PublicKey
from shared.evidence.statement import printable

from .accounts import account_link, counts_of
from .chain import BOOKING_COLUMNS, CURRENT, CURRENT_ROW, DAY, PACK, genuine, link_of

MAX_NAMED_FAULTS = 8  # faults that are named one by one


@dataclass
class LedgerProof:
    """What the chain of a ledger proves."""

    outcome: Outcome = Outcome.VERIFIED
    sentences: list[str] = field(default_factory=list)
    changed: dict[str, str] = field(default_factory=dict)  # what was changed, by passage
    unsigned: set[str] = field(default_factory=set)  # passages whose charge is not signed
    has_entries: bool = False  # False: of a version that chained nothing

    @property
    def text(self) -> str:
        """All sentences in one line."""
        more = len(self.sentences) - MAX_NAMED_FAULTS
        return "; ".join([*self.sentences[:MAX_NAMED_FAULTS], *([f"and {more} more"] if more > 0 else [])])

    def fault(self, text: str) -> None:
        """Note something that concerns the whole ledger."""
        self.outcome = Outcome.EDITED
        self.sentences.append(text)


@dataclass
class _Entries:
    """What is kept of the entries: the links that a statement names, and how many there are."""

    links: dict[int, str]  # by number; empty until it is found
    ranges: list[tuple[int, int]]  # of entries that are not signed, the last up to the end
    count: int = 0
    last: int = 0
    unsigned: int = 0


def prove_ledger(path: Path, ring: KeyRing, seals: Sequence[str] = ()) -> LedgerProof:
    """Check a ledger against accepted keys; raises `sqlite3.Error` if it cannot be read.

    `seals` are signed statements that the operator has kept: a ledger that ends before one of them was put back.
    """
    proof = LedgerProof()
    with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as database:
        database.row_factory = sqlite3.Row
        tables = {row["name"] for row in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        if not {"entry", "head"} <= tables:
            proof.outcome = Outcome.UNSIGNED
            proof.sentences.append("unsigned: of a version without signatures; the ledger chains it when it starts")
            return proof
        proof.has_entries = True
        statements = {str(row["name"]): row["statement"] for row in database.execute("SELECT * FROM head")}
        current = genuine(CURRENT, statements.get(CURRENT_ROW))
        if current is not None and not _has_numbers(current):
            current = None
        days = {name: genuine(DAY, text) for name, text in statements.items() if name != CURRENT_ROW}
        numbers = [
            int(record["number"]) for record in (current, *days.values()) if record is not None and _has_numbers(record)
        ]
        signed = int(current["number"]) if current else 0
        kept = [fields for text in seals if (fields := _kept(text, proof)) is not None]
        numbers += [int(fields["number"]) for fields in kept]
        entries = _Entries(dict.fromkeys(numbers, ""), [*_ranges(current or {}), (signed + 1, sys.maxsize)])
        _check_rows(database, entries, proof)
        _check_others(database, proof)
        _check_heads(statements, current, entries, proof)
        _check_answers(database, proof)
        _check_seals(kept, current, entries, ring, proof)
        if current is not None:
            _check_days(current, days, entries, proof)
            _check_key(current, ring, proof)
            if "account" in tables:
                _check_accounts(database, current, proof)
            _check_missing_packs(database, current, proof)
            ring = ring.with_key(PublicKey(current["key"], bytes.fromhex(current["public_key"])))  # it is named once
        _check_packs(database, ring, proof)
        if proof.changed:
            proof.sentences.append(f"{len(proof.changed)} charges are not those that were signed")
        elif current is not None and proof.outcome in (Outcome.VERIFIED, Outcome.UNSIGNED):
            proof.sentences.append(f"{entries.count} entries, signed until {_time(current['signed_ns'])}")
    return proof


def _check_rows(database: sqlite3.Connection, entries: _Entries, proof: LedgerProof) -> None:
    """Compute each link by the one that is stated before it."""
    expected, previous = 1, ""
    for row in database.execute(
        f"SELECT number, entry.transaction_id AS entered, link, {', '.join(f'booking.{n}' for n in BOOKING_COLUMNS)} "
        "FROM entry LEFT JOIN booking USING (transaction_id) ORDER BY number"
    ):
        number, passage_id = row["number"], str(row["passage_id"])
        if number != expected:
            proof.fault(f"entries are missing: {expected} to {number - 1}")
        elif row["passage_id"] is None:
            proof.fault(f"the booking of entry {expected} was removed (transaction {printable(row['entered'], 8)})")
        elif not _fits(row, previous):
            proof.changed[passage_id] = f"entry {expected} is not the one that was signed"
        if number in entries.links:
            entries.links[number] = str(row["link"])
        if any(first <= number <= last for first, last in entries.ranges):
            entries.unsigned += 1
            proof.unsigned.add(passage_id)
        entries.count, entries.last = entries.count + 1, number
        expected, previous = number + 1, row["link"]


def _fits(row: sqlite3.Row, previous: str) -> bool:
    try:
        return link_of(previous, row["number"], dict(row)) == str(row["link"])
    except (TypeError, ValueError):  # SQLite stores any type anywhere
        return False


def _check_others(database: sqlite3.Connection, proof: LedgerProof) -> None:
    """Name what is beside the chain, or refers to what is no longer there."""
    for row in database.execute(
        "SELECT passage_id, kind FROM booking WHERE transaction_id NOT IN (SELECT transaction_id FROM entry)"
    ):
        proof.fault(
            f"the {printable(row['kind'], 12)} of passage {printable(row['passage_id'], 8)} was added beside the chain"
        )
    for row in database.execute(
        "SELECT transaction_id FROM receipt WHERE transaction_id NOT IN (SELECT transaction_id FROM booking)"
    ):
        proof.fault(f"there is a receipt of transaction {printable(row['transaction_id'], 8)}, and no booking of it")
    for row in database.execute(
        "SELECT passage_id, summary FROM settled WHERE passage_id NOT IN (SELECT passage_id FROM booking)"
    ):
        if _state(row["summary"]) == "charged":
            proof.fault(f"passage {printable(row['passage_id'], 8)} was charged, and its booking is not there")


def _state(summary: object) -> object:
    try:
        return json.loads(str(summary)).get("state")
    except (ValueError, AttributeError, RecursionError):
        return None


def _check_heads(
    statements: Mapping[str, object], current: dict[str, str] | None, entries: _Entries, proof: LedgerProof
) -> None:
    """Compare the newest signed statement with the chain."""
    if current is None:
        if CURRENT_ROW in statements:
            proof.fault("the signature of its newest entry does not fit it")
        elif statements:
            proof.fault("the signature of its newest entry was removed")
        elif proof.outcome is Outcome.VERIFIED:
            proof.outcome = Outcome.UNSIGNED
            proof.sentences.append("unsigned: its entries are chained, and nothing of them is signed")
        return
    number = int(current["number"])
    if number > entries.last:
        proof.fault(f"entries are missing: {entries.last + 1} to {number}, the last that was signed")
    elif number and entries.links[number] != current["link"]:
        proof.fault(f"entry {number} is not the one that was signed: the chain was computed anew")
    if current.get("broken"):
        proof.fault(f"it was changed while the ledger did not run: {printable(current['broken'], 100)}")
    if entries.unsigned:
        if proof.outcome is Outcome.VERIFIED:
            proof.outcome = Outcome.UNSIGNED
        proof.sentences.append(f"{entries.unsigned} entries are unsigned: of an earlier version, or without a key")


def _check_days(
    current: Mapping[str, str], days: Mapping[str, dict[str, str] | None], entries: _Entries, proof: LedgerProof
) -> None:
    for name, fields in days.items():
        if fields is None or not _has_numbers(fields) or fields.get("day") != name:
            proof.fault(f"the signature of {printable(name, 10)} does not fit it")
        elif fields["ledger"] != current["ledger"]:
            proof.fault(f"the signature of {printable(name, 10)} is that of another ledger")
        elif entries.links[int(fields["number"])] != fields["link"]:
            proof.fault(f"entry {fields['number']} is not the one that was signed on {printable(name, 10)}")


def _kept(text: str, proof: LedgerProof) -> dict[str, str] | None:
    """Read a statement that the operator has kept: as it was published, or the message with it."""
    try:
        whole = json.loads(text)
        text = whole.get("statement", text)
    except (ValueError, AttributeError, RecursionError):
        proof.fault("a seal is no signed statement; give the file of seal_file, or what toll/seal has carried")
        return None
    fields = genuine(CURRENT, text)
    if fields is None or not _has_numbers(fields):
        proof.fault("the signature of a seal does not fit it")
        return None
    return fields


def _check_seals(
    kept: Sequence[dict[str, str]], current: Mapping[str, str] | None, entries: _Entries, ring: KeyRing,
    proof: LedgerProof,
) -> None:  # fmt: skip
    """Compare the ledger with what the operator has kept of it."""
    for fields in kept:
        number, signed_ns = int(fields["number"]), fields["signed_ns"]
        _check_key(fields, ring, proof)
        if current is not None and fields["ledger"] != current["ledger"]:
            proof.fault("a seal is that of another ledger")
        elif number > entries.last:
            proof.fault(f"it was put back: the operator has entry {number} of {_time(signed_ns)}, it ends with "
                        f"{entries.last}")  # fmt: skip
        elif number and entries.links[number] != fields["link"]:
            proof.fault(f"entry {number} is not the one that the operator has")
        elif current is not None and _later(fields, current):
            proof.fault(f"it was put back: the operator has a state of {_time(signed_ns)}, which is later")


def _later(fields: Mapping[str, str], current: Mapping[str, str]) -> bool:
    """Whether a statement is later than the ledger's newest one, in its accounts, detections or time."""
    names = ("accounts", "detections", "signed_ns")
    return any(_number(fields.get(name)) > _number(current.get(name)) for name in names)


def _number(text: str | None) -> int:
    return int(text) if text and text.isdecimal() else 0


def _check_answers(database: sqlite3.Connection, proof: LedgerProof) -> None:
    """Each entry has a receipt, or waits for one."""
    for row in database.execute(
        "SELECT number FROM entry WHERE transaction_id NOT IN (SELECT transaction_id FROM receipt) "
        "AND transaction_id NOT IN (SELECT transaction_id FROM outbox) ORDER BY number"
    ):
        proof.fault(f"entry {row['number']} has neither a receipt nor a row of the outbox")


def _check_accounts(database: sqlite3.Connection, current: Mapping[str, str], proof: LedgerProof) -> None:
    """Compare closed hours with their chain and with the balances, and the number of detections with the signed one."""
    expected, previous = 1, ""
    signed_number, signed_link = _number(current.get("accounts")), current.get("accounts_link", "")
    for row in database.execute("SELECT * FROM account ORDER BY number"):
        number, counts = row["number"], str(row["counts"])
        if number != expected or not _account_fits(row, previous):
            proof.fault(f"account {expected} is not the one that was closed")
            return
        if number == signed_number and row["link"] != signed_link:
            proof.fault(f"account {number} is not the one that was signed")
        rows = database.execute(
            "SELECT outcome, n FROM balance WHERE hour_ns = ? AND lane = ?", (row["hour_ns"], row["lane"])
        )
        if counts_of({str(each["outcome"]): each["n"] for each in rows}) != counts:
            proof.fault(f"the balance of lane {printable(row['lane'], 20)} differs from its closed account {number}")
        expected, previous = number + 1, str(row["link"])
    if signed_number >= expected:
        proof.fault(f"accounts are missing: {expected} to {signed_number}, the last that was signed")
    counted = database.execute("SELECT SUM(n) AS n FROM balance WHERE outcome = 'detections'").fetchone()["n"] or 0
    if counted < _number(current.get("detections")):
        proof.fault(f"{_number(current.get('detections')) - counted} detections were removed from the balances")


def _account_fits(row: sqlite3.Row, previous: str) -> bool:
    try:
        return bool(account_link(previous, row["number"], row["hour_ns"], row["lane"], row["counts"]) == row["link"])
    except (TypeError, ValueError):  # SQLite stores any type anywhere
        return False


def _has_numbers(fields: Mapping[str, str]) -> bool:
    try:
        int(fields["number"]), int(fields["signed_ns"]), int(fields["evidence_from_ns"]), list(_ranges(fields))
    except (KeyError, ValueError):
        return False
    return "link" in fields and "ledger" in fields


def _ranges(fields: Mapping[str, str]) -> Iterator[tuple[int, int]]:
    for name in fields.get("unsigned", "").split():
        first, _, last = name.partition("-")
        yield int(first), int(last)


def _check_key(fields: Mapping[str, str], ring: KeyRing, proof: LedgerProof) -> None:
    known = ring.find(fields["key"])
    if known is not None and known.public_key.hex() == fields["public_key"]:
        return
    if proof.outcome is not Outcome.EDITED:
        proof.outcome = Outcome.FOREIGN
    proof.sentences.append(
        f"signed by key {fields['key'][:16]}, which is not among the accepted ones; give its public key with --key"
    )


def _check_packs(database: sqlite3.Connection, ring: KeyRing, proof: LedgerProof) -> None:
    for row in database.execute("SELECT passage_id, digest, seal FROM evidence"):
        passage_id = str(row["passage_id"])
        if (seal := row["seal"]) is None:
            proof.unsigned.add(passage_id)
        elif (fault := pack_fault(seal, passage_id, str(row["digest"]), ring)) is not None:
            proof.changed.setdefault(passage_id, fault[1])


def pack_fault(seal: object, passage_id: str | None, digest: str, ring: KeyRing) -> tuple[Outcome, str] | None:
    """Say what is wrong with the signature of an evidence pack; None if it is good."""
    fields = genuine(PACK, seal)
    if fields is None:
        return Outcome.EDITED, "the signature of its evidence does not fit it"
    if fields.get("digest") != digest or passage_id not in (None, fields.get("passage_id")):
        return Outcome.EDITED, "its evidence is not the one that was signed"
    known = ring.find(fields["key"])
    if known is None or known.public_key.hex() != fields["public_key"]:
        return Outcome.FOREIGN, f"its evidence is signed by key {fields['key'][:16]}, which is not among the accepted"
    return None


def _check_missing_packs(database: sqlite3.Connection, current: Mapping[str, str], proof: LedgerProof) -> None:
    """Name charges whose evidence must still be there."""
    for charge in database.execute(
        "SELECT passage_id FROM booking WHERE kind = 'charge' AND booked_ns >= ? "
        "AND passage_id NOT IN (SELECT passage_id FROM evidence)", (int(current["evidence_from_ns"]),),
    ):  # fmt: skip
        proof.fault(f"the evidence of passage {printable(charge['passage_id'], 8)} was removed")


def _time(stamp_ns: str) -> str:
    try:
        return f"{datetime.fromtimestamp(int(stamp_ns) // 1_000_000_000, UTC):%Y-%m-%d %H:%M:%S} UTC"
    except (ValueError, OverflowError, OSError):
        return "a time out of range"

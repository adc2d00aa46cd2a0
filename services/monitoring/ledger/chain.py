"""The chain of bookings: each entry has the hash of the one before, and the newest is signed.

    link = SHA-256(link of the entry before, JSON of number and booking)

Links alone prove nothing to somebody who computes them anew. The signature does: of the newest entry with each booking
and each hour (`current`), which also states the newest closed account and how many detections there were, of the newest
entry of each day, of each entry in the message that sends it, and of each
evidence pack. They are of different kinds, so that none can stand in for the current one, which is stored once and
overwritten.
"""

import hashlib
import json
import logging
import secrets
from collections.abc import Mapping
from datetime import UTC, datetime

from shared.evidence import EvidenceError, KeyFile
from shared.evidence.statement import is_genuine, signed
from shared.messages.toll import LedgerSeal

from .store import Row, Store

log = logging.getLogger(__name__)

CURRENT, DAY, ENTRY, PACK = "ledger current", "ledger day", "ledger entry", "evidence pack"
ROW = "ledger row"
CURRENT_ROW = "current"  # name of its row; those of the days are dates
MAX_UNSEALED = 10_000
REFRESH_NS = 3600 * 1_000_000_000
BOOKING_COLUMNS = ("transaction_id", "passage_id", "kind", "booked_ns", "amount_cents", "content")


def link_of(previous: str, number: int, booking: Mapping[str, object]) -> str:
    """Give the hash of an entry: of the one before, its number and every column of its booking."""
    content = json.dumps([number, *(booking[name] for name in BOOKING_COLUMNS)], separators=(",", ":"))
    return hashlib.sha256(bytes.fromhex(previous) + content.encode()).hexdigest()


def genuine(kind: str, text: object) -> dict[str, str] | None:
    """Read a signed statement; None if it is none of this kind, or its signature does not fit."""
    try:
        fields = json.loads(str(text))
    except (ValueError, RecursionError):
        return None
    if not isinstance(fields, dict) or not all(isinstance(value, str) for value in fields.values()):
        return None
    return fields if is_genuine(kind, fields) else None


def _digest(content: tuple[object, ...]) -> str:
    return hashlib.sha256(json.dumps(content, separators=(",", ":")).encode()).hexdigest()


class Chain:
    """Writes entries and signatures; every method that changes something runs inside a transaction of the store."""

    def __init__(self, store: Store, key: KeyFile | None, plaza: str) -> None:
        self._store, self._key, self._plaza = store, key, plaza
        self._refreshed_ns = 0
        self.detections = 0  # since the ledger began
        self._unsealed: set[tuple[str, str, str]] = set()  # rows stored while the key could not be used
        self._head: str | None = None  # the newest signed statement, until it is published
        self.problem: str | None = None  # why nothing is signed now

    def begin(self) -> None:
        """Take the bookings of an earlier version into the chain: they stay unsigned, and cannot be changed any more.

        Runs a transaction of its own. Where there is a chain already, bookings outside it are left: nobody but the
        ledger adds any.
        """
        newest = self._newest() or {}
        counted = self._store.row("SELECT SUM(n) AS n FROM balance WHERE outcome = 'detections'")
        self.detections = max(int(newest.get("detections", "0")), (counted["n"] if counted else 0) or 0)
        if self._last() is not None or self._newest() is not None:
            return
        if not (rows := self._store.rows("SELECT * FROM booking ORDER BY rowid")):
            return
        with self._store.transaction():
            previous = ""
            for number, row in enumerate(rows, 1):
                previous = link_of(previous, number, dict(row))
                self._store.execute("INSERT INTO entry VALUES (?, ?, ?)", number, row["transaction_id"], previous)

    def add(self, booking: Mapping[str, object], now_ns: int) -> None:
        """Append a booking that was stored, and sign it."""
        fields = self._fields()
        last = self._last()
        number, previous = (last["number"] + 1, last["link"]) if last else (1, "")
        link = link_of(previous, number, booking)
        self._store.execute("INSERT INTO entry VALUES (?, ?, ?)", number, str(booking["transaction_id"]), link)
        self._sign({**fields, "number": str(number), "link": link}, now_ns)

    def evidence_deleted(self, before_ns: int, now_ns: int) -> None:
        """Sign that evidence of bookings before a time was deleted, because it may not be kept longer."""
        fields = self._fields()
        fields["evidence_from_ns"] = str(max(before_ns, int(fields["evidence_from_ns"])))
        self._sign(fields, now_ns)

    def refresh(self, now_ns: int) -> None:
        """Sign the newest entry each hour, and once for each day: what has the signature was whole then."""
        same_day = now_ns // (24 * REFRESH_NS) == self._refreshed_ns // (24 * REFRESH_NS)
        if 0 <= now_ns - self._refreshed_ns < REFRESH_NS and same_day:
            return
        self._refreshed_ns = now_ns
        fields = self._fields()
        if int(fields["number"]) or self.detections:
            self._sign(fields, now_ns, day=bool(int(fields["number"])))

    def head(self) -> str | None:
        """Take the newest signed statement for the operator, once."""
        taken, self._head = self._head, None
        return taken

    def row_seal(self, table: str, key: str, *content: object) -> str | None:
        """Sign a row of what is in progress; None without a key."""
        made = self._statement(ROW, {"table": table, "row": key, "digest": _digest(content)})
        if made is None and self._key is not None and len(self._unsealed) < MAX_UNSEALED:
            self._unsealed.add((table, key, _digest(content)))
        return None if made is None else json.dumps(made)

    def is_row(self, seal: str | None, table: str, key: str, *content: object) -> bool:
        """Whether a row is as it was signed; without a key every row is."""
        if self._key is None or (table, key, _digest(content)) in self._unsealed:
            return True
        fields = genuine(ROW, seal) if seal is not None else None
        if fields is None or not self._is_ours(fields):
            return False
        return (fields.get("table"), fields.get("row"), fields.get("digest")) == (table, key, _digest(content))

    def seal(self, transaction_id: str) -> LedgerSeal | None:
        """Sign an entry for the message that sends it; None without a key."""
        row = self._store.row("SELECT number, link FROM entry WHERE transaction_id = ?", transaction_id)
        newest = self._newest()
        if row is None or newest is None:
            return None
        fields = {"ledger": newest.get("ledger", ""), "number": str(row["number"]), "link": row["link"],
                  "transaction_id": transaction_id}  # fmt: skip
        made = self._statement(ENTRY, fields)
        if made is None:
            return None
        return LedgerSeal(
            ledger=made["ledger"], number=row["number"], link=row["link"], key=made["key"],
            public_key=made["public_key"], signature=made["signature"],
        )  # fmt: skip

    def pack_seal(self, passage_id: str, digest: str, now_ns: int) -> str | None:
        """Sign an evidence pack; None without a key."""
        made = self._statement(PACK, {"passage_id": passage_id, "digest": digest, "stored_ns": str(now_ns)})
        return None if made is None else json.dumps(made)

    def _last(self) -> Row | None:
        return self._store.row("SELECT number, link FROM entry ORDER BY number DESC LIMIT 1")

    def _newest(self) -> dict[str, str] | None:
        """The current signed statement; empty if it is not genuine or of another key, None if there is none."""
        row = self._store.row("SELECT statement FROM head WHERE name = ?", CURRENT_ROW)
        if row is None or self._key is None:
            return None
        fields = genuine(CURRENT, row["statement"])
        return fields if fields is not None and self._is_ours(fields) else {}

    def _is_ours(self, fields: Mapping[str, str]) -> bool:
        assert self._key is not None
        try:
            found = self._key.ring.find(fields["key"])
        except EvidenceError:
            return False
        return found is not None and found.public_key.hex() == fields["public_key"]

    def _fields(self) -> dict[str, str]:
        """What is to be signed of the chain as it stands; what was changed since the last signature is noted in it.

        A chain that does not end as it was signed is never signed as if it did.
        """
        newest, last = self._newest(), self._last()
        number, link = (last["number"], last["link"]) if last else (0, "")
        fields = {
            "ledger": secrets.token_hex(16), "plaza": self._plaza, "unsigned": "", "broken": "",
            "evidence_from_ns": "0", "accounts": "0", "accounts_link": "",
        }  # fmt: skip
        fields |= {name: value for name, value in (newest or {}).items() if name in fields}
        fields |= {"number": str(number), "link": link, "detections": str(self.detections)}
        self._note_accounts(fields)
        if newest is None:
            fields |= self._before_signatures(number)
        elif not newest:
            fields["broken"] = "its signature was not genuine"
        elif (signed_number := int(newest["number"])) != number or newest["link"] != link:
            row = self._store.row("SELECT link FROM entry WHERE number = ?", signed_number)
            if signed_number and (row is None or row["link"] != newest["link"]):
                fields["broken"] = fields["broken"] or f"entry {signed_number} was not as it had been signed"
            elif number > signed_number:
                ranges = [fields["unsigned"], f"{signed_number + 1}-{number}"]
                fields["unsigned"] = " ".join(filter(None, ranges))
        if fields["broken"]:
            self._tell(f"the chain of bookings is broken: {fields['broken']}; compare it with the operator's copies")
        return fields

    def _note_accounts(self, fields: dict[str, str]) -> None:
        """State the newest closed account; one that was signed and is not there any more breaks the chain."""
        signed_number, signed_link = int(fields["accounts"]), fields["accounts_link"]
        row = self._store.row("SELECT link FROM account WHERE number = ?", signed_number)
        if signed_number and (row is None or row["link"] != signed_link):
            fields["broken"] = fields["broken"] or f"account {signed_number} was not as it had been signed"
            return
        if (last := self._store.row("SELECT number, link FROM account ORDER BY number DESC LIMIT 1")) is not None:
            fields |= {"accounts": str(last["number"]), "accounts_link": last["link"]}

    def _before_signatures(self, number: int) -> dict[str, str]:
        """What the first signature says of the entries before it: unsigned, and their evidence may be deleted."""
        if self._key is None or not number:
            return {}
        row = self._store.row("SELECT MAX(booked_ns) AS ns FROM booking JOIN entry USING (transaction_id)")
        return {"unsigned": f"1-{number}", "evidence_from_ns": str((row["ns"] if row else 0) + 1)}

    def _sign(self, fields: dict[str, str], now_ns: int, *, day: bool = False) -> None:
        fields = {**fields, "signed_ns": str(now_ns)}
        if (made := self._statement(CURRENT, fields)) is None:
            return
        self._head = json.dumps(made)
        self._store.execute("INSERT OR REPLACE INTO head VALUES (?, ?)", CURRENT_ROW, self._head)
        if day:
            name = f"{datetime.fromtimestamp(now_ns // 1_000_000_000, UTC):%Y-%m-%d}"
            if (of_day := self._statement(DAY, {**fields, "day": name})) is not None:
                self._store.execute("INSERT OR IGNORE INTO head VALUES (?, ?)", name, json.dumps(of_day))

    def _statement(self, kind: str, fields: dict[str, str]) -> dict[str, str] | None:
        if self._key is None:
            return None
        try:
            made = signed(kind, fields, self._key.signer())
        except EvidenceError as error:
            self._tell(f"bookings are not signed: {error}")
            return None
        return made

    def _tell(self, problem: str) -> None:
        if problem != self.problem:
            log.error("%s", problem)
        self.problem = problem

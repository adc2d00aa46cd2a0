"""The rules of the ledger: what is stored of a passage, when it is charged, and what is deleted again.

Every method that changes something runs inside a transaction of the store; what is published is read from the store
after the commit. Messages may come twice, late, or after a restart: each is stored once.
"""

import hashlib
import json
import zlib
from collections import Counter

from pydantic import Field

from shared.messages.base import Message
from shared.messages.toll import (
    PASSAGES,
    SETTLED,
    STATIONS,
    EvidencePack,
    LaneBalance,
    LedgerState,
    OpenPassages,
    PassageState,
    PassageSummary,
    PlazaDetector,
    RegisteredStation,
    TollPassage,
    TollReceipt,
    TollRegistration,
    TollTransaction,
    TransactionKind,
)
from shared.runtime.config import Section
from shared.toll.plaza import Plaza

from .reconciliation import Crossing, Pulse, match
from .store import Row, Store

NS = 1_000_000_000
HOUR_NS = 3600 * NS
DAY_NS = 24 * HOUR_NS
RECENT = 50
OUTCOMES = ("charged", "undecided", "unregistered", "suspect", "void", "missed")


class Settings(Section):
    """How long the ledger waits, and how long it keeps what."""

    registration_limit_s: float = Field(default=300.0, gt=0, le=600.0, description="longest validity of a registration")
    registration_wait_s: float = Field(
        default=15.0,
        ge=0,
        description="time that a registration behind the exit line is waited for, because it may have been lost",
    )
    silence_limit_s: float = Field(
        default=120.0, gt=0, description="time without a statement after which a passage is settled"
    )
    uncharged_kept_s: float = Field(
        default=300.0, gt=0, le=600.0, description="time for which a settled passage without a charge is remembered"
    )
    evidence_kept_days: float = Field(
        default=60.0, gt=0, description="objection period: time for which evidence is kept"
    )
    match_after_s: float = Field(
        default=150.0, gt=0, description="time after which a detector pulse without a crossing is an unmatched one"
    )
    match_gate_s: float = Field(
        default=5.0,
        gt=0,
        description="largest time between a pulse and its crossing, or three standard deviations of that",
    )
    detector_sd_s: float = Field(default=0.1, gt=0, description="standard deviation of a pulse's time")
    resend_first_s: float = Field(
        default=1.0, gt=0, description="time until a transaction without receipt is sent again; it doubles each time"
    )
    resend_longest_s: float = Field(
        default=60.0, gt=0, description="longest time between two attempts to send a transaction"
    )


class Ledger:
    """Charges passages, keeps what proves them, and accounts for every detection."""

    def __init__(self, store: Store, plaza: Plaza, plaza_file: str, settings: Settings, now_ns: int) -> None:
        self._store, self._plaza, self._plaza_file, self._settings = store, plaza, plaza_file, settings
        self._started_ns = now_ns
        self.rejects: Counter[str] = Counter()
        self._unregistered: dict[str, TollPassage] = {}  # in progress; in memory only
        self._next_send: dict[str, tuple[int, int]] = {}  # attempts and time of the next, by transaction
        self._numbers: Counter[str] = Counter()  # bookings by kind, up to the row `_summed`: none is ever changed
        self._amount_cents = self._summed = 0
        self._cleaned_ns = 0  # what was settled before and not charged is deleted

    # Received messages

    def use(self, message: Message, now_ns: int) -> None:
        """Store what a message states; those that are not of the ledger's topics change nothing."""
        match message:
            case TollRegistration():
                self.register(message, now_ns)
            case PlazaDetector():
                self.detect(message, now_ns)
            case TollPassage():
                self.passage(message, now_ns)
            case TollReceipt():
                self.receipt(message, now_ns)
            case _:
                pass

    def register(self, message: TollRegistration, now_ns: int) -> None:
        """Store which contract uses a station ID now; the newest statement counts."""
        if message.tariff_class not in self._plaza.tariff.classes:
            self.rejects["tariff class"] += 1
            return
        until_ns = min(message.valid_until_ns, now_ns + round(self._settings.registration_limit_s * NS))
        self._store.execute(
            "INSERT INTO registration VALUES (?, ?, ?, ?, ?) ON CONFLICT (station_id) DO UPDATE SET contract = "
            "excluded.contract, tariff_class = excluded.tariff_class, sampled_ns = excluded.sampled_ns, "
            "valid_until_ns = excluded.valid_until_ns WHERE excluded.sampled_ns > registration.sampled_ns",
            message.station_id, message.contract, message.tariff_class, message.sampled_ns, until_ns,
        )  # fmt: skip

    def detect(self, message: PlazaDetector, now_ns: int) -> None:
        """Store a pulse, and the earlier ones of the message that were lost on the way."""
        if message.plaza != self._plaza.name or message.lane not in {lane.name for lane in self._plaza.lanes}:
            self.rejects["another plaza"] += 1
            return
        for number, sampled_ns in enumerate((message.sampled_ns, *message.earlier_ns)):
            if message.pulse < number or not now_ns - DAY_NS < sampled_ns < now_ns + HOUR_NS:
                continue
            new = self._store.execute(
                "INSERT OR IGNORE INTO pulse (lane, since_ns, number, sampled_ns) VALUES (?, ?, ?, ?)",
                message.lane, message.since_ns, message.pulse - number, sampled_ns,
            )  # fmt: skip
            if new:
                self._count(message.lane, sampled_ns, "detections")

    def passage(self, message: TollPassage, now_ns: int) -> None:
        """Follow a passage, and settle it when its state is final."""
        if (message.plaza, message.plaza_digest) != (self._plaza.name, self._plaza.digest):
            self.rejects["another plaza"] += 1
        elif self._store.execute("UPDATE settled SET final_ns = ? WHERE passage_id = ?", now_ns, message.passage_id):
            if message.state in (PassageState.VOID, PassageState.SUSPECT):
                self._reverse(message.passage_id, message.reason or message.state.value, now_ns)
        else:
            self._follow(message, now_ns)

    def receipt(self, message: TollReceipt, now_ns: int) -> None:
        """Take a transaction out of the outbox; what the operator does not accept is reversed."""
        if not self._store.row("SELECT 1 FROM booking WHERE transaction_id = ?", message.transaction_id):
            self.rejects["receipt of an unknown transaction"] += 1
            return
        self._store.execute(
            "INSERT OR IGNORE INTO receipt VALUES (?, ?, ?)",
            message.transaction_id, now_ns, message.model_dump_json(exclude_none=True),
        )  # fmt: skip
        self._store.execute("DELETE FROM outbox WHERE transaction_id = ?", message.transaction_id)
        self._next_send.pop(message.transaction_id, None)
        if not message.accepted:
            self._reverse(message.passage_id, f"not accepted by {message.operator}: {message.reason}", now_ns)

    # Periodic work

    def expire(self, now_ns: int) -> None:
        """Settle passages that fell silent, and delete what may not be kept longer."""
        silent_ns = now_ns - round(self._settings.silence_limit_s * NS)
        if self._started_ns < silent_ns:
            rows = self._store.rows("SELECT statement FROM passage WHERE sampled_ns < ?", silent_ns)
            stored = [TollPassage.model_validate_json(row["statement"]) for row in rows]
            silent = [p for p in self._unregistered.values() if p.sampled_ns < silent_ns]
            for passage in stored + silent:
                state = PassageState.VOID if passage.crossing_ns is None else PassageState.UNDECIDED
                self._settle(passage, state, "no statement from core.toll any more", now_ns)
        kept_ns = now_ns - round(self._settings.uncharged_kept_s * NS)
        self._store.execute("DELETE FROM registration WHERE valid_until_ns < ?", now_ns)
        self._store.execute(
            "DELETE FROM settled WHERE final_ns >= ? AND final_ns < ? "
            "AND NOT EXISTS (SELECT 1 FROM booking WHERE booking.passage_id = settled.passage_id)",
            self._cleaned_ns, kept_ns,
        )  # fmt: skip
        self._cleaned_ns = max(self._cleaned_ns, kept_ns)
        self._store.execute("DELETE FROM pulse WHERE sampled_ns < ? AND done", now_ns - DAY_NS)
        evidence_ns = now_ns - round(self._settings.evidence_kept_days * DAY_NS)
        self._store.execute("DELETE FROM evidence WHERE stored_ns < ?", evidence_ns)

    def reconcile(self, now_ns: int) -> None:
        """Account for pulses that are old enough: each belongs to a passage, or its vehicle was missed."""
        ripe_ns = now_ns - round(self._settings.match_after_s * NS)
        pulses = self._store.rows("SELECT rowid, lane, sampled_ns FROM pulse WHERE NOT done")
        crossings = {row["number"]: row for row in self._store.rows("SELECT * FROM crossing")}
        found = match(
            [Pulse(row["rowid"], row["lane"], row["sampled_ns"]) for row in pulses],
            [_crossing(row) for row in crossings.values()],
            detector_sd_s=self._settings.detector_sd_s,
            gate_s=self._settings.match_gate_s,
        )
        for row in pulses:
            if row["sampled_ns"] >= ripe_ns:
                continue
            crossing = crossings.pop(found[row["rowid"]], None) if row["rowid"] in found else None
            self._count(row["lane"], row["sampled_ns"], crossing["state"] if crossing else PassageState.MISSED)
            self._store.execute("UPDATE pulse SET done = ? WHERE rowid = ?", 1 if crossing else 2, row["rowid"])
            if crossing:
                self._store.execute("DELETE FROM crossing WHERE number = ?", crossing["number"])
        waiting = set(found.values())
        late_ns = ripe_ns - round(self._settings.match_gate_s * NS)
        for number, row in crossings.items():
            if row["crossing_ns"] < late_ns and number not in waiting:
                if row["state"] == PassageState.CHARGED:
                    self._count(row["lane"], row["crossing_ns"], "charged_without_detection")
                self._store.execute("DELETE FROM crossing WHERE number = ?", number)

    # Published messages

    def due(self, now_ns: int) -> list[TollTransaction]:
        """List the transactions to send now: those without a receipt, again after growing pauses."""
        rows = self._store.rows(
            "SELECT outbox.transaction_id, content FROM outbox JOIN booking USING (transaction_id) "
            "ORDER BY outbox.rowid LIMIT 100"
        )
        found = []
        for row in rows:
            attempts, next_ns = self._next_send.get(row["transaction_id"], (0, 0))
            if now_ns < next_ns:
                continue
            pause_s = min(self._settings.resend_first_s * 2.0**attempts, self._settings.resend_longest_s)
            self._next_send[row["transaction_id"]] = (min(attempts + 1, 30), now_ns + round(pause_s * NS))
            content = TollTransaction.model_validate_json(row["content"])
            found.append(content.model_copy(update={"attempt": attempts + 1}))
        return found

    def open_passages(self, now_ns: int) -> OpenPassages:
        """List what `core.toll` continues after a restart, and what it need not repeat."""
        rows = self._store.rows("SELECT statement FROM passage ORDER BY sampled_ns DESC LIMIT 300")
        stored = tuple(TollPassage.model_validate_json(row["statement"]) for row in rows)
        recently_ns = now_ns - round(self._settings.uncharged_kept_s * NS)
        settled = self._store.rows(
            "SELECT passage_id FROM settled WHERE final_ns >= ? ORDER BY final_ns DESC LIMIT ?", recently_ns, SETTLED
        )
        registered = self._store.rows(
            "SELECT station_id, valid_until_ns FROM registration WHERE valid_until_ns >= ? "
            "ORDER BY sampled_ns DESC LIMIT ?", now_ns, STATIONS,
        )  # fmt: skip
        return OpenPassages(
            sampled_ns=now_ns,
            passages=stored + tuple(self._unregistered.values())[: PASSAGES - len(stored)],
            settled=tuple(row["passage_id"] for row in settled),
            registered=tuple(
                RegisteredStation(station_id=row["station_id"], valid_until_ns=row["valid_until_ns"])
                for row in registered
            ),
        )

    def state(self, now_ns: int) -> LedgerState:
        """Sum up charges, outbox and the account of this hour and the last."""
        for row in self._store.rows("SELECT rowid, kind, amount_cents FROM booking WHERE rowid > ?", self._summed):
            self._summed = row["rowid"]
            self._numbers[row["kind"]] += 1
            self._amount_cents += row["amount_cents"]
        last = self._store.row("SELECT MAX(received_ns) AS ns FROM receipt")
        outbox = self._store.row("SELECT COUNT(*) AS n FROM outbox")
        return LedgerState(
            now_ns=now_ns,
            plaza=self._plaza.name,
            transactions=self._numbers[TransactionKind.CHARGE],
            reversals=self._numbers[TransactionKind.REVERSAL],
            amount_cents=self._amount_cents,
            outbox=outbox["n"] if outbox else 0,
            last_receipt_ns=last["ns"] if last else None,
            lanes=self.balances(now_ns // HOUR_NS * HOUR_NS - HOUR_NS),
            recent=self._recent(),
        )

    def balances(self, since_ns: int) -> tuple[LaneBalance, ...]:
        """Account for the detections of each lane and hour from a time on."""
        rows = self._store.rows("SELECT * FROM balance WHERE hour_ns >= ?", since_ns)
        counts = {(row["hour_ns"], row["lane"], row["outcome"]): row["n"] for row in rows}
        pending = Counter(
            (row["sampled_ns"] // HOUR_NS * HOUR_NS, row["lane"])
            for row in self._store.rows("SELECT lane, sampled_ns FROM pulse WHERE NOT done")
        )
        made = []
        for hour_ns, lane in sorted({key[:2] for key in counts}):
            outcomes = {outcome: counts.get((hour_ns, lane, outcome), 0) for outcome in OUTCOMES}
            detections, waiting = counts.get((hour_ns, lane, "detections"), 0), pending[hour_ns, lane]
            spare = counts.get((hour_ns, lane, "charged_without_detection"), 0)
            agrees = detections == sum(outcomes.values()) + waiting and not spare
            made.append(
                LaneBalance(lane=lane, hour_ns=hour_ns, detections=detections, pending=waiting, agrees=agrees,
                            charged_without_detection=spare, **outcomes)
            )  # fmt: skip
        return tuple(made)

    def evidence(self, passage_id: str) -> bytes | None:
        """Give the evidence pack of a charge as JSON."""
        row = self._store.row("SELECT pack FROM evidence WHERE passage_id = ?", passage_id)
        return zlib.decompress(row["pack"]) if row else None

    # One passage

    def _follow(self, message: TollPassage, now_ns: int) -> None:
        stored = self._store.row("SELECT * FROM passage WHERE passage_id = ?", message.passage_id)
        contracts = {(stored["contract"], stored["tariff_class"])} if stored else set()
        for station_id in message.station_ids:
            row = self._store.row(
                "SELECT contract, tariff_class FROM registration WHERE station_id = ? AND valid_until_ns >= ?",
                station_id, message.crossing_ns or message.sampled_ns,
            )  # fmt: skip
            contracts |= {(row["contract"], row["tariff_class"])} if row else set()
        crossed = TollPassage.model_validate_json(stored["crossed"]) if stored and stored["crossed"] else None
        if message.state is PassageState.CHARGED:
            self._charge(message, crossed, contracts, now_ns)
        elif message.state.is_final:
            self._settle(message, message.state, message.reason, now_ns)
        elif len(contracts) > 1:
            self._settle(message, PassageState.SUSPECT, "station IDs of two contracts", now_ns)
        elif not contracts:
            newest = self._unregistered.get(message.passage_id, message)
            if message.sampled_ns >= newest.sampled_ns:
                self._unregistered[message.passage_id] = message.model_copy(update={"evidence": None})
        elif not stored or message.sampled_ns >= stored["sampled_ns"]:
            ((contract, tariff_class),) = contracts
            self._unregistered.pop(message.passage_id, None)
            with_evidence = message if message.evidence else crossed
            self._store.execute(
                "INSERT OR REPLACE INTO passage VALUES (?, ?, ?, ?, ?, ?)",
                message.passage_id, message.sampled_ns, contract, tariff_class,
                message.model_copy(update={"evidence": None}).model_dump_json(exclude_none=True),
                with_evidence.model_dump_json(exclude_none=True) if with_evidence else None,
            )  # fmt: skip

    def _charge(
        self, message: TollPassage, crossed: TollPassage | None, contracts: set[tuple[str, str]], now_ns: int
    ) -> None:
        """Charge a passage that is complete, or say why not.

        `core.toll` knows a contract. Where the ledger does not, it was down when that was registered: the vehicle
        repeats the registration, and `core.toll` this statement.
        """
        proof = crossed or message
        waited_ns = now_ns - (message.exit_ns or message.crossing_ns or message.sampled_ns)
        if not contracts and waited_ns < self._settings.registration_wait_s * NS:
            return
        if len(contracts) > 1:
            self._settle(message, PassageState.SUSPECT, "station IDs of two contracts", now_ns)
        elif message.lane is None:
            self._settle(message, PassageState.UNDECIDED, message.reason or "no lane is certain", now_ns)
        elif not contracts:
            self._settle(message, PassageState.UNREGISTERED, "no contract for its station ID", now_ns)
        elif message.crossing_ns is None or message.crossing_sd_s is None or proof.evidence is None:
            self._settle(message, PassageState.SUSPECT, "its statement has no crossing or no evidence", now_ns)
        elif (cents := self._plaza.tariff.classes.get(min(contracts)[1])) is None:  # the file has changed since
            self.rejects["tariff class"] += 1
            reason = f"the tariff has no class {min(contracts)[1]}: add it to the plaza's file"
            self._settle(message, PassageState.SUSPECT, reason, now_ns)
        else:
            self._book(message, proof, *min(contracts), cents, now_ns)

    def _book(
        self, message: TollPassage, crossed: TollPassage, contract: str, tariff_class: str, cents: int, now_ns: int
    ) -> None:
        """Store charge, outbox row and evidence; `passage` has made sure that none is there, and UNIQUE insists."""
        tariff, lane = self._plaza.tariff, message.lane or ""
        pack = EvidencePack(
            plaza_file=self._plaza_file, tariff_version=tariff.version, contract=contract, tariff_class=tariff_class,
            lane=lane, amount_cents=cents, crossed=crossed, charged=message,
        ).model_dump_json(exclude_none=True).encode()  # fmt: skip
        transaction = TollTransaction(
            transaction_id=transaction_id(message.passage_id, TransactionKind.CHARGE),
            passage_id=message.passage_id,
            kind=TransactionKind.CHARGE,
            booked_ns=now_ns,
            plaza=self._plaza.name,
            lane=lane,
            lane_probability=_probability(message) or 0.0,
            crossing_ns=message.crossing_ns or 0,
            crossing_sd_s=message.crossing_sd_s or 0.0,
            contract=contract,
            tariff_class=tariff_class,
            tariff_version=tariff.version,
            amount_cents=cents,
            currency=tariff.currency,
            authenticated=message.authenticated,
            evidence_digest=hashlib.sha256(pack).hexdigest(),
        )
        self._enter(transaction)
        self._store.execute(
            "INSERT INTO evidence VALUES (?, ?, ?, ?)",
            message.passage_id, transaction.evidence_digest, now_ns, zlib.compress(pack),
        )  # fmt: skip
        self._settle(message, PassageState.CHARGED, "", now_ns, transaction)

    def _reverse(self, passage_id: str, reason: str, now_ns: int) -> None:
        """Book the opposite of a charge, once."""
        rows = self._store.rows("SELECT kind, content FROM booking WHERE passage_id = ?", passage_id)
        content = {row["kind"]: row["content"] for row in rows}
        if TransactionKind.CHARGE not in content or TransactionKind.REVERSAL in content:
            return
        charge = TollTransaction.model_validate_json(content[TransactionKind.CHARGE])
        opposite = {
            "transaction_id": transaction_id(passage_id, TransactionKind.REVERSAL),
            "kind": TransactionKind.REVERSAL,
            "booked_ns": now_ns,
            "amount_cents": -charge.amount_cents,
            "reason": reason[:400],
        }
        self._enter(charge.model_copy(update=opposite))

    def _enter(self, transaction: TollTransaction) -> None:
        self._store.execute(
            "INSERT INTO booking VALUES (?, ?, ?, ?, ?, ?)",
            transaction.transaction_id, transaction.passage_id, transaction.kind, transaction.booked_ns,
            transaction.amount_cents, transaction.model_dump_json(exclude_none=True),
        )  # fmt: skip
        self._store.execute("INSERT INTO outbox VALUES (?)", transaction.transaction_id)

    def _settle(
        self, message: TollPassage, state: PassageState, reason: str, now_ns: int, charge: TollTransaction | None = None
    ) -> None:
        """Store the end of a passage: its state, and its crossing without a name for the reconciliation."""
        self._unregistered.pop(message.passage_id, None)
        self._store.execute("DELETE FROM passage WHERE passage_id = ?", message.passage_id)
        summary = PassageSummary(
            passage_id=message.passage_id, state=state, lane=message.lane, crossing_ns=message.crossing_ns,
            probability=_probability(message), reason=reason[:400],
            tariff_class=charge.tariff_class if charge else None,
            amount_cents=charge.amount_cents if charge else None,
            currency=charge.currency if charge else None,
            evidence_digest=charge.evidence_digest if charge else None,
        )  # fmt: skip
        self._store.execute(
            "INSERT INTO settled VALUES (?, ?, ?)",
            message.passage_id, now_ns, summary.model_dump_json(exclude_none=True),
        )  # fmt: skip
        if message.crossing_ns is not None:
            lanes = json.dumps({lane.lane: lane.probability for lane in message.lanes})
            self._store.execute(
                "INSERT INTO crossing (crossing_ns, sd_s, state, lane, lanes) VALUES (?, ?, ?, ?, ?)",
                message.crossing_ns, message.crossing_sd_s or 1.0, state, message.lane, lanes,
            )  # fmt: skip

    def _count(self, lane: str, time_ns: int, outcome: str) -> None:
        self._store.execute(
            "INSERT INTO balance VALUES (?, ?, ?, 1) ON CONFLICT (lane, hour_ns, outcome) DO UPDATE SET n = n + 1",
            lane, time_ns // HOUR_NS * HOUR_NS, outcome,
        )  # fmt: skip

    def _recent(self) -> tuple[PassageSummary, ...]:
        rows = self._store.rows(
            "SELECT final_ns, summary, (SELECT COUNT(*) FROM receipt JOIN booking USING (transaction_id) "
            "WHERE booking.passage_id = settled.passage_id) AS receipts FROM settled ORDER BY final_ns DESC LIMIT ?",
            RECENT,
        )
        ended = [
            (row["final_ns"],
             PassageSummary.model_validate_json(row["summary"]).model_copy(update={"receipt": row["receipts"] > 0}))
            for row in rows
        ]  # fmt: skip
        missed = self._store.rows(
            "SELECT lane, since_ns, number, sampled_ns FROM pulse WHERE done = 2 ORDER BY sampled_ns DESC LIMIT ?",
            RECENT,
        )
        ended += [(row["sampled_ns"], _missed(row)) for row in missed]
        ended.sort(key=lambda one: one[0], reverse=True)
        stored = self._store.rows("SELECT statement FROM passage ORDER BY sampled_ns DESC LIMIT ?", RECENT)
        open_ = [TollPassage.model_validate_json(row["statement"]) for row in stored]
        open_ += list(self._unregistered.values())[-RECENT:]
        return (*(_summary(passage) for passage in open_), *(summary for _, summary in ended))


def transaction_id(passage_id: str, kind: TransactionKind) -> str:
    """Derive the ID of a transaction: the same for every attempt and after a restart of the ledger."""
    return hashlib.sha256(f"{kind}:{passage_id}".encode()).hexdigest()


def _crossing(row: Row) -> Crossing:
    return Crossing(row["number"], row["crossing_ns"], row["sd_s"], row["lane"], json.loads(row["lanes"]))


def _missed(row: Row) -> PassageSummary:
    """Summarise a pulse that no passage explains; its digest stands for the ID of the passage that is not known."""
    name = f"missed:{row['lane']}:{row['since_ns']}:{row['number']}"
    return PassageSummary(
        passage_id=hashlib.sha256(name.encode()).hexdigest(), state=PassageState.MISSED, lane=row["lane"],
        crossing_ns=row["sampled_ns"], reason="the lane's detector has counted it, and no passage explains it",
    )  # fmt: skip


def _probability(passage: TollPassage) -> float | None:
    return next((lane.probability for lane in passage.lanes if lane.lane == passage.lane), None)


def _summary(passage: TollPassage) -> PassageSummary:
    return PassageSummary(
        passage_id=passage.passage_id, state=passage.state, lane=passage.lane, crossing_ns=passage.crossing_ns,
        probability=_probability(passage), reason=passage.reason,
    )  # fmt: skip

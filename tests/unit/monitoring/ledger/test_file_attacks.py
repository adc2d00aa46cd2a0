"""A change of the ledger's file makes no other contract pay: it has no effect, or verification names it."""

import sqlite3
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from services.monitoring.ledger.ledger import HOUR_NS, Ledger
from services.monitoring.ledger.pack import pack_faults
from services.monitoring.ledger.proof import LedgerProof, prove_ledger
from services.monitoring.ledger.store import Store
from shared.evidence import KeyFile, Outcome
from shared.messages.explanation import explain
from shared.messages.toll import EvidencePack, PassageState, TollPassage
from shared.toll.plaza import Plaza, parse_plaza
from tests.support.v2x.tickets import Ticket, that_requires_tickets
from tests.support.v2x.tolling import NS, START_NS, WITH_DETECTORS, Vehicle, answer, ledger_at

OPEN, CROSSED, CHARGED = PassageState.OPEN, PassageState.CROSSED, PassageState.CHARGED
PLAZA_FILE = that_requires_tickets(WITH_DETECTORS)
SIGNED: Plaza = parse_plaza(PLAZA_FILE.encode())
MINE, VICTIM = Ticket("mine"), Ticket("victim")
CAR = Vehicle("a", plaza=SIGNED)
LATER_NS = START_NS + 30 * NS


class Unit:
    """A ledger with a key, in front of which one authenticated car drives."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "ledger.sqlite"
        self.key = KeyFile(folder / "keys")
        self.key.signer()
        self.pulses = 0
        self.start()

    def start(self, now_ns: int = START_NS) -> None:
        self.ledger: Ledger
        self.store: Store
        self.ledger, self.store = ledger_at(self.path, now_ns, key=self.key, plaza_file=PLAZA_FILE)

    def restart(self) -> None:
        self.store.close()
        self.start()

    def change(self, *statements: str) -> None:
        """Write into the file beside the ledger, as who has the disk can."""
        with sqlite3.connect(self.path) as database:
            for statement in statements:
                database.execute(statement)
        database.close()

    def says(self, state: PassageState, car: Vehicle = CAR, ticket: Ticket = MINE) -> None:
        statement = car.says(state, tickets=(ticket.digest,), authenticated=True)
        self.ledger.passage(with_signers(statement, ticket), LATER_NS)

    def pulse(self, car: Vehicle = CAR) -> None:
        self.ledger.detect(car.pulse(self.pulses), LATER_NS)
        self.pulses += 1

    def register(self, ticket: Ticket = MINE, contract: str = "mine") -> None:
        self.ledger.register(ticket.registration(contract, START_NS, station_id=CAR.station_ids[-1]), START_NS)

    def charge(self, car: Vehicle = CAR, ticket: Ticket = MINE, contract: str = "mine") -> None:
        self.register(ticket, contract)
        for state in (OPEN, CROSSED, CHARGED):
            self.says(state, car, ticket)
        self.pulse(car)
        self.ledger.reconcile(LATER_NS)

    def contracts(self) -> list[str]:
        return [charge.contract for charge in self.ledger.due(10**18)]

    def proof(self, *seals: str) -> LedgerProof:
        self.store.scrub()
        return prove_ledger(self.path, self.key.ring, seals)


def with_signers(statement: TollPassage, ticket: Ticket) -> TollPassage:
    """The frames of the evidence as the parser has found them."""
    if statement.evidence is None:
        return statement
    frames = tuple(frame.model_copy(update=ticket.extra) for frame in statement.evidence.frames)
    return statement.model_copy(update={"evidence": statement.evidence.model_copy(update={"frames": frames})})


@pytest.fixture
def unit(tmp_path: Path) -> Unit:
    return Unit(tmp_path)


def test_an_authenticated_car_is_charged_and_the_ledger_verifies(unit: Unit) -> None:
    unit.charge()
    assert unit.contracts() == ["mine"]
    assert unit.proof().outcome is Outcome.VERIFIED


CONTRACT = "UPDATE registration SET contract = 'victim', content = replace(content, '\"mine\"', '\"victim\"')"


def test_a_changed_contract_of_a_registration_has_no_effect_while_the_ledger_runs(unit: Unit) -> None:
    unit.register()
    unit.change(CONTRACT)
    for state in (OPEN, CROSSED, CHARGED):
        unit.says(state)
    unit.pulse()
    unit.ledger.reconcile(LATER_NS)
    assert unit.contracts() == ["mine"]


def test_a_changed_contract_of_a_registration_is_refused_by_the_next_process(unit: Unit) -> None:
    unit.register()
    unit.change(CONTRACT)
    unit.restart()
    assert unit.ledger.registrations.rejects == {"registration_changed": 1}
    for state in (OPEN, CROSSED, CHARGED):
        unit.says(state)
    unit.pulse()
    unit.ledger.reconcile(LATER_NS)
    assert unit.contracts() == []


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE {table} SET registrations = replace(registrations, '\"mine\"', '\"victim\"')",
        "UPDATE {table} SET crossed = replace(crossed, '\"n2\"', '\"n1\"')",
        "UPDATE {table} SET registrations = '[]'",
        "UPDATE {table} SET seal = NULL",
    ],
)
@pytest.mark.parametrize("table", ["passage", "held"])
def test_what_is_changed_of_a_passage_in_progress_goes_to_review(unit: Unit, table: str, statement: str) -> None:
    unit.register()
    unit.says(OPEN)
    unit.says(CROSSED)
    if table == "passage":
        unit.change(statement.format(table=table))
    unit.says(CHARGED)
    if table == "held":
        unit.change(statement.format(table=table))
    unit.pulse()
    unit.ledger.reconcile(LATER_NS)
    assert unit.contracts() == []
    (review,) = unit.ledger.reviews()
    assert (review.reason_code, review.decided_by) == (explain("ledger.changed"), explain("ledger.by_copy"))


def test_a_passage_stored_under_the_registration_of_another_ticket_is_not_charged_to_it(unit: Unit) -> None:
    """A row of the victim, genuine and sealed, in the place of that of the car."""
    unit.register()
    unit.register(VICTIM, "victim")
    victim = replace(CAR, name="b", station_ids=(9,))
    for state in (OPEN, CROSSED):
        unit.says(state, victim, VICTIM)
        unit.says(state)
    unit.change(
        "UPDATE passage SET registrations = (SELECT registrations FROM passage WHERE passage_id = "
        f"'{victim.passage_id}'), seal = (SELECT seal FROM passage WHERE passage_id = '{victim.passage_id}') "
        f"WHERE passage_id = '{CAR.passage_id}'"
    )
    unit.says(CHARGED)
    unit.pulse()
    unit.ledger.reconcile(LATER_NS)
    assert unit.contracts() == []


def test_emptied_registrations_have_no_effect_on_a_charge_that_is_made(unit: Unit) -> None:
    unit.charge()
    unit.change("DELETE FROM registration")
    pack = EvidencePack.model_validate_json(unit.ledger.evidence(CAR.passage_id) or b"")
    assert list(pack_faults(pack, SIGNED)) == [] and pack.registrations[0].contract == "mine"
    assert unit.proof().outcome is Outcome.VERIFIED


@pytest.mark.parametrize(
    ("statements", "sentence"),
    [
        (("DELETE FROM pulse", "DELETE FROM balance"), "1 detections were removed from the balances"),
        (("UPDATE balance SET n = 0",), "1 detections were removed"),
        (("DELETE FROM outbox",), "entry 1 has neither a receipt nor a row of the outbox"),
        (("DELETE FROM evidence",), "the evidence of passage"),
    ],
)
def test_emptied_tables_are_named(unit: Unit, statements: tuple[str, ...], sentence: str) -> None:
    unit.charge()
    unit.ledger.chain.refresh(LATER_NS)
    unit.change(*statements)
    proof = unit.proof()
    assert proof.outcome is Outcome.EDITED and sentence in proof.text


def test_an_entry_with_a_receipt_needs_no_row_of_the_outbox(unit: Unit) -> None:
    unit.charge()
    (charge,) = unit.ledger.due(LATER_NS)
    unit.ledger.receipt(answer(charge, LATER_NS), LATER_NS)
    assert unit.proof().outcome is Outcome.VERIFIED


def closed(unit: Unit) -> None:
    """Let the hour of a charge be closed and signed."""
    unit.charge()
    after_ns = START_NS + 2 * HOUR_NS
    unit.ledger.reconcile(after_ns)
    unit.ledger.expire(after_ns)
    unit.ledger.chain.refresh(after_ns + HOUR_NS)


@pytest.mark.parametrize(
    ("statement", "sentence"),
    [
        ("UPDATE balance SET n = 7 WHERE outcome = 'charged'", "differs from its closed account 1"),
        ("UPDATE account SET counts = '{}'", "account 1 is not the one that was closed"),
        ("DELETE FROM account", "accounts are missing: 1 to 1"),
    ],
)
def test_a_closed_hour_cannot_be_changed(unit: Unit, statement: str, sentence: str) -> None:
    closed(unit)
    assert unit.proof().outcome is Outcome.VERIFIED
    unit.change(statement)
    proof = unit.proof()
    assert proof.outcome is Outcome.EDITED and sentence in proof.text


def test_a_pulse_of_a_closed_hour_is_counted_and_changes_no_account(unit: Unit) -> None:
    closed(unit)
    unit.pulse(replace(CAR, crossing_ns=CAR.crossing_ns + NS))
    assert unit.ledger.rejects["pulse of a closed hour"] == 1
    assert unit.proof().outcome is Outcome.VERIFIED


def test_a_ledger_that_was_put_back_is_named_by_what_the_operator_has_kept(unit: Unit, tmp_path: Path) -> None:
    unit.charge()
    early = unit.ledger.head(LATER_NS)
    unit.store.scrub()
    copy = unit.path.read_bytes()
    other = replace(CAR, name="b", station_ids=(9,), crossing_ns=CAR.crossing_ns + 5 * NS)
    unit.charge(other, VICTIM, "victim")
    newest = unit.ledger.head(LATER_NS)
    assert early is not None and newest is not None
    assert unit.proof(early.statement, newest.model_dump_json()).outcome is Outcome.VERIFIED
    unit.store.close()
    for path in tmp_path.glob("ledger.sqlite*"):
        path.unlink()
    unit.path.write_bytes(copy)
    unit.start()
    assert unit.proof(early.statement).outcome is Outcome.VERIFIED, "the copy itself is whole"
    proof = unit.proof(newest.statement)
    assert proof.outcome is Outcome.EDITED and "it was put back: the operator has entry 2" in proof.text


@pytest.mark.parametrize("seal", ["", "no JSON", "{}", '{"statement": "x"}'])
def test_a_seal_that_is_none_is_named(unit: Unit, seal: str) -> None:
    unit.charge()
    assert unit.proof(seal).outcome is Outcome.EDITED


Change = Callable[[EvidencePack], dict[str, object]]


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (lambda _: {"contract": "victim"}, "the contract is not that of its registrations"),
        (lambda _: {"registrations": ()}, "the contract is not that of its registrations"),
        (
            lambda pack: {"registrations": (pack.registrations[0].model_copy(update={"contract": "victim"}),),
                          "contract": "victim"},
            "a registration is not valid: registration_not_possessed",
        ),
        (
            lambda _: {"registrations": (VICTIM.registration("victim", START_NS),), "contract": "victim"},
            "no registration covers its ticket or station ID",
        ),
        (lambda _: {"pulses": ()}, "it was confirmed by a detector, and the pack has no pulse"),
        (
            lambda pack: {"pulses": (pack.pulses[0].model_copy(update={"lane": "n1"}),)},
            "a pulse is not that of the crossing",
        ),
        (
            lambda pack: {"charged": pack.charged.model_copy(update={"authenticated": False})},
            "its CAM are not authenticated, and the plaza requires that",
        ),
    ],
)  # fmt: skip
def test_a_pack_is_judged_by_what_is_in_it(unit: Unit, change: Change, fault: str) -> None:
    unit.charge()
    pack = EvidencePack.model_validate_json(unit.ledger.evidence(CAR.passage_id) or b"")
    assert list(pack_faults(pack, SIGNED)) == []
    assert pack.verdict == explain("ledger.confirmed") and len(pack.pulses) == 1
    assert fault in list(pack_faults(pack.model_copy(update=change(pack)), SIGNED))


VERSION_3 = """
CREATE TABLE registration (station_id INTEGER PRIMARY KEY, contract TEXT NOT NULL, tariff_class TEXT NOT NULL,
    sampled_ns INTEGER NOT NULL, valid_until_ns INTEGER NOT NULL);
CREATE TABLE passage (passage_id TEXT PRIMARY KEY, sampled_ns INTEGER NOT NULL, contract TEXT NOT NULL,
    tariff_class TEXT NOT NULL, statement TEXT NOT NULL, crossed TEXT);
CREATE TABLE held (passage_id TEXT PRIMARY KEY, contract TEXT NOT NULL, tariff_class TEXT NOT NULL,
    charged TEXT NOT NULL, crossed TEXT NOT NULL);
CREATE TABLE settled (passage_id TEXT PRIMARY KEY, final_ns INTEGER NOT NULL, summary TEXT NOT NULL);
CREATE TABLE pulse (lane TEXT NOT NULL, since_ns INTEGER NOT NULL, number INTEGER NOT NULL,
    sampled_ns INTEGER NOT NULL, done INTEGER NOT NULL DEFAULT 0, PRIMARY KEY (lane, since_ns, number));
CREATE TABLE crossing (number INTEGER PRIMARY KEY, crossing_ns INTEGER NOT NULL, sd_s REAL NOT NULL,
    state TEXT NOT NULL, lane TEXT, lanes TEXT NOT NULL, passage_id TEXT, overlaps TEXT NOT NULL DEFAULT '[]',
    settled_ns INTEGER NOT NULL DEFAULT 0);
CREATE TABLE chain (name TEXT NOT NULL, passage_id TEXT NOT NULL, from_ns INTEGER NOT NULL, to_ns INTEGER NOT NULL,
    PRIMARY KEY (name, passage_id, from_ns));
INSERT INTO registration VALUES (7, 'contract-1', 'car', 1, 2);
PRAGMA user_version = 3;
"""


def test_a_file_of_version_3_is_migrated_and_what_is_held_without_a_registration_is_reviewed(tmp_path: Path) -> None:
    path = tmp_path / "ledger.sqlite"
    charged, crossed = (CAR.says(state).model_dump_json(exclude_none=True) for state in (CHARGED, CROSSED))
    with sqlite3.connect(path) as database:
        database.executescript(VERSION_3)
        database.execute("INSERT INTO held VALUES (?, 'contract-1', 'car', ?, ?)", (CAR.passage_id, charged, crossed))
        database.execute(
            "INSERT INTO settled VALUES (?, ?, ?)",
            (CAR.passage_id, START_NS, f'{{"passage_id": "{CAR.passage_id}", "state": "held"}}'),
        )
        database.execute(
            "INSERT INTO crossing (crossing_ns, sd_s, state, lane, lanes, passage_id) VALUES (?, 0.1, 'held', 'n2', "
            "'{\"n2\": 1.0}', ?)", (CAR.crossing_ns, CAR.passage_id),
        )  # fmt: skip
    database.close()
    unit = Unit(tmp_path)
    unit.pulse()
    unit.ledger.reconcile(LATER_NS)
    assert unit.contracts() == []
    assert [review.passage_id for review in unit.ledger.reviews()] == [CAR.passage_id]
    columns = {row["name"] for row in unit.store.rows("PRAGMA table_info(held)")}
    assert columns == {"passage_id", "charged", "crossed", "registrations", "seal"}

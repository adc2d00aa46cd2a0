"""A radio without a contract is kept only inside the review that it causes, and leaves nothing behind."""

from dataclasses import replace
from pathlib import Path

from shared.evidence import KeyFile
from shared.messages.toll import PassageState
from shared.toll.plaza import parse_plaza
from tests.support.v2x.tickets import Ticket, that_requires_tickets
from tests.support.v2x.tolling import NS, START_NS, WITH_DETECTORS, Vehicle, ledger_at

PLAZA_FILE = that_requires_tickets(WITH_DETECTORS)
PLAZA = parse_plaza(PLAZA_FILE.encode())
MINE, RADIO, GHOST = Ticket("mine"), Ticket("radio"), Ticket("ghost")
CAR = Vehicle("a", (1_234_567_891,), plaza=PLAZA)
OPEN, CROSSED, CHARGED = PassageState.OPEN, PassageState.CROSSED, PassageState.CHARGED
UNREGISTERED = PassageState.UNREGISTERED


def bytes_of(folder: Path) -> bytes:
    return b"".join(path.read_bytes() for path in sorted(folder.glob("ledger*")))


def test_a_radio_without_a_contract_leaves_nothing_after_its_review(tmp_path: Path) -> None:
    """One uses the station ID of a contract under a ticket of its own, one is a ghost beside a charged car."""
    key = KeyFile(tmp_path / "keys")
    key.signer()
    ledger, store = ledger_at(tmp_path / "ledger.sqlite", key=key, plaza_file=PLAZA_FILE)
    radio = replace(CAR, name="radio", lane="n3", frames=(b"frames of the radio",))
    ghost = replace(CAR, name="ghost", station_ids=(1_987_654_321,), frames=(b"frames of the ghost",))
    with store.transaction():
        ledger.register(MINE.registration("mine", START_NS, station_id=CAR.station_ids[0]), START_NS)
        for state in (OPEN, CROSSED, UNREGISTERED):
            for vehicle, ticket in ((radio, RADIO), (ghost, GHOST)):
                ledger.passage(vehicle.says(state, tickets=(ticket.digest,), authenticated=True), START_NS + 20 * NS)
        for state in (OPEN, CROSSED, CHARGED):
            statement = CAR.says(state, tickets=(MINE.digest,), authenticated=True, overlaps=(ghost.passage_id,))
            ledger.passage(statement, START_NS + 20 * NS)
        ledger.detect(CAR.pulse(), START_NS + 20 * NS)
        for second in (21, 55):
            ledger.reconcile(START_NS + second * NS)
    store.scrub()
    secrets = [
        RADIO.digest, GHOST.digest, radio.passage_id, ghost.passage_id, str(ghost.station_ids[0]),
        "frames of the radio", "frames of the ghost",
    ]  # fmt: skip
    found = bytes_of(tmp_path)
    assert [review.reason_code.code for review in ledger.reviews() if review.reason_code] == ["ledger.identity"]
    assert {secret for secret in secrets[:4] if secret.encode() in found} == {
        GHOST.digest, radio.passage_id, ghost.passage_id
    }, "the search finds what is there"  # fmt: skip
    assert [charge.contract for charge in ledger.due(START_NS + 56 * NS)] == ["mine"]
    with store.transaction():
        for row, _ in ledger.alarms.due():
            ledger.alarms.sent(row)
        for review in ledger.reviews():
            ledger.reviewed(review)
    for minute in range(1, 12):
        with store.transaction():
            ledger.reconcile(START_NS + minute * 60 * NS)
            ledger.expire(START_NS + minute * 60 * NS)
        store.scrub()
    left = bytes_of(tmp_path)
    assert [secret for secret in secrets if secret.encode() in left] == []
    assert CAR.passage_id.encode() in left
    store.close()

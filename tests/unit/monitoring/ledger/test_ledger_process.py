"""The ledger on the bus: what is published after a commit, and what happens without a usable database."""

import sqlite3
from collections.abc import Callable
from pathlib import Path

import pytest

from services.monitoring.ledger.ledger import Ledger
from services.monitoring.ledger.process import Config, Process
from services.monitoring.ledger.store import Store
from shared.bus.envelope import Envelope
from shared.messages.base import Message
from shared.messages.operation import Origin, OriginKind
from shared.messages.toll import LedgerState, OpenPassages, PassageState, TollPassage, TollTransaction
from tests.support.bus.envelopes import sent, sent_bytes
from tests.support.bus.fake_bus import FakeBus
from tests.support.v2x.tolling import COUNTED, START_NS, Vehicle

SECOND = 10  # receives


def run(
    folder: Path, messages: dict[int, list[Message]], calls: int, meanwhile: Callable[[int], object] = lambda _: None
) -> FakeBus:
    def script(call: int) -> list[Envelope] | None:
        meanwhile(call)
        return [sent(message, START_NS) for message in messages.get(call, [])] if call < calls else None

    bus = FakeBus(folder, script, start_ns=START_NS)
    Process(Config()).run(bus.as_bus())
    return bus


def published(bus: FakeBus, kind: type[Message]) -> list[Message]:
    return [message for message in bus.published if isinstance(message, kind)]


def passage() -> list[Message]:
    """All that is said of a vehicle, with the pulse of its lane's detector."""
    vehicle = Vehicle(plaza=COUNTED)
    states = (PassageState.CROSSED, PassageState.CHARGED)
    return [vehicle.registration(), vehicle.pulse(), *(vehicle.says(state) for state in states)]


def newest(bus: FakeBus) -> LedgerState:
    state = published(bus, LedgerState)[-1]
    assert isinstance(state, LedgerState)
    return state


def test_a_charge_is_published_and_the_state_says_what_was_booked(tmp_path: Path) -> None:
    bus = run(tmp_path, {3: passage()}, 3 * SECOND)
    first = published(bus, TollTransaction)[0]
    assert isinstance(first, TollTransaction) and first.amount_cents == 240
    assert (newest(bus).transactions, newest(bus).outbox, newest(bus).problem) == (1, 1, None)
    settled = published(bus, OpenPassages)[-1]
    assert isinstance(settled, OpenPassages) and settled.settled == (Vehicle().passage_id,)


def test_a_restart_charges_nothing_again_and_sends_what_has_no_receipt(tmp_path: Path) -> None:
    first = run(tmp_path, {3: passage()}, 2 * SECOND)
    again = run(tmp_path, {3: passage()}, 2 * SECOND)
    assert newest(again).transactions == 1
    ids = {t.transaction_id for bus in (first, again) for t in bus.published if isinstance(t, TollTransaction)}
    assert len(ids) == 1 and published(again, TollTransaction)


def test_a_message_that_the_ledger_cannot_handle_costs_itself_and_leaves_nothing_of_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    use = Ledger.use

    def fails_at_the_crossing(self: Ledger, message: Message, now_ns: int) -> None:
        use(self, message, now_ns)
        if isinstance(message, TollPassage) and message.state is PassageState.CROSSED:
            raise OverflowError("too large")

    monkeypatch.setattr(Ledger, "use", fails_at_the_crossing)
    vehicle = Vehicle()
    bus = run(tmp_path, {3: [vehicle.registration(), vehicle.says(PassageState.CROSSED)]}, 3 * SECOND)
    assert bus.rejects["fault"] == 1 and not bus.rejects["database"]
    assert newest(bus).problem is None and not newest(bus).recent, "the passage was rolled back"
    opened = published(bus, OpenPassages)[-1]
    assert isinstance(opened, OpenPassages) and opened.registered, "what came before it is stored"


def test_a_replay_writes_nothing(tmp_path: Path) -> None:
    origin = Origin(now_ns=START_NS, kind=OriginKind.REPLAY, name="drive")
    bus = run(tmp_path, {0: [origin], 3: passage()}, SECOND)
    assert bus.published == [] and bus.rejects["replay"] == 5
    assert not (tmp_path / "toll").exists()


def test_a_damaged_database_is_named_with_what_to_do_and_is_not_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "toll" / "ledger.sqlite"
    path.parent.mkdir()
    path.write_bytes(b"no database" * 1000)
    bus = run(tmp_path, {3: passage()}, 2 * SECOND)
    problem = newest(bus).problem or ""
    assert "ledger.sqlite cannot be used" in problem and "restore its backup" in problem
    assert bus.rejects["database"] >= 1 and not published(bus, TollTransaction)
    assert path.read_bytes() == b"no database" * 1000


def test_pages_that_were_overwritten_are_found_at_the_start(tmp_path: Path) -> None:
    run(tmp_path, {3: passage()}, 5)
    path = tmp_path / "toll" / "ledger.sqlite"
    data = bytearray(path.read_bytes())
    data[4096:12288] = b"\xff" * 8192
    path.write_bytes(data)
    assert "cannot be used" in (newest(run(tmp_path, {}, 2 * SECOND)).problem or "")


def test_charging_continues_when_the_damaged_database_was_moved_away(tmp_path: Path) -> None:
    path = tmp_path / "toll" / "ledger.sqlite"
    path.parent.mkdir()
    path.write_bytes(b"no database" * 1000)

    def remedy(call: int) -> None:
        if call == 20:
            path.rename(path.with_suffix(".damaged"))

    repeated = dict.fromkeys(range(3, 90, 10), passage())
    bus = run(tmp_path, repeated, 10 * SECOND, remedy)
    assert newest(bus).problem is None and newest(bus).transactions == 1


def test_a_full_disk_settles_nothing_and_charging_continues_when_there_is_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    full = True
    execute = Store.execute

    def limited(store: Store, sql: str, *values: str | float | bytes | None) -> int:
        if full and sql.startswith("INSERT INTO booking"):
            error = sqlite3.OperationalError("x")
            error.sqlite_errorcode = sqlite3.SQLITE_FULL
            raise error
        return execute(store, sql, *values)

    def remedy(call: int) -> None:
        nonlocal full
        full = call < 40

    monkeypatch.setattr(Store, "execute", limited)
    repeated = dict.fromkeys(range(3, 110, 10), passage())
    bus = run(tmp_path, repeated, 12 * SECOND, remedy)
    states = [state for state in bus.published if isinstance(state, LedgerState)]
    assert "make room on its disk" in (next(s.problem for s in states if s.problem) or "")
    assert (states[-1].problem, states[-1].transactions) == (None, 1)
    assert bus.rejects["database"] >= 1


def test_a_database_of_a_newer_program_is_left_alone(tmp_path: Path) -> None:
    run(tmp_path, {}, 2)
    path = tmp_path / "toll" / "ledger.sqlite"
    with sqlite3.connect(path) as database:
        database.execute("PRAGMA user_version=99")
    assert "update it" in (newest(run(tmp_path, {}, 2 * SECOND)).problem or "")


def test_what_is_no_message_is_counted(tmp_path: Path) -> None:
    bus = FakeBus(tmp_path, lambda call: [sent_bytes("toll/passage", b'{"state":1}', START_NS)] if call < 1 else None,
                  start_ns=START_NS)  # fmt: skip
    Process(Config()).run(bus.as_bus())
    assert bus.rejects["payload"] == 1

"""Charges and detectors: what is held, what stands, what a person has to judge, and what is one vehicle."""

import sqlite3
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from services.core.toll.codes import Code as SilentCode
from services.monitoring.ledger.confirmation import Claim, Verdict, groups, judge
from services.monitoring.ledger.ledger import Ledger, Settings
from services.monitoring.ledger.pack import LEAST_PROBABILITY, MOST_MISSED, MOST_OTHERS_PER_S, pack_faults
from services.monitoring.ledger.store import LedgerFault, Store
from shared.messages.explanation import explain, passage
from shared.messages.toll import (
    EvidencePack,
    LaneProbability,
    LedgerState,
    PassageState,
    PictureAction,
    TollReview,
    TransactionKind,
)
from shared.unpacked import MIN_LIMIT_BYTES
from tests.support.cases import each
from tests.support.v2x.tolling import COUNTED, NS, PLAZA, START_NS, STATION, Vehicle, answer, ledger_at

OPEN, CROSSED, CHARGED = PassageState.OPEN, PassageState.CROSSED, PassageState.CHARGED
HELD, SUSPECT, UNREGISTERED = PassageState.HELD, PassageState.SUSPECT, PassageState.UNREGISTERED
EXIT_S = 3  # from the gate line to the final statement


@dataclass
class Gate:
    """A ledger, and vehicles that pass its gate."""

    ledger: Ledger
    store: Store
    counted: bool
    pulses: int = 0

    def vehicle(self, name: str, at_s: float = 15.0, **changes: object) -> Vehicle:
        made = Vehicle(name, crossing_ns=START_NS + round(at_s * NS))
        if self.counted:
            made = replace(made, plaza=COUNTED)
        return replace(made, **changes)  # type: ignore[arg-type]

    def pulse(self, vehicle: Vehicle, after_s: float = 0.0) -> None:
        at = replace(vehicle, crossing_ns=vehicle.crossing_ns + round(after_s * NS))
        self.ledger.detect(at.pulse(self.pulses), at.crossing_ns)
        self.pulses += 1

    def end(self, vehicle: Vehicle, *ahead: Vehicle, registered: bool = True, **changes: Any) -> None:
        """The statement behind the exit line; the ledger works every second."""
        now_ns = vehicle.crossing_ns + EXIT_S * NS
        if registered:
            self.ledger.register(vehicle.registration(), vehicle.opened_ns)
        overlaps = tuple(vehicle.passage_id for vehicle in ahead)
        state = CHARGED if registered else UNREGISTERED
        statement = vehicle.says(state, overlaps=overlaps, exit_ns=now_ns).model_copy(update=changes)
        self.ledger.passage(statement, now_ns)
        self.work(vehicle, EXIT_S)

    def work(self, vehicle: Vehicle, after_s: float) -> int:
        now_ns = vehicle.crossing_ns + round(after_s * NS)
        self.ledger.reconcile(now_ns)
        self.ledger.expire(now_ns)
        return now_ns

    def state(self, vehicle: Vehicle, after_s: float = EXIT_S) -> LedgerState:
        return self.ledger.state(self.work(vehicle, after_s))

    def outcome(self, vehicle: Vehicle, after_s: float = EXIT_S) -> PassageState:
        recent = self.state(vehicle, after_s).recent
        return next(row.state for row in recent if row.passage_id == vehicle.passage_id)

    def reviews(self) -> dict[str, TollReview]:
        return {review.passage_id: review for review in self.ledger.reviews()}


@pytest.fixture(params=[True, False], ids=["detectors", "no detectors"])
def any_gate(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Gate]:
    ledger, store = ledger_at(tmp_path / "ledger.sqlite", counted=request.param)
    yield Gate(ledger, store, request.param)
    store.close()


@pytest.fixture
def gate(tmp_path: Path) -> Iterator[Gate]:
    ledger, store = ledger_at(tmp_path / "ledger.sqlite", counted=True)
    yield Gate(ledger, store, counted=True)
    store.close()


@pytest.fixture
def open_gate(tmp_path: Path) -> Iterator[Gate]:
    ledger, store = ledger_at(tmp_path / "ledger.sqlite", counted=False)
    yield Gate(ledger, store, counted=False)
    store.close()


@pytest.mark.parametrize("first", ["pulse", "statement"])
def test_a_charge_needs_the_pulse_of_its_lane(gate: Gate, first: str) -> None:
    car = gate.vehicle("a")
    if first == "pulse":
        gate.pulse(car)
    gate.end(car)
    if first == "statement":
        assert gate.outcome(car) is HELD and gate.ledger.due(car.crossing_ns) == []
        assert gate.state(car).held == 1
        gate.pulse(car)
    assert gate.outcome(car) is CHARGED
    (charge,) = gate.ledger.due(car.crossing_ns)
    assert charge.confirmed and charge.reason == ""
    found = gate.state(car)
    assert (found.held, found.in_review, found.unconfirmed, found.transactions) == (0, 0, 0, 1)


def test_a_charge_without_a_pulse_is_held_and_then_reviewed_and_never_booked(gate: Gate) -> None:
    car = gate.vehicle("a")
    gate.end(car)
    assert gate.outcome(car, 30.0) is HELD
    assert gate.outcome(car, 34.0) is SUSPECT
    found = gate.state(car, 34.0)
    assert (found.held, found.in_review, found.transactions) == (0, 1, 0)
    (review,) = gate.reviews().values()
    assert review.reason_code == explain("ledger.not_counted")
    assert (review.contract, review.amount_cents, review.currency, review.reversed) == ("contract-1", 240, "EUR", False)
    assert gate.ledger.due(START_NS + 100 * NS) == []
    gate.ledger.passage(car.says(CHARGED), START_NS + 1000 * NS)  # repeated
    assert gate.ledger.state(START_NS + 1000 * NS).transactions == 0
    assert gate.ledger.evidence(car.passage_id) is not None, "whoever judges it needs its evidence"
    gate.ledger.reviewed(review)
    assert gate.reviews() == {}


LANES = (LaneProbability(lane="n1", probability=0.3), LaneProbability(lane="n2", probability=0.7))


def test_the_lane_of_an_undecided_passage_is_that_of_its_pulse(gate: Gate) -> None:
    car = gate.vehicle("a")
    gate.ledger.register(car.registration(), car.opened_ns)
    crossed = car.says(CROSSED).model_copy(update={"lane": None, "lanes": LANES})
    gate.ledger.passage(crossed, car.crossing_ns)
    gate.pulse(replace(car, lane="n1"), 0.05)
    gate.end(car, lane=None, lanes=LANES, state=PassageState.UNDECIDED, evidence=None)
    assert gate.outcome(car, 4) is HELD  # whatever is beside it may still come
    assert gate.outcome(car, EXIT_S + 31) is CHARGED
    (charge,) = gate.ledger.due(car.crossing_ns + 40 * NS)
    assert (charge.lane, charge.lane_probability, charge.confirmed) == ("n1", 0.3, True)
    pack = EvidencePack.model_validate_json(gate.ledger.evidence(car.passage_id) or b"")
    assert pack.verdict and pack.verdict.code == "ledger.lane_by_pulse" and list(pack_faults(pack, COUNTED)) == []
    assert pack.assignment is not None
    for forged in (
        pack.model_copy(update={"assignment": None}),
        pack.model_copy(update={"lane": "n2", "pulses": (pack.pulses[0].model_copy(update={"lane": "n2"}),)}),
        pack.model_copy(
            update={"assignment": pack.assignment.model_copy(
                update={"pulses": (*pack.assignment.pulses, pack.pulses[0].model_copy(update={"lane": "n2"}))})}
        ),
    ):  # fmt: skip
        assert list(pack_faults(forged, COUNTED))


def with_version(pack: EvidencePack, version: str) -> EvidencePack:
    """The pack as another version of the algorithms would have made its evidence."""
    evidence = pack.crossed.evidence
    assert evidence is not None
    crossed = pack.crossed.model_copy(update={"evidence": evidence.model_copy(update={"version": version})})
    return pack.model_copy(update={"crossed": crossed})


def test_a_pack_confirms_its_lane_by_its_own_pulse_and_by_limits_of_a_ledger(gate: Gate) -> None:
    car = gate.vehicle("a")
    gate.pulse(car, 0.05)
    gate.end(car)
    assert gate.outcome(car, EXIT_S + 31) is CHARGED
    pack = with_version(EvidencePack.model_validate_json(gate.ledger.evidence(car.passage_id) or b""), "3")
    given = pack.assignment
    assert given is not None and list(pack_faults(pack, COUNTED)) == []
    other = pack.pulses[0].model_copy(update={"lane": "n1"})
    unconfirmed: dict[str, object] = {"assignment": None, "pulses": (), "verdict": explain("ledger.unconfirmed")}
    changes: list[tuple[dict[str, object], str]] = [
        ({"lane": "n1", "pulses": (other,), "assignment": given.model_copy(update={"pulses": (other,)})},
         "the lane that is charged is not that of the final statement"),
        ({"assignment": None}, "does not have the pulses and passages around it"),
        (unconfirmed, "its lane has a detector, which has not confirmed it"),
        ({"verdict": None}, "its verdict is not that of a charge"),
        ({"verdict": explain("ledger.not_counted")}, "its verdict is not that of a charge"),
        ({"charged": pack.charged.model_copy(update={"lanes": (*pack.charged.lanes, LANES[0])})},
         "lanes and times of the final statement are not those of the crossing"),
        ({"charged": pack.charged.model_copy(update={"crossing_sd_s": 0.01})}, "is surer of the crossing time"),
        ({"match_gate_s": 1e6}, "by limits that no ledger may have"),
        ({"assignment": given.model_copy(update={"probability": 0.5})}, "and 0.500000 is said"),
    ]  # fmt: skip
    limits = {"least_probability": 0.0, "missed": 0.0, "others_per_s": 100.0, "detector_sd_s": 60.0}
    changes += [
        ({"assignment": given.model_copy(update={name: value})}, "by limits that no ledger may have")
        for name, value in limits.items()
    ]
    for change, fault in changes:
        assert any(fault in found for found in pack_faults(pack.model_copy(update=change), COUNTED)), fault
    earlier = with_version(pack, "2").model_copy(update={"assignment": None})
    assert list(pack_faults(earlier, COUNTED)) == []
    plain = pack.model_copy(update=unconfirmed)
    assert list(pack_faults(plain, PLAZA)) == [], "without a detector nothing confirms"


def test_a_ledger_takes_no_settings_by_which_its_packs_would_be_refused() -> None:
    for name, value in (
        ("counted_probability", LEAST_PROBABILITY), ("detector_missed", MOST_MISSED),
        ("other_pulses_per_s", 1.01 * MOST_OTHERS_PER_S),
    ):  # fmt: skip
        with pytest.raises(ValidationError, match=name):
            Settings.model_validate({name: value})


def test_an_undecided_passage_with_a_vehicle_beside_it_is_left_to_a_person(gate: Gate) -> None:
    car = gate.vehicle("a")
    gate.ledger.register(car.registration(), car.opened_ns)
    gate.ledger.passage(car.says(CROSSED).model_copy(update={"lane": None, "lanes": LANES}), car.crossing_ns)
    for lane in ("n1", "n2"):
        gate.pulse(replace(car, lane=lane), 0.02)
    gate.end(car, lane=None, lanes=LANES, state=PassageState.UNDECIDED, evidence=None)
    assert gate.outcome(car, EXIT_S + 31) is SUSPECT
    review = gate.reviews()[car.passage_id]
    assert review.reason_code and review.reason_code.code == "ledger.unsure" and not gate.state(car).transactions


def test_a_pulse_two_seconds_away_is_that_of_another_vehicle(gate: Gate) -> None:
    car = gate.vehicle("a")
    gate.pulse(car, 2.0)
    gate.end(car)
    assert gate.outcome(car, EXIT_S + 31) is SUSPECT
    assert not gate.state(car).transactions


def test_a_second_pulse_of_its_lane_leaves_a_passage_to_a_person(gate: Gate) -> None:
    car = gate.vehicle("a")
    gate.pulse(car, -0.55)
    gate.pulse(car, 0.5)
    gate.end(car, crossing_sd_s=0.5)
    assert gate.outcome(car) is HELD
    assert gate.outcome(car, EXIT_S + 31) is SUSPECT and not gate.state(car).transactions
    review = gate.reviews()[car.passage_id]
    assert review.reason_code and review.reason_code.code == "ledger.unsure"
    assert float(str(review.reason_code.values["probability"])) == pytest.approx(
        0.525, abs=2e-3
    )  # of two normal densities


def fall_silent(gate: Gate, car: Vehicle) -> None:
    """The statement on a vehicle whose radio fell silent before the gate line."""
    gate.ledger.register(car.registration(), car.opened_ns)
    gate.ledger.passage(
        car.says(
            PassageState.VOID, car.crossing_ns + 5 * NS, lane=None, lanes=LANES, crossing_ns=car.crossing_ns,
            crossing_sd_s=1.0, reason="silent", reason_code=explain(SilentCode.SILENT_BEFORE),
        ), car.crossing_ns + 5 * NS,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("lane", "after_s", "state"),
    [
        ("n1", 8.0, SUSPECT), ("n2", 110.0, SUSPECT), ("n2", 119.5, PassageState.VOID), ("n3", 8.0, PassageState.VOID),
        ("n2", -8.0, PassageState.VOID),
    ],
)  # fmt: skip
def test_a_pulse_after_a_stand_without_radio_before_the_line_is_reviewed(
    gate: Gate, lane: str, after_s: float, state: PassageState
) -> None:
    car = gate.vehicle("a")
    fall_silent(gate, car)
    gate.work(car, 6.0)
    gate.pulse(replace(car, lane=lane), after_s)
    for at_s in (40.0, 100.0, 145.0, 160.0):
        assert gate.work(car, at_s)
    assert gate.outcome(car, 161.0) is state and gate.state(car, 161.0).held == 0
    codes = [review.reason_code.code for review in gate.reviews().values() if review.reason_code]
    assert codes == (["ledger.silent_counted"] if state is SUSPECT else [])
    assert state is not SUSPECT or gate.ledger.pictures.count(PictureAction.KEEP) == 1


def test_a_vehicle_that_comes_back_after_its_silence_and_is_charged_is_not_reviewed(gate: Gate) -> None:
    car, back = gate.vehicle("a"), gate.vehicle("a again", 40.0, station_ids=(STATION,))
    fall_silent(gate, car)
    gate.pulse(back)
    gate.ledger.register(back.registration(), back.opened_ns)
    gate.end(replace(back, opened_ns=back.crossing_ns - 10 * NS))
    gate.pulse(replace(back, lane="n1"), 20.0)  # of a vehicle that sends nothing
    assert gate.outcome(back, 31.0) is CHARGED
    assert gate.outcome(car, 161.0) is PassageState.VOID and gate.reviews() == {}


def test_one_pulse_confirms_one_charge(gate: Gate) -> None:
    first, second = gate.vehicle("a"), gate.vehicle("b", 15.2)
    gate.pulse(first)
    gate.end(first, crossing_sd_s=1.0)
    assert gate.outcome(first) is CHARGED
    gate.end(second, crossing_sd_s=0.1)  # nearer to the pulse than its own crossing was stated to be
    assert gate.outcome(second, EXIT_S + 31) is SUSPECT and gate.state(second).transactions == 1
    owners = [row["owner"] for row in gate.store.rows("SELECT owner FROM pulse")]
    assert owners == [first.passage_id]


def test_a_restart_changes_no_probability(tmp_path: Path) -> None:
    path, rates = tmp_path / "ledger.sqlite", list[object]()
    for start_s in (0, 700):
        ledger, store = ledger_at(path, START_NS + start_s * NS, counted=True)
        for number in range(0 if start_s else 60):
            at = Vehicle(crossing_ns=START_NS + 10 * number * NS)
            ledger.detect(at.pulse(number), at.crossing_ns)
        for now_s in (800, 860):
            ledger.reconcile(START_NS + now_s * NS)
        rates.append(dict(ledger._others_per_s(START_NS + 930 * NS)))
        store.close()
    assert rates[0] == rates[1] and max(rates[0].values()) > 0.04  # type: ignore[attr-defined]


def test_a_void_statement_ends_what_is_held(gate: Gate) -> None:
    car = gate.vehicle("a")
    gate.end(car)
    gate.ledger.passage(car.says(PassageState.VOID, reason="turned around"), car.crossing_ns + 5 * NS)
    assert gate.outcome(car, 60.0) is PassageState.VOID and gate.reviews() == {}
    assert gate.state(car, 60.0).held == 0


def test_a_pulse_of_another_lane_or_of_the_vehicle_behind_confirms_nothing(gate: Gate) -> None:
    ahead, behind = gate.vehicle("a", 15.0), gate.vehicle("b", 17.0)
    gate.ledger.detect(ahead.pulse(0, lane="n1"), ahead.crossing_ns)
    gate.pulse(behind)
    gate.end(ahead)
    assert gate.outcome(ahead) is HELD
    gate.end(behind)
    assert gate.outcome(behind, 4.0) is CHARGED
    assert gate.outcome(ahead, 40.0) is SUSPECT


def test_without_a_detector_a_charge_is_final_and_labelled(open_gate: Gate) -> None:
    car = open_gate.vehicle("a")
    open_gate.end(car)
    (charge,) = open_gate.ledger.due(car.crossing_ns)
    assert not charge.confirmed and charge.reason
    found = open_gate.state(car, 400.0)
    (row,) = found.recent
    assert (row.state, row.reason_code, row.confirmed) == (CHARGED, explain("ledger.unconfirmed"), False)
    assert (found.unconfirmed, found.in_review, found.reversals) == (1, 0, 0)


@pytest.mark.parametrize("front_registered", [True, False])
def test_two_passages_that_overlap_with_two_pulses_stand_both(gate: Gate, front_registered: bool) -> None:
    front, behind = gate.vehicle("front"), gate.vehicle("behind", 15.3)
    gate.pulse(front)
    gate.pulse(behind)
    gate.end(front, registered=front_registered)
    gate.end(behind, front)
    assert gate.outcome(behind) is CHARGED
    assert gate.outcome(front) is (CHARGED if front_registered else UNREGISTERED)
    assert gate.outcome(behind, 400.0) is CHARGED and gate.reviews() == {}


@pytest.mark.parametrize("ghost", ["front", "behind"])
@pytest.mark.parametrize("registered", [True, False])
@pytest.mark.parametrize("followed", [True, False])
def test_two_passages_that_overlap_with_one_pulse_go_to_review_both(
    gate: Gate, ghost: str, registered: bool, followed: bool
) -> None:
    """A ghost sends CAM 1.5 m ahead of a vehicle, or behind it; the vehicle that follows has a pulse of its own."""
    front, behind, next_one = gate.vehicle("front"), gate.vehicle("behind", 15.1), gate.vehicle("next", 17.0)
    gate.pulse(front if ghost == "behind" else behind)
    gate.end(front, registered=registered or ghost != "front")
    gate.end(behind, front, registered=registered or ghost != "behind")
    if followed:
        gate.pulse(next_one)
        gate.end(next_one)
    assert gate.outcome(front, 40.0) is SUSPECT and gate.outcome(behind, 40.0) is SUSPECT
    reviews = gate.reviews()
    assert reviews.keys() == {front.passage_id, behind.passage_id}
    assert reviews[front.passage_id].overlaps == (behind.passage_id,)
    assert {review.contract is None for review in reviews.values()} == ({False} if registered else {True, False})
    why = explain("ledger.overlap_counted", passage_count=2, pulse_count=1)
    assert reviews[front.passage_id].reason_code == why
    real = front if ghost == "behind" else behind
    assert reviews[real.passage_id].amount_cents == 240 and reviews[real.passage_id].evidence_digest
    final = gate.state(front, 400.0)
    assert final.transactions - final.reversals == (1 if followed else 0)
    assert final.amount_cents == (240 if followed else 0)
    if followed:
        assert gate.outcome(next_one, 400.0) is CHARGED


def test_a_charge_that_an_overlap_contradicts_later_is_reversed_and_reviewed(gate: Gate) -> None:
    front, behind = gate.vehicle("front"), gate.vehicle("behind", 15.1)
    gate.pulse(front)
    gate.end(front)
    assert gate.outcome(front) is CHARGED
    gate.end(behind, front)
    found = gate.state(behind, 40.0)
    assert (found.transactions, found.reversals, found.amount_cents, found.in_review) == (1, 1, 0, 2)
    reviews = gate.reviews()
    assert reviews[front.passage_id].reversed and not reviews[behind.passage_id].reversed
    assert {t.kind for t in gate.ledger.due(START_NS + 100 * NS)} == set(TransactionKind)


def test_without_detectors_a_ghost_ahead_does_not_make_the_passage_behind_free(open_gate: Gate) -> None:
    ghost, car = open_gate.vehicle("ghost"), open_gate.vehicle("car", 15.1)
    open_gate.end(ghost, registered=False)
    open_gate.end(car, ghost)
    assert open_gate.outcome(car, 4.0) is CHARGED and open_gate.reviews() == {}


def test_without_detectors_two_registered_passages_at_one_place_go_to_review(open_gate: Gate) -> None:
    front, behind = open_gate.vehicle("front"), open_gate.vehicle("behind", 15.1)
    open_gate.end(front)
    open_gate.end(behind, front)
    found = open_gate.state(behind, 4.0)
    assert (found.transactions, found.reversals, found.in_review) == (1, 1, 2)
    assert open_gate.reviews().keys() == {front.passage_id, behind.passage_id}


def test_what_cannot_be_derived_again_is_held_and_reviewed_also_with_a_pulse(any_gate: Gate) -> None:
    car = any_gate.vehicle("a")
    any_gate.pulse(car)
    any_gate.end(car, derivable=False)
    assert any_gate.outcome(car, 4.0) is SUSPECT
    assert any_gate.state(car).transactions == 0
    assert any_gate.reviews()[car.passage_id].reason_code == explain("ledger.not_derivable")


def test_held_passages_survive_a_restart_of_the_ledger(tmp_path: Path) -> None:
    ledger, store = ledger_at(tmp_path / "ledger.sqlite", counted=True)
    gate = Gate(ledger, store, counted=True)
    car = gate.vehicle("a")
    gate.end(car)
    store.close()
    ledger, store = ledger_at(tmp_path / "ledger.sqlite", car.crossing_ns + 5 * NS, counted=True)
    gate = Gate(ledger, store, counted=True)
    assert gate.outcome(car, 6.0) is HELD
    gate.pulse(car)
    assert gate.outcome(car, 7.0) is CHARGED
    store.close()


# One vehicle, two passages: frames were left out, or the station ID has changed


@pytest.mark.parametrize("link", ["station", "chain", "contract"])
def test_passages_of_one_vehicle_that_overlap_in_time_are_one_and_the_first_id_stays(any_gate: Gate, link: str) -> None:
    first = any_gate.vehicle("a", station_ids=(7,))
    stations = {"station": (7,), "chain": (7, 70), "contract": (71,)}[link]
    second = any_gate.vehicle("a second ID", 15.4, station_ids=stations, opened_ns=START_NS + 3 * NS)
    any_gate.pulse(first)
    any_gate.ledger.register(first.registration("one"), START_NS)
    any_gate.ledger.register(second.registration("one"), START_NS)
    for vehicle in (first, second):
        any_gate.ledger.passage(vehicle.says(CHARGED, exit_ns=vehicle.crossing_ns + 2 * NS), vehicle.crossing_ns)
    found = any_gate.state(first, 40.0)
    assert (found.transactions, found.reversals, found.in_review, found.held) == (1, 0, 0, 0)
    assert any_gate.outcome(first) is CHARGED
    (row,) = [row for row in found.recent if row.passage_id == second.passage_id]
    assert row.state is PassageState.VOID and row.reason_code == explain(
        "ledger.same_vehicle", passage=passage(first.passage_id)
    )
    assert all(lane.agrees for lane in found.lanes)


def test_a_passage_that_joins_two_contracts_is_reviewed_and_takes_neither_charge_back(any_gate: Gate) -> None:
    first, second = any_gate.vehicle("a", station_ids=(7,)), any_gate.vehicle("b", 15.5, station_ids=(8,))
    for vehicle in (first, second):
        any_gate.pulse(vehicle)
        any_gate.end(vehicle)
    joint = any_gate.vehicle("c", 16.0, station_ids=(7, 8))
    any_gate.ledger.passage(joint.says(UNREGISTERED, exit_ns=joint.crossing_ns + NS), joint.crossing_ns + NS)
    found = any_gate.state(joint, 5.0)
    assert (found.transactions, found.reversals) == (2, 0)
    assert any_gate.outcome(first) is CHARGED
    review = any_gate.reviews()[joint.passage_id]
    assert review.contracts == ("contract of b", "contract-1")


def test_the_next_passage_of_a_vehicle_is_charged(any_gate: Gate) -> None:
    again = any_gate.vehicle("a again", 200.0, station_ids=(7,), opened_ns=START_NS + 150 * NS)
    for vehicle in (any_gate.vehicle("a", station_ids=(7,)), again):
        any_gate.pulse(vehicle)
        any_gate.end(vehicle)
    assert any_gate.state(again, 5.0).transactions == 2


# Files of earlier versions, and damaged ones

VERSION_1 = Path(__file__).with_name("ledger_version_1.sql")


def test_a_ledger_of_version_1_is_migrated_with_its_charges_and_passages_in_progress(tmp_path: Path) -> None:
    path = tmp_path / "ledger.sqlite"
    with sqlite3.connect(path) as database:
        database.executescript(VERSION_1.read_text(encoding="utf-8"))
    for _ in range(2):
        ledger, store = ledger_at(path, START_NS + 60 * NS)
        found = ledger.state(START_NS + 60 * NS)
        assert (found.transactions, found.outbox, found.held, found.unconfirmed) == (1, 1, 0, 1)
        (charge,) = ledger.due(START_NS + 60 * NS)
        assert (charge.contract, charge.amount_cents, charge.confirmed) == ("contract-1", 240, False)
        ledger.reconcile(START_NS + 60 * NS)
        assert [passage.passage_id for passage in ledger.open_passages(START_NS + 60 * NS).passages] == [
            Vehicle("b").passage_id
        ]
        store.close()
    ledger, store = ledger_at(path, START_NS + 60 * NS)
    ledger.register(Vehicle("b").registration(sampled_ns=START_NS + 60 * NS), START_NS + 60 * NS)
    ledger.passage(Vehicle("b").says(CHARGED), START_NS + 61 * NS)
    ledger.receipt(answer(charge, START_NS + 61 * NS), START_NS + 61 * NS)
    assert ledger.state(START_NS + 61 * NS).transactions == 2, "the vehicle has repeated its registration"
    assert store.row("PRAGMA user_version")["user_version"] == 4  # type: ignore[index]
    store.close()


@pytest.mark.parametrize(
    "damage", [b"", b"no zlib", b"x\x9c\x03\x00\x00\x00\x00\x01", zlib.compress(bytes(MIN_LIMIT_BYTES + 1))]
)
def test_damaged_evidence_is_a_sentence(any_gate: Gate, damage: bytes) -> None:
    car = any_gate.vehicle("a")
    any_gate.pulse(car)
    any_gate.end(car)
    any_gate.store.execute("UPDATE evidence SET pack = ?", damage)
    with pytest.raises(LedgerFault, match=r"the evidence of passage \w{8} cannot be read: .*restore its backup"):
        any_gate.ledger.evidence(car.passage_id)


@pytest.mark.parametrize(
    ("table", "column"), [("settled", "summary"), ("booking", "content"), ("passage", "statement"), ("held", "crossed")]
)
def test_a_damaged_row_is_a_sentence(gate: Gate, table: str, column: str) -> None:
    charged, held, in_progress = gate.vehicle("a"), gate.vehicle("b", 25.0), gate.vehicle("c", 26.0)
    gate.pulse(charged)
    gate.end(charged)
    gate.end(held)
    gate.ledger.register(in_progress.registration(), START_NS)
    gate.ledger.passage(in_progress.says(CROSSED), START_NS)
    gate.store.execute(f"UPDATE {table} SET {column} = '{{'")
    with pytest.raises(LedgerFault, match=r"(a row of passage \w{8} cannot be read|malformed).*restore its backup"):
        gate.state(held, 5.0)
        gate.ledger.due(START_NS + 100 * NS)


# The decision itself


def claim(passage_id: str, *overlaps: str, **changes: object) -> Claim:
    values = {
        "has_detector": True,
        "is_charge": True,
        "is_derivable": True,
        "pulse_sds": 0.5,
        "waited": False,
        **changes,
    }
    return Claim(passage_id, frozenset(overlaps), **values)  # type: ignore[arg-type]


def test_passages_are_grouped_over_a_third_one() -> None:
    made = {
        item.passage_id: item for item in (claim("a"), claim("b", "a"), claim("c", "b"), claim("d"), claim("e", "x"))
    }
    assert [[claim.passage_id for claim in group] for group in groups(made)] == [["a", "b", "c"], ["d"], ["e"]]


@each(
    ("changes", "verdict"),
    [
        ({}, Verdict.STANDS),
        ({"pulse_sds": 3.1}, Verdict.WAITS),
        ({"pulse_sds": 3.1, "waited": True}, Verdict.STANDS),
        ({"has_second": True}, Verdict.WAITS),
        ({"has_second": True, "waited": True}, Verdict.STANDS),
        ({"pulse_sds": None}, Verdict.WAITS),
        ({"pulse_sds": None, "waited": True}, Verdict.REVIEW),
        ({"has_detector": False, "pulse_sds": None}, Verdict.STANDS),
        ({"is_derivable": False}, Verdict.REVIEW),
        ({"is_derivable": False, "is_charge": False}, Verdict.STANDS),
    ],
)
def test_a_passage_alone(changes: dict[str, object], verdict: Verdict) -> None:
    assert judge([claim("a", **changes)], {"a"}).verdict is verdict


def test_an_overlap_whose_other_passage_has_not_ended_waits_for_it() -> None:
    assert judge([claim("b", "a")], {"b"}).verdict is Verdict.WAITS
    assert judge([claim("b", "a", waited=True)], {"b"}).verdict is Verdict.STANDS


def counted(passage_id: str, pulse: int | None, *explains: int, contract: bool = True, **changes: object) -> Claim:
    """An authenticated passage of a group that has waited."""
    return claim(
        passage_id, "x", pulse=pulse, pulse_sds=None if pulse is None else 1.0, explains=frozenset(explains),
        is_charge=contract, authenticated=True, waited=True, **changes,
    )  # fmt: skip


@each(
    ("group", "charged", "ghosts"),
    [
        ((counted("a", 1, 1), counted("b", 2, 2), counted("x", None, 1, contract=False)), {"a": 1, "b": 2}, ("x",)),
        ((counted("a", None, 1), counted("b", 2, 2), counted("x", 1, 1, contract=False)), {"a": 1, "b": 2}, ("x",)),
        (
            (counted("a", 1, 1, 2), counted("b", None, 1), counted("x", 2, 2, contract=False)),
            {"a": 2, "b": 1}, ("x",),
        ),
        (
            (counted("a", 1, 1), counted("w", 2, 2, contract=False), counted("x", None, contract=False)),
            {"a": 1}, ("x",),
        ),
        ((counted("a", 1, 1), counted("b", None, 1), counted("x", None, 1, contract=False)), {}, ()),
        ((counted("a", 1), counted("x", None, 1, contract=False)), {}, ()),
    ],
)  # fmt: skip
def test_contracts_with_a_pulse_each_are_charged_and_what_has_none_left_is_a_ghost(
    group: tuple[Claim, ...], charged: dict[str, int], ghosts: tuple[str, ...]
) -> None:
    found = judge(group, {claim.passage_id for claim in group} | {"x"})
    assert found.verdict is (Verdict.ALONE if charged else Verdict.REVIEW)
    assert (dict(found.charged), found.ghosts) == (charged, ghosts)


@each(
    ("settings", "named"),
    [
        ({"uncharged_kept_s": 10.0}, "uncharged_kept_s is 10 s: at least confirm_wait_s, 30 s"),
        ({"drive_round_s": 280.0}, "uncharged_kept_s is 300 s: at least drive_round_s"),
        ({"match_after_s": 20.0}, "match_after_s is 20 s: at least confirm_wait_s"),
        ({"picture_undecided_s": 100.0}, "picture_undecided_s is 100 s: at least match_after_s"),
    ],
)
def test_times_of_which_one_ends_what_another_waits_for_are_refused(settings: dict[str, float], named: str) -> None:
    with pytest.raises(ValidationError, match=named):
        Settings.model_validate(settings)


def test_a_held_passage_that_is_not_remembered_any_more_is_no_damage(gate: Gate) -> None:
    car = gate.vehicle("a")
    gate.end(car)
    gate.store.execute("DELETE FROM settled")
    gate.work(car, 40.0)
    (review,) = gate.reviews().values()
    assert review.contract == "contract-1" and gate.state(car, 41.0).held == 0

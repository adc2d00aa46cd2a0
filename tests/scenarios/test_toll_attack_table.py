"""The table of attacks: what each one gains, signed and unsigned, through the whole role.

Signed: the plaza charges authenticated vehicles only, and every vehicle has a ticket; the attacker has a valid one of
his own. Unsigned: the plaza allows station IDs, and nothing is authenticated. `charged` are the contracts that pay,
`account` is what came of the detector's pulses. A contract that pays for another vehicle is wrong: that happens in one
row, unsigned, which says so.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from shared.messages.toll import AlarmKind
from tests.support.v2x.role import COMMON, Role
from tests.support.v2x.tickets import Ticket, that_requires_tickets
from tests.support.v2x.toll import Vehicle
from tests.support.v2x.tolling import WITH_DETECTORS

CAR = Vehicle(7, "n2", error=COMMON)
CROSSING_S = 12.5
GONE_S = 17.0  # beyond the exit line
SETTLED_S = 220.0
VICTIM, OTHER, THIRD, THIEF = (Ticket(name) for name in ("victim", "other", "third", "thief"))
DIRECTED = WITH_DETECTORS.replace('"detector": true', '"detector": true, "detector_direction": true')
MIXED = WITH_DETECTORS.replace('"detector": true', '"detector": true, "traffic": "mixed"')
Silent = Callable[[float, Vehicle], bool]


@dataclass
class Attack:
    """Vehicles, who has a contract, what the detector counts, and what follows signed and unsigned."""

    vehicles: tuple[Vehicle, ...]
    pulses_s: tuple[float, ...]
    signed: tuple[tuple[str, ...], dict[str, int]]  # contracts that pay, account
    unsigned: tuple[tuple[str, ...], dict[str, int]]
    tickets: tuple[Ticket, ...] = (VICTIM, THIEF)
    contracts: tuple[tuple[Ticket, str, int], ...] = ((VICTIM, "victim", 7),)
    silent: Silent = lambda _t, _vehicle: False
    backward_s: tuple[float, ...] = ()
    plaza_file: str = WITH_DETECTORS
    reviews: tuple[set[str], set[str]] = field(default=(set(), set()))  # codes, signed and unsigned
    gone_s: float = GONE_S
    wrong_unsigned: int = 0  # contracts that pay for another vehicle


def reversing(until_s: float, car: Vehicle = CAR) -> Vehicle:
    """The same station, from a time on, as if it drove backwards over the gate line."""
    at = car.distance(until_s)
    return replace(car, start=at, since=until_s, speed=20.0, backward=True)


REVERSED = (CAR, reversing(14.0))
SECOND = replace(CAR, station_id=8, start=CAR.start - 40.0)
FORWARD_THEN_BACK: Silent = lambda t, vehicle: (t >= 14.0) is not vehicle.backward  # noqa: E731  # one line of a table

ATTACKS = {
    "ghost 1.5 m ahead": Attack(
        (CAR, replace(CAR, station_id=9, start=CAR.start + 1.5)), (CROSSING_S,),
        signed=(("victim",), {"charged": 1}), unsigned=((), {"review": 1}),
        reviews=(set(), {"ledger.overlap_counted"}),
    ),
    "fake reverse behind the gate line": Attack(
        REVERSED, (CROSSING_S,), tickets=(VICTIM, VICTIM), silent=FORWARD_THEN_BACK,
        signed=((), {"review": 1}), unsigned=((), {"review": 1}),
        reviews=({"ledger.turned_counted"}, {"ledger.turned_counted"}),
    ),
    "silence behind the gate line": Attack(
        (CAR,), (CROSSING_S,), silent=lambda t, _: t > 13.0,
        signed=(("victim",), {"charged": 1}), unsigned=(("victim",), {"charged": 1}),
    ),
    "silence behind the gate line, pulse missed": Attack(
        (CAR,), (), silent=lambda t, _: t > 13.0, signed=((), {}), unsigned=((), {}),
        reviews=({"ledger.not_counted"}, {"ledger.not_counted"}),
    ),
    "silence before the gate line": Attack(
        (CAR,), (CROSSING_S,), silent=lambda t, _: t > 11.5,
        signed=((), {"review": 1}), unsigned=((), {"review": 1}),
        reviews=({"ledger.silent_counted"}, {"ledger.silent_counted"}),
    ),
    "silence before the gate line, and no pulse": Attack(
        (CAR,), (), silent=lambda t, _: t > 11.5, signed=((), {}), unsigned=((), {}),
    ),
    "U-turn that no detector has counted": Attack(
        REVERSED, (), tickets=(VICTIM, VICTIM), silent=FORWARD_THEN_BACK, signed=((), {}), unsigned=((), {}),
    ),
    "U-turn with a pulse backwards": Attack(
        REVERSED, (CROSSING_S, 16.0), tickets=(VICTIM, VICTIM), silent=FORWARD_THEN_BACK, backward_s=(16.0,),
        plaza_file=DIRECTED, signed=((), {"void": 2}), unsigned=((), {"void": 2}),
    ),
    "two U-turns and one pulse backwards": Attack(
        (*REVERSED, SECOND, reversing(16.0, SECOND)), (CROSSING_S, CROSSING_S + 2.0, 16.0),
        tickets=(VICTIM, VICTIM, OTHER, OTHER), contracts=((VICTIM, "victim", 7), (OTHER, "other", 8)),
        silent=lambda t, vehicle: (t >= (14.0 if vehicle.station_id == 7 else 16.0)) is not vehicle.backward,
        gone_s=18.5, backward_s=(16.0,), plaza_file=DIRECTED,
        signed=((), {"void": 2, "review": 1}), unsigned=((), {"void": 2, "review": 1}),
        reviews=({"ledger.turned_counted"}, {"ledger.turned_counted"}),
    ),
    "motorcycle without a radio beside a car": Attack(
        (CAR,), (CROSSING_S, CROSSING_S + 0.45),
        signed=(("victim",), {"charged": 1, "missed": 1}), unsigned=(("victim",), {"charged": 1, "missed": 1}),
    ),
    "motorcycle with a contract between two lanes": Attack(
        (replace(CAR, left=1.75),), (CROSSING_S,),
        signed=(("victim",), {"charged": 1}), unsigned=(("victim",), {"charged": 1}),
    ),
    "stated accuracy of 12 m, in a mixed lane": Attack(
        (replace(CAR, stated_sd=12.0),), (CROSSING_S,), plaza_file=MIXED,
        signed=(("victim",), {"charged": 1}), unsigned=(("victim",), {"charged": 1}),
    ),
    "trailer that is counted twice": Attack(
        (CAR,), (CROSSING_S, CROSSING_S + 0.35),
        signed=(("victim",), {"charged": 1, "missed": 1}), unsigned=(("victim",), {"charged": 1, "missed": 1}),
    ),
    "platoon at 3 m": Attack(
        (CAR, replace(CAR, station_id=8, start=CAR.start - 7.5), replace(CAR, station_id=9, start=CAR.start - 15.0)),
        (CROSSING_S, CROSSING_S + 0.375, CROSSING_S + 0.75), tickets=(VICTIM, OTHER, THIRD),
        contracts=((VICTIM, "victim", 7), (OTHER, "other", 8), (THIRD, "third", 9)),
        signed=(("other", "third", "victim"), {"charged": 3}),
        unsigned=(("other", "third", "victim"), {"charged": 3}),
    ),
    "tailgating without a radio": Attack(
        (CAR,), (CROSSING_S, CROSSING_S + 0.375),
        signed=(("victim",), {"charged": 1, "missed": 1}), unsigned=(("victim",), {"charged": 1, "missed": 1}),
    ),
    "two contracts of one ticket or station ID": Attack(
        (CAR,), (CROSSING_S,), contracts=((VICTIM, "victim", 7), (VICTIM, "second", 7)),
        signed=((), {"review": 1}), unsigned=((), {"review": 1}),
        reviews=({"ledger.two_contracts"}, {"ledger.two_contracts"}),
    ),
    "the victim's station ID with another valid ticket": Attack(
        (CAR,), (CROSSING_S,), tickets=(THIEF,),
        signed=((), {"suspect": 1}), unsigned=(("victim",), {"charged": 1}), wrong_unsigned=1,
        reviews=({"ledger.identity"}, set()),
    ),
}  # fmt: skip


def role_of(folder: Path, attack: Attack, *, signed: bool) -> Role:
    common: dict[str, object] = {"vehicles": attack.vehicles, "pulses_s": attack.pulses_s, "registered": (),
                                 "backward_s": attack.backward_s}  # fmt: skip
    if signed:
        role = Role(
            folder, **common, tickets=dict(enumerate(attack.tickets)), contracts=attack.contracts,  # type: ignore[arg-type]
            plaza_file=that_requires_tickets(attack.plaza_file),
        )  # fmt: skip
    else:
        stations = tuple((station, contract) for _, contract, station in attack.contracts)
        role = Role(folder, **common, stations=stations, plaza_file=attack.plaza_file)  # type: ignore[arg-type]
    role.is_lost = lambda t, vehicle: t > attack.gone_s or attack.silent(t, vehicle)
    return role


@pytest.mark.parametrize("signed", [True, False], ids=["signed", "unsigned"])
@pytest.mark.parametrize("name", ATTACKS)
def test_an_attack_makes_nobody_else_pay_and_nothing_past_a_detector_free(
    tmp_path: Path, name: str, signed: bool
) -> None:
    attack = ATTACKS[name]
    role = role_of(tmp_path, attack, signed=signed)
    role.drive(SETTLED_S)
    charges = role.ledger.due(10**18)
    paid = sorted(charge.contract for charge in charges if charge.amount_cents > 0)
    contracts, account = attack.signed if signed else attack.unsigned
    assert tuple(paid) == contracts
    (balance,) = role.state().lanes or (None,)
    found = Counter(balance.model_dump(include=set(ACCOUNT)) if balance else {})
    assert +found == Counter(account), "what came of each pulse"
    assert (balance is None) == (not attack.pulses_s)
    assert balance is None or (balance.agrees and balance.detections == len(attack.pulses_s))
    codes = {review.reason_code.code for review in role.reviews() if review.reason_code}
    assert codes == attack.reviews[0 if signed else 1]
    assert all(charge.authenticated is signed for charge in charges)
    owners = {contract for ticket, contract, _ in attack.contracts if ticket in attack.tickets}
    wrong = [contract for contract in paid if contract not in owners]
    assert len(wrong) == (0 if signed else attack.wrong_unsigned)


ACCOUNT = ("charged", "review", "undecided", "unregistered", "suspect", "void", "missed")


@pytest.mark.parametrize(("stop_s", "kept"), [(13.2, 1), (11.5, 0)], ids=["behind the gate line", "before it"])
def test_a_contract_whose_core_stops_while_it_passes_is_left_to_a_person(
    tmp_path: Path, stop_s: float, kept: int
) -> None:
    role = role_of(tmp_path, Attack((CAR,), (CROSSING_S,), ((), {}), ((), {})), signed=True)
    role.drive(stop_s)
    role.core = None
    role.drive(180.0)
    (review,) = role.reviews()
    assert review.contract == "victim" and review.reason_code and review.reason_code.code == "ledger.no_statement"
    assert len(role.store.rows("SELECT 1 FROM evidence")) == kept
    assert [row["action"] for row in role.store.rows("SELECT action FROM picture")] == ["keep"]


def test_an_authenticated_ghost_is_reported_with_its_ticket_and_kept_in_the_pack(tmp_path: Path) -> None:
    role = role_of(tmp_path, ATTACKS["ghost 1.5 m ahead"], signed=True)
    role.drive(60.0)
    (charge,) = role.ledger.due(10**18)
    (alarm,) = role.alarms
    assert (alarm.kind, alarm.ticket, alarm.lane) == (AlarmKind.MISBEHAVIOUR, THIEF.digest, "n2")
    assert charge.ghosts == 1 and charge.ticket == VICTIM.digest


def test_a_slow_ghost_with_a_ticket_and_a_length_of_a_lorry_stops_no_charge(tmp_path: Path) -> None:
    """Three cars pass beside a station without contract that states 16.5 m, of which each car is a neighbour."""
    cars = tuple(replace(CAR, station_id=10 + k, start=CAR.start - 40.0 * k) for k in range(3))
    ghost = replace(CAR, station_id=99, start=-35.0, speed=3.0, extra={"vehicle_length_m": 16.5})
    tickets = {k: Ticket(f"car {k}") for k in range(3)}
    role = Role(
        tmp_path, (*cars, ghost), (), tuple(CROSSING_S + 2.0 * k for k in range(3)), tickets={**tickets, 3: THIEF},
        contracts=tuple((ticket, f"contract {k}", 10 + k) for k, ticket in tickets.items()),
        plaza_file=that_requires_tickets(WITH_DETECTORS),
    )  # fmt: skip
    role.is_lost = lambda t, vehicle: vehicle.distance(t) > 80.0
    role.drive(120.0)
    assert role.state().transactions == 3 and role.reviews() == []
    assert [(alarm.kind, alarm.ticket) for alarm in role.alarms] == [(AlarmKind.MISBEHAVIOUR, THIEF.digest)]


def test_one_radio_with_ghosts_before_every_car_stops_no_charge_and_is_an_attack(tmp_path: Path) -> None:
    """Five cars in ten seconds, each with a ghost that is not authenticated 1.5 m ahead."""
    cars = tuple(replace(CAR, station_id=10 + k, start=CAR.start - 40.0 * k) for k in range(5))
    ghosts = tuple(replace(car, station_id=100 + k, start=car.start + 1.5) for k, car in enumerate(cars))
    tickets = {k: Ticket(f"car {k}") for k in range(5)}
    role = Role(
        tmp_path, (*cars, *ghosts), (), tuple(CROSSING_S + 2.0 * k for k in range(5)), tickets=tickets,
        contracts=tuple((ticket, f"contract {k}", 10 + k) for k, ticket in tickets.items()),
        plaza_file=that_requires_tickets(WITH_DETECTORS),
    )  # fmt: skip
    role.is_lost = lambda t, vehicle: vehicle.distance(t) > 80.0
    role.drive(70.0)
    assert role.state().transactions == 5 and role.reviews() == []
    assert [(alarm.kind, alarm.lane, alarm.ticket) for alarm in role.alarms] == [(AlarmKind.GHOSTS, "n2", None)]
    assert role.alarms[0].ghosts >= 3

"""A stranger who sends the victim's station ID from elsewhere: the victim is charged, or a person judges."""

from dataclasses import replace
from pathlib import Path

import pytest

from shared.messages.toll import PassageState
from tests.support.v2x.role import COMMON, Role
from tests.support.v2x.tickets import Ticket, that_requires_tickets
from tests.support.v2x.toll import Vehicle
from tests.support.v2x.tolling import WITH_DETECTORS

CAR = Vehicle(7, "n2", error=COMMON)
STRANGER = Vehicle(7, "s2", error=COMMON, start=-300.0)
CROSSING_S = 12.5
VICTIM, THIEF = Ticket("victim"), Ticket("thief")


def role_of(folder: Path, *, signed: bool, ahead_s: float = 0.0, with_clock: float = 0.0) -> Role:
    """The stranger is on the other carriageway first, and his clock may be ahead."""
    stranger = replace(STRANGER, clock_error_s=with_clock)
    role = Role(
        folder, (stranger, CAR), (), (CROSSING_S,), plaza_file=that_requires_tickets(WITH_DETECTORS) if signed else "",
        tickets={0: THIEF, 1: VICTIM} if signed else {}, contracts=((VICTIM, "victim", 7),) if signed else (),
        stations=() if signed else ((7, "victim"),),
    )  # fmt: skip
    role.is_lost = lambda t, vehicle: t > 17.0 or (vehicle.lane == "n2" and t < ahead_s)
    return role


@pytest.mark.parametrize("with_clock", [0.0, 0.5])
def test_signed_the_victim_is_charged_whoever_uses_the_id_first(tmp_path: Path, with_clock: float) -> None:
    role = role_of(tmp_path, signed=True, ahead_s=2.0, with_clock=with_clock)
    role.drive(40.0)
    assert [charge.contract for charge in role.ledger.due(10**18)] == ["victim"]
    (balance,) = role.state().lanes
    assert (balance.charged, balance.missed) == (1, 0)
    states = {statement.state for statement in role.statements if statement.tickets == (THIEF.digest,)}
    assert PassageState.CHARGED not in states


@pytest.mark.parametrize("with_clock", [0.0, 0.5])
def test_unsigned_the_victims_frames_are_used_and_his_car_is_not_missed(tmp_path: Path, with_clock: float) -> None:
    role = role_of(tmp_path, signed=False, ahead_s=2.0, with_clock=with_clock)
    role.drive(200.0)
    assert role.ledger.due(10**18) == []
    (balance,) = role.state().lanes
    assert (balance.review, balance.missed) == (1, 0)
    assert role.core is not None and role.core.rejects["late_or_repeated"] == 0

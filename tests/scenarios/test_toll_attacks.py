"""Attacks on a toll plaza through the whole role: radio frames, parser, tracks, passages, detectors, bookings."""

import struct
from dataclasses import replace
from pathlib import Path

import pytest

from shared.messages.toll import PassageState
from shared.messages.v2x import Encapsulation
from shared.v2x import geonetworking, its_time
from tests.support.v2x.role import COMMON, Role, packet
from tests.support.v2x.toll import Vehicle

CAR = Vehicle(7, "n2", error=COMMON)
CROSSING_S = 12.5
CYCLE_S = its_time.CYCLE_MS / 1000.0
CHARGED, SUSPECT = PassageState.CHARGED, PassageState.SUSPECT
TIME_AT = geonetworking.POSITION_AT + 8


def with_header_time(frame: bytes, later_s: float) -> bytes:
    """Set the clock of the header forward, as an attacker who knows the check does."""
    (time_ms,) = struct.unpack_from(">I", frame, TIME_AT)
    moved = struct.pack(">I", (time_ms + round(later_s * 1000)) % geonetworking.TIME_CYCLE_MS)
    return frame[:TIME_AT] + moved + frame[TIME_AT + 4 :]


@pytest.mark.parametrize(
    ("omitted_s", "attack"),
    [
        (0.0, "as received"),
        (4.0, "new headers"),
        pytest.param(0.0, "bare CAM", marks=pytest.mark.slow),
        (4.0, "bare CAM"),
    ],
)
def test_frames_replayed_after_65_s_charge_nobody_again(tmp_path: Path, omitted_s: float, attack: str) -> None:
    """The detector even counts a vehicle at the time of the replay: the attacker drives through himself."""
    role = Role(tmp_path, (CAR,), pulses_s=(CROSSING_S, CROSSING_S + CYCLE_S))
    bare = attack == "bare CAM"
    role.encapsulation = Encapsulation.NONE if bare else Encapsulation.GEONETWORKING
    role.is_lost = lambda t, _vehicle: bare or t > 20.0
    for k in range(200):
        frame = packet(CAR, k / 10.0)
        again = with_header_time(frame, CYCLE_S) if attack == "new headers" else frame
        if bare:
            role.injected.append((k / 10.0, geonetworking.decode_payload(frame)))
        if k / 10.0 >= omitted_s:
            role.injected.append((k / 10.0 + CYCLE_S, geonetworking.decode_payload(again) if bare else again))
    role.drive(20.0)
    assert list(role.outcomes().values()) == [CHARGED]
    role.drive(CYCLE_S + 20.0)
    assert (role.state().transactions, role.state().in_review) == (1, 0)
    assert len({statement.passage_id for statement in role.statements}) == 1
    refused = role.parser.rejects["header_time"] if attack == "as received" else role.core.rejects["replayed"]  # type: ignore[union-attr]
    assert refused == 200 - round(omitted_s * 10)


@pytest.mark.parametrize("omitted_s", [pytest.param(3.0, marks=pytest.mark.slow), 6.0])
def test_a_second_receiver_that_misses_the_first_frames_makes_no_second_charge(
    tmp_path: Path, omitted_s: float
) -> None:
    """The process is lost with its memory, and the next one opens the passage of the vehicle under another ID."""
    role = Role(tmp_path, (CAR,), pulses_s=(CROSSING_S,))
    role.drive(20.0)
    (first,) = role.outcomes()
    late = Role(tmp_path, (CAR,), pulses_s=(CROSSING_S,))
    late.is_lost = lambda t, _vehicle: t < omitted_s
    late.drive(40.0)
    assert {statement.passage_id for statement in late.statements if statement.state is CHARGED} - {first}, "another ID"
    assert late.state().transactions - late.state().reversals == 1
    assert late.outcomes()[first] is CHARGED


@pytest.mark.parametrize("detectors", [True, pytest.param(False, marks=pytest.mark.slow)])
@pytest.mark.parametrize("real", [pytest.param(True, marks=pytest.mark.slow), False])
def test_an_unregistered_vehicle_1_5_m_ahead_never_makes_a_passage_free(
    tmp_path: Path, detectors: bool, real: bool
) -> None:
    """A ghost: one pulse, a person judges both. A real vehicle that is located too far back: two pulses, both stand."""
    ghost = replace(CAR, station_id=9, start=CAR.start + 1.5)
    pulses = (CROSSING_S - 0.075, CROSSING_S) if real else (CROSSING_S,)
    role = Role(tmp_path, (ghost, CAR), pulses_s=pulses, detectors=detectors)
    role.drive(60.0)
    of_car = next(statement.passage_id for statement in role.statements if statement.station_ids == (7,))
    assert PassageState.VOID not in role.outcomes().values()
    if real or not detectors:
        assert role.outcomes()[of_car] is CHARGED and role.reviews() == []
    else:
        assert set(role.outcomes().values()) == {SUSPECT} and len(role.outcomes()) == 2
        review = next(review for review in role.reviews() if review.passage_id == of_car)
        assert (review.contract, review.amount_cents, len(review.overlaps)) == ("contract of 7", 240, 1)


@pytest.mark.parametrize("detectors", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_missing_pulse_holds_the_charge_where_there_is_a_detector(tmp_path: Path, detectors: bool) -> None:
    role = Role(tmp_path, (CAR,), detectors=detectors)
    role.drive(20.0)
    found = role.state()
    assert (found.held, found.transactions, found.unconfirmed) == ((1, 0, 0) if detectors else (0, 1, 1))
    role.drive(60.0)
    assert list(role.outcomes().values()) == [SUSPECT if detectors else CHARGED]
    assert role.state().transactions == (0 if detectors else 1)

"""A restart of core.toll with the ledger's memory: the same passages, and evidence that is complete."""

from dataclasses import replace
from pathlib import Path

import pytest

from cli.verify_toll import Evidence, differences_of, is_continued, parse
from shared.messages.explanation import explain
from shared.messages.toll import EvidenceFrame, PassageState, UsedCams
from shared.messages.v2x import CamList
from shared.v2x import its_time
from shared.v2x.evidence import cam_of
from tests.support.v2x.role import COMMON, LATENCY_S, Role, packet, stamp
from tests.support.v2x.toll import START_NS, Vehicle

CAR = Vehicle(7, "n2", error=COMMON)
RENAMED = CAR.named(77)
CROSSING_S = 12.5


def unit_of(folder: Path, new_id_at: float | None = None) -> Role:
    """A unit whose only vehicle changes its station ID at a time [s]."""
    unit = Role(folder, (CAR, RENAMED), registered=(7, 77), pulses_s=(CROSSING_S,))
    unit.is_lost = lambda t, vehicle: (vehicle is RENAMED) != (new_id_at is not None and t >= new_id_at)
    return unit


def evidence_of(unit: Role, passage_id: str) -> Evidence:
    text = unit.ledger.evidence(passage_id)
    assert text is not None
    return Evidence(passage_id, text)


@pytest.mark.parametrize("kill", [3.0, 6.0, 11.6, 12.2, 13.0])
@pytest.mark.parametrize("new_id_at", [None, 5.0])
def test_after_a_restart_the_charge_is_derived_bit_for_bit_from_complete_evidence(
    tmp_path: Path, kill: float, new_id_at: float | None
) -> None:
    """1.5 s of CAM are lost while nobody tracks; all others are evidence, from the opening on."""
    unit = unit_of(tmp_path, new_id_at)
    unit.drive(kill)
    opened = unit.statements[0]
    unit.restart_core()
    unit.drive(40.0)
    (charged,) = [
        passage_summary for passage_summary in unit.state().recent if passage_summary.state is PassageState.CHARGED
    ]
    assert charged.passage_id == opened.passage_id
    found = evidence_of(unit, charged.passage_id)
    pack = parse(found)
    assert pack.crossed.evidence is not None
    assert pack.crossed.evidence.track_since_ns == opened.opened_ns and not is_continued(pack)
    assert differences_of(found, pack) == []
    before = [frame for frame in pack.crossed.evidence.frames if frame.sampled_ns < stamp(kill)]
    lost_s = 1.6 if new_id_at is not None and 0.0 <= kill - new_id_at < 1.5 else 0.6  # a new ID is not confirmed yet
    assert len(before) >= (kill - (opened.opened_ns - START_NS) * 1e-9 - lost_s) * 10.0, "all but the last half second"


@pytest.mark.parametrize("is_killed", [True, False])
def test_a_vehicle_that_is_heard_again_behind_the_exit_line_is_charged_by_evidence_that_gives_the_same(
    tmp_path: Path, is_killed: bool
) -> None:
    """Gate and exit line lie between two CAM; after a restart nothing but the end is stated, with the same evidence."""
    unit = unit_of(tmp_path)
    unit.drive(12.2)
    if is_killed:
        unit.restart_core(outage_s=2.3)
    else:
        unit.is_lost = lambda t, vehicle: vehicle is RENAMED or 12.2 <= t < 14.5
    unit.drive(40.0)
    (charged,) = [
        passage_summary for passage_summary in unit.state().recent if passage_summary.state is PassageState.CHARGED
    ]
    found = evidence_of(unit, charged.passage_id)
    pack = parse(found)
    assert pack.crossed.state is (PassageState.CHARGED if is_killed else PassageState.CROSSED)
    assert not is_continued(pack) and differences_of(found, pack) == []


@pytest.mark.parametrize("late_s", [1.5, 4.0])
@pytest.mark.parametrize("kill", [12.2, 13.4])
def test_a_delta_that_came_too_late_is_not_used_after_a_restart_either(
    tmp_path: Path, kill: float, late_s: float
) -> None:
    """As on a busy machine: without a delta the CAM leave the lane open, and a restart must not decide it.

    The pulse decides, and the charge follows from the evidence all the same.
    """
    unit = unit_of(tmp_path)
    unit.drive(3.0)
    unit.fixes_late_s = late_s
    unit.drive(kill)
    assert unit.core is not None and unit.core.rejects["late_delta"] > 2
    unit.restart_core()
    unit.drive(60.0)
    (final,) = unit.state().recent
    assert final.reason_code and final.reason_code.code == "ledger.lane_by_pulse"
    found = evidence_of(unit, final.passage_id)
    pack = parse(found)
    assert pack.charged.lane is None and pack.lane == final.lane == "n2"
    assert not is_continued(pack) and differences_of(found, pack) == []


def test_without_the_memory_a_passage_that_cannot_be_derived_again_is_reviewed_and_not_charged(tmp_path: Path) -> None:
    """Both are killed just before the gate line: the new track begins behind it, and its evidence has no crossing."""
    unit = unit_of(tmp_path)
    unit.drive(12.3)
    unit.core = None
    unit.drive(13.0)
    unit.start_ledger()
    unit.drive(13.8)
    unit.start_core()
    unit.drive(60.0)
    final = unit.state()
    assert (final.transactions, final.in_review) == (0, 1)
    assert final.recent[0].reason_code == explain("ledger.not_derivable")


def test_a_restart_of_the_ledger_before_that_of_core_toll_loses_nothing(tmp_path: Path) -> None:
    """The ledger's memory is filled again by the process that runs."""
    unit = unit_of(tmp_path)
    unit.drive(6.0)
    unit.start_ledger()
    unit.drive(9.0)
    unit.restart_core()
    unit.drive(40.0)
    (charged,) = unit.state().recent
    pack = parse(found := evidence_of(unit, charged.passage_id))
    assert not is_continued(pack) and differences_of(found, pack) == []
    assert pack.crossed.evidence is not None
    assert sum(frame.sampled_ns < stamp(6.0) for frame in pack.crossed.evidence.frames) > 30


def test_the_memory_holds_a_minute_and_is_not_on_the_disk(tmp_path: Path) -> None:
    unit = Role(tmp_path, (replace(CAR, speed=0.0, start=-100.0),))
    unit.drive(100.0)
    unit.restart_core()
    new = UsedCams(sampled_ns=stamp(101.5), since_ns=stamp(101.5), cams=())
    unit.ledger.remember(new)
    kept = [frame for restored in unit.ledger.restored() for frame in restored.used.cams]
    assert 68.0 * 10 < len(kept) < 71.0 * 10
    on_disk = b"".join(path.read_bytes() for path in tmp_path.iterdir())
    assert not any(frame.data in on_disk for frame in kept)
    unit.ledger.expire(stamp(200.0))
    unit.ledger.remember(new.model_copy(update={"since_ns": stamp(200.0)}))
    assert unit.ledger.restored() == []


def test_a_replay_is_recognised_after_a_restart(tmp_path: Path) -> None:
    unit = unit_of(tmp_path)
    unit.drive(20.0)
    unit.restart_core()
    unit.vehicles = ()
    unit.drive(66.0)
    assert unit.core is not None
    cycle_s = its_time.CYCLE_MS / 1000.0
    late = tuple(
        cam_of(
            EvidenceFrame(
                sampled_ns=stamp(t + cycle_s), received_ns=stamp(t + cycle_s + LATENCY_S), data=packet(CAR, t)
            )
        )
        for t in (k / 10.0 for k in range(20))
    )
    list(unit.core.handle(CamList(received_ns=late[-1].received_ns, source="v2x0", cams=late)))
    assert unit.core.rejects["replayed"] == 20


def test_a_restored_frame_that_is_no_cam_is_counted(tmp_path: Path) -> None:
    unit = unit_of(tmp_path)
    unit.drive(6.0)
    unit.ledger.remember(
        UsedCams(sampled_ns=stamp(6.0), since_ns=1, cams=({"sampled_ns": 0, "received_ns": 0, "data": b"no CAM",
                                                           "clock_offset_ns": 0},))  # type: ignore[arg-type]
    )  # fmt: skip
    unit.restart_core()
    unit.drive(20.0)
    assert unit.core is not None and unit.core.rejects["truncated"] == 1
    assert unit.statements[-1].state is PassageState.CHARGED

"""The simulated plaza: errors and generation rules as they are stated, and a channel with the stated losses."""

from collections import Counter
from itertools import pairwise, takewhile
from math import hypot
from pathlib import Path

import numpy as np
import pytest

from services.parsers.gnss.process import Config as GnssConfig
from services.parsers.gnss.process import Process as GnssParser
from services.parsers.v2x.process import Config, Process
from services.sensors.traffic.errors import ErrorModel, GaussMarkov
from services.sensors.traffic.motion import acceleration, gate_distance, lane_path, turning_path
from services.sensors.traffic.operator import Operator
from services.sensors.traffic.world import Channel, Frame, Traffic, TrafficMix, World
from shared.messages.base import Message
from shared.messages.gnss import GnssFix, GnssRaw
from shared.messages.toll import (
    PassageState,
    PlazaDetector,
    PlazaTruth,
    TollRegistration,
    TrafficPassage,
    TransactionKind,
)
from shared.messages.v2x import Authentication, Cam, CamFrames, CamList
from shared.toll.registration import fault_of
from shared.toll.simulated import operator
from shared.v2x import frames
from shared.v2x.security.envelope import unwrap
from tests.support.v2x.tolling import NS, PLAZA, START_NS, Vehicle, ledger_at

PERFECT = Channel(loss=0.0, duplicates=0.0, latency_s=0.0, reordered=0.0)
ALL_WELL = TrafficMix(unequipped=0.0, unregistered=0.0, silent=0.0, new_station_id=0.0, corrected=0.0, turning=0.0)
Events = list[tuple[int, Frame | Message]]


def driven(duration_s: float, seed: int = 3, **changes: object) -> Events:
    traffic = Traffic.model_validate({"vehicles": 30, **changes})
    end_ns = START_NS + round(duration_s * NS)
    return list(takewhile(lambda event: event[0] < end_ns, World(PLAZA, traffic, seed, START_NS)))


def passages(events: Events) -> list[TrafficPassage]:
    return [p for _, item in events if isinstance(item, PlazaTruth) for p in item.passages]


def decoded(events: Events) -> tuple[list[Cam], Process]:
    parser = Process(Config())
    cams = []
    for due_ns, item in events:
        if isinstance(item, Frame):
            batch = CamFrames(received_ns=due_ns, source="v2x0", data=frames.pack([(due_ns, item.data)]))
            cams += [cam for answer in parser.handle(batch) for cam in answer.cams]  # type: ignore[union-attr]
    return cams, parser


def test_the_same_seed_gives_the_same_traffic_and_another_seed_another() -> None:
    first, again, other = driven(5.0), driven(5.0), driven(5.0, seed=4)
    assert first == again
    assert [item for _, item in first if isinstance(item, Frame)] != [i for _, i in other if isinstance(i, Frame)]


def test_every_frame_decodes_and_its_generation_time_is_when_it_was_sent() -> None:
    cams, parser = decoded(driven(20.0, channel=PERFECT, mix=ALL_WELL))
    assert len(cams) > 1000 and not parser.rejects
    ages_ns = [cam.received_ns - cam.sampled_ns for cam in cams]
    assert min(ages_ns) >= 0 and max(ages_ns) < 1_000_000  # generationDeltaTime counts milliseconds


def test_vehicles_send_by_the_generation_rules() -> None:
    """At 14 to 22 m/s a vehicle has moved by 4 m after 0.2 to 0.3 s; at standstill one CAM a second is due."""
    cams, _ = decoded(driven(30.0, channel=PERFECT, mix=ALL_WELL))
    by_station: dict[int, list[Cam]] = {}
    for cam in cams:
        by_station.setdefault(cam.station_id, []).append(cam)
    gaps = [(b.sampled_ns - a.sampled_ns) * 1e-9 for own in by_station.values() for a, b in pairwise(own)]
    assert min(gaps) >= 0.09 and max(gaps) <= 1.11
    assert 2.5 < 1.0 / float(np.mean(gaps)) < 8.0


def test_position_errors_are_those_of_the_model_and_the_common_part_is_the_units_own_error() -> None:
    """With a common error alone, every vehicle and the unit's receiver err by the same vector."""
    model = ErrorModel(multipath_sd_m=0.0, white_sd_m=0.0, unit_sd_m=0.0)
    events = driven(4.0, channel=PERFECT, mix=ALL_WELL, errors=model)
    parser = GnssParser(GnssConfig())
    fixes = [
        fix
        for _, item in events
        if isinstance(item, GnssRaw)
        for fix in parser.handle(item)
        if isinstance(fix, GnssFix)
    ]
    fix = fixes[0]
    assert fix.latitude_deg is not None and fix.longitude_deg is not None
    error = np.array(PLAZA.plane(fix.latitude_deg, fix.longitude_deg))
    assert hypot(*error) > 0.5
    cams, _ = decoded(events)
    first = cams[0]
    truth = next(item for _, item in events if isinstance(item, PlazaTruth))
    vehicle = next(v for v in truth.vehicles if v.station_id == first.station_id)
    assert first.latitude_deg is not None and first.longitude_deg is not None
    stated = np.array(PLAZA.plane(first.latitude_deg, first.longitude_deg))
    true = np.array(PLAZA.plane(vehicle.latitude_deg, vehicle.longitude_deg))
    along = np.array([np.cos(vehicle.heading_rad), np.sin(vehicle.heading_rad)])
    across = np.array([-along[1], along[0]])
    moved = (first.sampled_ns - truth.sampled_ns) * 1e-9 * vehicle.speed_m_s
    assert (stated - true - error) @ across == pytest.approx(0.0, abs=0.15)
    assert (stated - true - error) @ along == pytest.approx(moved, abs=0.3)


def test_a_gauss_markov_error_has_its_standard_deviation_and_its_correlation_time() -> None:
    process = GaussMarkov(2.0, 5.0, 0.1, np.random.default_rng(1))
    values = []
    for _ in range(200_000):
        process.step()
        values.append(process.value)
    series = np.array(values)
    assert series.std(axis=0) == pytest.approx([2.0, 2.0], rel=0.05)
    lagged = (series[:-50] * series[50:]).mean(axis=0) / series.var(axis=0)
    assert lagged == pytest.approx([np.exp(-1.0)] * 2, abs=0.05)


def test_the_channel_loses_repeats_and_delays_the_stated_shares() -> None:
    channel = Channel(loss=0.05, duplicates=0.02, latency_s=0.03, reordered=0.02, reorder_s=1.0)
    world = World(PLAZA, Traffic(vehicles=40, channel=channel), 1, START_NS)
    arrived = [
        item.data for _, item in takewhile(lambda e: e[0] < START_NS + 40 * NS, world) if isinstance(item, Frame)
    ]
    counts = Counter(arrived)
    share = 1.0 - len(counts) / world.frames
    assert share == pytest.approx(0.05, abs=0.012)
    assert sum(n - 1 for n in counts.values()) / len(counts) == pytest.approx(0.02, abs=0.006)


def test_each_pulse_is_a_passage_and_lost_messages_are_recovered_from_the_next() -> None:
    events = driven(50.0)
    pulses = [item for _, item in events if isinstance(item, PlazaDetector)]
    seen = {(p.lane, stamp) for p in pulses for stamp in (p.sampled_ns, *p.earlier_ns)}
    due = {(p.lane, p.crossing_ns) for p in passages(events) if p.crossing_ns < START_NS + 45 * NS}
    assert len(due) > 15 and due <= seen
    every_fifth = pulses[::5]
    kept = {(p.lane, stamp) for p in every_fifth for stamp in (p.sampled_ns, *p.earlier_ns)}
    last = {lane: max(p.sampled_ns for p in every_fifth if p.lane == lane) for lane in {p.lane for p in every_fifth}}
    assert {(lane, ns) for lane, ns in due if ns <= last.get(lane, 0)} <= kept


def test_vehicles_do_not_run_into_each_other_and_stop_before_a_barrier() -> None:
    world = World(PLAZA, Traffic(vehicles=60), 5, START_NS)
    stopped = 0
    for due_ns, _ in world:
        if due_ns > START_NS + 40 * NS:
            break
        for lane in PLAZA.lanes:
            queue = [v for v in world.queues[lane.name] if v.path.turn is None]
            gaps = [a.distance - a.length - b.distance for a, b in pairwise(queue)]
            assert min(gaps, default=1.0) > 0.0
            stopped += sum(v.speed < 0.1 and 0.0 < v.gate - v.distance < 4.0 for v in queue)
    assert stopped > 10


def test_vehicles_that_turn_around_do_not_cross_the_gate() -> None:
    events = driven(45.0, mix={"turning": 1.0})
    truth = [item for _, item in events if isinstance(item, PlazaTruth)][-1]
    assert truth.turned > 3 and not passages(events)
    path = turning_path(PLAZA.lanes[2], 45.0)
    there, back = path.pose(100.0, 0.0), path.pose(path.length - 100.0, 0.0)
    assert abs(abs(there.heading - back.heading) - np.pi) < 0.01
    assert max(path.pose(s, 0.0).curvature for s in np.arange(0.0, path.length, 1.0)) > 0.1


def test_vehicles_without_equipment_send_nothing_and_unregistered_ones_have_no_contract() -> None:
    events = driven(30.0, mix={"unequipped": 1.0})
    assert not [item for _, item in events if isinstance(item, (Frame, TollRegistration))]
    events = driven(30.0, mix={"unequipped": 0.0, "unregistered": 1.0})
    assert [item for _, item in events if isinstance(item, Frame)]
    assert not [item for _, item in events if isinstance(item, TollRegistration)]


def test_a_new_station_id_is_registered_with_the_same_contract() -> None:
    events = driven(25.0, mix={"unequipped": 0.0, "unregistered": 0.0, "new_station_id": 1.0, "turning": 0.0})
    stations: dict[str, set[int]] = {}
    for _, item in events:
        if isinstance(item, TollRegistration):
            assert item.station_id is not None
            stations.setdefault(item.contract, set()).add(item.station_id)
    assert sum(len(ids) == 2 for ids in stations.values()) > 15


def test_vehicles_accelerate_on_a_free_road_and_brake_before_a_standing_obstacle() -> None:
    assert acceleration(10.0, 20.0, None, 0.0) > 1.0
    assert acceleration(20.0, 20.0, None, 0.0) == pytest.approx(0.0)
    assert acceleration(15.0, 20.0, 25.0, 15.0) < -2.0


def test_a_path_is_as_long_as_its_lane_and_offsets_are_to_the_right() -> None:
    lane = PLAZA.lanes[0]
    path = lane_path(lane)
    assert path.length == pytest.approx(700.0, abs=0.05) and gate_distance(lane) == pytest.approx(500.0, abs=0.05)
    centre, right = path.pose(100.0, 0.0), path.pose(100.0, 3.5)
    assert hypot(right.north - centre.north, right.east - centre.east) == pytest.approx(3.5)
    second = lane_path(PLAZA.lanes[1]).pose(100.0, 0.0)  # the next lane of this direction is on the right
    assert hypot(right.north - second.north, right.east - second.east) < 0.02
    assert centre.curvature == 0.0


def test_the_operator_books_a_transaction_once_and_answers_each_message(tmp_path: Path) -> None:
    ledger, store = ledger_at(tmp_path / "ledger.sqlite")
    vehicle = Vehicle()
    ledger.register(vehicle.registration(), START_NS)
    ledger.passage(vehicle.says(PassageState.CHARGED), START_NS + 30 * NS)
    (transaction,) = ledger.due(START_NS + 30 * NS)
    operator = Operator()
    answers = [operator.receive(transaction, START_NS + n) for n in range(3)]
    assert [a.duplicate for a in answers] == [False, True, True] and all(a.accepted for a in answers)
    assert len(operator.booked) == 1 and transaction.kind is TransactionKind.CHARGE
    store.close()


def test_the_operator_stores_a_bounded_number_of_transactions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ledger, store = ledger_at(tmp_path / "ledger.sqlite")
    ledger.register(Vehicle().registration(), START_NS)
    ledger.passage(Vehicle().says(PassageState.CHARGED), START_NS + 30 * NS)
    (transaction,) = ledger.due(START_NS + 30 * NS)
    store.close()
    monkeypatch.setattr("services.sensors.traffic.operator.MAX_BOOKED", 3)
    operator = Operator()
    for k in range(5):
        operator.receive(transaction.model_copy(update={"transaction_id": f"{k:064x}"}), START_NS)
    assert list(operator.booked) == [f"{k:064x}" for k in (2, 3, 4)]


def test_vehicles_that_sign_are_authenticated_and_send_their_certificate_once_a_second() -> None:
    events = driven(6.0, signed=1.0, channel=PERFECT, mix=ALL_WELL)
    assert [item for _, item in events if isinstance(item, Frame)] == [
        item for _, item in driven(6.0, signed=1.0, channel=PERFECT, mix=ALL_WELL) if isinstance(item, Frame)
    ], "the same seed signs alike"
    parser = Process(Config.model_validate({"security": {"trust_folder": "deploy/trust"}, "simulated": True}))
    whole_ns: dict[str, list[int]] = {}
    for due_ns, item in events:
        if isinstance(item, Frame):
            signer = unwrap(item.data)
            if signer.certificate is not None:
                whole_ns.setdefault(signer.signer.hex(), []).append(due_ns)
            batch = CamFrames(received_ns=due_ns, source="v2x0", data=frames.pack([(due_ns, item.data)]))
            for answer in parser.handle(batch):
                assert isinstance(answer, CamList)
                assert {cam.authentication for cam in answer.cams} == {Authentication.AUTHENTICATED}
    assert parser.rejects.total() == 0
    assert len(whole_ns) == 30
    gaps = [(b - a) * 1e-9 for times in whole_ns.values() for a, b in pairwise(times)]
    assert min(gaps) >= 1.0 and max(gaps) <= 2.0


def test_who_signs_changes_nothing_else_of_the_traffic() -> None:
    plain, signed = driven(10.0), driven(10.0, signed=1.0)
    assert passages(plain) == passages(signed)
    assert [due for due, _ in plain] == [due for due, _ in signed]


def test_a_vehicle_that_signs_registers_its_ticket_and_another_one_after_its_change() -> None:
    mix = ALL_WELL.model_copy(update={"new_station_id": 1.0})
    stated = [item for _, item in driven(30.0, signed=1.0, channel=PERFECT, mix=mix, vehicles=5)
              if isinstance(item, TollRegistration)]  # fmt: skip
    keys = (operator().public_key.hex(),)
    assert stated and {fault_of(one, plaza=PLAZA.name, operator_keys=keys, require_ticket=True) for one in stated} == {
        None
    }
    pairs = {(one.contract, one.ticket) for one in stated}
    assert max(Counter(contract for contract, _ in pairs).values()) > 1, "a contract with two tickets"

"""Passages of simulated vehicles: opened, crossed, charged, or not."""

import gc
from dataclasses import replace
from math import cos, isclose, sin

import numpy as np
import pytest

from services.core.toll.codes import Code
from services.core.toll.core import DELTAS_AT_ONCE, EVIDENCE_BYTES, USED_BYTES, derive
from services.core.toll.settings import Settings
from services.core.toll.tracks import Repetitions
from shared.bus.codec import encode
from shared.messages.toll import (
    STATION_IDS,
    GateCommand,
    OpenPassages,
    PassageEvidence,
    PassageState,
    TollDelta,
    TollPassage,
    UsedCam,
    UsedCams,
)
from shared.messages.v2x import Authentication, CamList, StationType
from shared.topics import MANY_BYTES
from tests.support.cases import each
from tests.support.v2x.toll import START_NS, Plant, Vehicle, fix, lane_of, place

COMMON = (2.5, -1.5)  # [m, north and east] error that the receivers have in common
CAR = Vehicle(7, "n2", error=COMMON)
TICKETED = {"authentication": Authentication.AUTHENTICATED, "signer": "6999ac931bf65e6b"}


def code_of(passage: TollPassage) -> str:
    return passage.reason_code.code if passage.reason_code else ""


def test_a_registered_vehicle_is_charged_once_after_the_exit_line() -> None:
    plant = Plant(COMMON)
    plant.register(7)
    plant.drive(CAR, until=20.0)
    assert plant.states == ["open", "crossed", "charged"]
    opened, crossed, charged = plant.passages
    assert {passage.passage_id for passage in plant.passages} == {opened.passage_id}
    assert charged.lane == "n2"
    assert crossed.crossing_ns is not None and crossed.crossing_sd_s is not None
    assert isclose((crossed.crossing_ns - START_NS) * 1e-9, 12.5, abs_tol=3.0 * crossed.crossing_sd_s)
    assert charged.exit_ns is not None and charged.exit_ns >= START_NS + 13_900_000_000
    assert charged.evidence is not None
    assert charged.evidence.track_since_ns == charged.opened_ns
    assert not charged.authenticated


SIGNED = {"authentication": Authentication.SIGNED_NOT_VERIFIED, "signer": "6999ac931bf65e6b"}


def without_provenance(statement: TollPassage | GateCommand) -> TollPassage | GateCommand:
    """A statement, as if its frames were unsigned."""
    if not isinstance(statement, TollPassage) or statement.evidence is None:
        return statement
    frames = [
        frame.model_copy(update={"authentication": Authentication.UNSIGNED, "signer": None})
        for frame in statement.evidence.frames
    ]
    evidence = statement.evidence.model_copy(update={"frames": tuple(frames)})
    return statement.model_copy(update={"evidence": evidence})


def test_a_signature_that_is_not_verified_changes_no_statement() -> None:
    """Registered or not, and beside an unsigned car that uses the same station ID: as if nothing were signed."""
    for other in (replace(CAR, lane="s1"), Vehicle(8, "n1", error=COMMON, start=-280.0)):
        plants = []
        for extra in ({}, SIGNED):
            plant = Plant(COMMON)
            plant.register(7)
            plant.drive(replace(CAR, extra=extra), other, until=20.0)
            plants.append(plant)
        unsigned, signed = plants
        assert [without_provenance(s) for s in signed.statements] == unsigned.statements
        assert not any(passage.authenticated for passage in signed.passages)
        assert signed.core.rejected == unsigned.core.rejected
    assert {"charged", "unregistered"} <= set(signed.states)


@pytest.mark.parametrize(
    ("unsigned", "authentication"), [((), "signed_not_verified"), ((30,), "unsigned"), ((0,), "unsigned")]
)
def test_a_track_states_the_least_that_is_known_of_the_senders_of_its_cam(
    unsigned: tuple[int, ...], authentication: str
) -> None:
    plant = Plant(COMMON)
    plain, signed = replace(CAR, start=-190.0), replace(CAR, start=-190.0, extra=SIGNED)
    for k in range(50):
        plant.statements += plant.core.use([(plain if k in unsigned else signed).cam(plant.plaza, k / 10.0)])
    (track,) = plant.core.tracks(START_NS + 5 * 10**9).tracks
    assert track.authentication == authentication


def test_a_vehicle_that_changes_its_station_id_is_as_known_as_before() -> None:
    plant = Plant(COMMON)
    plant.drive(replace(CAR, start=-1000.0), until=5.0)
    later = replace(CAR, start=-1000.0, extra=SIGNED).named(70)
    plant.drive(later, since=5.0, until=6.0)
    assert {track.authentication for track in plant.core.tracks(START_NS).tracks} == {"unsigned", "signed_not_verified"}
    plant.drive(later, since=6.0, until=15.0)
    (track,) = plant.core.tracks(START_NS).tracks
    assert (track.station_id, track.authentication) == (70, "unsigned")


def test_a_wrong_sign_of_the_delta_puts_the_vehicle_into_another_lane() -> None:
    """The receivers err by a lane to the right: the delta moves the vehicle back to the left, into its own lane."""
    plaza = Plant().plaza
    here, beside = place(lane_of(plaza, "n1"), 0.0), place(lane_of(plaza, "n1"), 0.0, left=-3.5)
    error = (beside[0] - here[0], beside[1] - here[1])
    plant = Plant(error)
    plant.drive(Vehicle(7, "n1", error=error), until=12.0)
    (track,) = plant.core.tracks(START_NS + 12 * 10**9).tracks
    probability = {lane.lane: lane.probability for lane in track.lanes}
    assert probability["n1"] > 0.95
    assert track.delta_applied
    wrong = Plant((-error[0], -error[1]))
    wrong.drive(Vehicle(7, "n1", error=error), until=12.0)
    (track,) = wrong.core.tracks(START_NS + 12 * 10**9).tracks
    assert {lane.lane: lane.probability for lane in track.lanes}.get("n1", 0.0) < 0.05


def test_a_vehicle_that_is_corrected_already_is_left_alone() -> None:
    plant = Plant((3.0, 2.0))
    plant.drive(Vehicle(7, "n3", stated_sd=0.5), until=12.0)
    (track,) = plant.core.tracks(START_NS + 12 * 10**9).tracks
    assert not track.delta_applied
    assert max(track.lanes, key=lambda lane_probability: lane_probability.probability).lane == "n3"


def test_without_a_delta_no_lane_is_decided_and_nothing_charged() -> None:
    plant = Plant(None)
    plant.register(7)
    plant.drive(CAR, until=20.0)
    assert plant.states == ["open", "crossed", "undecided"]
    assert not plant.gates


@pytest.mark.parametrize("values", [{"differential": True}, {"latitude_deg": None}, {"source": "another"}])
def test_a_fix_that_does_not_show_the_common_error_is_not_used(values: dict[str, object]) -> None:
    plant = Plant(COMMON)
    before = plant.core.estimate_delta(START_NS)
    plant.core.fix(fix(plant.plaza, 0.5, 90.0, 0.0, **values))
    assert plant.core.estimate_delta(START_NS) == before
    assert sum(plant.core.rejected.values()) == 1


def test_an_old_delta_is_not_applied() -> None:
    plant = Plant(COMMON)
    plant.error = None
    plant.drive(replace(CAR, start=-400.0), until=12.5)
    (track,) = plant.core.tracks(START_NS + 12 * 10**9).tracks
    assert not track.delta_applied
    assert plant.core.estimate_delta(START_NS + 12 * 10**9).valid is False


def test_a_vehicle_without_contract_is_listed_and_not_charged() -> None:
    plant = Plant(COMMON)
    plant.drive(CAR, until=20.0)
    assert plant.states == ["open", "crossed", "unregistered"]
    assert all(passage.evidence is None for passage in plant.passages)
    assert not any(command.open for command in plant.gates)


def test_a_stop_on_the_gate_line_stays_open() -> None:
    plant = Plant(COMMON)
    plant.register(7)
    plant.drive(replace(CAR, start=-200.0, acceleration=-1.0), until=60.0)
    assert plant.states == ["open"]
    plant.drive(replace(CAR, speed=0.0, acceleration=2.0, start=0.0, since=60.0), since=60.0, until=75.0)
    assert plant.states == ["open", "crossed", "charged"]


@pytest.mark.parametrize("ahead", [0.5, 1.5, 2.1])
def test_the_crossing_of_a_vehicle_that_waits_before_the_line_is_as_uncertain_as_its_wait_is_long(ahead: float) -> None:
    """It stops 1.2 m before the line for 10 s, and its receiver errs by `ahead` metres to the front."""
    plant = Plant(COMMON)
    plant.register(7)
    _, _, heading = place(lane_of(plant.plaza, "n2"), 0.0)
    error = (COMMON[0] + ahead * cos(heading), COMMON[1] + ahead * sin(heading))
    plant.drive(replace(CAR, error=error, start=-201.2, acceleration=-1.0), until=30.0)
    started = replace(CAR, error=error, speed=0.0, acceleration=2.0, start=-1.2, since=30.0)
    plant.drive(started, since=30.0, until=45.0)
    charged = plant.passages[-1]
    assert charged.state is PassageState.CHARGED
    assert charged.crossing_ns is not None and charged.crossing_sd_s is not None
    late_s = 30.0 + 1.2**0.5 - (charged.crossing_ns - START_NS) * 1e-9
    assert abs(late_s) < 3.0 * charged.crossing_sd_s
    passing = Plant(COMMON)
    passing.register(7)
    passing.drive(CAR, until=20.0)
    assert (passing.passages[-1].crossing_sd_s or 1.0) < 0.1


def test_the_crossing_of_a_vehicle_that_was_silent_is_as_uncertain_as_the_silence_is_long() -> None:
    """It stops 20 m before the line, is silent from then on for 15 s, and sends again behind the exit line."""
    plant = Plant(COMMON)
    plant.register(7)
    plant.drive(replace(CAR, start=-220.0, acceleration=-1.0), until=20.0)
    started = replace(CAR, speed=0.0, acceleration=3.0, start=-20.0, since=29.0)
    plant.drive(started, since=35.0, until=38.0)
    charged = plant.passages[-1]
    assert charged.state is PassageState.CHARGED
    assert charged.crossing_ns is not None and charged.crossing_sd_s is not None
    error_s = 29.0 + (40.0 / 3.0) ** 0.5 - (charged.crossing_ns - START_NS) * 1e-9
    assert 1.0 < abs(error_s) < 2.0 * charged.crossing_sd_s


def test_a_restart_in_a_queue_does_not_give_a_passage_to_the_vehicle_behind() -> None:
    """The follower, 7 m behind and not yet at the approach line, is received first after the restart."""
    plant = Plant(COMMON)
    plant.register(7, 8)
    leader = replace(CAR, start=-199.0, speed=0.8)
    follower = replace(leader, station_id=8, start=-206.0)
    plant.drive(leader, follower, until=3.0)
    (stored,) = plant.passages
    plant.restart()
    list(plant.core.continue_passages(OpenPassages(sampled_ns=0, passages=(stored,), settled=())))
    plant.drive(follower, since=4.5, until=4.6)
    plant.drive(follower, leader, since=4.6, until=6.0)
    assert [passage.station_ids for passage in plant.passages] == [(7,)]
    newest = [statement for statement in plant.statements if isinstance(statement, TollPassage)][-1]
    assert (newest.passage_id, newest.station_ids) == (stored.passage_id, (7,))


def test_a_restart_while_the_vehicle_waits_on_the_line_loses_no_charge() -> None:
    """The position of the ledger's statement is 0.6 m behind the line, where a passage is still open."""
    plant = Plant(COMMON)
    plant.register(7)
    plant.drive(replace(CAR, start=-199.4, acceleration=-1.0), until=25.0)
    stored = next(statement for statement in reversed(plant.statements) if isinstance(statement, TollPassage))
    assert stored.state is PassageState.OPEN and stored.crossing_ns is None
    plant.restart()
    list(plant.core.continue_passages(OpenPassages(sampled_ns=0, passages=(stored,), settled=())))
    plant.drive(replace(CAR, start=0.6, speed=0.0, acceleration=2.0, since=26.0), since=26.0, until=40.0)
    assert plant.states == ["open", "crossed", "charged"]


@pytest.mark.parametrize("stop", [-30.0, 20.0])
def test_a_vehicle_that_turns_around_is_void(stop: float) -> None:
    plant = Plant(COMMON)
    plant.register(7)
    plant.drive(replace(CAR, start=stop - 200.0, acceleration=-1.0), until=21.0)
    back = replace(CAR, backward=True, start=stop, speed=0.0, acceleration=2.0, since=21.0)
    plant.drive(back, since=21.0, until=35.0)
    assert plant.states == (["open", "void"] if stop < 0.0 else ["open", "crossed", "void"])
    assert code_of(plant.passages[-1]) == (Code.TURNED_BEFORE if stop < 0.0 else Code.TURNED_BEHIND)


def test_a_vehicle_of_the_other_direction_passes_its_own_lanes() -> None:
    plant = Plant(COMMON)
    plant.register(7, 8)
    plant.drive(CAR, Vehicle(8, "s2", error=COMMON), until=20.0)
    assert sorted(passage.lane or "" for passage in plant.passages if passage.state is PassageState.CHARGED) == [
        "n2",
        "s2",
    ]


@pytest.mark.parametrize("moment", [5.0, 12.3, 13.0])
def test_a_new_station_id_continues_the_passage_of_the_silent_one(moment: float) -> None:
    plant = Plant(COMMON)
    plant.register(7, 70)
    plant.drive(CAR, until=moment)
    plant.drive(CAR.named(70), since=moment, until=20.0)
    assert plant.states == ["open", "crossed", "charged"]
    assert plant.passages[-1].station_ids == (7, 70)
    assert len(plant.core.tracks(START_NS + 20 * 10**9).tracks) == 1


def test_two_vehicles_behind_each_other_are_charged_both() -> None:
    plant = Plant(COMMON)
    plant.register(7, 8)
    plant.drive(CAR, replace(CAR, station_id=8, start=CAR.start - 7.0), until=20.0)
    assert plant.states.count("charged") == 2


@pytest.mark.parametrize("registered", [(7, 8), (8,)])
def test_of_two_vehicles_at_one_place_the_second_names_the_first_and_neither_is_dropped(
    registered: tuple[int, ...],
) -> None:
    """A vehicle without contract 1 m ahead may be none: the passage behind it stays, and detectors decide."""
    plant = Plant(COMMON)
    plant.register(*registered)
    plant.drive(CAR, replace(CAR, station_id=8, start=CAR.start - 1.0), until=20.0)
    final = {passage.station_ids[0]: passage for passage in plant.passages if passage.state.is_final}
    assert final[8].state is PassageState.CHARGED
    assert final[8].overlaps == (final[7].passage_id,) and final[7].overlaps == ()
    assert final[7].state is (PassageState.CHARGED if 7 in registered else PassageState.UNREGISTERED)


def test_a_vehicle_that_falls_silent_is_void_after_half_a_minute() -> None:
    plant = Plant(COMMON)
    plant.register(7)
    plant.drive(CAR, until=8.0)
    plant.drive(until=45.0, since=8.0)
    assert plant.states == ["open", "void"]
    assert code_of(plant.passages[-1]) == Code.SILENT_BEFORE


def test_a_final_statement_is_repeated_until_it_is_settled() -> None:
    plant = Plant(COMMON)
    plant.register(7)
    plant.drive(CAR, until=20.0)
    charged = plant.passages[-1]
    plant.statements.clear()
    plant.second()
    assert [statement.passage_id for statement in plant.statements if isinstance(statement, TollPassage)] == [
        charged.passage_id
    ]
    settled = OpenPassages(sampled_ns=START_NS, passages=(), settled=(charged.passage_id,))
    list(plant.core.continue_passages(settled))
    plant.statements.clear()
    plant.second()
    assert not plant.statements


def test_a_new_station_id_continues_none_of_two_silent_ones_that_it_may_be() -> None:
    """Two stations 3 m apart fall silent at once: which contract the one that comes has is not guessed."""
    plant = Plant((1.0, 1.0))
    plant.register(7, 8)
    first, second = Vehicle(7, "n2", error=(1.0, 1.0)), Vehicle(8, "n2", start=-247.0, error=(1.0, 1.0))
    plant.drive(first, second, until=8.0)
    plant.drive(first.named(9), until=20.0, since=8.0)
    assert plant.core.rejected["ambiguous_continuation"] == 1
    assert {passage.station_ids for passage in plant.passages} == {(7,), (8,), (9,)}
    plant.statements.clear()
    while plant.clock_s < 60.0:
        plant.second()
    silent = [passage for passage in plant.passages if passage.reason_code and passage.state is PassageState.VOID]
    assert {passage.station_ids for passage in silent} == {(7,), (8,)}
    assert all(passage.crossing_ns is not None for passage in silent)  # a pulse of their time is a review


@each("kill", [2.4, 5.0, 11.1, 11.8, 12.6, 13.3])
@each("renamed", [False, True])
def test_a_restart_at_any_time_continues_the_passage(kill: float, renamed: bool) -> None:
    """The ledger knows the last statement; 1.5 s pass until the new process receives CAM."""
    plant = Plant(COMMON)
    plant.register(7, 70)
    plant.drive(CAR, until=kill)
    statements = [statement for statement in plant.statements if isinstance(statement, TollPassage)]
    finals = {statement.passage_id for statement in statements if statement.state.is_final}
    newest = {statement.passage_id: statement for statement in statements if statement.passage_id not in finals}
    plant.restart()
    stored = tuple(toll_passage.model_copy(update={"evidence": None}) for toll_passage in newest.values())
    list(plant.core.continue_passages(OpenPassages(sampled_ns=0, passages=stored, settled=tuple(finals))))
    plant.drive(CAR.named(70) if renamed else CAR, since=kill + 1.5, until=22.0)
    assert plant.states.count("charged") == 1
    assert len({passage.passage_id for passage in plant.passages}) == 1


def test_after_a_restart_a_renamed_vehicle_continues_its_own_passage_and_not_that_of_a_silent_one() -> None:
    """Two vehicles 15 m behind each other; the first is silent after the restart, the second has a new station ID."""
    plant = Plant(COMMON)
    plant.register(7, 8, 80)
    second = replace(CAR, station_id=8, start=CAR.start - 15.0)
    plant.drive(CAR, second, until=6.0)
    stored = {statement.station_ids: statement for statement in plant.statements if isinstance(statement, TollPassage)}
    plant.restart()
    list(plant.core.continue_passages(OpenPassages(sampled_ns=0, passages=tuple(stored.values()), settled=())))
    plant.drive(second.named(80), since=7.0, until=10.0)
    newest = [statement for statement in plant.statements if isinstance(statement, TollPassage)][-1]
    assert (newest.passage_id, newest.station_ids) == (stored[(8,)].passage_id, (8, 80))


def test_the_ledgers_answer_may_come_after_the_vehicle() -> None:
    plant = Plant(COMMON)
    plant.register(7)
    plant.drive(CAR, until=5.0)
    stored = plant.passages[-1]
    plant.restart()
    plant.drive(CAR, since=5.5, until=8.0)
    plant.statements += plant.core.continue_passages(OpenPassages(sampled_ns=0, passages=(stored,), settled=()))
    plant.drive(CAR, since=8.0, until=20.0)
    assert plant.states == ["open", "open", "void", "crossed", "charged"]
    assert plant.passages[-1].passage_id == stored.passage_id
    assert plant.passages[2].passage_id != stored.passage_id


def test_no_passage_is_opened_before_the_ledger_answered_or_the_wait_is_over() -> None:
    plant = Plant(COMMON)
    plant.restart(answered=False)
    plant.drive(replace(CAR, start=-200.0), until=2.9)
    assert not plant.passages
    plant.drive(replace(CAR, start=-200.0), since=2.9, until=5.0)
    assert plant.states == ["open"]


def test_the_charge_is_derived_again_bit_for_bit_from_the_evidence() -> None:
    plant = Plant(COMMON)
    plant.register(7, 70, 8, 9)
    noise = np.random.default_rng(4)
    others = [Vehicle(8, "n1", error=COMMON, start=-240.0), Vehicle(9, "n3", error=COMMON, start=-262.0)]
    for second in range(20):
        car = replace(CAR if second < 9 else CAR.named(70), error=(2.5 + 0.3 * noise.standard_normal(), -1.5))
        plant.drive(others[0], car, others[1], since=float(second), until=second + 1.0)
    charged = next(
        passage for passage in plant.passages if passage.state is PassageState.CHARGED and 7 in passage.station_ids
    )
    assert charged.evidence is not None
    cams = {(cam.received_ns, cam.frame): cam for cam in plant_cams(plant, noise_seed=4)}
    used = [cams[frame.received_ns, frame.data] for frame in charged.evidence.frames]
    settings = Settings.model_validate_json(charged.evidence.settings)
    again = derive(plant.plaza, settings, used, charged.evidence.deltas)[-1]
    same = {"lane", "lanes", "crossing_ns", "crossing_sd_s", "exit_ns", "state", "passage_id", "delta_ns", "opened_ns"}
    assert again.model_dump(include=same) == charged.model_dump(include=same)


def plant_cams(plant: Plant, noise_seed: int) -> list:  # type: ignore[type-arg]
    """The CAM of the vehicle of the test above once more."""
    noise = np.random.default_rng(noise_seed)
    found = []
    for second in range(20):
        car = replace(CAR if second < 9 else CAR.named(70), error=(2.5 + 0.3 * noise.standard_normal(), -1.5))
        found += [car.cam(plant.plaza, k / 10.0) for k in range(10 * second, 10 * second + 10)]
    return found


def test_loss_repetition_and_reordering_neither_lose_nor_double_a_charge() -> None:
    """5 % of the CAM are lost, 2 % repeated, and a fifth arrives up to 1 s late."""
    plant = Plant(COMMON)
    rng = np.random.default_rng(6)
    lanes = ["n1", "n3", "s1", "s3"]
    fleet = [
        Vehicle(k, lanes[k % 4], error=COMMON, speed=float(rng.uniform(15.0, 30.0)), start=-220.0 - 60.0 * (k // 4))
        for k in range(1, 13)
    ]
    plant.register(*(vehicle.station_id for vehicle in fleet))
    arrivals = []
    for k in range(300):
        for vehicle in fleet:
            for _ in range(int(rng.choice([0, 1, 2], p=[0.05, 0.93, 0.02]))):
                latency_s = float(rng.uniform(0.02, 1.0)) if rng.random() < 0.2 else 0.02
                arrivals.append(vehicle.cam(plant.plaza, k / 10.0, latency_s=latency_s))
    for cam in sorted(arrivals, key=lambda item: item.received_ns):
        if cam.received_ns >= START_NS + round(plant.clock_s * 1e9):
            plant.second()
        plant.statements += plant.core.use([cam])
    charged = [passage.station_ids for passage in plant.passages if passage.state is PassageState.CHARGED]
    undecided = [passage.station_ids for passage in plant.passages if passage.state is PassageState.UNDECIDED]
    assert len(set(charged)) == len(charged)
    assert len(charged) + len(undecided) == len(fleet)
    assert len(charged) >= 10
    assert plant.core.rejected["late_or_repeated"] > 50


def test_a_station_with_a_wrong_clock_crosses_at_the_units_time() -> None:
    plant = Plant(COMMON)
    plant.register(7)
    plant.drive(replace(CAR, clock_error_s=-1.004), until=20.0)
    assert plant.states == ["open", "crossed", "charged"]
    assert isclose(((plant.passages[1].crossing_ns or 0) - START_NS) * 1e-9, 12.5, abs_tol=0.15)


def relayed(plant: Plant, car: Vehicle, delay_s: float, first: int = 17, until: int = 200) -> None:
    """The first CAM of a vehicle arrive late, all at their delay; the next ones come from the vehicle."""
    for k in range(until):
        if k / 10.0 >= plant.clock_s:
            plant.second()
        late = round(delay_s * 1e9) if k < first else 0
        cam = car.cam(plant.plaza, k / 10.0 - (delay_s if late else 0.0), **({"latency_s": delay_s} if late else {}))
        plant.statements += plant.core.use([cam])


@each("authenticated", (True, False))
def test_who_relays_the_first_cam_late_does_not_shift_the_crossing(authenticated: bool) -> None:
    plant, car = Plant(COMMON), replace(CAR, extra=TICKETED if authenticated else {})
    relayed(plant, car, 1.6)
    crossed = next(one for one in plant.passages if one.state is PassageState.CROSSED)
    assert isclose(((crossed.crossing_ns or 0) - START_NS) * 1e-9, 12.5, abs_tol=0.15)
    assert plant.core.rejected["too_old"] == (17 if authenticated else 0)


def test_an_authenticated_cam_is_used_at_its_own_time_within_a_second() -> None:
    for clock_error_s, reject in ((-1.1, "too_old"), (1.1, "from_the_future"), (-0.9, ""), (0.9, "")):
        plant = Plant(COMMON)
        plant.drive(replace(CAR, clock_error_s=clock_error_s, extra=TICKETED), until=0.1)
        assert plant.core.rejected[reject] == bool(reject), clock_error_s
        for track in plant.core.tracks(START_NS).tracks:
            assert isclose((track.updated_ns - START_NS) * 1e-9, clock_error_s, abs_tol=1e-6)


def test_late_and_repeated_cam_are_counted_and_not_used() -> None:
    plant = Plant(COMMON)
    first, second = CAR.cam(plant.plaza, 1.0), CAR.cam(plant.plaza, 1.1)
    list(plant.core.use([second, first, second]))
    assert plant.core.rejected["late_or_repeated"] == 2


@pytest.mark.parametrize("omitted", [0, 25])
@pytest.mark.parametrize("replays", [1, 2])
def test_a_replay_after_a_cycle_of_generation_delta_time_opens_no_passage(omitted: int, replays: int) -> None:
    """Who replays the frames without the first ones, with new headers, gets no passage, however often."""
    plant = Plant(COMMON)
    plant.register(7)
    plant.drive(CAR, until=20.0)
    assert plant.states == ["open", "crossed", "charged"]
    cycle_ns = 65_536_000_000
    for replay in range(1, replays + 1):
        for k in range(omitted, 200):
            shift = {"sampled_ns": replay * cycle_ns, "received_ns": replay * cycle_ns}
            cam = CAR.cam(plant.plaza, k / 10.0)
            moved = cam.model_copy(update={name: getattr(cam, name) + ns for name, ns in shift.items()})
            if moved.received_ns >= START_NS + round(plant.clock_s * 1e9):
                plant.second()
            plant.statements += plant.core.use([moved.model_copy(update={"frame": b"another header" + cam.frame})])
    assert plant.states == ["open", "crossed", "charged"]
    assert plant.core.rejected["replayed"] == replays * 200 - omitted * replays


def test_the_cam_of_70_s_are_remembered_and_not_more() -> None:
    memory, plaza = Repetitions(), Plant().plaza
    for k in range(2000):
        assert memory.add(CAR.cam(plaza, k / 10.0)) is None
    assert len(memory) == 701


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"latitude_deg": None}, "no_position"),
        ({"position_out_of_range": True}, "position_cannot_be_trusted"),
        ({"latitude_deg": 49.80}, "out_of_range"),
        ({"station_type": StationType.ROAD_SIDE_UNIT}, "no_road_vehicle"),
    ],
)
def test_cam_that_cannot_be_used_are_counted(values: dict[str, object], reason: str) -> None:
    plant = Plant(COMMON)
    list(plant.core.use([replace(CAR, extra=values).cam(plant.plaza, 1.0)]))
    assert plant.core.rejected == {reason: 1}
    assert not plant.core.tracks(START_NS).tracks


def test_unavailable_motion_does_not_prevent_a_charge() -> None:
    plant = Plant(COMMON)
    plant.register(7)
    nothing = {"yaw_rate_rad_s": None, "longitudinal_acceleration_m_s2": None, "speed_m_s": None}
    plant.drive(replace(CAR, extra=nothing), until=20.0)
    assert plant.states[-1] == "charged"


def test_a_station_id_that_another_vehicle_uses_starts_a_new_track() -> None:
    plant = Plant(COMMON)
    plant.drive(CAR, until=4.0)
    first = plant.core.tracks(START_NS).tracks[0].track
    plant.drive(replace(CAR, lane="s1"), since=4.0, until=5.0)
    found = [track.track for track in plant.core.tracks(START_NS).tracks]
    assert found[0] == first and len(found) == 2
    assert plant.core.rejected["outside_gate"] == Settings().track.jumps


def test_more_stations_than_tracks_are_rejected() -> None:
    plant = Plant(settings=Settings().with_values({"track.max_tracks": 3}))
    list(plant.core.use([Vehicle(k, "n1", start=-100.0 - 20.0 * k).cam(plant.plaza, 1.0) for k in range(5)]))
    assert len(plant.core.tracks(START_NS).tracks) == 3
    assert plant.core.rejected["too_many_tracks"] == 2


def test_a_barrier_opens_for_the_first_vehicle_of_its_lane_only() -> None:
    plant = Plant(COMMON)
    plant.register(7, 8)
    first, second = replace(CAR, lane="n3", speed=3.0, start=-60.0), replace(CAR, lane="n3", speed=3.0, start=-68.0)
    plant.drive(first, second.named(8), until=19.0)
    by_passage: dict[str, list[bool]] = {}
    for command in plant.gates:
        assert command.lane == "n3"
        by_passage.setdefault(command.passage_id, []).append(command.open)
    opened = next(passage.passage_id for passage in plant.passages if passage.station_ids == (7,))
    held = next(passage.passage_id for passage in plant.passages if passage.station_ids == (8,))
    assert all(by_passage[opened])
    assert not any(by_passage[held])
    plant.drive(first, second.named(8), since=19.0, until=25.0)
    assert [command.open for command in plant.gates if command.passage_id == held][-1]


def test_a_gate_command_predicts_the_crossing() -> None:
    plant = Plant(COMMON)
    plant.register(7)
    plant.drive(CAR, until=12.0)
    for command in plant.gates:
        assert command.crossing_ns is not None and command.crossing_sd_s is not None
        assert abs((command.crossing_ns - START_NS) * 1e-9 - 12.5) < 3.0 * command.crossing_sd_s
    assert plant.gates[0].sampled_ns < START_NS + 8 * 10**9


def test_a_batch_of_random_order_and_hostile_values_raises_nothing() -> None:
    plant = Plant(COMMON)
    rng = np.random.default_rng(8)
    for _ in range(300):
        extra = {
            "speed_m_s": float(rng.choice([0.0, 163.82])),
            "heading_rad": float(rng.uniform(0.0, 6.28)),
            "yaw_rate_rad_s": float(rng.choice([-5.7, 5.7])),
            "longitudinal_acceleration_m_s2": float(rng.choice([-16.0, 16.1])),
            "heading_confidence_rad": float(rng.choice([0.0017, 0.2])),
            "position_semi_major_m": float(rng.choice([0.0, 0.01, 40.93])),
            "vehicle_length_m": float(rng.choice([0.1, 102.2])),
        }
        cams = [
            replace(CAR, station_id=int(rng.integers(6)), start=float(rng.uniform(-400, 100)), extra=extra).cam(
                plant.plaza, float(rng.uniform(0.0, 60.0))
            )
            for _ in range(5)
        ]
        list(plant.core.use(cams))
        CamList.model_validate({"received_ns": 0, "source": "x", "cams": tuple(cams)})
        for track in plant.core.tracks(START_NS).tracks:
            assert all(0.0 <= lane.probability <= 1.0 + 1e-9 for lane in track.lanes)


def test_a_station_id_that_jumps_to_and_fro_leaves_nothing_behind() -> None:
    """It is followed at both places, and at no further ones."""
    plant = Plant(COMMON)
    near, far = Vehicle(7, "n2", speed=0.0, start=-30.0), Vehicle(7, "n2", speed=0.0, start=-150.0)
    for k in range(20):
        plant.drive(near if k % 2 else far, since=0.5 * k, until=0.5 * (k + 1))
    plant.second()
    assert plant.core.rejected["outside_gate"] == plant.settings.track.jumps
    assert len(plant.core._journeys) == len(plant.core.tracks(START_NS).tracks) == 2


def test_a_batch_with_several_cam_of_a_vehicle_gives_the_statements_of_single_cam() -> None:
    statements = []
    for size in (1, 4):
        plant = Plant(COMMON)
        plant.register(7)
        cams = [CAR.cam(plant.plaza, k / 10.0, latency_s=0.5 - k % 4 / 10.0) for k in range(200)]
        plant.core.tick(START_NS)
        statements.append([
            toll_passage for k in range(0, 200, size) for toll_passage in plant.core.use(cams[k : k + size])
            if isinstance(toll_passage, TollPassage)
        ])  # fmt: skip
    assert statements[0] == statements[1]
    assert any(statement.state is PassageState.CROSSED for statement in statements[0])


SLOW = replace(CAR, speed=10.0)


def test_a_station_that_comes_back_where_its_vehicle_can_be_continues_its_passage() -> None:
    plant = Plant(COMMON)
    plant.register(7)
    plant.drive(SLOW, until=8.0)
    plant.drive(since=8.0, until=14.5)
    plant.drive(SLOW, since=14.5, until=30.0)
    assert plant.states == ["open", "crossed", "charged"]
    assert len({passage.passage_id for passage in plant.passages}) == 1


@pytest.mark.parametrize("silent_s", [0.0, 2.0], ids=["", "silent from before the gate line to behind the exit line"])
@pytest.mark.parametrize("lane", ["n2", "s2"])
def test_a_station_id_that_comes_back_at_another_place_does_not_continue_the_passage(
    lane: str, silent_s: float
) -> None:
    """Anybody can send unsigned CAM with the station ID of a vehicle that has fallen silent."""
    plant = Plant(COMMON)
    plant.register(7)
    plant.drive(CAR, until=8.0)
    first = plant.passages[0].passage_id
    plant.drive(since=8.0, until=15.0)
    again = replace(CAR, lane=lane, since=15.0)
    plant.drive(again, since=15.0, until=27.2)
    plant.drive(since=27.2, until=27.2 + silent_s)
    plant.drive(again, since=27.2 + silent_s, until=31.0)
    plant.drive(since=31.0, until=42.0)
    ends = {passage.passage_id == first: passage for passage in plant.passages if passage.state.is_final}
    assert ends[True].state is PassageState.VOID
    assert ends[False].state is PassageState.SUSPECT
    assert code_of(ends[False]) == Code.SAME_STATION
    assert not any(command.open for command in plant.gates if command.passage_id != first)


def test_a_contradiction_is_known_after_a_restart() -> None:
    plant = Plant(COMMON)
    plant.register(7)
    plant.drive(CAR, until=8.0)
    plant.drive(since=8.0, until=15.0)
    again = replace(CAR, since=15.0)
    plant.drive(again, since=15.0, until=20.0)
    newest = {statement.passage_id: statement for statement in plant.statements if isinstance(statement, TollPassage)}
    plant.restart()
    list(plant.core.continue_passages(OpenPassages(sampled_ns=0, passages=tuple(newest.values()), settled=())))
    plant.drive(again, since=21.0, until=31.0)
    assert plant.states.count("suspect") == 1
    assert "charged" not in plant.states


def test_an_answer_of_the_ledger_on_a_vehicle_elsewhere_does_not_end_the_younger_passage() -> None:
    plant = Plant(COMMON)
    plant.register(7)
    plant.drive(CAR, until=8.0)
    stored = [statement for statement in plant.statements if isinstance(statement, TollPassage)][-1]
    plant.core = plant.new_core()
    plant.drive(replace(CAR, since=9.0), since=9.0, until=14.0)
    plant.statements += plant.core.continue_passages(OpenPassages(sampled_ns=0, passages=(stored,), settled=()))
    plant.drive(replace(CAR, since=9.0), since=14.0, until=25.0)
    assert plant.states == ["open", "open", "suspect"]


def test_a_silence_of_more_than_five_seconds_between_two_ticks_continues_the_passage() -> None:
    """The CAM that ends the silence arrives before the tick that would have deleted the old track."""
    plant = Plant(COMMON)
    plant.register(7)
    cams = [SLOW.cam(plant.plaza, k / 10.0) for k in range(300)]
    statements = [*plant.core.use(cams[:80]), *plant.core.use(cams[132:])]
    ends = [
        statement
        for statement in statements
        if isinstance(statement, TollPassage) and statement.state.is_final and not statement.checkpoint
    ]
    assert len(ends) == 1
    assert len({statement.passage_id for statement in statements if isinstance(statement, TollPassage)}) == 1


def test_a_passage_has_a_bounded_number_of_station_ids() -> None:
    plant = Plant(COMMON)
    crawl = replace(CAR, speed=2.0, start=-140.0)
    for k in range(STATION_IDS + 3):
        plant.drive(crawl.named(100 + k), since=3.4 * k, until=3.4 * k + 3.3)
    assert (
        max(len(statement.station_ids) for statement in plant.statements if isinstance(statement, TollPassage))
        == STATION_IDS
    )


def test_two_stations_at_one_place_that_arrive_in_one_batch_leave_both_tracks() -> None:
    """A late CAM of the old station ID arrives with the one that would confirm the new one."""
    plant = Plant(COMMON)
    old, new = CAR, CAR.named(70)
    plant.drive(old, until=5.0)
    list(plant.core.use([new.cam(plant.plaza, 5.2)]))
    late, confirming = old.cam(plant.plaza, 5.1, latency_s=1.6), new.cam(plant.plaza, 6.7)
    list(plant.core.use([confirming, late]))
    table = plant.core._table
    assert {track.slot for track in table.tracks}.isdisjoint(table._free)
    for update in table.use([new.cam(plant.plaza, 6.8)]):
        assert [item.track.station_id for item in update] == [70]
    assert {track.slot for track in table.tracks}.isdisjoint(table._free)
    assert len(set(table._free)) == len(table._free)


def test_a_station_id_in_use_again_does_not_lend_its_passage_to_another() -> None:
    """The old track was deleted for its silence, and the same station ID is used again before the link is confirmed."""
    plant = Plant(COMMON)
    table = plant.core._table
    list(table.use([CAR.cam(plant.plaza, 1.0)]))
    list(table.use([CAR.named(70).cam(plant.plaza, 2.0)]))
    list(table.use([replace(CAR, start=-300.0).cam(plant.plaza, 6.5)]))
    (update,) = next(iter(table.use([CAR.named(70).cam(plant.plaza, 6.6)])))
    assert update.continues is None
    assert update.track.station_ids == [70]


def test_a_retained_delta_of_a_later_time_does_not_keep_out_those_of_now() -> None:
    """The host's monotonic clock begins anew when it starts."""
    plant = Plant(COMMON)
    ours = plant.core.estimate_delta(START_NS)
    core = type(plant.core)(plant.plaza, plant.settings)
    for of_plaza in plant.fixes:
        core.fix(of_plaza)
    core.use_delta(ours.model_copy(update={"sampled_ns": START_NS + 10**15}))
    core.use_delta(core.estimate_delta(START_NS))
    assert [delta.sampled_ns for delta in core._deltas] == [ours.sampled_ns]
    assert core.rejected["delta_from_the_future"] == 1


def test_the_frames_that_are_kept_for_evidence_are_nothing_for_the_garbage_collector() -> None:
    plant = Plant(COMMON)
    plant.drive(CAR, until=6.0)
    gc.collect()
    (track,) = plant.core._table.tracks
    assert len(track.frames) > 5
    assert not any(gc.is_tracked(frame) for frame in track.frames)


def test_a_vehicle_beside_a_slow_one_that_is_silent_for_a_moment_does_not_continue_it() -> None:
    """A vehicle that crawls sends one CAM a second, and one in twenty is lost."""
    plant = Plant(COMMON)
    plant.register(7, 8)
    crawl, beside = replace(CAR, lane="n3", speed=1.0, start=-60.0), replace(CAR, lane="n2", speed=10.0, start=-150.0)
    for second in range(20):
        if second % 4 != 3:
            plant.statements += plant.core.use([crawl.cam(plant.plaza, float(second))])
        plant.drive(beside.named(8), since=max(float(second), 9.2), until=second + 1.0)
    assert {track.station_id for track in plant.core.tracks(START_NS + 20 * 10**9).tracks} == {7, 8}
    assert all(len(passage.station_ids) == 1 and code_of(passage) != Code.SAME_STATION for passage in plant.passages)


@pytest.mark.parametrize("speed", [1.0, 10.0])
def test_a_crawling_vehicle_that_misses_one_cam_is_not_continued_by_one_in_its_place(speed: float) -> None:
    plant = Plant(COMMON)
    table = plant.core._table
    near = replace(CAR, speed=1.0, start=-60.0)
    list(table.use([near.cam(plant.plaza, 1.0)]))
    list(table.use([replace(near, speed=speed, start=-61.0, since=2.0).named(8).cam(plant.plaza, 2.0)]))
    (update,) = next(
        iter(table.use([replace(near, speed=speed, start=-61.0, since=2.0).named(8).cam(plant.plaza, 2.9)]))
    )
    assert update.continues is None


def test_the_evidence_of_a_very_long_passage_is_its_end_as_much_as_a_message_holds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def evidence() -> PassageEvidence:
        plant = Plant(COMMON)
        plant.register(7)
        plant.drive(CAR, until=20.0)
        charged = plant.passages[-1]
        assert plant.states[-1] == "charged" and charged.evidence is not None
        return charged.evidence

    whole = evidence()
    assert len(encode(whole)) <= EVIDENCE_BYTES
    monkeypatch.setattr("services.core.toll.core.EVIDENCE_BYTES", len(encode(whole)) // 2)
    cut = evidence()
    assert len(encode(whole)) // 3 < len(encode(cut)) <= len(encode(whole)) // 2
    assert cut.frames == whole.frames[-len(cut.frames) :]
    assert cut.lanes == tuple(row for row in whole.lanes if row.sampled_ns >= cut.frames[0].received_ns)


def test_used_cam_are_given_in_messages_that_the_broker_passes_on() -> None:
    core = Plant(COMMON).core
    core._table.used = [(0, (k, k, bytes(2304), "authenticated", "0123456789abcdef")) for k in range(1, 501)]
    found: list[UsedCam] = []
    while cams := core.used():
        found += cams
        message = UsedCams(sampled_ns=1, since_ns=1, cams=cams)
        assert len(encode(message)) <= USED_BYTES + 200
    assert [cam.sampled_ns for cam in found] == list(range(1, 501))
    delta = TollDelta(
        sampled_ns=10**18, plaza=64 * "p", valid=True, reason=400 * "r", north_m=-1.234567890123456, east_m=-1.2,
        sd_m=1.234567890123456, fixes=10, window_s=60.0,
    )  # fmt: skip
    deltas = DELTAS_AT_ONCE * (delta,)
    assert len(encode(UsedCams(sampled_ns=1, since_ns=1, cams=(), deltas=deltas))) + USED_BYTES < MANY_BYTES - 1_000


def test_tracks_beyond_what_a_message_holds_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    plant = Plant(COMMON)
    plant.drive(CAR, Vehicle(8, "n1", error=COMMON), until=5.0)
    (first, second) = plant.core.tracks(START_NS).tracks
    monkeypatch.setattr("services.core.toll.core.TRACKS_BYTES", len(encode(first)) + 10)
    assert plant.core.tracks(START_NS).tracks == (first,) != (second,)
    assert plant.core.rejected["tracks left out"] == 1

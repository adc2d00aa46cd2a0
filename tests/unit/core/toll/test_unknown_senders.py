"""What stations without a ticket cannot do to vehicles that are authenticated."""

from collections import Counter
from dataclasses import replace

import pytest

from services.core.toll import core, tracks
from services.core.toll.codes import Code
from services.core.toll.process import Config, Process
from services.core.toll.settings import Settings, TrackSettings
from services.core.toll.tracks import Repetitions
from shared.messages.base import Tick
from shared.messages.toll import AlarmKind, TollAlarm, TollTrack
from shared.messages.v2x import Authentication, CamList
from tests.support.v2x.toll import START_NS, Plant, Vehicle, example_plaza

COMMON = (2.5, -1.5)  # [m, north and east] error that the receivers have in common
TICKETED = {"authentication": Authentication.AUTHENTICATED, "signer": "6999ac931bf65e6b"}
CAR = Vehicle(7, "n2", error=COMMON, extra=TICKETED)
PLACES = 20  # of tracks, in the tests


def ghosts(count: int) -> list[Vehicle]:
    return [Vehicle(1000 + k, "s1", speed=0.01, start=-240.0 - k, error=COMMON) for k in range(count)]


def small(tracks: int = PLACES) -> Settings:
    return Settings(track=TrackSettings(max_tracks=tracks))


def tracks_of(plant: Plant) -> Counter[bool]:
    def is_known(track: TollTrack) -> bool:
        return track.ticket is not None

    return Counter(map(is_known, plant.core.tracks(START_NS).tracks))


def test_a_table_full_of_unknown_stations_has_room_for_an_authenticated_one() -> None:
    plant = Plant(COMMON, small())
    plant.drive(*ghosts(PLACES + 5), until=1.0)
    plant.core.cover_all([CAR.cam(plant.plaza, 0.0)])
    plant.drive(*ghosts(PLACES + 5), CAR, since=1.0, until=20.0)
    assert plant.states == ["open", "crossed", "charged"]
    assert tracks_of(plant) == {True: 1, False: PLACES - 1}
    assert plant.core.rejected["track_evicted"] == 1 and plant.core.rejected["too_many_tracks"] > 5


def test_the_station_that_is_silent_for_longest_gives_way() -> None:
    plant = Plant(COMMON, small())
    plant.drive(*ghosts(PLACES), until=0.1)
    plant.drive(*ghosts(PLACES)[1:], since=0.1, until=0.2)
    plant.drive(CAR, since=0.2, until=0.3)
    left = {track.station_id for track in plant.core.tracks(START_NS).tracks}
    assert left == {7, *(vehicle.station_id for vehicle in ghosts(PLACES)[1:])}


def test_authenticated_stations_give_way_to_none() -> None:
    plant = Plant(COMMON, small(2))
    tickets = [replace(CAR, station_id=k, start=-250.0 + 10.0 * k, extra={**TICKETED, "signer": f"{k:016x}"})
               for k in range(3)]  # fmt: skip
    plant.drive(*tickets, *ghosts(1), until=1.0)
    assert tracks_of(plant) == {True: 2} and plant.core.rejected["track_evicted"] == 0


def test_a_full_table_is_an_alarm_once_a_minute() -> None:
    process, plaza = Process(Config(track=TrackSettings(max_tracks=PLACES))), example_plaza()
    alarms = []
    for second in range(70):
        now_ns = START_NS + second * 10**9
        cams = tuple(vehicle.cam(plaza, float(second)) for vehicle in ghosts(PLACES + 1))
        for message in (CamList(received_ns=now_ns, source="v2x0", cams=cams), Tick(now_ns=now_ns)):
            alarms += [answer for answer in process.handle(message) if isinstance(answer, TollAlarm)]
    assert [(alarm.kind, alarm.ghosts) for alarm in alarms] == [(AlarmKind.GHOSTS, PLACES)] * 2
    assert {alarm.reason_code.code for alarm in alarms if alarm.reason_code} == {Code.TRACKS_FULL}


def test_an_unknown_station_at_the_barrier_keeps_it_closed_for_no_vehicle_that_is_known() -> None:
    car, ghost = replace(CAR, lane="n3"), Vehicle(66, "n3", speed=0.001, start=-2.0, error=COMMON)
    for ahead, is_open in ((ghost, True), (replace(ghost, extra={**TICKETED, "signer": "1" * 16}), False)):
        plant = Plant(COMMON)
        plant.core.cover_all([car.cam(plant.plaza, 0.0)])
        plant.drive(ahead, until=1.0)
        plant.drive(ahead, car, since=1.0, until=12.0)
        mine = {command.open for command in plant.gates if command.passage_id == passage_of(plant, 7)}
        assert mine == {is_open}


def passage_of(plant: Plant, station: int) -> str:
    return next(passage.passage_id for passage in plant.passages if station in passage.station_ids)


def test_a_copy_without_its_signature_does_not_make_the_genuine_cam_late() -> None:
    memory, cam = Repetitions(), CAR.cam(example_plaza(), 1.0)
    copy = cam.model_copy(update={"authentication": Authentication.UNSIGNED, "signer": None})
    assert [memory.add(each) for each in (copy, cam, cam, copy)] == [None, None, *["late_or_repeated"] * 2]


def test_one_ghost_of_a_hundred_metres_overlaps_no_car_that_is_forty_metres_behind() -> None:
    for length_m, overlapped in ((102.0, 0), (25.0, 0), (4.5, 0)):
        ghost = replace(CAR, station_id=99, start=CAR.start + 40.0,
                        extra={**TICKETED, "signer": "1" * 16, "vehicle_length_m": length_m})  # fmt: skip
        assert overlaps(ghost) == overlapped
    near = replace(CAR, station_id=99, start=CAR.start + 15.0,
                   extra={**TICKETED, "signer": "1" * 16, "vehicle_length_m": 25.0})  # fmt: skip
    assert overlaps(near) == 1


def overlaps(ahead: Vehicle) -> int:
    plant = Plant(COMMON)
    plant.core.cover_all([CAR.cam(plant.plaza, 0.0), ahead.cam(plant.plaza, 0.0)])
    plant.drive(ahead, CAR, until=16.0)
    return max(len(passage.overlaps) for passage in plant.passages)


def test_long_frames_have_a_budget_of_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracks, "TABLE_BYTES", 100_000)
    monkeypatch.setattr(core, "TAKEN_BYTES", 50_000)
    plant, vehicles = Plant(COMMON), [*ghosts(10), CAR]
    for step in range(120):
        cams = [vehicle.cam(plant.plaza, step / 10.0) for vehicle in vehicles]
        list(plant.core.use([cam.model_copy(update={"frame": cam.frame.ljust(2304, b"\0")}) for cam in cams]))
        plant.core.used()
    table = plant.core._table
    held = {track.station_id: sum(len(frame[2]) for frame in track.frames) for track in table.tracks}
    assert held == {track.station_id: track.frame_bytes for track in table.tracks}
    assert sum(held.values()) <= 100_000 and max(held.values()) == held[7]
    assert sum(len(received[2]) for _, received in plant.core._taken) <= 50_000
    assert plant.core.rejected["frame_dropped"] > 0 and plant.core.rejected["used_cam_dropped"] > 0


def test_one_track_keeps_few_frames_before_its_passage_and_no_more_than_evidence_holds_in_it() -> None:
    waiting = tracks.Track(1, 0, [7], 0, 0, 0, 0)
    for number in range(500):
        waiting.keep((number, number, bytes(1000), "unsigned", None))
    assert len(waiting.frames) == tracks.FRAMES_BEFORE and waiting.frames[-1][0] == 499
    waiting.has_passage = True
    for number in range(500):
        waiting.keep((number, number, bytes(1000), "unsigned", None))
    assert waiting.frame_bytes == len(waiting.frames) * 1000 == tracks.TRACK_BYTES


def test_unsigned_frames_stop_no_continuation_of_an_authenticated_vehicle_and_take_none_over() -> None:
    """A ghost behind it falls silent with it, and another one appears where it goes on under its next ticket."""
    plant = Plant(COMMON)
    plant.register(7, 70)
    ghost = Vehicle(8, "n2", start=CAR.start - 3.0, error=COMMON)
    after = replace(CAR.named(70), extra={**TICKETED, "signer": "0123456789abcdef"})
    plant.drive(CAR, ghost, until=8.0)
    plant.drive(after, replace(ghost, station_id=9, start=CAR.start - 1.0), since=8.0, until=20.0)
    known = [passage for passage in plant.passages if passage.authenticated]
    assert known[-1].station_ids == (7, 70) and known[-1].state.is_final
    assert plant.core.rejected["ambiguous_continuation"] == 0


def test_a_track_that_is_deleted_keeps_no_others_alive() -> None:
    plant = Plant(COMMON)
    kept = list[tracks.Track]()
    for n in range(12):  # a chain of station IDs, each of which appears where the one before would be
        plant.drive(CAR.named(100 + n), since=0.3 * n, until=0.3 * (n + 1))
        kept += [track for track in plant.core._table.tracks if track not in kept]
    plant.drive(since=3.6, until=60.0)
    assert len(kept) > 5 and not plant.core._table.tracks
    assert all(track.predecessor is None and not track.others for track in kept)

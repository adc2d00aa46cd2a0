"""core.toll as a process: when the delta position is estimated, and what a new process takes over."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from services.core.toll.process import Config, In, Out, Process
from shared.errors import ConfigError
from shared.messages.base import Tick
from shared.messages.toll import OpenPassages, RegisteredStation, TollDelta, TollPassage, TollTracks
from shared.messages.v2x import CamList
from shared.runtime.config import parse_vehicle
from shared.toll.plaza import plaza_path
from tests.support.v2x.tickets import that_requires_tickets
from tests.support.v2x.toll import FAR_NS, SECOND_NS, START_NS, Vehicle, example_plaza, fix, nothing_open

COMMON = (2.5, -1.5)  # [m, north and east] error that all receivers have in common
PLAZA = example_plaza()
CAR = Vehicle(7, "n2", error=COMMON)
FIX_LATENCY_S = 0.06


def stamp(t: float) -> int:
    return START_NS + round(t * SECOND_NS)


def inputs(since: float, until: float, *, tick_phase_s: float, with_fixes: bool = True) -> Iterator[In]:
    """What arrives from one time [s] to another: fixes of full seconds, ticks, ten CAM a second of a vehicle."""
    arrivals: list[tuple[float, In]] = []
    for second in range(round(since), round(until)):
        if with_fixes:
            arrivals.append((second + FIX_LATENCY_S, fix(PLAZA, float(second), *COMMON)))
        arrivals.append((second + tick_phase_s, Tick(now_ns=stamp(second + tick_phase_s))))
        for tenth in range(10):
            t = second + tenth / 10.0
            cams = CamList(received_ns=stamp(t + 0.02), source="v2x0", cams=(CAR.cam(PLAZA, t),))
            arrivals.append((t + 0.02, cams))
    return (message for _, message in sorted(arrivals, key=lambda arrival: arrival[0]))


def run(process: Process, messages: Iterator[In]) -> list[Out]:
    return [answer for message in messages for answer in process.handle(message)]


def newest_delta_applied(answers: list[Out]) -> bool:
    track = [answer for answer in answers if isinstance(answer, TollTracks)][-1].tracks[0]
    return track.delta_applied


@pytest.mark.parametrize("tick_phase_s", [0.01, 0.03, 0.5, 0.99])
def test_the_delta_is_applied_whatever_the_phase_of_the_ticks(tick_phase_s: float) -> None:
    process = Process(Config())
    answers = run(process, inputs(-5.0, 14.0, tick_phase_s=tick_phase_s))
    assert process.rejects["late_delta"] == 0
    assert newest_delta_applied(answers)
    assert sum(isinstance(answer, TollDelta) and answer.valid for answer in answers) >= 8


def test_without_fixes_a_tick_states_why_there_is_no_delta() -> None:
    answers = run(Process(Config()), inputs(0.0, 8.0, tick_phase_s=0.5, with_fixes=False))
    reasons = {answer.reason for answer in answers if isinstance(answer, TollDelta)}
    assert reasons == {"no fix of the unit's receiver"}


def test_a_new_process_applies_the_retained_delta_at_once() -> None:
    first = run(Process(Config()), inputs(-15.0, 1.0, tick_phase_s=0.5))
    retained = [answer for answer in first if isinstance(answer, TollDelta)][-1]
    again = Process(Config())
    list(again.handle(retained))
    assert newest_delta_applied(run(again, inputs(2.0, 5.0, tick_phase_s=0.5, with_fixes=False)))
    assert not newest_delta_applied(run(Process(Config()), inputs(2.0, 5.0, tick_phase_s=0.5, with_fixes=False)))


@pytest.mark.parametrize(("listed", "state"), [(True, "charged"), (False, "unregistered")])
def test_a_new_process_takes_registrations_over_from_the_ledger(listed: bool, state: str) -> None:
    station = RegisteredStation(station_id=CAR.station_id, valid_until_ns=FAR_NS)
    process = Process(Config())
    list(process.handle(nothing_open(stamp(-16.0))))
    answers = run(process, inputs(-15.0, 4.0, tick_phase_s=0.5))
    list(process.handle(OpenPassages(
        sampled_ns=stamp(4.0), passages=(), settled=(), registered=(station,) if listed else ()
    )))  # fmt: skip
    answers += run(process, inputs(4.0, 20.0, tick_phase_s=0.5))
    states = [answer.state.value for answer in answers if isinstance(answer, TollPassage) and not answer.checkpoint]
    assert states[-1] == state


def test_checkpoints_come_once_a_second_with_the_cam_and_not_with_the_tick() -> None:
    process = Process(Config())
    list(process.handle(nothing_open(stamp(-1.0))))
    by_tick = {True: 0, False: 0}
    for message in inputs(0.0, 9.0, tick_phase_s=0.5):
        for answer in process.handle(message):
            if isinstance(answer, TollPassage) and answer.checkpoint:
                by_tick[isinstance(message, Tick)] += 1
    assert by_tick[True] == 0
    assert 4 <= by_tick[False] <= 9


def test_a_plaza_that_requires_signatures_does_not_trust_the_operator_of_the_simulation(tmp_path: Path) -> None:
    """The example's file names its key, which everybody can compute; where nothing must be signed it does no harm."""
    example = plaza_path(Path("deploy/plazas/example.geojson")).read_text()
    (tmp_path / "plaza.geojson").write_text(that_requires_tickets(example))
    text = f'[vehicle]\nrole = "rsu"\n[core.toll]\nplaza_file = "{tmp_path}/plaza.geojson"\n'
    assert parse_vehicle('[vehicle]\nrole = "rsu"\n').section("core.toll", Config)
    with pytest.raises(ConfigError, match="everybody can countersign"):
        parse_vehicle(text).section("core.toll", Config)
    assert parse_vehicle(text + "[sensors.traffic]\n").section("core.toll", Config)

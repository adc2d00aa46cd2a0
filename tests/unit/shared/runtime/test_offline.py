"""The offline runtime: messages and ticks in order to every consumer."""

import itertools

import pytest

from services.sensors.simulator.scenarios import BY_NAME
from services.sensors.simulator.world import Equipment, World
from shared.messages.base import Message, Tick
from shared.messages.gnss import FixType, GnssFix, GnssRaw
from shared.messages.imu import ImuRaw, ImuSamples
from shared.messages.navigation import FilterState, NavigationPhase, NavigationSolution, NavigationState, TruthState
from shared.messages.vehicle import CanRaw
from shared.processes import Role, running
from shared.runtime import offline
from shared.runtime.config import parse_vehicle
from shared.runtime.offline import OfflineUnit
from shared.topics import BY_MESSAGE


class Echo:
    """A process that stores what it received and answers a fix with a state."""

    def __init__(self) -> None:
        self.given: list[Message] = []

    def handle(self, message: Message) -> list[Message]:
        self.given.append(message)
        if isinstance(message, GnssFix):
            return [NavigationState(
                sampled_ns=message.sampled_ns, phase=NavigationPhase.LEVELLING, since_ns=0, reason="", fixes_used=1,
                fixes_rejected=0, samples_used=0, samples_rejected=0, imu_gaps=0, resets=0,
            )]  # fmt: skip
        return []

    def close(self) -> list[Message]:
        return []


def fix(received_ns: int) -> GnssFix:
    return GnssFix(sampled_ns=received_ns, received_ns=received_ns, source="g", fix_type=FixType.NONE)


@pytest.fixture
def echoes(monkeypatch: pytest.MonkeyPatch) -> dict[str, Echo]:
    made: dict[str, Echo] = {}

    def load(name: str, _vehicle: object) -> Echo:
        return made.setdefault(name, Echo())

    monkeypatch.setattr(offline, "load_process", load)
    return made


def test_a_message_and_its_answers_are_delivered_to_each_consumer(echoes: dict[str, Echo]) -> None:
    published = list(OfflineUnit(parse_vehicle("")).run([fix(1)]))
    running_here = {row.name for row in running(Role.OBU)}
    answers = [NavigationState] * len(
        running_here & set(BY_MESSAGE[GnssFix].consumers)
    )  # one of each process that received the fix
    assert len(answers) >= 2
    assert [type(m) for m in published] == [GnssFix, *answers]
    assert [type(m) for m in echoes["core.fusion"].given] == [GnssFix]
    assert [type(m) for m in echoes["controller.mode"].given] == [GnssFix, *answers]
    assert echoes["parsers.imu"].given == []


def test_a_process_does_not_receive_its_own_messages(echoes: dict[str, Echo]) -> None:
    row = BY_MESSAGE[FilterState]
    assert row.producers == ("core.fusion",) and "core.fusion" in row.consumers
    zero = (0.0, 0.0, 0.0)
    state = FilterState(
        sampled_ns=1, fingerprint="", imu="i", quaternion_ned_from_body=(1.0, *zero), velocity_ned_m_s=zero,
        latitude_deg=0.0, longitude_deg=0.0, height_ellipsoid_m=0.0, accelerometer_bias_m_s2=zero,
        gyroscope_bias_rad_s=zero, accelerometer_scale=zero, gyroscope_scale=zero, parameters=(),
        specific_force_body_m_s2=zero, angular_rate_body_rad_s=zero, covariance=(),
    )  # fmt: skip
    assert list(OfflineUnit(parse_vehicle("")).run([state])) == [state]
    assert echoes["core.fusion"].given == []


def test_a_tick_is_delivered_each_second_before_later_messages(echoes: dict[str, Echo]) -> None:
    list(OfflineUnit(parse_vehicle(""), ["core.fusion"]).run([fix(10**9 - 1), fix(10**9 + 5), fix(5 * 10**9)]))
    kinds = [m.now_ns if isinstance(m, Tick) else type(m) for m in echoes["core.fusion"].given]
    assert kinds == [GnssFix, 10**9, GnssFix, 5 * 10**9, GnssFix]


def test_unchecked_messages_are_valid() -> None:
    """Producers on the path of an inertial sample skip validation; their messages must be valid."""
    world = World(BY_NAME["urban"], 1, 10**18, Equipment())
    driven = (message for _, message in itertools.islice(world, 4000) if not isinstance(message, TruthState))
    kinds = set()
    for message in OfflineUnit(parse_vehicle("")).run(driven):
        assert type(message).model_validate(message.model_dump()) == message
        kinds.add(type(message))
    assert {ImuRaw, GnssRaw, CanRaw, ImuSamples, NavigationSolution} <= kinds


def test_only_processes_that_are_functions_of_their_messages_are_created(echoes: dict[str, Echo]) -> None:
    OfflineUnit(parse_vehicle("[sensors.simulator]"))
    assert set(echoes) == {row.name for row in running(Role.OBU) if row.is_function}

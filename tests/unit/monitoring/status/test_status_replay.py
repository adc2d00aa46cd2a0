"""The state of a replay: recorded time, and jumps that leave nothing of what they left."""

from collections.abc import Iterable

from services.monitoring.status.replay import ReplayFeed
from services.monitoring.status.state import State
from shared.bus.bus import Envelope
from shared.messages.base import Message
from shared.messages.navigation import NavigationSolution
from shared.messages.operation import Origin, OriginKind, Outage
from shared.messages.replay import ReplayEvents, ReplayState, TrustChange
from shared.messages.trust import TrustLevel
from shared.runtime.config import parse_vehicle
from tests.support.bus.envelopes import sent
from tests.support.drives.meridian import BEGIN_NS, SECOND, solution, verdict

HOST_NS = 1_800_000_000 * SECOND
END_NS = BEGIN_NS + 1000 * SECOND


def replayed(message: Message, at_ns: int, producer: str = "core.fusion") -> Envelope:
    return sent(message, HOST_NS, producer)._replace(recorded_ns=at_ns)


def status(at_s: float, epoch: int, *, complete: bool = True, playing: bool = True, speed: float = 1.0) -> Envelope:
    state = ReplayState(
        position_ns=BEGIN_NS + round(at_s * SECOND), begin_ns=BEGIN_NS, end_ns=END_NS, speed=speed, playing=playing,
        epoch=epoch, complete=complete, name="drive.mcap",
    )  # fmt: skip
    return sent(state, HOST_NS, "sensors.replay")


def jump(at_s: float, epoch: int, messages: Iterable[Envelope], *, playing: bool = True) -> list[Envelope]:
    return [status(at_s, epoch, complete=False, playing=playing), *messages, status(at_s, epoch, playing=playing)]


def made() -> tuple[State, ReplayFeed]:
    state = State("car", parse_vehicle("").processes, HOST_NS, 900.0, replay=True)
    return state, ReplayFeed(state)


def moment(at_s: float) -> list[Envelope]:
    at_ns = BEGIN_NS + round(at_s * SECOND)
    origin = Origin(now_ns=at_ns, kind=OriginKind.REPLAY, name="drive")
    return [
        sent(origin, HOST_NS, "sensors.replay"),
        replayed(solution(at_ns), at_ns),
        replayed(verdict(at_ns, TrustLevel.SAFE), at_ns, "core.trust"),
    ]


def shown_s(state: State, feed: ReplayFeed, host_ns: int = HOST_NS) -> float | None:
    message = state.newest(NavigationSolution, "navigation/solution", feed.now_ns(host_ns), live=True)
    return None if message is None else (message.sampled_ns - BEGIN_NS) / SECOND


def test_time_is_that_of_the_recording_and_passes_at_the_speed_of_the_replay() -> None:
    _, feed = made()
    feed.take([status(10.0, 1, speed=4.0)], HOST_NS)
    assert feed.now_ns(HOST_NS) == BEGIN_NS + 10 * SECOND
    assert feed.now_ns(HOST_NS + SECOND // 2) == BEGIN_NS + 12 * SECOND
    feed.take([status(12.0, 1, playing=False)], HOST_NS + SECOND // 2)
    assert feed.now_ns(HOST_NS + 90 * SECOND) == BEGIN_NS + 12 * SECOND


def test_time_stops_when_the_replay_is_lost() -> None:
    _, feed = made()
    feed.take([status(10.0, 1)], HOST_NS)
    assert feed.now_ns(HOST_NS + 60 * SECOND) == BEGIN_NS + 11 * SECOND
    assert feed.lost(HOST_NS + 2 * SECOND) and not feed.lost(HOST_NS + SECOND // 2)


def test_a_jump_back_leaves_nothing_that_is_newer() -> None:
    state, feed = made()
    feed.take(jump(500.0, 1, moment(500.0)), HOST_NS)
    assert shown_s(state, feed) == 500.0
    outage = Outage(what="sensors.imu", since_ns=BEGIN_NS + 498 * SECOND, until_ns=BEGIN_NS + 499 * SECOND, cause="x")
    feed.take([replayed(outage, BEGIN_NS + 500 * SECOND, "monitoring.health")], HOST_NS)
    assert len(state.outages.closed()) == 1
    feed.take(jump(20.0, 2, moment(20.0)), HOST_NS)
    state.pass_to(feed.now_ns(HOST_NS))
    assert shown_s(state, feed) == 20.0
    assert not state.outages.closed()
    assert max(stamp for stamp, _ in state.trust_history.changes) <= BEGIN_NS + 20 * SECOND
    assert state.verdict.state == "safe"


def test_until_a_jump_is_complete_the_position_before_is_shown() -> None:
    state, feed = made()
    feed.take(jump(500.0, 1, moment(500.0), playing=False), HOST_NS)
    first, *rest = jump(20.0, 2, moment(20.0), playing=False)
    feed.take([first, *rest[:-1]], HOST_NS)
    assert (shown_s(state, feed), feed.now_ns(HOST_NS)) == (500.0, BEGIN_NS + 500 * SECOND)
    feed.take(rest[-1:], HOST_NS)
    assert (shown_s(state, feed), feed.now_ns(HOST_NS)) == (20.0, BEGIN_NS + 20 * SECOND)
    assert feed.fresh


def test_what_the_processes_of_the_replay_say_of_themselves_is_not_part_of_the_recording() -> None:
    state, feed = made()
    feed.take([*jump(5.0, 1, moment(5.0)), sent(solution(BEGIN_NS), HOST_NS, "core.fusion")], HOST_NS)
    assert shown_s(state, feed) == 5.0


def test_verdicts_and_outages_before_a_position_come_from_the_events_of_the_drive() -> None:
    state, feed = made()
    changes = tuple(
        TrustChange(since_ns=BEGIN_NS + s * SECOND, state=n) for s, n in ((0, "initialising"), (90, "safe"))
    )
    outage = Outage(what="sensors.imu", since_ns=BEGIN_NS + 30 * SECOND, until_ns=BEGIN_NS + 31 * SECOND, cause="x")
    feed.take(jump(100.0, 1, moment(100.0)), HOST_NS)
    feed.take([sent(ReplayEvents(trust=changes, outages=(outage,)), HOST_NS, "sensors.replay")], HOST_NS)
    assert [name for _, name in state.trust_history.changes][:2] == ["initialising", "safe"]
    assert [outage.what for outage in state.outages.closed()] == ["sensors.imu"]
    feed.take(jump(10.0, 2, moment(10.0)), HOST_NS)
    assert [name for _, name in state.trust_history.changes][:1] == ["initialising"]
    assert not state.outages.closed()


def test_silence_in_a_recording_is_no_loss_of_the_broker() -> None:
    state, feed = made()
    feed.take(jump(5.0, 1, moment(5.0)), HOST_NS)
    feed.take([status(60.0, 1)], HOST_NS)
    state.pass_to(feed.now_ns(HOST_NS))
    assert not state.judgement.problems
    assert shown_s(state, feed) is None, "the solution is stale"
